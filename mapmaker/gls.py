"""Maximum-likelihood maps, with the noise measured as white levels and correlated modes.

The map m solves ``(P^T N^-1 P) m = P^T N^-1 d`` for pointing P and streams d, which are not cleaned beforehand: modes
that the atmosphere shares among the detectors, and low frequencies, get low weights, but their sky signal is not lost.
For any symmetric N^-1 the expectation of the map is the sky.

The noise of a scan is assumed stationary and independent of the other scans. N is block diagonal in the discrete cosine
transform of the scan, which is the Fourier transform of the scan followed by its mirror image: a circulant
approximation without the step between the end of a scan and its beginning, which for red noise would leak a power of
f^-2 over all frequencies. In each frequency band ``N_b = w_b diag(r) + V_b V_b^T``, with smooth modes of the array and
those that stand out of the rest (`mapmaker.noise_modes`), inverted by Woodbury's identity. Phases between detectors are
not modelled: a pattern that drifts over the array takes two modes. The mean of a scan has no weight.

Noise that is measured in a scan fits that scan: a map with it loses noise, and as much of the sky, to modes that are
there by chance. The noise of a scan is therefore measured in other scans of the observation. Each number that is
measured adds a little noise. The model is small: one level w_b a band, one r a detector, one power of all smooth
modes of a degree, and further modes where they are significant.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.fft import dct, idct

from mapmaker.binning import map_shape
from mapmaker.errors import InsufficientDataError
from mapmaker.geometry import MapGeometry
from mapmaker.iterative import StreamBlock, subtract_sky
from mapmaker.linear_maps import SolvedMap, solved_map
from mapmaker.noise_modes import band_noise
from mapmaker.normal_equations import SolveOptions
from mapmaker.timestreams import FocalPlane
from mapmaker.validation import argument_error, band_edges, bounds_of_scans, number, reals, whole


@dataclass(frozen=True)
class GlsOptions:
    """Options of the noise model and of the solution.

    Attributes
    ----------
    band_edges_hz : (n_band + 1,)
        Frequency bands; other frequencies get no weight.
    max_modes
        Largest number of modes in a band.
    eigenvalue_cut
        A mode that is not smooth is kept if its eigenvalue exceeds this times the largest eigenvalue of uncorrelated
        noise.
    folds
        Parts of the scans: the noise of a part is measured in the others.
    solve
        Convergence of the solution.
    """

    band_edges_hz: tuple[float, ...] = (0.0, 0.1, 0.2, 0.4, 0.8, 1.6, np.inf)
    max_modes: int = 20
    eigenvalue_cut: float = 2.0
    folds: int = 6
    solve: SolveOptions = field(default_factory=SolveOptions)

    def __post_init__(self) -> None:
        """Raise OutOfRangeError or ValueError for values out of range."""
        band_edges("band_edges_hz", self.band_edges_hz)
        whole("max_modes", self.max_modes, least=0)
        whole("folds", self.folds, least=2, most=2**31 - 1)
        number("eigenvalue_cut", self.eigenvalue_cut, least=1)


@dataclass(frozen=True)
class NoiseModel:
    """Noise covariance of one cosine mode, ``diag(white) + modes modes^T``, in each band.

    A mode of frequency f and noise of one-sided PSD p [mK^2/Hz] has the variance p rate / 2.

    Attributes
    ----------
    band_edges_hz : (n_band + 1,)
    white_mk2 : (n_band, n_det)
        0 for a dead detector, which gets no weight.
    modes_mk
        (n_det, n_mode) of each band.
    sample_rate_hz
    """

    band_edges_hz: tuple[float, ...]
    white_mk2: np.ndarray
    modes_mk: tuple[np.ndarray, ...]
    sample_rate_hz: float

    @cached_property
    def inverse_white(self) -> np.ndarray:
        """Inverse white levels (n_band, n_det) [1/mK^2]; 0 for dead detectors."""
        return np.divide(1.0, self.white_mk2, out=np.zeros_like(self.white_mk2), where=self.white_mk2 > 0)

    @cached_property
    def inverse_modes(self) -> tuple[np.ndarray, ...]:
        """U (n_det, n_mode) [1/mK] of each band in Woodbury's identity ``N^-1 = diag(inverse_white) - U U^T``."""
        return tuple(_woodbury(row, modes) for row, modes in zip(self.inverse_white, self.modes_mk, strict=True))

    def apply(self, data_mk: np.ndarray, index: np.ndarray, scan_bounds: np.ndarray) -> np.ndarray:
        """Compute ``N^-1 d``; see `NoiseWeight`. Samples without data have to be filled: they are not left out here."""
        out = np.empty_like(data_mk)
        self._write(data_mk, scan_bounds, out)
        return out

    def _write(self, data_mk: np.ndarray, scan_bounds: np.ndarray, out: np.ndarray) -> None:
        n_right, n_det, _ = data_mk.shape
        for n, samples in _scans_of_a_length(scan_bounds):
            scans = data_mk[..., samples].reshape(n_right, n_det, -1, n).transpose(0, 2, 1, 3)
            weighed = self._weighed(dct(np.ascontiguousarray(scans), axis=-1, norm="ortho", overwrite_x=True))
            weighed = idct(weighed, axis=-1, norm="ortho", overwrite_x=True)
            out[..., samples] = weighed.transpose(0, 2, 1, 3).reshape(n_right, n_det, -1)

    def _weighed(self, modes: np.ndarray) -> np.ndarray:
        """Compute N^-1 of cosine modes (n_right, n_scan, n_det, n_samp), in place."""
        modes[..., 0] = 0
        bands = band_slices(modes.shape[-1], self.sample_rate_hz, self.band_edges_hz)
        for band, white, shared in zip(bands, self.inverse_white, self.inverse_modes, strict=True):
            x, u = modes[..., band], shared.astype(modes.dtype)
            seen = u @ (u.T @ x)
            x *= white.astype(modes.dtype)[:, None]
            x -= seen
        modes[..., : bands[0].start] = 0
        modes[..., bands[-1].stop :] = 0
        return modes

    def white(self, scan_bounds: np.ndarray) -> np.ndarray:
        """Weights (n_det, n_scan) of the white noise alone, the mean over all cosine modes; see `NoiseWeight`."""
        shares = []
        for n_samp in np.diff(scan_bounds, axis=1)[:, 0].tolist():
            bands = band_slices(n_samp, self.sample_rate_hz, self.band_edges_hz)
            shares.append([(band.stop - band.start) / n_samp for band in bands])
        return self.inverse_white.T @ np.array(shares).T


