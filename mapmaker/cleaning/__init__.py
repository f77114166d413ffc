"""Removal of the atmosphere from time-streams, scan by scan: one table of all cleaning algorithms."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from mapmaker.cleaning.local import LocalOptions, subtract_local
from mapmaker.cleaning.pca import PcaOptions, needed_eigenvalues, subtract_pca
from mapmaker.cleaning.polynomial import PolynomialOptions, exponents, subtract_polynomial
from mapmaker.cleaning.scans import Cleaned, live_detectors
from mapmaker.cleaning.spectral import SpectralOptions, subtract_spectral
from mapmaker.cleaning.templates import (
    AVERAGE,
    PLANAR,
    QUADRATIC,
    TemplateOptions,
    subtract_average,
    subtract_mean,
    subtract_planar,
    subtract_quadratic,
)
from mapmaker.cleaning.time_filters import (
    HighpassOptions,
    NotchOptions,
    TimePolynomialOptions,
    subtract_low_frequencies,
    subtract_time_modes,
)
from mapmaker.cleaning.wind import WindOptions, slowness, subtract_wind

if TYPE_CHECKING:
    from mapmaker.timestreams import FocalPlane

__all__ = [
    "ALGORITHMS",
    "TEMPLATE_CLEANINGS",
    "TIME_FILTERS",
    "Cleaned",
    "Cleaner",
    "CleaningAlgorithm",
    "HighpassOptions",
    "LocalOptions",
    "NotchOptions",
    "PcaOptions",
    "PolynomialOptions",
    "SpectralOptions",
    "TemplateOptions",
    "TimePolynomialOptions",
    "WindOptions",
    "clean",
    "clean_in_order",
    "detectors_needed",
    "live_detectors",
    "slowness",
]


class Cleaner(Protocol):
    """Signature of a cleaning algorithm; `options` is the algorithm's own frozen record.

    Each is decorated with `checks_streams` of `mapmaker.cleaning.scans`.
    """

    def __call__(
        self, data_mk: np.ndarray, scan_bounds: np.ndarray, focal_plane: FocalPlane, options: Any, /
    ) -> Cleaned:
        """Clean one observation; arguments, result and errors as for `clean`."""
        ...


@dataclass(frozen=True)
class CleaningAlgorithm:
    """Cleaning algorithm: its function, its options, the detectors that it needs, its use of responsivities.

    Parameters
    ----------
    subtract
        Function that cleans one observation.
    options
        Class of its record of options; `object` accepts anything.
    needs
        Least number of detectors, as a function of the options.
    takes_responsivities
        Whether it subtracts templates times responsivities, with the source of the responsivities in its options.
    """

    subtract: Cleaner
    options: type
    needs: Callable[[Any], int]
    takes_responsivities: bool = False


def _more_than(n_template: int) -> Callable[[Any], int]:
    return lambda options: n_template + 1


def _polynomial_needs(options: PolynomialOptions) -> int:
    return options.regions * (len(exponents(options.order)) + 1)


ALGORITHMS: dict[str, CleaningAlgorithm] = {
    "none": CleaningAlgorithm(subtract_mean, object, _more_than(0)),
    "average": CleaningAlgorithm(subtract_average, TemplateOptions, _more_than(len(AVERAGE)), True),
    "planar": CleaningAlgorithm(subtract_planar, TemplateOptions, _more_than(len(PLANAR)), True),
    "quadratic": CleaningAlgorithm(subtract_quadratic, TemplateOptions, _more_than(len(QUADRATIC)), True),
    "polynomial": CleaningAlgorithm(subtract_polynomial, PolynomialOptions, _polynomial_needs, True),
    "wind": CleaningAlgorithm(subtract_wind, WindOptions, _more_than(len(AVERAGE)), True),
    "pca": CleaningAlgorithm(subtract_pca, PcaOptions, needed_eigenvalues),
    "local": CleaningAlgorithm(subtract_local, LocalOptions, _more_than(1)),
    "spectral": CleaningAlgorithm(subtract_spectral, SpectralOptions, _more_than(0)),
    "highpass": CleaningAlgorithm(subtract_low_frequencies, HighpassOptions, _more_than(0)),
    "notch": CleaningAlgorithm(subtract_time_modes, NotchOptions, _more_than(0)),
    "time_polynomial": CleaningAlgorithm(subtract_time_modes, TimePolynomialOptions, _more_than(0)),
}
TIME_FILTERS = ("highpass", "notch", "time_polynomial")
TEMPLATE_CLEANINGS = tuple(name for name, item in ALGORITHMS.items() if item.takes_responsivities)


def detectors_needed(name: str, options: Any) -> int:
    """Number of detectors that an algorithm needs with these options; errors as for `clean`."""
    _check(name, options)
    return ALGORITHMS[name].needs(options)


def clean(name: str, data_mk: np.ndarray, scan_bounds: np.ndarray, focal_plane: FocalPlane, *, options: Any) -> Cleaned:
    """Clean one observation with an algorithm; the input is unchanged.

    A scan is discarded (`kept` is False and its samples are 0) for a value that is not finite, a dead detector, or an
    iteration that does not converge. "none" and filters in time do not check for dead detectors; `live_detectors` finds
    them. Scans
    that share one fit of responsivities are all discarded if it does not converge; scans that are not finite or have a
    dead detector are excluded from the fit. Source: Sayers et al. (2010), section on atmospheric noise removal.

    Parameters
    ----------
    name
        A key of `ALGORITHMS`.
    data_mk : (n_det, n_samp)
        float32; other real types become float64.
    scan_bounds : (n_scan, 2)
        Scans [start, stop), which do not overlap.
    focal_plane
    options
        The algorithm's record of options.

    Returns
    -------
    Cleaned

    Raises
    ------
    ValueError
        For an unknown name, options of another algorithm, shapes, types or bounds that do not match, and focal planes
        that do not support the templates.
    """
    _check(name, options)
    return ALGORITHMS[name].subtract(data_mk, scan_bounds, focal_plane, options)


def clean_in_order(
    steps: Sequence[tuple[str, Any]], data_mk: np.ndarray, scan_bounds: np.ndarray, focal_plane: FocalPlane
) -> Cleaned:
    """Clean one observation with several algorithms in turn.

    A scan is kept if every step keeps it: once discarded it is 0. `responsivity` is that of the first step with
    templates, 1 without one; `iterations` and `removed` are sums.

    Parameters
    ----------
    steps
        (name, options) of each algorithm.
    data_mk, scan_bounds, focal_plane
        As for `clean`.

    Raises
    ------
    ValueError
        For no steps, and as `clean`.
    """
    if not len(steps):
        raise ValueError("no cleaning steps found; one or more are expected")
    for step in steps:
        if not isinstance(step, tuple | list) or len(step) != 2:
            raise ValueError(f"steps: found {step!r:.60}; pairs of a name and its options are expected")
        _check(*step)
    done: list[Cleaned] = []
    for name, options in steps:
        found = clean(name, data_mk, scan_bounds, focal_plane, options=options)
        data_mk = found.data_mk
        done.append(replace(found, data_mk=data_mk[:0]))  # the streams between two steps are not kept
    kept = np.all([item.kept for item in done], axis=0)
    fitted = [item for (name, _), item in zip(steps, done, strict=True) if name in TEMPLATE_CLEANINGS]
    return Cleaned(
        data_mk=data_mk,
        kept=kept,
        responsivity=np.where(kept[:, None], (fitted or done)[0].responsivity, np.nan),
        iterations=np.sum([item.iterations for item in done], axis=0),
        removed=np.where(kept, np.sum([item.removed for item in done], axis=0), 0),
    )


def _check(name: str, options: Any) -> None:
    if not isinstance(name, str) or name not in ALGORITHMS:
        raise ValueError(f"unknown cleaning {name!r}, allowed: {', '.join(ALGORITHMS)}")
    expected = ALGORITHMS[name].options
    if not isinstance(options, expected):
        raise ValueError(f"options of {name!r} must be {expected.__name__}, got {type(options).__name__}")
