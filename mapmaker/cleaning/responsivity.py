"""Responsivities of template cleaning: fitted to each scan, fitted to all scans of an observation together, or given.

Sayers et al. (2010) fit them to each scan ("Average Template Subtraction"). A scan that is short, or in calm weather,
holds too little atmosphere for that: the iteration does not converge, and the scan is discarded. Of all scans of an
observation, each less its means, the Gram matrices add up: one c_i follows from more atmosphere, while each scan keeps
templates of its own. A camera that is calibrated elsewhere needs no fit.

Near its end, a step of the paper's iteration turns an error e of ln c into -M e, where the eigenvalues of M are between
0 and 1, and the nearer to 1 the more of the template is noise: in calm weather it goes on for hundreds of steps, forth
and back. The fit to an observation takes 2/3 of each step. It leaves e (1 - 2/3) - 2/3 M e, a third of e or less
whatever the weather, and ends at the same c within some thirty steps.

The iteration needs the streams only through their Gram matrix G_ij = sum_n d_in d_jn, so it runs on G alone. The Gram
matrix is formed in float64 whatever the streams' type: in float32 it would limit c to about 1e-7, short of the
tolerance of 1e-8. Of many detectors, whose G takes longer to form than the iteration passes over the streams, G is
never formed: what it does to a template is two products with each scan.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from mapmaker.cleaning.scans import Cleaned, Fit, clean_scans, finite_scans, has_dead
from mapmaker.validation import argument_error, number, reals, whole

SCAN, OBSERVATION = "scan", "observation"

# Detectors up to which the Gram matrix is formed. At 300 it takes as long as the passes of ten iterations, 5 to 15 ns a
# sample; at 600 it takes 15, at 1000 21, at 4000 86.
MOST_GRAM = 600

# Shares of the iteration's steps that fits take: to a scan as in the paper, to an observation as said above.
_STEPS = {SCAN: 1.0, OBSERVATION: 2 / 3}

Responsivities = str | np.ndarray
Blocks = Callable[[], Iterable[np.ndarray]]  # mean-removed streams (n_det, n) to fit to, made anew by each call


@dataclass(frozen=True)
class Region:
    """Detectors that share templates: `rows`, an index into the streams, and `basis` (n_par, n_det) of
    `template_basis`.
    """

    rows: np.ndarray | slice
    basis: np.ndarray


@dataclass(frozen=True)
class TemplateModel:
    """Templates of regions that cover all detectors, and how a scan shows them.

    `view` takes a mean-removed scan (n_det, n_samp) and its number. It returns the mean-removed streams (n_det, n) in
    which all detectors see a template at one time, and a function of c (n_det,) that subtracts the templates from the
    scan, in place.
    """

    regions: tuple[Region, ...]
    view: Callable[[np.ndarray, int], tuple[np.ndarray, Callable[[np.ndarray], None]]]

    @property
    def n_templates(self) -> int:
        """Templates of all regions."""
        return sum(len(region.basis) for region in self.regions)


def check_fit(tolerance: float, max_iterations: int, responsivities: Responsivities) -> None:
    """Raise ValueError for values out of range."""
    number("tolerance", tolerance, above=0)
    whole("max_iterations", max_iterations, least=1, most=2**31 - 1)
    if isinstance(responsivities, str):
        if responsivities not in (SCAN, OBSERVATION):
            raise ValueError(
                f"responsivities must be {SCAN!r}, {OBSERVATION!r} or those of the detectors, got {responsivities!r}"
            )
        return
    if not reals("responsivities", responsivities, ("n_det",)).all():
        raise argument_error("responsivities", "a zero", "finite numbers other than zero are")


def clean_templates(data_mk: np.ndarray, scan_bounds: np.ndarray, model: TemplateModel, options) -> Cleaned:
    """Subtract templates from each scan, with responsivities as `options.responsivities` says.

    options: a record with tolerance, max_iterations and responsivities. Other arguments, which fit each other, and
    result as for `mapmaker.cleaning.clean`. Raises ValueError for given responsivities of another number of detectors.
    """
    asked = options.responsivities
    if isinstance(asked, str) and asked == SCAN:
        return clean_scans(data_mk, scan_bounds, lambda block, scan: _fit_scan(block, scan, model, options))
    if isinstance(asked, str):
        c, iterations = _fit_observation(data_mk, scan_bounds, model, options)
    elif len(asked) == len(data_mk):
        c, iterations = np.asarray(asked, dtype=np.float64), 0
    else:
        raise ValueError(f"{len(asked)} responsivities found for {len(data_mk)} detectors; one a detector is expected")
    return clean_scans(
        data_mk, scan_bounds, lambda block, scan: _subtract(block, scan, model, c=c, iterations=iterations)
    )


def _fit_scan(block: np.ndarray, scan: int, model: TemplateModel, options) -> Fit:
    """Fit responsivities to one mean-removed scan, and subtract its templates in place."""
    streams, subtract = model.view(block, scan)
    c, iterations = fit_regions(lambda: (streams,), model.regions, options)
    if c is None:
        return Fit(None, iterations)
    subtract(c)
    return Fit(c, iterations, model.n_templates)


def _subtract(block: np.ndarray, scan: int, model: TemplateModel, *, c: np.ndarray | None, iterations: int) -> Fit:
    """Subtract the templates of known responsivities (None: the fit failed) from one mean-removed scan, in place."""
    if c is None or has_dead(block):
        return Fit(None, iterations)
    model.view(block, scan)[1](c)
    return Fit(c, iterations, model.n_templates)


def _fit_observation(
    data_mk: np.ndarray, scan_bounds: np.ndarray, model: TemplateModel, options
) -> tuple[np.ndarray | None, int]:
    """Responsivities of all scans that are finite and have no dead detector, None if not converged; iterations."""

    def blocks() -> Iterator[np.ndarray]:
        for scan, block in finite_scans(data_mk, scan_bounds):
            if not has_dead(block):
                yield model.view(block, scan)[0]

    return fit_regions(blocks, model.regions, options)


def fit_regions(blocks: Blocks, regions: tuple[Region, ...], options) -> tuple[np.ndarray | None, int]:
    """c (n_det,) of all regions, None if one does not converge; iterations of the one that took longest, or failed."""
    c, most = np.empty(sum(region.basis.shape[1] for region in regions)), 0
    for region in regions:
        rows = region.rows
        found, iterations = fit_responsivity(lambda rows=rows: (b[rows] for b in blocks()), region.basis, options)
        if found is None:
            return None, iterations
        c[rows], most = found, max(most, iterations)
    return c, most


def fit_responsivity(blocks: Blocks, basis: np.ndarray, options) -> tuple[np.ndarray | None, int]:
    """c (n_det,) of streams whose templates are those of `basis`, None if not converged, and iterations.

    c is held free of all rows of the basis but the first, the constant. By the Gram matrix, or by passes over the
    streams. Raises ValueError for streams of other detectors than those of `basis`.
    """
    from mapmaker.kernels.cleaning import iterate_responsivity

    n_det, c = basis.shape[1], np.ones(basis.shape[1])
    # One type each: the loop is compiled for the first that comes.
    tolerance, max_iterations = float(options.tolerance), int(options.max_iterations)
    step = _STEPS[options.responsivities]
    if n_det <= MOST_GRAM:
        products = (block @ block.T for block in blocks())
        gram = next(products, None)
        for product in products:
            gram += product
        if gram is None:
            return None, 0
        if gram.shape != (n_det, n_det):
            raise argument_error("blocks", f"{len(gram)} detectors", f"{n_det}, those of basis, are")
        converged, iterations = iterate_responsivity(gram, basis, basis[1:], tolerance, max_iterations, step, c)
    else:
        converged, iterations = _iterate_by_passes(
            blocks, basis, tolerance=tolerance, max_iterations=max_iterations, step=step, c=c
        )
    return (c if converged else None), iterations


def _iterate_by_passes(
    blocks: Blocks,
    basis: np.ndarray,
    *,
    tolerance: float,
    max_iterations: int,
    step: float,
    c: np.ndarray,
) -> tuple[bool, int]:
    """`iterate_responsivity` without the Gram matrix, with c held free of all rows of the basis but the first."""
    from mapmaker.kernels.cleaning import correlate, project_out, relax

    if all(map(has_dead, blocks())):
        return False, 0
    power = np.empty((len(basis), len(basis)))
    for iteration in range(1, max_iterations + 1):
        previous = c.copy()
        weighted = basis / c
        correlate(basis, weighted, sum((weighted @ block) @ block.T for block in blocks()), power, c)
        if not np.isfinite(c).all() or not c.all():
            return False, iteration
        project_out(basis[1:], c)
        relax(step, previous, c)
        if np.abs(c / previous - 1).mean() < tolerance:
            return True, iteration
    return False, max_iterations