@dataclass(frozen=True)
class ScanNoise:
    """Noise of the scans of an observation, measured in other scans.

    Attributes
    ----------
    models
        Scan s has the model ``s % len(models)``, of the scans that it was measured with.
    """

    models: tuple[NoiseModel, ...]

    def apply(self, data_mk: np.ndarray, index: np.ndarray, scan_bounds: np.ndarray) -> np.ndarray:
        """Compute ``N^-1 d``; see `NoiseModel.apply`."""
        out = np.empty_like(data_mk)
        for k, model in enumerate(self.models):
            model._write(data_mk, scan_bounds[k :: len(self.models)], out)
        return out

    def white(self, scan_bounds: np.ndarray) -> np.ndarray:
        """Weights (n_det, n_scan) of the white noise alone; see `NoiseWeight`."""
        n_model = len(self.models)
        weights = np.empty((len(self.models[0].white_mk2[0]), len(scan_bounds)))
        for k, model in enumerate(self.models):
            weights[:, k::n_model] = model.white(scan_bounds[k::n_model])
        return weights


def _scans_of_a_length(scan_bounds: np.ndarray) -> Iterator[tuple[int, slice | np.ndarray]]:
    """Lengths of scans, and the samples of all scans of each; a slice where these are contiguous."""
    length = np.diff(scan_bounds, axis=1)[:, 0]
    for n in np.unique(length).tolist():
        samples = (scan_bounds[length == n, :1] + np.arange(n)).ravel()
        together = samples[-1] - samples[0] == len(samples) - 1
        yield n, slice(int(samples[0]), int(samples[-1]) + 1) if together else samples


def _woodbury(inverse_white: np.ndarray, modes: np.ndarray) -> np.ndarray:
    weighted = inverse_white[:, None] * modes
    inner = np.linalg.cholesky(np.eye(modes.shape[1]) + modes.T @ weighted)
    return np.linalg.solve(inner, weighted.T).T


def measure_scan_noise(
    data_mk: np.ndarray,
    scan_bounds: np.ndarray,
    focal_plane: FocalPlane,
    sample_rate_hz: float,
    options: GlsOptions,
) -> ScanNoise:
    """Measure the noise of each scan of an observation in other scans; arguments and errors are those of
    `measure_noise`.

    The scans are divided into `options.folds` parts, every nth scan in one. The noise of a part is measured in all
    others. A single scan is measured in itself.
    """
    scan_bounds = bounds_of_scans(scan_bounds, np.shape(data_mk)[-1])
    n_part = max(1, min(options.folds, len(scan_bounds)))
    part = np.arange(len(scan_bounds)) % n_part
    others = [scan_bounds[part != k] if n_part > 1 else scan_bounds for k in range(n_part)]
    models = (measure_noise(data_mk, bounds, focal_plane, sample_rate_hz, options) for bounds in others)
    return ScanNoise(tuple(models))


