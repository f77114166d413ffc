"""Result of one observation: maps, sums and noise levels, without time-streams."""

from dataclasses import dataclass, field

import numpy as np

from surveysim.atmosphere.weather import Weather


@dataclass(frozen=True)
class ObservationResult:
    """Maps and sums of one observation, without time-streams.

    Attributes
    ----------
    sums : (n_set, n_y, n_x)
        Sum of samples [mK], of the type of the streams.
    hits : (n_set, n_y, n_x)
        Number of samples, int32 or int64.
    exposure : (n_set, n_y, n_x)
        Sum of the weights of the samples: `hits` where all detectors weigh alike.
    noise_mk2 : (n_set,)
        Noise variance per sample in the scored region; observations are weighted by it.
    bin_noise_mk2 : (n_set, n_bin)
        Noise variance per sample in each multipole bin; no bins without a score.
    signal_maps : (n_sky, n_transfer, 2, n, n)
        Signal simulations on the scored patch, without [0] and with [1] cleaning, for each transfer function; or None.
    discarded, iterations, removed
        Discarded scans, mean iterations, and mean removed templates per scan of each pipeline.
    figures_of_merit : (n_pipeline, n_target)
        Of the pipelines for all detectors; None unless pipelines are compared.
    weather
        None without an atmosphere.
    elevation_rad
        Mean over the scans.
    raw_psd, clean_psd : (n_freq,)
        PSDs before and after cleaning [mK^2/Hz], means over detectors.
    compared_psd : (n_compare, n_freq)
        PSDs after the other pipelines.
    white_mk2_hz
        White level after cleaning, mean over detectors.
    flagged
        Fraction of the samples of all detectors that is lost.
    seconds
        Time spent in each stage.
    split_sums, split_exposure : (n_part, n, n)
        As `sums` and `exposure` of the actual data on the scored patch, in each part of the splits within observations;
        None without any.
    """

    observation: int
    sums: np.ndarray
    hits: np.ndarray
    exposure: np.ndarray
    noise_mk2: np.ndarray
    bin_noise_mk2: np.ndarray
    signal_maps: np.ndarray | None
    discarded: tuple[int, ...]
    iterations: tuple[float, ...]
    removed: tuple[float, ...]
    figures_of_merit: np.ndarray | None
    weather: Weather | None
    elevation_rad: float
    raw_psd: np.ndarray
    clean_psd: np.ndarray
    compared_psd: np.ndarray
    white_mk2_hz: float
    flagged: float = 0.0
    seconds: dict[str, float] = field(default_factory=dict)
    split_sums: np.ndarray | None = None
    split_exposure: np.ndarray | None = None
