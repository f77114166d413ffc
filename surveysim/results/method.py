"""Sentences on the scoring of a survey and on the quoted estimate."""

import math

# The quoted estimate of sigma(A).
CONTROLLED = (
    "sigma(A) is controlled: the simulated value times the forecast for all weather over the forecast for the weather "
    "drawn, which removes the chance of the weather sample"
)
PLAIN = "sigma(A) is plain: for the weather drawn, since this cleaning has no forecast to use as control variate"
OPTIMAL_METHOD = (
    "The optimal set takes for each observation the pipeline whose own map has the lowest noise for its signal, which "
    "favours chance; the transfer function of each pipeline is measured on two observations."
)
METHOD = (
    "Noise is measured from co-adds with random signs (jackknives); the power of a sky in the "
    "time-streams is divided by the effective number of observations.",
    "Each data set weights its observations by their measured noise in the scored multipoles. That lowers the co-added "
    "noise by chance; this bias is corrected.",
    "sigma(A)^-2 is the sum over bins of n/2 (M/N)^2: every data set weights its bins by its own noise.",
    "M is a flat spectrum after beam and pixels, convolved with the taper's power spectrum, times the transfer "
    "function.",
    "The noise-only sets have the transfer function of the actual data's cleaning; the masked array has its own.",
    "The noise-only sets take each detector's Hann-tapered PSD of the cleaned time-streams and are not cleaned again.",
    OPTIMAL_METHOD,
    "The masked array is cleaned with its own detectors alone; scaled means times its share of the detectors.",
)


def method(compared: bool, bandwidth: float | None, correlation: float) -> tuple[str, ...]:
    """Return lines on the scoring of a scene.

    Parameters
    ----------
    compared : bool
        Whether pipelines are compared.
    bandwidth : float
        Width of the band; 0 if it is not known.
    correlation : float
        Correlation of the measured noise of neighbouring bins; NaN for a single bin.
    """
    lines = [line for line in METHOD if compared or line != OPTIMAL_METHOD]
    band = "over the band" if bandwidth else "at the band's centre, as the scene gives no instrument.bandwidth"
    lines.append(f"Rayleigh-Jeans temperature is converted to CMB temperature {band}.")
    if not math.isnan(correlation):
        lines.append(
            f"The taper correlates the measured noise of neighbouring bins by {correlation:.2f}; n allows for it in "
            "sums over bins."
        )
    return tuple(lines)
