"""Sums over a survey for the forecast of maximum-likelihood maps, with the noise of each band of frequencies measured.

The noise model of a run is that of `mapmaker.gls`: in each band the mean covariance of the cleaned streams over the
band's cosine modes, as a level of each detector, smooth modes of the array, and those that stand out of the rest. With
W_b its inverse, a map mode that is seen at the frequency f through the taper w along a scan has

    z = sum_b S_b s^H W_b s,    S_b = int_b |w(f - f')|^2 df',
    Q = sum_b s^H W_b F [int_b |w(f - f')|^2 C(f') df'] F^H W_b s,

over bands of both signs of f'. The mean of a scan, the cosine mode 0, is in no band. C is the sum of white noise with
its correlations, excess and readout noise, and the waves of the layers, whose phases between detectors the noise model
leaves out.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mapmaker.gls import GlsOptions
from mapmaker.noise_modes import band_noise
from surveysim.forecasting.closed_forms import readout_level, readout_lines
from surveysim.forecasting.layer_table import sine_nodes, stream_frequencies
from surveysim.forecasting.mode_response import LayerWaves, Modes, ProjectedArray, projected_array
from surveysim.forecasting.noise_bins import MapBins
from surveysim.forecasting.noise_model import map_bins
from surveysim.forecasting.observing_conditions import Correlation, ObservingConditions, white_shapes
from surveysim.forecasting.solved_maps import ObservationNoise, SolvedSums
from surveysim.reduction.cleaning_pipelines import CleaningPipeline
from surveysim.reduction.setup import Setup
from surveysim.telescope.pixel_coherence import part_weights
from surveysim.telescope.scans import Scans, samples_per_scan
from surveysim.timestreams.low_frequency import excess_psd

# Components, and steps of the response, with a closed form of these maps.
COMPONENTS = ("photon", "detector", "excess", "readout_noise", "atmosphere", "sky")
STEPS = ("pointing_errors", "responsivity")
MOST_DETECTORS = 600  # whose covariance is inverted in each band
_DRAWS = 8  # observations that represent a survey


@dataclass(frozen=True, eq=False)
class Band:
    """Band of frequencies, up to `high_hz`: its number of cosine modes in a scan."""

    low_hz: float
    high_hz: float
    n_mode: int
    step_hz: float

    def holds(self, frequency_hz: np.ndarray) -> np.ndarray:
        """Tell which frequencies (n,), of either sign, are in the band."""
        at_hz = np.abs(frequency_hz)
        return (at_hz >= self.low_hz) & (at_hz < self.high_hz)

    @property
    def width_hz(self) -> float:
        """Width of the band, of both signs."""
        return 2 * self.n_mode * self.step_hz


def noise_bands(scans: Scans, edges_hz: Sequence[float]) -> list[Band]:
    """Bands of a noise model; each cosine mode stands for the frequencies about it."""
    n_samp, rate = samples_per_scan(scans), scans.sample_rate_hz
    step = rate / (2 * n_samp)
    first = np.maximum(np.ceil(np.asarray(edges_hz) / step - 1e-9), 1)
    first = np.minimum(first, n_samp)
    # The last modes are those of the rest up to half of the rate.
    return [
        Band((low - 0.5) * step, np.inf if high == n_samp else (high - 0.5) * step, int(high - low), step)
        for low, high in zip(first[:-1], first[1:], strict=True)
    ]


@dataclass(frozen=True, eq=False)
class StreamNoise:
    """Two-sided cross-spectra of the streams of an observation.

    Attributes
    ----------
    white : (n_det, n_det)
        White noise [mK^2/Hz].
    lines
        Correlation (n_det, n_det) of excess noise and of each part of the readout noise, their lines (n_line,) of both
        signs [Hz], and the variances (n_line,) of these.
    layers
        Waves of each layer: their frequencies (n_wave,), variances (n_wave,) and amplitudes in the detectors
        (n_det, n_wave).
    """

    white: np.ndarray
    lines: list[tuple[np.ndarray, np.ndarray, np.ndarray]]
    layers: list[tuple[np.ndarray, np.ndarray, np.ndarray]]

    def mean(self, band: Band) -> np.ndarray:
        """Mean real cross-spectra (n_det, n_det) in a band."""
        total = self.white
        for correlation, at_hz, variance in self.lines:
            total = total + correlation * (variance[band.holds(at_hz)].sum() / band.width_hz)
        for at_hz, variance, seen in self.layers:
            inside = band.holds(at_hz)
            waves = seen[:, inside] * np.sqrt(variance[inside] / band.width_hz)
            total = total + (waves @ waves.conj().T).real
        return total


def likelihood_sums(
    setup: Setup, pipeline: CleaningPipeline, conditions: ObservingConditions, share: np.ndarray, options: GlsOptions
) -> tuple[Modes, SolvedSums, ObservationNoise]:
    """Add up the observations of a survey, with fractions of kept samples (n_obs,); a few represent all."""
    bins = map_bins(setup, pipeline, conditions, white_shapes(setup), None)
    modes, n_obs = bins[0].frequencies.modes, len(share)
    total, each = np.zeros((5, len(bins), bins[0].frequencies.at_hz.size)), np.empty((2, n_obs, len(modes.wave)))
    for alike in _representatives(conditions):
        draw = int(alike[len(alike) // 2])
        found = np.stack([_observation(setup, pipeline, of, conditions, draw, options) for of in bins], axis=1)
        total += share[alike].sum() / n_obs * found
        normal, noise, layer = (modes.mean(conditions.speed_share[draw] @ item) for item in found[[0, 1, 3]])
        each[:, alike] = np.array([noise, layer])[:, None] / normal**2
    normal, noise, signal, _, fitted = (item.reshape(-1, *modes.wave.shape) for item in total)
    taken = modes.mean(fitted.mean(axis=0).ravel()) / modes.mean(normal.mean(axis=0).ravel())
    return modes, SolvedSums(normal, noise, signal), ObservationNoise(each[0], each[1], taken)


def _representatives(conditions: ObservingConditions) -> list[np.ndarray]:
    """Group the observations by the strength of the layer; the middle one of a group represents it."""
    order = np.argsort(conditions.layers.sum(axis=0), kind="stable")
    return np.array_split(order, min(_DRAWS, len(order)))


def _observation(
    setup: Setup,
    pipeline: CleaningPipeline,
    of: MapBins,
    conditions: ObservingConditions,
    draw: int,
    options: GlsOptions,
) -> np.ndarray:
    """Normal matrix, noise, signal, the layers' part of the noise, and the part of the normal matrix (5, n_mode).

    That part is the one that the modes of the noise model which are found in the data, on the same streams, take of it.
    """
    spectrum, camera = of.frequencies, setup.camera
    array = projected_array(
        camera.focal_plane.subset(pipeline.rows),
        float(conditions.angle[draw, of.node].mean()),
        responsivity=camera.responsivity[pipeline.rows],
        algorithm=pipeline.spatial_step or "none",
        assumed=of.arrays[0].assumed,
    )
    noise = _stream_noise(of, array, conditions, draw)
    steering, n_det = array.phases(spectrum.modes.wave.ravel()), len(array.place)
    project = array.cleaned(np.eye(n_det))
    normal, added, signal, of_layers, fitted = total = np.zeros((5, spectrum.at_hz.size))
    n_scans = setup.observing.scans.n_scans
    others = max(1, n_scans - -(-n_scans // options.folds))  # scans that the noise of a scan is measured in
    bands = noise_bands(setup.observing.scans, options.band_edges_hz)
    n_vectors = np.array([band.n_mode for band in bands]) * others
    covariances = np.array([project @ noise.mean(band) @ project.T for band in bands])
    weights = _weights(covariances, n_vectors, array.place, options)
    for band, n_vector, (weight, n_fitted) in zip(bands, n_vectors, weights, strict=True):
        inside = band.holds(spectrum.nodes_hz)
        through = _through(of, spectrum.nodes_hz[inside], spectrum.weight_hz[inside])
        weighed = weight @ steering
        response = project.T @ weighed
        seen_weight = through * _product(steering, weighed)
        normal += seen_weight
        fitted += seen_weight * n_fitted / n_vector
        signal += through * _product(response, array.responsivity[:, None] * steering)
        added += through * _product(response, noise.white @ response)
        for correlation, at_hz, variance in noise.lines:
            inside = band.holds(at_hz)
            added += _through(of, at_hz[inside], variance[inside]) * _product(response, correlation @ response)
        for at_hz, variance, seen in noise.layers:
            inside = band.holds(at_hz)
            amplitude = response.conj().T @ seen[:, inside]
            leak = spectrum.apodization.at(spectrum.at_hz[:, None] - at_hz[inside]) ** 2
            of_layers += ((amplitude.real**2 + amplitude.imag**2) * leak) @ variance[inside]
    added += of_layers
    rate = setup.observing.scans.sample_rate_hz
    scale = np.array([1 / n_det, rate / n_det, 1 / array.responsivity.sum(), rate / n_det, 1 / n_det])
    return total * scale[:, None]


def _product(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Real parts of the products of columns (n_det, n), (n,)."""
    return np.einsum("ij,ij->j", left.conj(), right).real


