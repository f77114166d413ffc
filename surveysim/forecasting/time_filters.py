"""Filters in time of a cleaning pipeline, as the forecast sees them: linear operators on the samples of a scan.

A wave of frequency f_a that passes the filters F of a pipeline and the taper w adds to the map mode of frequency f_k
the amplitude <w e_k, F e_a>, with e the waves at the times of the samples. F is a product of the operators of
`mapmaker.cleaning.time_filters`, each one minus a sum over few modes, so

    F = 1 - sum_j a_j b_j^T,    <w e_k, F e_a> = w(f_k - f_a) - sum_j <w e_k, a_j> <b_j, e_a>.

All a_j and b_j are even or odd about the middle of the scan. The fit of responsivities to a scan removes modes of the
streams as the filters before it leave them; the filters after it act on what is left.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mapmaker.cleaning import TIME_FILTERS
from mapmaker.cleaning.time_filters import TimeModes, count_time_modes, time_modes
from surveysim.reduction.cleaning_pipelines import CleaningPipeline, filter_options
from surveysim.reduction.filter_checks import MOST_ELEMENTS
from surveysim.reduction.setup import Setup
from surveysim.telescope.scans import samples_per_scan


@dataclass(frozen=True, eq=False)
class LinearFilter:
    """Operator 1 - left right^T on the samples of a scan.

    Attributes
    ----------
    left, right : (n_samp, n)
        Columns, even or odd about the middle of the scan.
    odd : (n,)
        Flags of the odd ones.
    """

    left: np.ndarray
    right: np.ndarray
    odd: np.ndarray

    def then(self, left: np.ndarray, right: np.ndarray, odd: np.ndarray) -> LinearFilter:
        """Apply another operator 1 - left right^T after this one."""
        after = right - self.right @ (self.left.T @ right)
        return LinearFilter(
            np.hstack([self.left, left]), np.hstack([self.right, after]), np.concatenate([self.odd, odd])
        )

    def apply(self, columns: np.ndarray) -> np.ndarray:
        """Filter columns (n_samp, n)."""
        return columns - self.left @ (self.right.T @ columns)

    @property
    def kept_power(self) -> float:
        """Fraction of the power of white noise that is left."""
        n_samp = len(self.left)
        cross, lost = np.sum(self.left * self.right), (self.left.T @ self.left) * (self.right.T @ self.right)
        return float(1 - (2 * cross - lost.sum()) / n_samp)


def no_filter(n_samp: int) -> LinearFilter:
    """Operator that leaves scans of a number of samples as they are."""
    nothing = np.zeros((n_samp, 0))
    return LinearFilter(nothing, nothing, np.zeros(0, bool))


def product(filters: Iterable[TimeModes], n_samp: int) -> LinearFilter:
    """Combine filters that act one after the other."""
    total = no_filter(n_samp)
    for item in filters:
        total = total.then(item.modes * item.loss, item.modes, item.odd)
    return total


def baseline_filter(n_samp: int, length: int) -> LinearFilter:
    """Operator that removes the mean of each piece of a scan, of `length` samples or nearly, but for the scan's mean.

    The pieces are those of `mapmaker.destriping`, symmetric about the middle of the scan.
    """
    n_piece = max(1, round(n_samp / length))
    edges = np.linspace(0, n_samp, n_piece + 1).round().astype(int)
    edges = np.where(np.arange(n_piece + 1) <= n_piece / 2, edges, n_samp - edges[::-1])
    pieces = np.zeros((n_samp, n_piece))
    for number, (first, end) in enumerate(itertools.pairwise(edges)):
        pieces[first:end, number] = 1.0
    parts = []
    for sign in (1, -1):
        columns = pieces + sign * pieces[::-1]
        columns -= columns.mean(axis=0)
        vectors, values, _ = np.linalg.svd(columns, full_matrices=False)
        parts.append(vectors[:, values > 1e-9])
    modes = np.hstack(parts)
    return LinearFilter(modes, modes, np.repeat([False, True], [item.shape[1] for item in parts]))


@dataclass(frozen=True, eq=False)
class ScanFilters:
    """Filters of a pipeline, before and after its templates, in scans of one length.

    Attributes
    ----------
    before, after
    sample_rate_hz
    """

    before: LinearFilter
    after: LinearFilter
    sample_rate_hz: float

    @cached_property
    def total(self) -> LinearFilter:
        """All filters, which act on time alone, as one."""
        return self.before.then(self.after.left, self.after.right, self.after.odd)

    @property
    def time_s(self) -> np.ndarray:
        """Times (n_samp,) of the samples from the middle of a scan."""
        n_samp = len(self.before.left)
        return (np.arange(n_samp) - (n_samp - 1) / 2) / self.sample_rate_hz


def has_few_modes(setup: Setup, pipeline: CleaningPipeline) -> bool:
    """Tell whether the modes of a pipeline's filters fit in memory: those of a high-pass of long scans do not."""
    n_samp, rate_hz = samples_per_scan(setup.observing.scans), setup.observing.scans.sample_rate_hz
    names = [name for name in pipeline.steps if name in TIME_FILTERS]
    counts = [count_time_modes(filter_options(setup.scene.cleaning, name, rate_hz), n_samp) for name in names]
    return sum(counts) * n_samp <= MOST_ELEMENTS