def measure_noise(
    data_mk: np.ndarray,
    scan_bounds: np.ndarray,
    focal_plane: FocalPlane,
    sample_rate_hz: float,
    options: GlsOptions,
) -> NoiseModel:
    """Measure the noise of one observation from all its scans together; sky signal counts as noise.

    Parameters
    ----------
    data_mk : (n_det, n_samp)
    scan_bounds : (n_scan, 2)
    focal_plane
        Positions of the detectors.
    sample_rate_hz
    options

    Raises
    ------
    ValueError
        Where a band has fewer than 2 modes of the scans, or no detector with noise.
    """
    data_mk = reals("data_mk", data_mk, (len(focal_plane.x_rad), "n_samp"), finite=False)
    scan_bounds = bounds_of_scans(scan_bounds, data_mk.shape[1])
    number("sample_rate_hz", sample_rate_hz, above=0)
    if not len(scan_bounds):
        raise InsufficientDataError("scan_bounds: found no scan; one or more are expected")
    amplitudes = _band_amplitudes(data_mk, scan_bounds, sample_rate_hz, options.band_edges_hz)
    for b, n in enumerate(item.shape[1] for item in amplitudes):
        if n < 2:
            low, high = options.band_edges_hz[b : b + 2]
            raise InsufficientDataError(f"the scans have {n} modes from {low} to {high} Hz; 2 or more are needed")
    if not all(np.isfinite(item).all() for item in amplitudes):
        raise argument_error("data_mk", "values that are not finite in scans", "finite ones are")
    found = band_noise(
        np.array([item @ item.T / item.shape[1] for item in amplitudes]),
        np.array([item.shape[1] for item in amplitudes]),
        np.column_stack([focal_plane.x_rad, focal_plane.y_rad]),
        max_modes=options.max_modes,
        eigenvalue_cut=options.eigenvalue_cut,
    )
    return NoiseModel(options.band_edges_hz, found.white_mk2, found.modes_mk, sample_rate_hz)


def _band_amplitudes(
    data_mk: np.ndarray, scan_bounds: np.ndarray, sample_rate_hz: float, band_edges_hz: tuple[float, ...]
) -> list[np.ndarray]:
    """Amplitudes (n_det, n) of the cosine modes of all scans in each band."""
    bands = [band_slices(stop - start, sample_rate_hz, band_edges_hz) for start, stop in scan_bounds]
    sizes = np.array([[band.stop - band.start for band in of_scan] for of_scan in bands])
    amplitudes = [np.empty((len(data_mk), n)) for n in sizes.sum(axis=0)]
    ends = np.cumsum(sizes, axis=0)
    for (start, stop), of_scan, until, size in zip(scan_bounds, bands, ends, sizes, strict=True):
        modes = dct(data_mk[:, start:stop].astype(np.float64), axis=1, norm="ortho")
        for item, band, end, n in zip(amplitudes, of_scan, until, size, strict=True):
            item[:, end - n : end] = modes[:, band]
    return amplitudes


def band_slices(n_samp: int, sample_rate_hz: float, band_edges_hz: tuple[float, ...]) -> list[slice]:
    """Cosine modes of a scan in each band; mode k has the frequency ``k rate / (2 n_samp)``, mode 0 is in no band."""
    frequency = np.arange(n_samp) * sample_rate_hz / (2 * n_samp)
    edges = np.maximum(np.searchsorted(frequency, band_edges_hz), 1)
    return [slice(int(low), int(high)) for low, high in zip(edges[:-1], edges[1:], strict=True)]


def gls_map(
    geometry: MapGeometry,
    observations: Callable[[], Iterable[StreamBlock]],
    *,
    sample_rate_hz: float,
    options: GlsOptions,
    sky_mk: np.ndarray | None = None,
) -> SolvedMap:
    """Maximum-likelihood map of observations, each with the noise measured from its own streams.

    Scans with values that are not finite are discarded.

    Parameters
    ----------
    geometry
    observations
        Function that returns all blocks for one pass, one at a time. Their weights are not used.
    sample_rate_hz
    options
    sky_mk : (n_stokes, n_y, n_x), optional
        Earlier map, subtracted from the streams before their noise is measured; needed unless the sky is faint compared
        with the noise.

    Raises
    ------
    ValueError
        For no observation, pixels or a sky of another map, and as `measure_noise`.
    """
    number("sample_rate_hz", sample_rate_hz, above=0)
    if sky_mk is not None:
        sky_mk = reals("sky_mk", sky_mk, map_shape(geometry))

    def weigh(block: StreamBlock) -> ScanNoise:
        rest = block if sky_mk is None else subtract_sky(block, sky_mk)
        return measure_scan_noise(rest.data_mk, block.scan_bounds, block.focal_plane, sample_rate_hz, options)

    return solved_map(geometry, observations, weigh, options=options.solve)