def _through(of: MapBins, at_hz: np.ndarray, strength: np.ndarray) -> np.ndarray:
    """Power of lines (n,) that enters each mode through the taper, (n_mode,)."""
    spectrum = of.frequencies
    return spectrum.apodization.at(spectrum.at_hz[:, None] - at_hz) ** 2 @ strength


def _stream_noise(of: MapBins, array: ProjectedArray, conditions: ObservingConditions, draw: int) -> StreamNoise:
    n_det = len(array.place)
    photon, excess = of.correlations
    parts = part_weights(float(conditions.stop_share[draw]), len(photon))
    shared = sum(weight * _dense(item, n_det) for weight, item in zip(parts, photon, strict=True))
    white = conditions.white[draw] * _dense(of.independent, n_det) + conditions.shared[draw] * shared
    lines = [(_dense(excess, n_det), *_excess_lines(of, float(conditions.excess[draw])))]
    for psd, at_hz, variance, correlation in readout_lines(of) if of.scene.readout_noise else ():
        level = readout_level(psd, conditions)[draw]
        lines.append((_dense(correlation, n_det), *_in_scans(of.scans, at_hz, level * variance / 2)))
    return StreamNoise(white / 2, lines, list(_layers(of, array, conditions, draw)))


def _dense(correlation: Correlation, n_det: int) -> np.ndarray:
    """Correlation as a matrix."""
    if correlation is None:
        return np.eye(n_det)
    return correlation if isinstance(correlation, np.ndarray) else correlation @ np.eye(n_det)


