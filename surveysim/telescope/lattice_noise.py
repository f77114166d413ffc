"""Noise that overlapping pixels of a hexagonal lattice share, without a matrix of all their pairs.

Circulant embedding (Dietrich and Newsam 1997, SIAM J. Sci. Comput. 18, 1088): the lattice, a skewed square one, is
laid on a torus with room to spare, where the correlation of two cells is the closed form's along the shorter way
around. The correlation of a torus is diagonal in Fourier space; fields of its spectrum cost one transform for two
samples of all detectors, where a factor of the matrix costs a product with n_det^2 elements for each sample.
Eigenvalues are negative where the torus cuts coherence off. They are set to zero, and the correlation at steps that no
two detectors are apart is free to take up what that changes: both in turn, as alternating projections. The correlation
that is left is known exactly, and a torus is as large as it takes for it to be off by no more than `LARGEST_ERROR`.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from surveysim.runtime.errors import OutOfRangeError
from surveysim.runtime.rng import NormalDeviates
from surveysim.telescope.pixel_coherence import Illumination, coherence_at

# Of any correlation that detectors have on the torus, which is 1 for one with itself. Neighbours share 0.5 of the field
# at 0.7 (f/#)lambda.
LARGEST_ERROR = 2e-3
_ROOM, _GROWTH, _MOST_SPANS = 1.1, 1.12, 8
_PROJECTIONS = 60
# Complex numbers of the fields that are made at once: they stay in a processor's cache.
_BATCH = 2**18


@dataclass(frozen=True, eq=False)
class CirculantFactor:
    """A root of the correlation of detectors: `amplitude` (n_q, n_r) float32 of the modes, flat `cells` (n_det,)."""

    amplitude: np.ndarray
    cells: np.ndarray

    def fields(self, n: int, deviates: NormalDeviates, *, first: int = 0) -> Iterator[tuple[slice, np.ndarray]]:
        """Batches (n_det, n_batch) complex64 of n fields, with their places among them, from the field `first` on.

        Real and imaginary parts are independent and of unit variance, correlated between detectors and not from one
        field to the next.
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
    """Correlation C of detectors at some `cells` (n_det,) of a torus, by its eigenvalues `values` (n_q, n_r).

    They are 1 in the mean, as C is of a detector with itself.
    """

    values: np.ndarray
    cells: np.ndarray

    def factor(self, share: float = 1.0) -> CirculantFactor:
        """A root of ``share C + (1 - share) I``."""
        amplitude = np.sqrt((share * self.values + (1 - share)) / self.values.size)
        return CirculantFactor(amplitude.astype(np.float32), self.cells)

    def times(self, columns: np.ndarray) -> np.ndarray:
        """C times columns (n_det, n_column), real or complex."""
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
        """C of a cell and that at the origin, (n_q, n_r)."""
        from scipy.fft import ifft2

        return ifft2(self.values).real


@dataclass(frozen=True, eq=False)
class NoiseCorrelation:
    """Correlation of many detectors, as `torus` has it (None: none), times their `gain` (n_det,) on both sides.

    It stands for a matrix (n_det, n_det) where that is multiplied from the left.
    """

    torus: CirculantCorrelation | None
    gain: np.ndarray

    def __matmul__(self, columns: np.ndarray) -> np.ndarray:
        """The matrix times columns (n_det, n_column)."""
        gain = self.gain[:, None]
        return gain * (gain * columns if self.torus is None else self.torus.times(gain * columns))


def embed(cells: np.ndarray, pitch_f_lambda: float, coherence: str, illumination: Illumination) -> CirculantCorrelation:
    """The smallest torus that holds detectors at lattice places `cells` (n_det, 2), within `LARGEST_ERROR`.

    The axes of the lattice are 60 degrees apart; `coherence` and `illumination` are those of a correlation matrix.
    Where optics change so much that the torus does, so do all draws. Raises ValueError where a torus of 64 times the
    lattice's area is still too small: for dense pixels with a sharp coherence.
    """
    places = cells - cells.min(axis=0)
    span = places.max(axis=0) + 1
    lags = _lags(places, span)
    wanted = coherence_at(_length(lags) * pitch_f_lambda, coherence, illumination)
    room, error = _ROOM, math.inf
    while room <= _MOST_SPANS:
        n_q, n_r = sizes = _sizes(span, room)
        seen = lags[:, 0] % n_q, lags[:, 1] % n_r
        values = _eigenvalues(coherence_at(_distance(sizes) * pitch_f_lambda, coherence, illumination), seen)
        torus = CirculantCorrelation(values, places[:, 0] * n_r + places[:, 1])
        error = float(np.abs(torus.correlation[seen] - wanted).max())
        if error <= LARGEST_ERROR:
            return torus
        room *= _GROWTH
    raise OutOfRangeError(
        f"found correlations off by {error:.2g} on a torus of {n_q} by {n_r} pixels {pitch_f_lambda:.3g} (f/#)lambda "
        f"apart; {LARGEST_ERROR:g} or less is expected: a larger pitch, a tapered illumination or coherence 'intensity'"
    )


def _eigenvalues(correlation: np.ndarray, seen: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Eigenvalues, none negative and 1 in the mean, of a torus with nearly this correlation at the steps `seen`."""
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


def _distance(sizes: tuple[int, int]) -> np.ndarray:
    """The shorter way around a torus of (n_q, n_r) cells from its origin to each, in pitches."""
    steps = np.stack(np.meshgrid(*map(np.arange, sizes), indexing="ij"), axis=-1)
    turns = [(a * sizes[0], b * sizes[1]) for a in range(-2, 2) for b in range(-2, 2)]
    return np.min([_length(steps + turn) for turn in turns], axis=0)


def _lags(places: np.ndarray, span: np.ndarray) -> np.ndarray:
    """All steps (n_lag, 2) from one of some places to another, each once."""
    from scipy.fft import fft2, ifft2

    taken = np.zeros(2 * span)
    taken[tuple(places.T)] = 1
    pairs = np.rint(ifft2(np.abs(fft2(taken)) ** 2).real)
    steps = np.argwhere(pairs > 0)
    return np.where(steps >= span, steps - 2 * span, steps)


def _length(steps: np.ndarray) -> np.ndarray:
    """Length of steps (..., 2) along axes 60 degrees apart, in pitches."""
    q, r = steps[..., 0], steps[..., 1]
    return np.sqrt(q * q + q * r + r * r)


def _sizes(span: np.ndarray, room: float) -> tuple[int, int]:
    from scipy.fft import next_fast_len

    n_q, n_r = (next_fast_len(math.ceil(room * n)) for n in span.tolist())
    return n_q, n_r
