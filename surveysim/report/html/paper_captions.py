"""Captions of the paper's figures: contents and points to look for; the figures themselves state the numbers."""

from surveysim.report.html.captions import Caption

PAPER = {
    1: Caption(
        "Opacity and water vapour",
        "Zenith optical depth against precipitable water vapour at four sites, in two bands.",
        "Across: precipitable water vapour [mm]. Up: zenith optical depth, at 150 GHz and at 275 GHz.",
        "Look for the points, each site's median water: the sites differ far more by their water than by their lines.",
    ),
    2: Caption(
        "The thin-screen model",
        "Sketch of the telescope's columns through a layer to scale, and the layer's emission over one scan.",
        "Lengths in m; in the last panel, across: time [s], up: Rayleigh-Jeans temperature [mK].",
        "Look for how much the columns of all detectors overlap in the layer: they see nearly the same.",
    ),
    3: Caption(
        "Delays between detectors against the angle of their pair",
        "Slopes of the phase between detectors against the angle of their pair, for one layer and for two.",
        "Across: angle of the pair of detectors [deg]. Up: slope of the phase over separation [s/arcmin].",
        "Look for points that leave the sinusoid: one frozen layer gives exactly one sinusoid, two layers do not.",
    ),
    4: Caption(
        "Angular wind speed of the turbulent layer",
        "Histograms of measured and drawn angular wind speeds in two bands.",
        "Across: angular wind speed [arcmin/s]. Up: share of the observations per 5 arcmin/s.",
        "Compare the measured with the drawn histogram: slow winds, close to the scan speed, are flagged.",
    ),
    5: Caption(
        "Correlation between detectors against separation",
        "Correlation between detectors against their separation, with models of several indices and heights.",
        "Across: separation of detectors [arcmin]. Up: correlation less its mean [mK^2], in better (top) and worse "
        "(bottom) weather, with models of several indices (left) and heights (right).",
        "Look for how little the heights on the right differ where the points are: data do not tell the height.",
    ),
    6: Caption(
        "Index and height of the layer that fit best",
        "Histograms of the best-fitting index and height.",
        "Across: best-fit index b and best-fit height [m]. Up: number of observations.",
        "Look for the width of the index's histogram, and for the flatness of the heights'.",
    ),
    7: Caption(
        "Cumulative distribution of the atmospheric noise amplitude",
        "Share of observations below an amplitude B2 of atmospheric noise, in two bands.",
        "Across: amplitude B2 of the atmosphere [mK^2 rad^(-5/3)]. Up: share of the observations below.",
        "Look for the measured lines on the drawn ones, and for the points: the paper's quartiles.",
    ),
    8: Caption(
        "Atmospheric noise amplitude against precipitable water",
        "Amplitude B2 of atmospheric noise against precipitable water in two bands, with a prediction.",
        "Across: precipitable water [mm]. Up: amplitude B2 [mK^2 rad^(-5/3)].",
        "Look for the width of the shaded ranges: water alone does not tell the noise, its fluctuations do.",
    ),
    9: Caption(
        "Residual variance of single maps",
        "Variance of single maps beyond white noise against B2, and its cumulative distribution.",
        "Top, across: amplitude B2 [mK^2 rad^(-5/3)]; up: variance of a map beyond its white level [mK_CMB^2]. Bottom: "
        "the share of observations below a residual.",
        "Look for how much slower the residual grows than B2: what is left after cleaning is not the atmosphere alone.",
    ),
    10: Caption(
        "Time-streams before and after cleaning",
        "Power spectral density of time-streams before and after four cleaning algorithms, in good and poor weather.",
        "Across: frequency [Hz]. Up: power spectral density [mK^2/Hz], in good (left) and poor (right) weather; the "
        "lower row is the upper one in part.",
        "Look for the distance between the algorithms, and for how far all of them stay above the photon noise.",
    ),
    11: Caption(
        "Templates of quadratic subtraction",
        "Power spectral density of the six templates of quadratic subtraction, in good and poor weather.",
        "Across: frequency [Hz]. Up: power spectral density of each template [mK^2/Hz].",
        "Look for the distance of the higher orders from the zeroth at low frequency.",
    ),
    12: Caption(
        "Average subtraction and adaptive PCA",
        "Noise, transfer function and signal to noise of average subtraction and PCA, in good and poor weather.",
        "Across: frequency [Hz]. Up: power spectral density [mK^2/Hz], and the signal to noise of a flat CMB spectrum.",
        "Look for how close the two cleaning algorithms are where the signal to noise is highest.",
    ),
    13: Caption(
        "Noise of the co-added map and sensitivity to a flat CMB band power",
        "Map noise, noise over transfer function and cumulative sensitivity of each cleaning, against multipole.",
        "Across: multipole ℓ, in the lower row the lowest that is used. Up: noise PSD [µK²_CMB arcmin^2]; uncertainty "
        "σ(A) of bins and of all data above [µK²_CMB]; its ratio to that of average subtraction.",
        "Look for quadratic subtraction at low multipoles: little noise, but less signal still.",
    ),
    14: Caption(
        "Correlation of detectors below 1 Hz",
        "Histograms of correlation coefficients of adjacent and other pairs after two cleaning algorithms.",
        "Across: magnitude of the correlation coefficient below 1 Hz. Up: share of the pairs.",
        "Look for the distance between adjacent pairs (top) and others (bottom): overlap correlates neighbours alone.",
    ),
    15: Caption(
        "Correlation below 1 Hz against separation",
        "Correlation coefficient below 1 Hz against separation of detectors.",
        "Across: separation of detectors [arcmin]. Up: mean correlation coefficient below 1 Hz.",
        "Look for the fall from adjacent pairs to zero within a few (f/#)λ, and for the negative lobe behind it.",
    ),
    16: Caption(
        "Noise of the co-added map with and without correlations",
        "Noise of the map of four data sets against multipole.",
        "Across: multipole ℓ. Up: root of the map's noise PSD [µK_CMB arcmin].",
        "Look for the masked array on the uncorrelated line: with wide spacing nothing is shared, and nothing is lost.",
    ),
}