def _excess_lines(of: MapBins, variance: float) -> tuple[np.ndarray, np.ndarray]:
    """Lines of excess noise of a variance, of both signs."""
    if of.scene.excess is None:
        return np.zeros(0), np.zeros(0)
    n_samp, rate = samples_per_scan(of.scans), of.scans.sample_rate_hz
    step = rate / (2 * n_samp)
    psd = variance * excess_psd(of.scene.excess, 1.0, n_samp, 2 * n_samp, rate)[1:]
    positive = step * np.arange(1, n_samp + 1)
    return np.concatenate([-positive, positive]), np.tile(psd * step / 2, 2)


def _in_scans(scans: Scans, at_hz: np.ndarray, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lines as scans see them: waves slower than the first cosine mode as trends, which are in that mode but for 1 %.

    A wave of frequency f has the variance ``(2 pi f T)^2 / 12`` of its own about the mean of a scan of length T.
    """
    n_samp, rate = samples_per_scan(scans), scans.sample_rate_hz
    first = rate / (2 * n_samp)
    slow = np.abs(at_hz) < first / 2
    of_trend = (2 * np.pi * at_hz * n_samp / rate) ** 2 / 12
    return np.where(slow, np.sign(at_hz) * first, at_hz), np.where(slow, of_trend, 1.0) * variance


def _layers(
    of: MapBins, array: ProjectedArray, conditions: ObservingConditions, draw: int
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Waves of each layer in each of its motions and shifts of evolution."""
    for number, amplitude in enumerate(conditions.layers[:, draw]):
        waves: LayerWaves = of.layer_waves(number)
        seen = array.phases(2 * np.pi * waves.alpha) * array.responsivity[:, None]
        place = int(np.argmin(np.abs(sine_nodes(of.conditions) - conditions.sine[draw])))
        power = amplitude * conditions.gain[draw] ** 2 * waves.power[place]
        motions = conditions.motions[number][draw, of.node]
        for motion in motions.tolist():
            for shift, part in zip(waves.shift_hz, waves.shift_share, strict=True):
                yield stream_frequencies(waves, motion) + shift, power * part / len(motions), seen


def _weights(
    covariances: np.ndarray, n_vectors: np.ndarray, place: np.ndarray, options: GlsOptions
) -> list[tuple[np.ndarray, int]]:
    """Inverse noise (n_det, n_det) of each band, modelled as in `mapmaker.gls`, and its modes that are not smooth.

    The covariances (n_band, n_det, n_det) are those of detectors at complex positions, measured on `n_vectors` cosine
    modes of each band.
    """
    found = band_noise(
        covariances,
        n_vectors,
        np.column_stack([place.real, place.imag]),
        max_modes=options.max_modes,
        eigenvalue_cut=options.eigenvalue_cut,
    )
    each = zip(found.white_mk2, found.modes_mk, found.n_found, strict=True)
    return [(np.linalg.inv(np.diag(white) + modes @ modes.T), count) for white, modes, count in each]