def pipeline_filters(setup: Setup, pipeline: CleaningPipeline) -> ScanFilters | None:
    """Filters in time of a pipeline; None without any."""
    section, names, scans = setup.scene.cleaning, pipeline.steps, setup.observing.scans
    if set(names).isdisjoint(TIME_FILTERS):
        return None
    n_samp, rate_hz = samples_per_scan(scans), scans.sample_rate_hz
    middle = next((place for place, name in enumerate(names) if name not in TIME_FILTERS), 0)
    before, after = names[:middle], [name for name in names[middle:] if name in TIME_FILTERS]

    def combined(some: Sequence[str]) -> LinearFilter:
        return product((time_modes(filter_options(section, name, rate_hz), n_samp) for name in some), n_samp)

    return ScanFilters(combined(before), combined(after), rate_hz)


def wave_components(columns: np.ndarray, odd: np.ndarray, time_s: np.ndarray, frequency_hz: np.ndarray) -> np.ndarray:
    """Project cosines on even columns (n_samp, n) and sines on odd ones: (n_f, n)."""
    phase = 2 * np.pi * np.outer(frequency_hz, time_s)
    found = np.empty((len(phase), len(odd)))
    for flag, wave in ((False, np.cos), (True, np.sin)):
        if (odd == flag).any():
            found[:, odd == flag] = wave(phase) @ columns[:, odd == flag]
    return found


@dataclass(frozen=True, eq=False)
class TaperedFilters:
    """Filters of a scan that is seen through a taper.

    Attributes
    ----------
    of
        The filters.
    taper : (n_samp,)
        Taper at the samples, scaled as `surveysim.forecasting.scan_apodization.ScanApodization.transfer`.
    """

    of: ScanFilters
    taper: np.ndarray

    def map_components(self, at_hz: np.ndarray) -> np.ndarray:
        """Products <w e_k, a_j> of map modes at frequencies (n_f,): (n_f, n)."""
        total = self.of.total
        return wave_components(self.taper[:, None] * total.left, total.odd, self.of.time_s, at_hz)

    def stream_components(self, frequency_hz: np.ndarray) -> np.ndarray:
        """Products <b_j, e_a> of waves of frequencies (n_f,): (n_f, n)."""
        total = self.of.total
        return wave_components(total.right, total.odd, self.of.time_s, frequency_hz)

    def fitted_components(self, modes: np.ndarray, odd: np.ndarray, at_hz: np.ndarray) -> np.ndarray:
        """Project map modes on fitted modes (n_samp, n) after the filters that follow the fit: (n_f, n)."""
        return wave_components(self.taper[:, None] * self.of.after.apply(modes), odd, self.of.time_s, at_hz)

    def lost_components(self, modes: np.ndarray, odd: np.ndarray, frequency_hz: np.ndarray) -> np.ndarray:
        """Project waves after the filters that precede the fit on fitted modes (n_samp, n): (n_f, n)."""
        before = self.of.before
        seen = modes - before.right @ (before.left.T @ modes)
        return wave_components(seen, odd, self.of.time_s, frequency_hz)
