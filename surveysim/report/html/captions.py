"""Captions of the figures of a run, a sweep and a convergence study: axes, contents, and points to look for."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Caption:
    """Title of a figure, its text alternative, its axes and contents, and points to look for."""

    title: str
    alt: str
    shows: str
    look_for: str


# By name of the file. In braces: facts of the run (`surveysim.report.html.survey`).
RUN = {
    "track": Caption(
        "Scans and samples",
        "Two panels: the track of the boresight about the centre of the field, and the samples in pixels of the map.",
        "Across and up: offsets from the centre of the field, east to the left. Left: track of the boresight in the "
        "first observation, coloured by its speed on the sky, or by time where the speed is constant; vermilion: "
        "turnarounds, which are simulated and in no map; dots: detectors at the start. Turnarounds that are not "
        "simulated are left out. Right: samples of the actual data in each pixel, of all observations. The square is "
        "the scored area.",
        "Look for an even number of samples inside the square, and for tracks that cross it in several directions, "
        "which tell the sky from drifts.",
    ),
    "timestream_psd": Caption(
        "Time-streams before and after cleaning",
        "Power spectral density of the time-streams against frequency, before and after cleaning, with noise levels.",
        "Across: frequency [Hz]. Up: power spectral density [mK^2/Hz] of single scans, a mean over detectors and "
        "observations. If the weather varies, the left panel has the quarter of the observations with the lowest B2 "
        "and the right panel the quarter with the highest. Solid green: white noise of the scene; dashed green: its "
        "photon "
        "noise (BLIP, background-limited performance). Dotted: power of the beam at the multipole that corresponds "
        "to a frequency at the scan speed, on an arbitrary scale.",
        "Look for the distance between the blue line, after cleaning ({cleaning}), and the measured white level "
        "(black) at frequencies where the beam still passes the sky. The excess at low frequency is the noise that "
        "correlates detectors.",
    ),
    "map": Caption(
        "The co-added map and its noise",
        "Two maps in right ascension and declination: the smoothed signal and the noise of each pixel.",
        "Across and up: right ascension and declination. Left: the co-added map of the actual data, smoothed "
        "with the beam; right: the noise of its pixels, from the weights; both in µK_CMB. The square is the scored "
        "area. Pixels with more than four times the lowest noise are blank.",
        "Look for even noise inside the square, and for stripes along the scans: they are noise that cleaning left. "
        "{sky}",
    ),
    "map_psd": Caption(
        "Noise of the co-added maps",
        "Noise power spectral density of the map of each data set against multipole.",
        "Across: multipole ℓ. Up: power spectral density of the noise [µK²_CMB sr], from co-adds with random signs. "
        "Shaded: the standard error of each bin. Thin lines: the forecast in closed form. Scaled: the PSD of a masked "
        "array, multiplied by its share of the detectors. Grey line: a flat CMB spectrum with A = σ(A), as it appears "
        "in the "
        "map; grey area: the scored range.",
        "Look for the distance from the actual line down to the uncorrelated one, the cost of correlations between "
        "detectors, and from there to the white one, the cost of low-frequency noise.",
    ),
    "transfer_function": Caption(
        "Transfer functions",
        "Power transmission of cleaning, beam and pixel against multipole.",
        "Across: multipole ℓ. Up: fraction of the signal's power that passes cleaning (points with errors, from flat "
        "CMB skies through the same scans and cleaning; thin lines: forecast), the beam, the map's pixels, and all of "
        "them. Grey area: the scored range.",
        "Look for the multipole below which cleaning removes the signal with the noise, and for the one above which "
        "the beam removes it: bins of the scored range beyond them add little to the score.",
    ),
    "sky": Caption(
        "Sky in and out",
        "Three panels: the sky that goes in, the map of it that comes back, and the transfer function of modes.",
        "Left: the scene's sky through the beam, averaged over pixels. Middle: the map of it without noise, after "
        "scans and cleaning ({cleaning}), of the observations with signal simulations. Both in µK_CMB, less their "
        "medians, on the scored area, with one scale: that of the map that comes back. "
        "Right: amplitude that is left of modes with the multipoles ℓ_x and ℓ_y, from the simulated skies.",
        "Look for sources of the left panel in the middle one, the hollows around them, and for the stripes of the "
        "right panel where scans along that direction lose all long waves.",
    ),
    "cumulative_sensitivity": Caption(
        "Cumulative sensitivity",
        "Uncertainty of a flat band power from all data above a multipole, against that multipole.",
        "Across: the lowest multipole ℓ used. Up: uncertainty σ(A) of a flat band power [µK²_CMB] from all bins above "
        "it. Shaded: its Monte Carlo error. Scaled: of a masked array, multiplied by its share of the detectors. At "
        "the vertical line, the scene's lowest multipole, the lines have the "
        "values of the score table.",
        "Look for the slope at the vertical line: the steeper, the more the result depends on the lowest multipole.",
    ),
    "weights": Caption(
        "Weights of multipoles in the score",
        "Share of each bin of multipoles in the score of each data set.",
        "Across: multipole ℓ. Up: share of a bin in σ(A)^(-2) of each data set. Vertical lines: effective multipoles.",
        "Look for the multipoles with the largest shares: σ(A) comes from them. Where a share is large at an end of "
        "the scored range, σ(A) depends on where the range ends.",
    ),
    "weather": Caption(
        "Noise of each observation",
        "Noise of each observation's map against the amplitude B2 of the atmosphere, coloured by wind speed.",
        "Across: amplitude B2 of the atmosphere drawn for the observation. Up: noise of its map, as variance of "
        "one sample [mK^2], from the scored multipoles if there is a score. Colour: wind speed [arcmin/s]. Dashed: "
        "white level of the time-streams.",
        "Look for the distance of the points from the dashed line: white noise limits observations close to it; "
        "atmosphere and low-frequency noise that cleaning left limit those far above. Observations with high noise get "
        "little weight.",
    ),
    "spectra": Caption(
        "Band powers and null tests",
        "Two panels: band powers of the first split over the input spectrum, and null tests in units of their errors.",
        "Across: multipole ℓ. Left: band powers [µK²_CMB] from the cross-spectra of the first split, with Monte Carlo "
        "errors; line: those of the spectrum of the simulated sky, where it is a spectrum alone; diamonds: those of "
        "the sky itself, with its sample variance. Right: power of half the difference of the parts of each split, "
        "less that of their noise, over its error; the label has the probability to "
        "exceed. Grey area: one standard error.",
        "Look for points that scatter about the line and about zero by their errors. A null test that fails tells of "
        "a difference between the parts that the sky and the noise do not have.",
    ),
    "run_time": Caption(
        "Error against run time",
        "Relative error of the survey's uncertainty against the time of simulation.",
        "Across: time of simulation [s] with the workers of this run, without start-up, "
        "compilation, scoring and figures. Up: relative error of the best "
        "estimate of σ(A). Solid: with more observations alone. Dashed: with more sign-flipped co-adds and simulated "
        "skies as well, if they are needed. Diamond: this run.",
        "Look for the slope of the solid line: where it flattens, a smaller error needs more sign-flipped co-adds. The "
        "lines are extrapolated from this run's own errors and times.",
    ),
}
SWEEP = Caption(
    "All points",
    "Metric of all points, and its ratio to the reference point.",
    "Across: the values of the first axis; a colour for each combination of the others. Left: the metric of the actual "
    "data set, by default σ(A), with Monte Carlo errors; dashes or triangles are the forecast. Right: its ratio to the "
    "reference point. Coloured bars are paired errors, which allow for the noise and weather that points share; grey "
    "bars are errors of independent runs. Orange diamonds: points that are not comparable with the reference, as one "
    "of the two loses too many scans.",
    "Look for points further than two coloured bars from 1, which differ from the reference point, and for the best.",
)
FORECAST_SWEEP = Caption(
    "All points",
    "Forecast of the metric of all points, and its ratio to the reference point.",
    "Across: the values of the first axis; a colour for each combination of the others. Left: the metric of the "
    "actual data set, by default σ(A), by forecast. Right: its ratio to the reference point.",
    "Look for the best point, and for the curvature around it.",
)
BUDGET = Caption(
    "Survey time by stage",
    "Bars of survey time from the least scene to the whole one, and the cost of each stage removed or added alone.",
    "Across: survey time that gives the same score, in percent of the whole scene's. Left: each bar adds the cost of a "
    "stage added alone to the least scene (grey at the top); the orange bar is the rest of the whole scene's time, the "
    "interactions of the stages. Right: the cost of each stage, removed alone from the whole scene (discs) and added "
    "alone to the least one (squares). Bars are paired errors.",
    "Look for the longest bars, which a better camera shortens, for stages at 0 within their error bars, which this "
    "scene can do without, and for discs far from their squares: stages whose cost depends on the others.",
)
ACCURACY = Caption(
    "Accuracy and its cost",
    "Errors and biases of the score against CPU time, for every setting of every parameter.",
    "Across: CPU time without start-up [s]. Up: relative error of σ(A) for numbers of observations (left) and for the "
    "other Monte Carlo parameters (middle); bias of σ(A) for numerical parameters (right), or its error if that is "
    "larger (squares). Diamonds are the scene's own settings. Grey: the Pareto front.",
    "Look for diamonds far from the grey line: there another setting is as good and faster.",
)

OPTIMUM = Caption(
    "The metric along each knob",
    "Forecasts of the metric against each knob, with the range within 1 % of the best design.",
    "Across: a knob. Up: the metric, by forecast. Blue: designs along this knob, with the others at the best design; "
    "the line is a smooth surface through the designs near it. Grey: all allowed designs of the search. Orange: "
    "within 1 % of the best.",
    "Look for the width of the orange range: inside it other reasons may decide. A range that ends at the edge of the "
    "panel ends with the range that was searched.",
)
FRONT = Caption(
    "Two metrics that compete",
    "Designs by their two metrics, with the Pareto front.",
    "Across and up: the two metrics, by forecast. Grey: all allowed designs of the search. Blue: the front, "
    "designs that no other beats in both metrics.",
    "Look for a corner of the front, from which little is gained in one metric for much of the other.",
)
SIMULATED_DESIGNS = Caption(
    "The simulated designs",
    "Metric of each simulated design, and its ratio to the scene as it is.",
    "Across: designs. Up: the metric of the actual data with Monte Carlo errors, and its ratio to the scene as it is "
    "with paired errors. Triangles: forecast.",
    "Look for ratios that differ by more than their errors.",
)
# Of a comparison of runs, by name of the file.
COMPARISON = {
    "map_psd": Caption(
        "Noise of the co-added maps",
        "Noise power spectral density of the actual data's map of each run against multipole.",
        "Across: multipole ℓ. Up: power spectral density of the noise of the actual data [µK²_CMB sr]. Shaded: the "
        "standard error of each bin.",
        "Look for the multipoles at which the runs differ: at high ℓ by their white noise, at low ℓ by what cleaning "
        "leaves.",
    ),
    "transfer_function": Caption(
        "Transfer functions",
        "Power transmission of cleaning of each run against multipole.",
        "Across: multipole ℓ. Up: fraction of the signal's power that scanning and cleaning pass, without beam and "
        "pixel, with its error.",
        "Look for less noise that is paid for with less signal: both fall together where cleaning removes more.",
    ),
    "timestream_psd": Caption(
        "Time-streams before and after cleaning",
        "Median power spectral density of the time-streams of each run against frequency, before and after cleaning.",
        "Across: frequency [Hz]. Up: power spectral density [mK²/Hz], a mean over detectors and a median over "
        "observations. Thin: before cleaning; thick: after it.",
        "Look for the frequency at which the thick lines leave their white level.",
    ),
}
