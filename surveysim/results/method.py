"""Sentences on how a survey is scored, and on which estimate is quoted."""

import numpy as np

# Which estimate of sigma(A) is quoted, in one sentence.
CONTROLLED = (
    "sigma(A) is controlled: the simulated value times the forecast for all weather over that for the weather drawn, "
    "which takes out the luck of the weather"
)
PLAIN = "sigma(A) is plain: of the weather drawn, since cleaning has no forecast that could take out its luck"
OPTIMAL_METHOD = (
    "The optimal set takes for each observation the pipeline whose own map has the least noise for its signal, which "
    "favours chance; what a pipeline leaves of the signal is that of two observations."
)
METHOD = (
    "Noise is measured by co-adds with random signs; of a sky in the streams 1 / n_eff of its power stays.",
    "Each data set's observations are weighted by their own measured noise in the scored multipoles. That lowers the "
    "co-added noise by chance; this bias is corrected.",
    "sigma(A)^-2 = sum over bins of n/2 (M/N)^2: every data set weights its bins by its own noise.",
    "M is a flat spectrum behind beam and pixels, convolved with the taper's power spectrum, times the window.",
    "The window is that of the actual data's cleaning, also for the simulated sets; the masked array has its own.",
    "The simulated sets take each detector's Hann-tapered PSD of the cleaned streams and are not cleaned again.",
    OPTIMAL_METHOD,
    "The masked array is cleaned with its own detectors alone; scaled means times its share of the detectors.",
)


def method(compared: bool, bandwidth: float | None, correlation: float) -> tuple[str, ...]:
    """Lines on how a scene is scored.

    `compared` says whether pipelines are compared, `bandwidth` is the instrument's, `correlation` that of neighbouring
    bins' noise, NaN for a single bin.
    """
    lines = [line for line in METHOD if compared or line != OPTIMAL_METHOD]
    band = "over the band" if bandwidth else "at the band's centre, as the scene gives no instrument.bandwidth"
    lines.append(f"Rayleigh-Jeans becomes CMB temperature {band}.")
    if not np.isnan(correlation):
        lines.append(
            f"The taper correlates the measured noise of neighbouring bins by {correlation:.2f}; n allows for it in "
            "sums over bins."
        )
    return tuple(lines)
