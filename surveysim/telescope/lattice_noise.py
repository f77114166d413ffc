"""Correlated noise of overlapping pixels on lattices, without a matrix of all pairs.

Circulant embedding (Dietrich and Newsam 1997, SIAM J. Sci. Comput. 18, 1088): the lattice, square in skewed
coordinates, is embedded in a larger torus. Two cells of the torus have the correlation at their shortest separation
around it. The covariance of a torus is diagonal in Fourier space: one transform draws two samples of all detectors,
where a factor of the matrix costs a product with n_det^2 elements for each sample.

Eigenvalues are negative where the torus truncates the coherence. Alternating projections set them to zero and restore
the correlation at the separations that occur between detectors; at other separations the correlation is free. The
correlation of the result is known exactly. The torus is large enough that its error is at most `LARGEST_ERROR`.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from surveysim.runtime.errors import OutOfRangeError
from surveysim.runtime.rng import NormalDeviates
from surveysim.telescope.layouts import Lattice
from surveysim.telescope.pixel_coherence import PixelCoherence, part_weights

# Largest error of a correlation between detectors. At 0.7 (f/#)lambda the field coherence of neighbours is 0.5.
LARGEST_ERROR = 2e-3
_ROOM, _GROWTH, _MOST_SPANS = 1.1, 1.12, 8
_PROJECTIONS = 60
# Complex numbers of the fields drawn at once: they fit in the processor's cache.
_BATCH = 2**18


@dataclass(frozen=True, eq=False)
class CirculantFactor:
    """Square root of the detectors' correlation: float32 `amplitude` (n_q, n_r) of the modes, flat `cells` (n_det,)."""

    amplitude: np.ndarray
    cells: np.ndarray

    def fields(self, n: int, deviates: NormalDeviates, *, first: int = 0) -> Iterator[tuple[slice, np.ndarray]]:
        """Draw n fields from number `first` on in batches (n_det, n_batch) complex64, and yield each with its slice.

        Real and imaginary parts are independent, have unit variance, and are correlated between detectors but not
        between fields.
        """
        from scipy.fft import fft2

        step = max(1, _BATCH // self.amplitude.size)
        for start in range(0, n, step):
            places = slice(start, min(start + step, n))
            shape = (places.stop - start, *self.amplitude.shape, 2)
            modes = deviates.draw(shape, first=2 * (first + start) * self.amplitude.size).view(np.complex64)[..., 0]
            modes *= self.amplitude
            field = fft2(modes, overwrite_x=True).reshape(len(modes), -1)
            yield places, np.ascontiguousarray(field[:, self.cells].T)


@dataclass(frozen=True, eq=False)
class CirculantCorrelation:
    """Correlation C of detectors at `cells` (n_det,) of a torus, by its eigenvalues `values` (n_q, n_r).

    Their mean is 1, the correlation of a detector with itself.
    """

    values: np.ndarray
    cells: np.ndarray

    def factor(self, share: float = 1.0) -> CirculantFactor:
        """Square root of ``share C + (1 - share) I``."""
        amplitude = np.sqrt((share * self.values + (1 - share)) / self.values.size)
        return CirculantFactor(amplitude.astype(np.float32), self.cells)

    def times(self, columns: np.ndarray) -> np.ndarray:
        """Multiply C with columns (n_det, n_column), real or complex."""
        from scipy.fft import fft2, ifft2

        product = np.empty_like(columns)
        step = max(1, _BATCH // self.values.size)
        for first in range(0, columns.shape[1], step):
            some = columns[:, first : first + step].T
            field = np.zeros((len(some), self.values.size), complex)
            field[:, self.cells] = some
            modes = fft2(field.reshape(-1, *self.values.shape), overwrite_x=True) * self.values
            spread = ifft2(modes, overwrite_x=True).reshape(field.shape)[:, self.cells].T
            product[:, first : first + step] = spread if np.iscomplexobj(columns) else spread.real
        return product

    @property
    def correlation(self) -> np.ndarray:
        """Correlation of each cell with the origin, (n_q, n_r)."""
        return _correlation(self.values)


@dataclass(frozen=True, eq=False)
class LatticePixels:
    """Correlation of detectors at `cells` (n_det,) of a torus by its parts, of the eigenvalues (n_part, n_q, n_r).

    The parts add up with the weights of `surveysim.telescope.pixel_coherence.part_weights`.
    """

    values: np.ndarray
    cells: np.ndarray

    def at(self, stop_share: float) -> CirculantCorrelation:
        """Correlation for one share of the stop."""
        weights = part_weights(stop_share, len(self.values))
        return CirculantCorrelation(np.tensordot(weights, self.values, axes=1), self.cells)

    def columns(self, rows: np.ndarray | slice) -> list[CirculantCorrelation]:
        """Parts for some of the detectors."""
        return [CirculantCorrelation(values, self.cells[rows]) for values in self.values]


@dataclass(frozen=True, eq=False)
class WaferFactor:
    """Square root of the correlation of detectors on several wafers, by the factor of each; wafers share nothing."""

    parts: tuple[CirculantFactor, ...]

    def fields(self, n: int, deviates: NormalDeviates, *, first: int = 0) -> Iterator[tuple[slice, np.ndarray]]:
        """Draw fields as `CirculantFactor.fields`, the wafers side by side; each field takes consecutive deviates."""
        from scipy.fft import fft2

        sizes = [part.amplitude.size for part in self.parts]
        total, ends = sum(sizes), np.cumsum(sizes)
        step = max(1, _BATCH // total)
        for start in range(0, n, step):
            places = slice(start, min(start + step, n))
            count = places.stop - start
            modes = deviates.draw((count, total, 2), first=2 * (first + start) * total).view(np.complex64)[..., 0]
            found = []
            for part, own in zip(self.parts, np.split(modes, ends[:-1], axis=1), strict=True):
                field = fft2(own.reshape(count, *part.amplitude.shape) * part.amplitude).reshape(count, -1)
                found.append(field[:, part.cells].T)
            yield places, np.concatenate(found)


@dataclass(frozen=True, eq=False)
class WaferCorrelation:
    """Correlation of detectors on several wafers, which share nothing; `rows` are the detectors of each part."""

    parts: tuple[CirculantCorrelation, ...]
    rows: tuple[np.ndarray, ...]

    def factor(self, share: float = 1.0) -> WaferFactor:
        """Square root of ``share C + (1 - share) I``."""
        return WaferFactor(tuple(part.factor(share) for part in self.parts))

    def times(self, columns: np.ndarray) -> np.ndarray:
        """Multiply C with columns (n_det, n_column), real or complex."""
        product = np.empty_like(columns)
        for part, rows in zip(self.parts, self.rows, strict=True):
            product[rows] = part.times(columns[rows])
        return product


@dataclass(frozen=True, eq=False)
class WaferPixels:
    """Correlation of detectors on several wafers, by the wafers and their parts; detectors follow in their order."""

    wafers: tuple[LatticePixels, ...]

    def at(self, stop_share: float) -> WaferCorrelation:
        """Correlation for one share of the stop."""
        return WaferCorrelation(tuple(wafer.at(stop_share) for wafer in self.wafers), self._rows())

    def columns(self, rows: np.ndarray | slice) -> list[WaferCorrelation]:
        """Parts for some of the detectors."""
        chosen = np.arange(sum(len(wafer.cells) for wafer in self.wafers))[rows]
        places = [np.flatnonzero(np.isin(chosen, own)) for own in self._rows()]
        of_wafers = zip(self.wafers, places, self._rows(), strict=True)
        found = [wafer.columns(chosen[at] - own[0]) for wafer, at, own in of_wafers]
        return [WaferCorrelation(parts, tuple(places)) for parts in zip(*found, strict=True)]

    def _rows(self) -> tuple[np.ndarray, ...]:
        counts = [len(wafer.cells) for wafer in self.wafers]
        return tuple(np.split(np.arange(sum(counts)), np.cumsum(counts)[:-1]))


LatticeFactor = CirculantFactor | WaferFactor
LatticeCorrelation = CirculantCorrelation | WaferCorrelation


@dataclass(frozen=True, eq=False)
class GroupCorrelation:
    """Correlation of noise that all detectors of a group have in common: 1 within it, 0 between groups.

    `groups` (n_det,) are the numbers of the groups.
    """

    groups: np.ndarray

    def times(self, columns: np.ndarray) -> np.ndarray:
        """Multiply the correlation with columns (n_det, n_column), real or complex."""
        order = np.argsort(self.groups, kind="stable")
        _, first, group = np.unique(self.groups[order], return_index=True, return_inverse=True)
        product = np.empty_like(columns)
        product[order] = np.add.reduceat(columns[order], first, axis=0)[group]
        return product


@dataclass(frozen=True, eq=False)
class NoiseCorrelation:
    """Matrix (n_det, n_det) of `torus` (None: zero), multiplied by `gain` (n_det,) on both sides, for products from the
    left.
    """

    torus: LatticeCorrelation | GroupCorrelation | None
    gain: np.ndarray

    def __matmul__(self, columns: np.ndarray) -> np.ndarray:
        """Multiply the matrix with columns (n_det, n_column)."""
        gain = self.gain[:, None]
        return gain * (gain * columns if self.torus is None else self.torus.times(gain * columns))


def embed(lattice: Lattice, f_lambda_rad: float, coherence: PixelCoherence) -> LatticePixels:
    """Find the smallest torus for the detectors of a lattice with an error within `LARGEST_ERROR` of each part of
    `coherence`.

    If a change of the optics changes the size of the torus, all draws change.

    Raises
    ------
    OutOfRangeError
        If a torus of 64 times the lattice's area is too small: for dense pixels with a sharp coherence.
    """
    pitch_f_lambda, cosine = lattice.pitch_rad / f_lambda_rad, lattice.cosine
    places = lattice.cells - lattice.cells.min(axis=0)
    span = places.max(axis=0) + 1
    lags = _lags(places, span)
    wanted = coherence.parts(_length(lags, cosine) * pitch_f_lambda)
    room, error = _ROOM, math.inf
    while room <= _MOST_SPANS:
        n_q, n_r = sizes = _sizes(span, room)
        seen = lags[:, 0] % n_q, lags[:, 1] % n_r
        parts = coherence.parts(_distance(sizes, cosine) * pitch_f_lambda)
        values = np.stack([_eigenvalues(part, seen) for part in parts])
        error = float(np.abs(_correlation(values)[:, *seen] - wanted).max())
        if error <= LARGEST_ERROR:
            return LatticePixels(values, places[:, 0] * n_r + places[:, 1])
        room *= _GROWTH
    raise OutOfRangeError(
        f"found correlations off by {error:.2g} on a torus of {n_q} by {n_r} pixels {pitch_f_lambda:.3g} (f/#)lambda "
        f"apart; {LARGEST_ERROR:g} or less is expected: a larger pitch, a tapered illumination or squared coherence"
    )


def pair_sums(lattice: Lattice, f_lambda_rad: float, coherence: PixelCoherence) -> np.ndarray:
    """Sum (n_part,) of each part of the coherence over all pairs of two different detectors, both orders, exactly."""
    places = lattice.cells - lattice.cells.min(axis=0)
    lags, pairs = _counted_lags(places, places.max(axis=0) + 1)
    separation = _length(lags, lattice.cosine) * (lattice.pitch_rad / f_lambda_rad)
    return coherence.parts(separation) @ pairs - len(places)


def _correlation(values: np.ndarray) -> np.ndarray:
    """Correlation (..., n_q, n_r) of each cell of a torus with the origin, from its eigenvalues."""
    from scipy.fft import ifft2

    return ifft2(values).real


def _eigenvalues(correlation: np.ndarray, seen: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Eigenvalues, non-negative and with mean 1, of a torus with nearly this correlation at the separations `seen`."""
    from scipy.fft import fft2, ifft2

    wanted = correlation[seen]
    for _ in range(_PROJECTIONS):
        values = fft2(correlation).real
        if values.min() >= 0:
            break
        values = np.clip(values, 0, None)
        correlation = ifft2(values).real
        correlation[seen] = wanted
    return values / values.mean()


def _distance(sizes: tuple[int, int], cosine: float) -> np.ndarray:
    """Shortest distance around a torus of (n_q, n_r) cells from its origin to each cell, in pitches."""
    steps = np.stack(np.meshgrid(*map(np.arange, sizes), indexing="ij"), axis=-1)
    turns = [(a * sizes[0], b * sizes[1]) for a in range(-2, 2) for b in range(-2, 2)]
    return np.min([_length(steps + turn, cosine) for turn in turns], axis=0)


def _lags(places: np.ndarray, span: np.ndarray) -> np.ndarray:
    """List all separations (n_lag, 2) between pairs of positions, each once."""
    return _counted_lags(places, span)[0]


def _counted_lags(places: np.ndarray, span: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """List all separations (n_lag, 2) between two positions, each once, and their ordered pairs (n_lag,)."""
    from scipy.fft import fft2, ifft2

    taken = np.zeros(2 * span)
    taken[tuple(places.T)] = 1
    pairs = np.rint(ifft2(np.abs(fft2(taken)) ** 2).real)
    steps = np.argwhere(pairs > 0)
    return np.where(steps >= span, steps - 2 * span, steps), pairs[pairs > 0]


def _length(steps: np.ndarray, cosine: float) -> np.ndarray:
    """Length of vectors (..., 2) along axes with this cosine of the angle between them, in pitches."""
    q, r = steps[..., 0], steps[..., 1]
    return np.sqrt(q * q + 2 * cosine * q * r + r * r)


def _sizes(span: np.ndarray, room: float) -> tuple[int, int]:
    from scipy.fft import next_fast_len

    n_q, n_r = (next_fast_len(math.ceil(room * n)) for n in span.tolist())
    return n_q, n_r
