"""Removal of the atmosphere from the streams, scan by scan: every algorithm behind one table."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from mapmaker.cleaning.templates import (
    AVERAGE,
    PLANAR,
    QUADRATIC,
    Cleaned,
    TemplateOptions,
    subtract_average,
    subtract_mean,
    subtract_planar,
    subtract_quadratic,
)

if TYPE_CHECKING:
    from mapmaker.timestreams import FocalPlane

__all__ = ["CLEANERS", "N_TEMPLATES", "Cleaned", "Cleaner", "TemplateOptions", "clean"]


class Cleaner(Protocol):
    """What every algorithm offers; `options` is the algorithm's own frozen record."""

    def __call__(self, data_mk: np.ndarray, scan_bounds: np.ndarray, focal_plane: FocalPlane, options: Any) -> Cleaned:
        """Clean one observation; arguments, result and errors as for `clean`."""
        ...


CLEANERS: dict[str, Cleaner] = {
    "none": subtract_mean,
    "average": subtract_average,
    "planar": subtract_planar,
    "quadratic": subtract_quadratic,
}
# How many templates each takes from the detectors: more detectors than these are needed.
N_TEMPLATES = {"none": 0, "average": len(AVERAGE), "planar": len(PLANAR), "quadratic": len(QUADRATIC)}


def clean(name: str, data_mk: np.ndarray, scan_bounds: np.ndarray, focal_plane: FocalPlane, options: Any) -> Cleaned:
    """Clean one observation with the named algorithm; the input is left as it is.

    data_mk: (n_det, n_samp) float32 or float64 [mK]. scan_bounds: (n_scan, 2) [start, stop). options: the
    algorithm's record, `TemplateOptions` for average, planar, quadratic. For a subset of the detectors,
    slice data and focal plane alike. A scan with a value that is not finite, or whose iteration does not
    converge or that has a dead detector, is discarded: `kept` is False and its samples are 0. Raises
    ValueError for an unknown name, for shapes, types or bounds that do not fit, and for focal planes that
    do not support the templates. Sayers et al. (2010), section on atmospheric noise removal.
    """
    if name not in CLEANERS:
        raise ValueError(f"unknown cleaning {name!r}, allowed: {', '.join(CLEANERS)}")
    return CLEANERS[name](data_mk, scan_bounds, focal_plane, options)
