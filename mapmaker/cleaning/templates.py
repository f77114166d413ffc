"""Cleaning with polynomial templates over the focal plane: none, average, planar, quadratic.

Sayers et al. (2010), "Average Template Subtraction" and "Higher-Order Template Subtraction". Each scan is modelled as
d_n = C S p_n: S are the polynomial terms at the detector positions, C = diag(c) the relative responsivities. c and the
templates T_n = S p_n are solved for alternately until c converges, and c_i T_in is subtracted.

With more than the constant term, a gradient of c over the array is degenerate to first order with a fraction of the
common signal in the gradient template: (1 + a x) p_0 = p_0 + (a p_0) x. The iteration of the paper drifts along these
directions for 10^2 to 10^5 steps, and hardly any scan would reach 1e-8 in 100 steps. c is therefore kept orthogonal to
the non-constant template shapes, and the templates contain those components; the residual is of second order, a times
the atmosphere's own gradient. Average subtraction has no such direction and is as in the paper.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mapmaker.cleaning.responsivity import (
    SCAN,
    Region,
    Responsivities,
    TemplateModel,
    check_fit,
    clean_templates,
)
from mapmaker.cleaning.scans import Cleaned, Fit, check_streams, checks_streams, clean_scans
from mapmaker.errors import InsufficientDataError
from mapmaker.validation import reals

if TYPE_CHECKING:
    from mapmaker.timestreams import FocalPlane

# Least norm of a term orthogonal to the terms before it, in units of the array's radius. Below it, detectors lie on one
# line or conic within the accuracy of their positions, and six digits of the template would be lost.
RANK_TOLERANCE = 1e-6

# Exponents (of x, of y) of the terms of S.
AVERAGE = ((0, 0),)
PLANAR = (*AVERAGE, (1, 0), (0, 1))
QUADRATIC = (*PLANAR, (1, 1), (2, 0), (0, 2))


@dataclass(frozen=True)
class TemplateOptions:
    """Options of template cleaning; the paper takes 1e-8 within 100 iterations.

    Attributes
    ----------
    tolerance
        Mean fractional change of c_i at convergence.
    max_iterations
    responsivities
        "scan" for one fit to each scan, as in the paper; "observation" for one fit to all scans of the streams; or
        known responsivities (n_det,), up to a common factor.
    first_guess : (n_scan, n_det), optional
        Responsivities that the fit to each scan begins with, which takes fewer iterations if they are close; 1 without
        them, as in the paper.
    """

    tolerance: float
    max_iterations: int
    responsivities: Responsivities = SCAN
    first_guess: np.ndarray | None = None

    def __post_init__(self) -> None:
        """Raise ValueError for values out of range."""
        check_fit(self.tolerance, self.max_iterations, self.responsivities, self.first_guess)


def template_basis(focal_plane: FocalPlane, exponents: Sequence[tuple[int, int]]) -> np.ndarray:
    """Orthonormal basis of the polynomials x^a y^b at the detectors.

    Row k and those before it span the first k + 1 terms; the first is constant. (S^T S)^-1 S^T is then the transpose.
    Neither normal equations nor high powers are formed: each row is an earlier one times x or y, orthogonalised against
    all earlier ones (Arnoldi's process; Brubeck et al. 2021, SIAM Review 63, 405), which keeps all digits at any order.

    Parameters
    ----------
    focal_plane
    exponents
        (a, b) of each term: complete degrees, rising from (0, 0); in each, x^a y^b follows y times all terms that
        precede x^a y^(b-1).

    Returns
    -------
    (n_par, n_det) array

    Raises
    ------
    ValueError
        For no more detectors than terms, and positions that do not separate the terms, to a millionth of the array's
        radius.
    """
    n_det, n_par = len(focal_plane.x_rad), len(exponents)
    if n_det <= n_par:
        raise InsufficientDataError(f"{n_par} templates need at least {n_par + 1} detectors, got {n_det}")
    u, v = _scaled(focal_plane, focal_plane.x_rad, focal_plane.y_rad)
    row_of = {(0, 0): np.full(n_det, n_det**-0.5)}
    for a, b in exponents[1:]:
        before = row_of.get((a, b - 1) if b else (a - 1, b))
        if before is None:
            continue
        known = np.array(list(row_of.values()))
        row = before * (v if b else u)
        for _ in range(2):  # the second pass removes the rounding of the first
            row = row - known.T @ (known @ row)
        norm = np.linalg.norm(row)
        if norm > RANK_TOLERANCE:
            row_of[a, b] = row / norm
    if len(row_of) < n_par:
        raise InsufficientDataError(
            f"the {n_det} detector positions support {len(row_of)} independent templates, need {n_par}: "
            "they lie on one line or conic, or too close to it"
        )
    return np.array(list(row_of.values()))


def _scaled(focal_plane: FocalPlane, x_rad: np.ndarray, y_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions from the array's centre, in units of its radius."""
    x, y = np.asarray(focal_plane.x_rad, dtype=np.float64), np.asarray(focal_plane.y_rad, dtype=np.float64)
    scale = np.hypot(x - x.mean(), y - y.mean()).max() or 1.0
    return (np.asarray(x_rad) - x.mean()) / scale, (np.asarray(y_rad) - y.mean()) / scale


def _shapes(
    focal_plane: FocalPlane, exponents: Sequence[tuple[int, int]], x_rad: np.ndarray, y_rad: np.ndarray
) -> np.ndarray:
    """Terms x^a y^b (n_place, n_par) at some positions, from the array's centre in units of its radius."""
    u, v = _scaled(focal_plane, x_rad, y_rad)
    return np.stack([u**a * v**b for a, b in exponents], axis=1)


def template_streams(
    data_mk: np.ndarray,
    scan_bounds: np.ndarray,
    focal_plane: FocalPlane,
    *,
    responsivity: np.ndarray,
    exponents: Sequence[tuple[int, int]],
    place_rad: tuple[float, float],
) -> np.ndarray:
    """Contribution of each term x^a y^b to the template at one position of the focal plane.

    It is p_n = (S^T S)^-1 S^T C^-1 d_n of each mean-removed scan, times the terms at `place_rad`, relative to the mean
    position of the detectors. Source: Sayers et al. (2010), "Higher-Order Template Subtraction".

    Parameters
    ----------
    data_mk : (n_det, n_samp)
    scan_bounds : (n_scan, 2)
    focal_plane
    responsivity : (n_scan, n_det)
        As in `Cleaned`.
    exponents
        (a, b) of each term, as for `template_basis`.
    place_rad
        Position (x, y) in the frame of the focal plane.

    Returns
    -------
    (n_par, n_samp) array
        float64 [mK]; 0 in discarded scans and outside scans.

    Raises
    ------
    ValueError
        As `template_basis`, and for arrays that do not match.
    """
    data_mk, bounds = check_streams(data_mk, scan_bounds, focal_plane)
    responsivity = reals("responsivity", responsivity, (len(bounds), len(data_mk)), finite=False, empty=True)
    basis = template_basis(focal_plane, exponents)
    shapes = _shapes(focal_plane, exponents, focal_plane.x_rad, focal_plane.y_rad)
    here = _shapes(focal_plane, exponents, *reals("place_rad", place_rad, (2,))[:, None])[0]
    terms = here[:, None] * np.linalg.solve(basis @ shapes, basis)
    streams = np.zeros((len(terms), data_mk.shape[1]))
    for (start, stop), c in zip(bounds, responsivity, strict=True):
        if np.isfinite(c).all():
            block = data_mk[:, start:stop] / c[:, None]
            streams[:, start:stop] = terms @ (block - block.mean(axis=1, keepdims=True))
    return streams


@checks_streams
def subtract_mean(data_mk: np.ndarray, scan_bounds: np.ndarray, focal_plane: FocalPlane, options: object) -> Cleaned:
    """Remove each detector's mean in each scan only; arguments, result and errors as for `clean`.

    The options are ignored. Responsivities are 1, without iterations.
    """
    return clean_scans(data_mk, scan_bounds, lambda block, scan: Fit(np.ones(len(block))))


@checks_streams
def subtract_average(
    data_mk: np.ndarray, scan_bounds: np.ndarray, focal_plane: FocalPlane, options: TemplateOptions
) -> Cleaned:
    """Remove the mean and the common signal; arguments, result and errors as for `clean`.

    The paper's average template, sum c^-1 d / sum c^-1, differs from the one-parameter polynomial by a factor common to
    all detectors, which c includes: c_i T_n is the same.
    """
    return _subtract_templates(data_mk, scan_bounds, focal_plane, options, exponents=AVERAGE)


@checks_streams
def subtract_planar(
    data_mk: np.ndarray, scan_bounds: np.ndarray, focal_plane: FocalPlane, options: TemplateOptions
) -> Cleaned:
    """Remove the mean and templates 1, x, y; arguments, result and errors as for `clean`."""
    return _subtract_templates(data_mk, scan_bounds, focal_plane, options, exponents=PLANAR)


@checks_streams
def subtract_quadratic(
    data_mk: np.ndarray, scan_bounds: np.ndarray, focal_plane: FocalPlane, options: TemplateOptions
) -> Cleaned:
    """Remove the mean and templates 1, x, y, xy, x^2, y^2; arguments, result and errors as for `clean`."""
    return _subtract_templates(data_mk, scan_bounds, focal_plane, options, exponents=QUADRATIC)


def _subtract_templates(
    data_mk: np.ndarray,
    scan_bounds: np.ndarray,
    focal_plane: FocalPlane,
    options: TemplateOptions,
    *,
    exponents: Sequence[tuple[int, int]],
) -> Cleaned:
    regions = (Region(slice(None), template_basis(focal_plane, exponents)),)
    return clean_templates(data_mk, scan_bounds, TemplateModel(regions), options)
