"""What the figures of a run, a sweep and a measurement of accuracy show, and what to look for in them."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Caption:
    """Title of a figure, the text in its place, its axes and what it shows, and what to look for."""

    title: str
    alt: str
    shows: str
    look_for: str


# By name of the file. In braces: facts of the run (`surveysim.report.html.survey`).
RUN = {
    "timestream_psd": Caption(
        "Time-streams before and after cleaning",
        "Power spectral density of the time-streams against frequency, before and after cleaning, with noise levels.",
        "Across: frequency [Hz]. Up: power spectral density [mK^2/Hz] of single scans, a mean over detectors and "
        "observations. Where the weather varies, the left panel has the quarter of the observations with the lowest B2 "
        "and the right panel that with the highest. Dotted: the beam's power at the multipole that a frequency has at "
        "the scan speed, at an arbitrary scale.",
        "Look for how close cleaning ({cleaning}) brings the blue line to the measured white level (black) where the "
        "beam still passes the sky. What is left above it at low frequency is the noise that correlates detectors.",
    ),
    "map": Caption(
        "The co-added map and its noise",
        "Two maps in right ascension and declination: the smoothed signal and the noise of each pixel.",
        "Across and up: right ascension and declination [deg]. Left: the co-added map of the actual data, smoothed "
        "with the beam; right: the noise of its pixels, from the weights; both in µK_CMB. The square is the area that "
        "is scored. Nothing is shown where the noise is above four times its lowest.",
        "Look for even noise inside the square, and for stripes along the scans, which would be noise that cleaning "
        "left. {sky}",
    ),
    "map_psd": Caption(
        "Noise of the co-added maps",
        "Noise power spectral density of the map of each data set against multipole.",
        "Across: multipole ℓ. Up: power spectral density of the noise [µK²_CMB sr], from co-adds with random signs. "
        "Shaded: the standard error of each bin. Thin lines: the forecast in closed form. A masked array's is "
        "multiplied by its share of the detectors. Grey line: a flat CMB spectrum as large as σ(A), as the map shows "
        "it; grey area: the scored range.",
        "Look for the distance from the actual line down to the uncorrelated one, which is what correlations between "
        "detectors cost, and from there to the white one, which is what low-frequency noise costs.",
    ),
    "transfer_function": Caption(
        "What is left of the signal",
        "Power transmission of cleaning, beam and pixel against multipole.",
        "Across: multipole ℓ. Up: share of the signal's power that is left by cleaning (points with errors, from flat "
        "CMB skies through the same scans and cleaning; thin lines: forecast), by the beam and by the map's pixels, "
        "and by all of them.",
        "Look for the multipole below which cleaning takes the signal with the noise, and for the one above which the "
        "beam leaves nothing. The score lives between the two.",
    ),
    "cumulative_sensitivity": Caption(
        "Cumulative sensitivity",
        "Uncertainty of a flat band power from all data above a multipole, against that multipole.",
        "Across: the lowest multipole ℓ used. Up: uncertainty σ(A) of a flat band power [µK²_CMB] from all bins from "
        "there on. Shaded: its Monte Carlo error. The vertical line is the scene's lowest multipole, where the lines "
        "have the values of the score table.",
        "Look for how steep the lines are at the vertical line: so much does the result hang on the lowest multipole.",
    ),
    "weights": Caption(
        "Multipoles that the score comes from",
        "Share of each bin of multipole in the score of each data set.",
        "Across: multipole ℓ. Up: share of a bin in the score of each data set. Vertical lines: effective multipoles.",
        "Look for where the weight lies. It should be far from the ends of the scored range.",
    ),
    "weather": Caption(
        "Noise of each observation",
        "Noise of each observation's map against the amplitude B2 of the atmosphere, coloured by wind speed.",
        "Across: amplitude B2 of the atmosphere drawn for the observation. Up: noise of its map [mK^2 a sample], in "
        "the scored band if there is one. Colour: wind speed [arcmin/s]. Dashed: the white level of the streams.",
        "Look for the B2 from which observations leave the white level: only beyond it does the atmosphere rule the "
        "noise. Observations of high noise get little weight.",
    ),
    "run_time": Caption(
        "Error against run time",
        "Relative error of the survey's uncertainty against the time of simulation.",
        "Across: time of simulation [s] with as many workers as this run had, without starting. Up: relative error of "
        "the best estimate of σ(A). Solid: with more observations alone. Dashed: with more sign flips and window skies "
        "as well, where they are needed. Diamond: this run.",
        "Look for where the solid line flattens: from there on more observations bring little without more sign flips. "
        "Lines are extrapolated from this run's own errors and times.",
    ),
}
SWEEP = Caption(
    "All points",
    "Uncertainty of a flat band power of all points, and its ratio to the reference point.",
    "Across: the values of the first axis; a colour for each combination of the others. Left: σ(A) of the actual data "
    "set [µK²_CMB] with Monte Carlo errors; dashes or triangles are the forecast. Right: its ratio to the reference "
    "point. Coloured bars are errors that count what all points have in common; grey bars are those that independent "
    "runs would have. Orange diamonds: points that can't be compared with the reference, as one of the two loses too "
    "many scans.",
    "Look for points further than two coloured bars from 1, which differ from the reference point, and for the lowest.",
)
FORECAST_SWEEP = Caption(
    "All points",
    "Forecast uncertainty of a flat band power of all points, and its ratio to the reference point.",
    "Across: the values of the first axis; a colour for each combination of the others. Left: σ(A) of the actual data "
    "set [µK²_CMB] by forecast. Right: its ratio to the reference point.",
    "Look for the lowest point, and for how flat the line is around it.",
)
ACCURACY = Caption(
    "What accuracy costs",
    "Errors and biases of the score against CPU time, for every setting of every knob.",
    "Across: CPU time without start-up [s]. Up: relative error of σ(A) for numbers of observations (left) and for the "
    "other Monte Carlo knobs (middle); bias of σ(A) for numerical knobs (right), or its error where that is larger "
    "(squares). Diamonds are the scene's own settings. Grey: the Pareto front, beyond which nothing is both faster and "
    "better.",
    "Look for diamonds far from the grey line: there another setting is as good and faster.",
)
