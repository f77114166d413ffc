"""Deviates for tests, and statistical tests of standard normal deviates."""

from dataclasses import dataclass, field

import numpy as np
from numba import njit
from scipy.special import factorial2, ndtr
from scipy.stats import chi2, kstwobign, norm, poisson

from surveysim.runtime.rng import NormalDeviates, normal_deviates

LANES, TILE = 16, 64
_EDGE, _PER_UNIT = 8, 4096
# Thresholds of |x| for counts of the tails.
_TAILS = np.array([3.0, 3.5, 4.0, 4.5, 5.0, 5.5, 6.0, 6.5])
# Radii of pairs whose logarithms of probability, -r^2 / 2, have so many bits of the uniform number behind them.
_SAME = 2e-6


def deviates(source: int | np.random.Generator) -> NormalDeviates:
    """Deviates of a number, or others at every call with the same generator."""
    return normal_deviates(source if isinstance(source, int) else int(source.integers(2**63)), "test")


@njit
def _count(x, counts, powers, radii, tail_radius):
    """Add to the histogram and to sums of powers 1 to 8; return how many `radii` beyond `tail_radius` were written."""
    for value in x:
        wide = np.float64(value)
        counts[min(max(int((wide + _EDGE) * _PER_UNIT), 0), counts.size - 1)] += 1
        power = 1.0
        for k in range(powers.size):
            power *= wide
            powers[k] += power
    n = 0
    for tile in range(x.size // TILE):
        for lane in range(LANES):
            for pair in (0, 2 * LANES):
                first = np.float64(x[tile * TILE + pair + lane])
                second = np.float64(x[tile * TILE + pair + lane + LANES])
                radius = np.sqrt(first * first + second * second)
                if radius > tail_radius and n < radii.size:
                    radii[n] = radius
                    n += 1
    return n


@dataclass
class DeviateTests:
    """Sums of deviates, which arrive in pieces of whole tiles, and the tests of them.

    Parameters
    ----------
    tail_radius
        Radii of pairs beyond it are tested for coincidences, which coarse uniform numbers make.
    """

    tail_radius: float
    n: int = 0
    counts: np.ndarray = field(default_factory=lambda: np.zeros(2 * _EDGE * _PER_UNIT, np.int64))
    powers: np.ndarray = field(default_factory=lambda: np.zeros(8))
    radii: list = field(default_factory=list)
    products: np.ndarray = field(default_factory=lambda: np.zeros((2, TILE, 2 * TILE)))

    def add(self, x: np.ndarray) -> None:
        """Add deviates."""
        radii = np.empty(100_000)
        self.radii.extend(radii[: _count(x, self.counts, self.powers, radii, self.tail_radius)])
        tiles = x.reshape(-1, TILE).astype(np.float32, copy=False)
        for total, values in zip(self.products, (tiles, (tiles * tiles - 1) / np.float32(np.sqrt(2))), strict=True):
            for part in range(0, len(values), 4096):  # sums of float32 stay short
                own, following = values[part : part + 4096], np.roll(values, -1, axis=0)[part : part + 4096]
                total += own.T @ np.hstack([own, following])
        self.n += x.size

    def probabilities(self) -> dict[str, float]:
        """Probabilities of each test for perfect deviates: uniform from 0 to 1, near 0 for departures."""
        return {
            **self._moments(),
            "Kolmogorov-Smirnov": self._kolmogorov_smirnov(),
            "Anderson-Darling": self._anderson_darling(),
            "tails": self._tails(),
            "radii": self._coincidences(),
            "lanes": two_sided(self._own(self.products[0]), self.n // TILE),
            "squares of lanes": two_sided(self._own(self.products[1]), self.n // TILE),
            "tiles": two_sided(self.products[0][:, TILE:], self.n // TILE),
            "squares of tiles": two_sided(self.products[1][:, TILE:], self.n // TILE),
        }

    def _moments(self) -> dict[str, float]:
        moment = [factorial2(k - 1) if k % 2 == 0 else 0.0 for k in range(17)]
        moment[0] = 1.0
        found = {}
        for k in range(1, 9):
            deviation = np.sqrt((moment[2 * k] - moment[k] ** 2) / self.n)
            found[f"moment {k}"] = 2 * norm.sf(abs(self.powers[k - 1] / self.n - moment[k]) / deviation)
        return found

    def _at_edges(self) -> tuple[np.ndarray, np.ndarray]:
        edges = np.arange(1, len(self.counts)) / _PER_UNIT - _EDGE
        return np.cumsum(self.counts)[:-1] / self.n, ndtr(edges)

    def _kolmogorov_smirnov(self) -> float:
        found, expected = self._at_edges()
        return kstwobign.sf(np.abs(found - expected).max() * np.sqrt(self.n))

    def _anderson_darling(self) -> float:
        """A^2 is a sum of chi^2 over k (k + 1), k = 1, 2, ... (Anderson and Darling 1954); its tail by the first."""
        found, expected = self._at_edges()
        inside = (expected > 1e-12) & (expected < 1 - 1e-12)
        found, expected = found[inside], expected[inside]
        square = self.n * (found - expected) ** 2 / (expected * (1 - expected))
        a2 = float(np.sum((square[1:] + square[:-1]) / 2 * np.diff(expected)))
        factor = np.prod([1 / np.sqrt(1 - 2 / (k * (k + 1))) for k in range(2, 2000)])
        return float(min(1.0, factor * chi2.sf(2 * a2, 1)))

    def _tails(self) -> float:
        edges = np.concatenate([-_TAILS[::-1], _TAILS])
        at = np.rint((edges + _EDGE) * _PER_UNIT).astype(int)
        split = np.split(self.counts, at)
        found = np.array([part.sum() for part in split])
        expected = self.n * np.diff(np.concatenate([[0], ndtr(edges[: len(_TAILS)])]))
        expected = np.concatenate([expected, expected[::-1]])
        found = np.concatenate([found[: len(_TAILS)], found[len(_TAILS) + 1 :]])
        keep = expected >= 5
        rare, likely = found[~keep].sum(), expected[~keep].sum()
        square = np.sum((found[keep] - expected[keep]) ** 2 / expected[keep])
        return 3 * min(1 / 3, chi2.sf(square, keep.sum()), poisson.sf(rare - 1, likely), poisson.cdf(rare, likely))

    def _coincidences(self) -> float:
        """Radii that are closer than `_SAME`: n^2 _SAME times the integral of r^2 exp(-r^2) pairs are expected."""
        r = self.tail_radius
        integral = r * np.exp(-r * r) / 2 + np.sqrt(np.pi) / 2 * norm.sf(r * np.sqrt(2))
        expected = (self.n / 2) ** 2 * _SAME * integral
        found = np.sum(np.diff(np.sort(self.radii)) < _SAME)
        return poisson.sf(found - 1, expected)

    @staticmethod
    def _own(products: np.ndarray) -> np.ndarray:
        return products[:, :TILE][np.triu_indices(TILE, 1)]


def two_sided(products: np.ndarray, n: int) -> float:
    """Probability of sums of n products of independent deviates: their chi^2, from below and above."""
    square = np.sum(products**2) / n
    return 2 * min(chi2.sf(square, products.size), chi2.cdf(square, products.size))


def sequence_probabilities(x: np.ndarray) -> dict[str, float]:
    """Probabilities of the correlations of sequences (n_sequence, n), of them and of their squares."""
    pairs = np.triu_indices(len(x), 1)
    squares = (x * x - 1) / np.sqrt(2)
    return {
        "sequences": two_sided((x @ x.T)[pairs], x.shape[1]),
        "squares of sequences": two_sided((squares @ squares.T)[pairs], x.shape[1]),
    }
