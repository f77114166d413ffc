"""Noise of streams in the multipole bins of a data set: in maps of cleaned streams, and in noise-only sets."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from surveysim.atmosphere.layers import Layer
from surveysim.forecasting.fitted_modes import FittedModes
from surveysim.forecasting.layer_table import LayerNoise, interpolate_motions, sine_nodes, stream_frequencies
from surveysim.forecasting.mode_response import (
    LayerWaves,
    Modes,
    ProjectedArray,
    layer_gain,
    layer_stream_gain,
    layer_waves,
    matrix_power,
    ring_modes,
    stream_power,
)
from surveysim.forecasting.observing_conditions import Correlation, NoiseCorrelations, ObservingConditions
from surveysim.forecasting.response_filters import Origin, StreamFilters
from surveysim.forecasting.scan_apodization import ScanApodization, frequency_nodes, hann_apodization, scan_apodization
from surveysim.forecasting.time_filters import ScanFilters
from surveysim.scene.analysis import Score
from surveysim.scene.scene import Scene
from surveysim.telescope.lattice_noise import GroupCorrelation, NoiseCorrelation
from surveysim.telescope.scans import Scans, samples_per_scan
from surveysim.timestreams.crosstalk import CrosstalkMatrix
from surveysim.timestreams.sharing import common_streams
from surveysim.timestreams.simulation import CameraSetup

_FROZEN_SCANS = 10  # decorrelation time in scans above which a layer is taken as frozen


@dataclass(frozen=True)
class ScanFrequencies:
    """Scored modes (n_mode,) with their aliased frequencies, and quadrature nodes and weights (n,) of white noise."""

    scans: Scans
    speed_rad_s: float
    modes: Modes
    at_hz: np.ndarray
    apodization: ScanApodization
    nodes_hz: np.ndarray
    weight_hz: np.ndarray

    @cached_property
    def white(self) -> np.ndarray:
        """Sum of the leakage of white noise of unit PSD into each mode."""
        return self.filtered_white(np.ones(len(self.nodes_hz)))

    def filtered_white(self, power: np.ndarray) -> np.ndarray:
        """Sum of the leakage of noise of a PSD (n,) at the nodes into each mode."""
        return self.apodization.sums((self.weight_hz * power)[None], self.nodes_hz, self.at_hz)

    @cached_property
    def unfiltered_white(self) -> np.ndarray:
        """Sum of the leakage of white noise that no filter in time has changed."""
        apodization = replace(self.apodization, filters=None)
        return apodization.sums(self.weight_hz[None], self.nodes_hz, self.at_hz)


def scan_frequencies(
    scans: Scans,
    score: Score,
    ell: np.ndarray,
    *,
    speed_rad_s: float,
    straight: bool,
    fitted_modes: FittedModes,
    time_filters: ScanFilters | None,
) -> ScanFrequencies:
    """Frequencies at which scans at some speed see the modes of bins around `ell` (n_bin,)."""
    rate = scans.sample_rate_hz
    modes = ring_modes(ell)
    at_hz = modes.wave.real.ravel() * speed_rad_s / (2 * np.pi)
    at_hz -= rate * np.round(at_hz / rate)  # aliases of the sample rate
    apodization = scan_apodization(
        samples_per_scan(scans) / rate,
        speed_rad_s=speed_rad_s,
        size_rad=score.size_rad,
        taper_fraction=score.taper_fraction,
        fitted_modes=fitted_modes,
        filters=time_filters,
        centred=straight,
    )
    nodes, weight = frequency_nodes(apodization, max(1.1 * np.abs(at_hz).max(), 0.5 * rate))
    return ScanFrequencies(scans, speed_rad_s, modes, at_hz, apodization, nodes, weight)


@dataclass(frozen=True, kw_only=True)
class NoiseBins(ABC):
    """Conversion of noise in the streams of detectors to noise variance a sample in the bins of a data set.

    Attributes
    ----------
    layers
        Layers of the atmosphere.
    conditions
        Observing conditions that bracket all others.
    node
        Number of the speed of `frequencies` among those of the track.
    arrays
        The pipeline's detectors, at a few angles to the scan.
    independent
        Correlation of white noise that detectors do not share: diagonal; None where all detectors are alike.
    camera, rows
        Camera, and the pipeline's detectors.
    filters
        Filters of the streams; None without time constants.
    gain_variance
        Variance of the gains about those that cleaning takes, independent between detectors.
    """

    scene: Scene
    layers: tuple[Layer, ...]
    conditions: ObservingConditions
    node: int
    frequencies: ScanFrequencies
    arrays: list[ProjectedArray]
    correlations: NoiseCorrelations
    camera: CameraSetup
    rows: np.ndarray | slice
    independent: Correlation = None
    filters: StreamFilters | None = None
    gain_variance: float = 0.0

    def passed(self, frequency_hz: np.ndarray, origin: Origin) -> np.ndarray:
        """Power (n,) that the filters leave of noise at some frequencies; 1 without filters."""
        return np.ones(len(frequency_hz)) if self.filters is None else self.filters.power(frequency_hz, origin)

    @property
    def scans(self) -> Scans:
        """Scans of an observation."""
        return self.frequencies.scans

    def layer_waves(self, number: int) -> LayerWaves:
        """Wavevectors of the layer with a number."""
        layer, seconds = self.layers[number], self.frequencies.apodization.duration_s
        longest = np.abs(self.conditions.motions[number]).max() * seconds
        time_s = layer.section.decorrelation_time_s
        evolution = time_s if time_s is not None and time_s < _FROZEN_SCANS * seconds else None
        return layer_waves(layer.strips.screen, longest, sine_nodes(self.conditions).tolist(), evolution)

    @abstractmethod
    def white(self, correlation: Correlation, origin: Origin = "light") -> np.ndarray:
        """Bins (n_bin,) of white noise of unit PSD, seen by the detectors or added at their output."""

    @abstractmethod
    def low_frequency(self, at_hz: np.ndarray, variance: np.ndarray, correlation: Correlation) -> np.ndarray:
        """Bins (n_bin,) of noise in lines (n,), positive and negative, that passes the response of the detectors."""

    @abstractmethod
    def readout(self, at_hz: np.ndarray, variance: np.ndarray, correlation: Correlation) -> np.ndarray:
        """Bins (n_bin,) of noise in lines (n,), positive and negative, added after the response of the detectors."""

    def in_common(self, shared: str, group_size: int | None = None) -> Correlation:
        """Correlation of noise that "detector", "group" or "array" has in common; None for independent detectors."""
        if shared == "detector":
            return None
        streams = common_streams(self.camera, shared, group_size)[self.rows]
        return NoiseCorrelation(GroupCorrelation(streams), np.ones(len(streams)))

    def layer_table(self, number: int, waves: LayerWaves, in_bins: Callable[..., list[np.ndarray]]) -> LayerNoise:
        """Interpolate noise over the motions against a layer at this speed of the track (`interpolate_motions`).

        `in_bins` are bins (n_bin,) at each elevation of waves of some power (n_sine, n_a) at frequencies (n_a,) [Hz].
        """

        def noise(motion: complex) -> list[np.ndarray]:
            total = np.zeros(())
            for shift, share in zip(waves.shift_hz, waves.shift_share, strict=True):
                along = stream_frequencies(waves, motion) + shift
                total = total + share * np.array(in_bins(waves.power * self.passed(along, "light"), along))
            return list(total)

        motions, speed = self.conditions.motions[number][:, self.node], self.frequencies.speed_rad_s
        return interpolate_motions(motions, sine_nodes(self.conditions), speed_rad_s=speed, noise=noise)

    @abstractmethod
    def layer(self, number: int) -> LayerNoise:
        """Bins of the layer with a number, of unit amplitude, as a function of its motion."""


def crosstalked(response: np.ndarray, crosstalk: CrosstalkMatrix | None) -> np.ndarray:
    """Turn an array response (n_det, n_mode) into that to streams before crosstalk, whose matrix is symmetric."""
    return response if crosstalk is None else crosstalk.times(response)


@dataclass(frozen=True, kw_only=True)
class MapBins(NoiseBins):
    """Bins of the map of cleaned streams.

    Attributes
    ----------
    crosstalk
        Crosstalk between the detectors; None without it.
    responses
        Response (n_det, n_mode) of each array to the modes, in single precision.
    pixel : (n_bin,)
        Window of the map's pixels.
    """

    crosstalk: CrosstalkMatrix | None
    responses: list[np.ndarray]
    pixel: np.ndarray

    def signal_amplitude(self) -> np.ndarray:
        """Amplitude (n_mode,) that response, scans and cleaning leave of each mode of the sky."""
        at_hz = self.frequencies.at_hz
        kept = []
        for array in self.arrays:
            # In double precision: what cleaning leaves of waves much longer than the array is rounding in single.
            phases = array.phases(self.frequencies.modes.wave.ravel())
            response = crosstalked(array.respond(phases), self.crosstalk)
            seen = phases * array.responsivity[:, None]
            if self.filters is not None:
                seen *= self.filters.signal(at_hz)
            kept.append(np.einsum("ij,ij->j", response.conj(), seen) / (array.responsivity @ array.weight))
        return np.mean(kept, axis=0) * self.frequencies.apodization.signal_amplitude(at_hz)

    def _mean(self, powers: list[np.ndarray], leakage: np.ndarray) -> np.ndarray:
        """Average over arrays and the modes of each bin."""
        means = [self.frequencies.modes.mean(power * leakage) for power in powers]
        return np.mean(means, axis=0) * self.scans.sample_rate_hz / 2

    def white(self, correlation: Correlation, origin: Origin = "light") -> np.ndarray:
        """Bins (n_bin,) of white noise of unit PSD, seen by the detectors or added at their output."""
        leakage = scattering = self.frequencies.white
        if self.filters is not None:
            power, weight = self.passed(self.frequencies.nodes_hz, origin), self.frequencies.weight_hz
            leakage = self.frequencies.filtered_white(power)
            # Across the scan pixels alias noise of the same frequency, along it of all others.
            scattering = (leakage + scattering * np.average(power, weights=weight)) / 2
        if (filters := self.frequencies.apodization.filters) is not None:
            kept = self.frequencies.unfiltered_white * filters.of.total.kept_power
            scattering = (scattering + kept) / 2
        return self._at_output(leakage, scattering, correlation)

    def readout(self, at_hz: np.ndarray, variance: np.ndarray, correlation: Correlation) -> np.ndarray:
        """Bins (n_bin,) of noise in lines (n,), positive and negative, added after the response of the detectors."""
        variance = variance * self.passed(at_hz, "output")
        leakage = self.frequencies.apodization.sums(variance[None], at_hz, self.frequencies.at_hz)
        return self._at_output(leakage, leakage, correlation)

    def _at_output(self, leakage: np.ndarray, scattering: np.ndarray, correlation: Correlation) -> np.ndarray:
        """Bins (n_bin,) of noise after the response of the detectors, with its leakage (n_mode,) into the modes.

        Pixels attenuate modes, and alias the lost noise over all modes, at the level of a stream, `scattering`.
        Templates of few detectors leave much less than that in modes that are longer than the array.
        """
        seen = self._mean([matrix_power(response, correlation) for response in self.responses], leakage)
        scattered = self.frequencies.modes.mean(scattering) * self.scans.sample_rate_hz / 2 * (1 - self.pixel)
        return seen * self.pixel + stream_power(self.arrays[0], correlation) * scattered

    def low_frequency(self, at_hz: np.ndarray, variance: np.ndarray, correlation: Correlation) -> np.ndarray:
        """Bins (n_bin,) of noise in lines (n,), positive and negative, that passes the response of the detectors.

        It is aliased across the scan, among modes of one frequency: independent noise is unchanged.
        """
        variance = variance * self.passed(at_hz, "light")
        leakage = self.frequencies.apodization.sums(variance[None], at_hz, self.frequencies.at_hz)
        pairs = list(zip(self.arrays, self.responses, strict=True))
        alone = [matrix_power(response * array.responsivity[:, None], None) for array, response in pairs]
        own = self._mean(alone, leakage)
        shared = self._mean([matrix_power(response, correlation) for response in self.responses], leakage)
        return own + (shared - own) * self.pixel

    def layer(self, number: int) -> LayerNoise:
        """Bins of the layer with a number, of unit amplitude, as a function of its motion."""
        waves, spectrum = self.layer_waves(number), self.frequencies
        pairs = list(zip(self.arrays, self.responses, strict=True))
        gain = np.mean([layer_gain(*pair, waves, self.gain_variance) for pair in pairs], axis=0)

        def in_bins(power: np.ndarray, along: np.ndarray) -> list[np.ndarray]:
            sums = spectrum.apodization.power_sums(gain, power, along, spectrum.at_hz)
            return [spectrum.modes.mean(item) * self.scans.sample_rate_hz for item in sums]

        table = self.layer_table(number, waves, in_bins)
        return lambda motion, sine: table(motion, sine) * self.pixel


@dataclass(frozen=True, kw_only=True)
class NoiseOnlyBins(NoiseBins):
    """Bins of a data set "uncorrelated" or "white", simulated from the PSDs of the cleaned streams.

    Attributes
    ----------
    lines_hz : (n_line,)
        Frequencies of these PSDs.
    hann
        Leakage of the Hann apodization that they are measured with.
    in_bins
        Function that converts a two-sided PSD (n_line,) to bins (n_bin,).
    """

    lines_hz: np.ndarray
    hann: ScanApodization
    in_bins: Callable[[np.ndarray], np.ndarray]

    def white(self, correlation: Correlation, origin: Origin = "light") -> np.ndarray:
        """Bins (n_bin,) of white noise of unit PSD, seen by the detectors or added at their output."""
        nodes = self.frequencies.nodes_hz
        return self._streams(nodes, self.frequencies.weight_hz * self.passed(nodes, origin), correlation)

    def low_frequency(self, at_hz: np.ndarray, variance: np.ndarray, correlation: Correlation) -> np.ndarray:
        """Bins (n_bin,) of noise in lines (n,), positive and negative, that passes the response of the detectors."""
        return self._streams(at_hz, variance * self.passed(at_hz, "light"), correlation)

    def readout(self, at_hz: np.ndarray, variance: np.ndarray, correlation: Correlation) -> np.ndarray:
        """Bins (n_bin,) of noise in lines (n,), positive and negative, added after the response of the detectors."""
        return self._streams(at_hz, variance * self.passed(at_hz, "output"), correlation)

    def _streams(self, at_hz: np.ndarray, variance: np.ndarray, correlation: Correlation) -> np.ndarray:
        # The power of the cleaned streams does not depend on the array's angle.
        psd = self.hann.sums(variance[None] / 2, at_hz, self.lines_hz)
        return stream_power(self.arrays[0], correlation) * self.in_bins(psd)

    def layer(self, number: int) -> LayerNoise:
        """Bins of the layer with a number, of unit amplitude, as a function of its motion."""
        waves = self.layer_waves(number)
        gain = np.mean([layer_stream_gain(array, waves, self.gain_variance) for array in self.arrays], axis=0)

        def in_bins(power: np.ndarray, along: np.ndarray) -> list[np.ndarray]:
            return [self.in_bins(psd) for psd in self.hann.power_sums(gain[None], power, along, self.lines_hz)]

        return self.layer_table(number, waves, in_bins)


def noise_only_bins(of: MapBins, name: str, white_above_hz: float) -> NoiseOnlyBins:
    """Bins of the noise-only set with a name, from those of the map of the actual data."""
    spectrum, apodization, rate = of.frequencies, of.frequencies.apodization, of.scans.sample_rate_hz
    seconds, n_samp = apodization.duration_s, samples_per_scan(of.scans)
    lines = np.arange(1, (n_samp - 1) // 2 + 1) / seconds
    if name == "uncorrelated":
        # Streams periodic over a scan: lines, without a mean.
        both = np.concatenate([-lines, lines])
        through = apodization.at(spectrum.at_hz[:, None] - both) ** 2 / seconds
        to_modes = rate * (through[:, : len(lines)] + through[:, len(lines) :])
    else:
        high = lines > white_above_hz
        white = spectrum.white if apodization.filters is None else spectrum.unfiltered_white
        to_modes = rate * np.outer(white, high / high.sum())

    def in_bins(psd: np.ndarray) -> np.ndarray:
        """Bins of a two-sided PSD (n_line,) of the streams."""
        return spectrum.modes.mean(to_modes @ psd)

    filters = None if apodization.filters is None else apodization.filters.of
    hann = hann_apodization(seconds, apodization.fitted_modes, filters)
    return NoiseOnlyBins(
        scene=of.scene,
        layers=of.layers,
        conditions=of.conditions,
        node=of.node,
        frequencies=spectrum,
        arrays=of.arrays,
        correlations=of.correlations,
        camera=of.camera,
        rows=of.rows,
        independent=of.independent,
        filters=of.filters,
        gain_variance=of.gain_variance,
        lines_hz=lines,
        hann=hann,
        in_bins=in_bins,
    )
