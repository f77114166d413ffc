"""Responsivities for template cleaning: fitted to each scan, fitted to all scans of an observation, or given.

Sayers et al. (2010) fit them to each scan ("Average Template Subtraction"). A scan that is short, or in calm weather,
has too little atmosphere for that: the iteration does not converge, and the scan is discarded. The Gram matrices of all
mean-removed scans of an observation add up: one c_i follows from more atmosphere, while each scan keeps its own
templates. A camera that is calibrated elsewhere needs no fit.

Near convergence, a step of the paper's iteration turns an error e of ln c into -M e, with eigenvalues of M between 0
and 1 that approach 1 as noise dominates the template: in calm weather it oscillates for hundreds of steps. The fit to
an observation takes 2/3 of each step. It leaves e (1 - 2/3) - 2/3 M e, at most a third of e in any weather, and
converges to the same c within some thirty steps.

The iteration needs only products of the Gram matrix G_ij = sum_n d_in d_jn of the streams with templates. Each is two
passes over the streams, or one over G where that is formed. To form G takes as long as some fifteen iterations on the
streams of a scan with one template. It is formed where convergence is slow, for several templates or shifted streams,
and for an observation, whose scans would be prepared again for each pass. For many detectors it takes longer, and is
never formed. All sums are in float64 whatever the streams' type: in float32 they would limit c to about 1e-7, above the
tolerance of 1e-8.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from mapmaker.chunks import row_chunks
from mapmaker.cleaning.scans import Cleaned, Fit, clean_scans, finite_scans, has_dead, is_dead
from mapmaker.validation import argument_error, number, reals, whole

SCAN, OBSERVATION = "scan", "observation"

# Largest number of detectors for which the Gram matrix is formed. For 300 it takes as long as the passes of ten
# iterations, 5 to 15 ns a sample; for 600 as 15, for 1000 as 21, for 4000 as 86.
MOST_GRAM = 600

# Iterations that take as long on the streams of a scan, with one template, as its Gram matrix does.
_FEW_ITERATIONS = 15

# Fraction of each step that is taken: 1 for a scan as in the paper, 2/3 for an observation (see the module docstring).
_STEPS = {SCAN: 1.0, OBSERVATION: 2 / 3}

Responsivities = str | np.ndarray
Blocks = Callable[[], Iterable[np.ndarray]]  # mean-removed streams (n_det, n) for one pass of a fit


@dataclass(frozen=True)
class Region:
    """Detectors that share templates.

    Attributes
    ----------
    rows
        Index into the streams.
    basis : (n_par, n_det)
        Orthonormal template shapes of `template_basis`.
    """

    rows: np.ndarray | slice
    basis: np.ndarray


@dataclass(frozen=True)
class TemplateModel:
    """Templates of regions that cover all detectors, and their view of a scan.

    Attributes
    ----------
    regions
    shifted
        None where all detectors see a template at the same time. Otherwise a function of a mean-removed scan (n_det,
        n_samp) and its number. It returns the mean-removed streams (n_det, n) in which they do, and a function of c
        (n_det,) that subtracts the templates from the scan, in place.
    """

    regions: tuple[Region, ...]
    shifted: Callable[[np.ndarray, int], tuple[np.ndarray, Callable[[np.ndarray], None]]] | None = None

    def view(self, block: np.ndarray, scan: int) -> tuple[np.ndarray, Callable[[np.ndarray], None]]:
        """Return the streams that `shifted` returns, and its function of c, for a scan."""
        if self.shifted is None:
            return block, partial(_subtract_regions, block, self.regions)
        return self.shifted(block, scan)

    @property
    def n_templates(self) -> int:
        """Number of templates of all regions."""
        return sum(len(region.basis) for region in self.regions)


def check_fit(
    tolerance: float, max_iterations: int, responsivities: Responsivities, first_guess: np.ndarray | None
) -> None:
    """Raise ValueError for values out of range."""
    if first_guess is not None and not reals("first_guess", first_guess, ("n_scan", "n_det"), empty=True).all():
        raise argument_error("first_guess", "a zero", "finite numbers other than zero are")
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


def clean_templates(data_mk: np.ndarray, scan_bounds: np.ndarray, model: TemplateModel, options: Any) -> Cleaned:
    """Subtract templates from each scan, with the responsivities that `options.responsivities` selects.

    Parameters
    ----------
    data_mk, scan_bounds
        Checked arguments of `mapmaker.cleaning.clean`.
    model
    options
        Record with tolerance, max_iterations, responsivities and first_guess.

    Returns
    -------
    Cleaned

    Raises
    ------
    ValueError
        For given responsivities of another number of detectors, and a first guess of other scans or detectors.
    """
    asked = options.responsivities
    guess = options.first_guess
    if guess is not None and np.shape(guess) != (len(scan_bounds), len(data_mk)):
        expected = f"{(len(scan_bounds), len(data_mk))}, scans and detectors, is"
        raise argument_error("first_guess", f"the shape {np.shape(guess)}", expected)
    if isinstance(asked, str) and asked == SCAN:
        if model.n_templates == 1 and model.shifted is None and len(data_mk) <= MOST_GRAM:
            return _clean_on_streams(data_mk, scan_bounds, model, options)
        return clean_scans(data_mk, scan_bounds, lambda block, scan: _fit_scan(block, scan, model, options))
    if isinstance(asked, str):
        c, iterations = _fit_observation(data_mk, scan_bounds, model, options)
    elif len(asked) == len(data_mk):
        c, iterations = np.asarray(asked, dtype=np.float64), 0
    else:
        raise ValueError(f"{len(asked)} responsivities found for {len(data_mk)} detectors; one a detector is expected")
    if c is None or model.shifted is not None:
        return clean_scans(
            data_mk, scan_bounds, lambda block, scan: _subtract(block, scan, model, c=c, iterations=iterations)
        )
    return _clean_by_rows(data_mk, scan_bounds, model, c=c, iterations=iterations)


def _clean_on_streams(data_mk: np.ndarray, scan_bounds: np.ndarray, model: TemplateModel, options: Any) -> Cleaned:
    """Fit and subtract one template; scans whose fit converges slowly are fitted by their Gram matrices."""
    from mapmaker.kernels.cleaning import GIVEN_UP, KEPT, clean_on_streams, remove_means

    basis, cleaned_mk = model.regions[0].basis, np.zeros(data_mk.shape, data_mk.dtype)
    c = np.ones((len(scan_bounds), len(data_mk)))
    if options.first_guess is not None:
        c[:] = options.first_guess
    iterations, outcome = np.empty((2, len(scan_bounds)), np.int64)
    limits = float(options.tolerance), int(options.max_iterations), _STEPS[SCAN], _FEW_ITERATIONS
    clean_on_streams(data_mk, scan_bounds, basis, basis[1:], *limits, c, cleaned_mk, iterations, outcome)
    c[outcome != KEPT] = np.nan
    for s in np.flatnonzero(outcome == GIVEN_UP):
        start, stop = scan_bounds[s]
        block = np.empty((len(data_mk), stop - start))
        remove_means(data_mk, start, stop, block)
        fit = _fit_scan(block, int(s), model, options)
        iterations[s] = fit.iterations
        if fit.responsivity is not None:
            c[s], cleaned_mk[:, start:stop] = fit.responsivity, block
    kept = np.all(np.isfinite(c), axis=1)
    return Cleaned(cleaned_mk, kept, c, iterations, np.where(kept, model.n_templates, 0))


def _fit_scan(block: np.ndarray, scan: int, model: TemplateModel, options: Any) -> Fit:
    """Fit responsivities to one mean-removed scan, and subtract its templates in place."""
    streams, subtract = model.view(block, scan)
    guess = np.ones(len(block)) if options.first_guess is None else options.first_guess[scan]
    c, iterations = fit_regions(lambda: (streams,), model.regions, options, guess)
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


def _subtract_regions(block: np.ndarray, regions: tuple[Region, ...], c: np.ndarray) -> None:
    """Subtract the templates of all regions from one mean-removed scan, in place."""
    from mapmaker.kernels.cleaning import subtract_templates

    for region in regions:
        part, own = block[region.rows], c[region.rows]
        subtract_templates(part, region.basis * own, (region.basis / own) @ part)
        if not isinstance(region.rows, slice):  # `part` is a copy
            block[region.rows] = part


def _clean_by_rows(
    data_mk: np.ndarray, scan_bounds: np.ndarray, model: TemplateModel, *, c: np.ndarray, iterations: int
) -> Cleaned:
    """Subtract templates of known responsivities from each scan, some detectors at a time.

    Scans in float64 and of many detectors would not fit in the processor's cache.
    """
    kept = np.zeros(len(scan_bounds), bool)
    finite, cleaned_mk = kept.copy(), np.zeros(data_mk.shape, data_mk.dtype)
    for s, (start, stop) in enumerate(scan_bounds):
        scan, power = slice(start, stop), np.empty(len(c))
        templates = [_templates_by_rows(data_mk, scan, region, c=c, power=power) for region in model.regions]
        finite[s] = np.isfinite(power).all()
        kept[s] = finite[s] and not is_dead(power)
        if kept[s]:
            for region, streams in zip(model.regions, templates, strict=True):
                _subtract_by_rows(data_mk, scan, region, c=c, templates=streams, out=cleaned_mk)
    responsivity = np.where(kept[:, None], c, np.nan)
    return Cleaned(
        cleaned_mk, kept, responsivity, np.where(finite, iterations, 0), np.where(kept, model.n_templates, 0)
    )


def _templates_by_rows(
    data_mk: np.ndarray, scan: slice, region: Region, *, c: np.ndarray, power: np.ndarray
) -> np.ndarray:
    """Compute the templates (n_par, n) of a region in a scan; write the power of its detectors, NaN if not finite."""
    templates = np.zeros((len(region.basis), scan.stop - scan.start))
    for places, rows, block in _row_blocks(data_mk, scan, region):
        if block is None:
            power[rows] = np.nan
            return templates
        power[rows] = np.einsum("in,in->i", block, block)
        templates += (region.basis[:, places] / c[rows]) @ block
    return templates


def _subtract_by_rows(
    data_mk: np.ndarray, scan: slice, region: Region, *, c: np.ndarray, templates: np.ndarray, out: np.ndarray
) -> None:
    """Write the mean-removed scan of a region less its templates."""
    from mapmaker.kernels.cleaning import subtract_templates

    for places, rows, block in _row_blocks(data_mk, scan, region):
        subtract_templates(block, region.basis[:, places] * c[rows], templates)
        out[rows, scan] = block


def _row_blocks(
    data_mk: np.ndarray, scan: slice, region: Region
) -> Iterator[tuple[slice, np.ndarray | slice, np.ndarray | None]]:
    """Some detectors of a region, their rows in the streams, and their mean-removed scan (None if not finite)."""
    from mapmaker.kernels.cleaning import remove_means

    n = scan.stop - scan.start
    for places in row_chunks(region.basis.shape[1], 2 * n):
        rows: np.ndarray | slice = places
        part, start = data_mk[places], scan.start
        if not isinstance(region.rows, slice):
            rows = region.rows[places]
            part, start = data_mk[rows, scan], 0
        block = np.empty((len(part), n))
        finite = remove_means(part, start, start + n, block)
        yield places, rows, block if finite else None


def _fit_observation(
    data_mk: np.ndarray, scan_bounds: np.ndarray, model: TemplateModel, options: Any
) -> tuple[np.ndarray | None, int]:
    """Fit responsivities to all scans that are finite and have no dead detector; None if not converged; iterations."""

    def blocks() -> Iterator[np.ndarray]:
        for scan, block in finite_scans(data_mk, scan_bounds):
            if not has_dead(block):
                yield model.view(block, scan)[0]

    return fit_regions(blocks, model.regions, options, np.ones(len(data_mk)))


def _part_of(blocks: Blocks, rows: np.ndarray | slice) -> Iterator[np.ndarray]:
    return (block[rows] for block in blocks())


def fit_regions(
    blocks: Blocks, regions: tuple[Region, ...], options: Any, guess: np.ndarray
) -> tuple[np.ndarray | None, int]:
    """Fit the responsivities of all regions, from a first guess (n_det,).

    Returns
    -------
    c : (n_det,) or None
        None if one region does not converge.
    iterations : int
        Those of the region that took longest, or failed.
    """
    c, most = np.empty(sum(region.basis.shape[1] for region in regions)), 0
    for region in regions:
        rows = region.rows
        found, iterations = fit_responsivity(partial(_part_of, blocks, rows), region.basis, options, guess[rows])
        if found is None:
            return None, iterations
        c[rows], most = found, max(most, iterations)
    return c, most


def fit_responsivity(
    blocks: Blocks, basis: np.ndarray, options: Any, guess: np.ndarray | None = None
) -> tuple[np.ndarray | None, int]:
    """Fit responsivities to streams, by the Gram matrix or by passes over the streams.

    c is kept orthogonal to all rows of the basis but the first, the constant.

    Parameters
    ----------
    blocks
        Function that returns the mean-removed streams (n_det, n) for one pass.
    basis : (n_par, n_det)
        Template shapes.
    options
        Record with tolerance, max_iterations and responsivities.
    guess : (n_det,)
        First guess of c; 1 without one, as in the paper.

    Returns
    -------
    c : (n_det,) or None
        None if not converged.
    iterations : int

    Raises
    ------
    ValueError
        For streams of another number of detectors than `basis`.
    """
    n_det = basis.shape[1]
    c = np.ones(n_det) if guess is None else np.array(guess, dtype=np.float64)
    # Fixed types: kernels are compiled for those of the first call.
    limits = float(options.tolerance), int(options.max_iterations), _STEPS[options.responsivities]
    by = _iterate_by_passes if n_det > MOST_GRAM else _iterate_on_gram
    converged, iterations = by(blocks, basis, *limits, c=c)
    return (c if converged else None), iterations


def _iterate_on_gram(
    blocks: Blocks, basis: np.ndarray, tolerance: float, max_iterations: int, step: float, *, c: np.ndarray
) -> tuple[bool, int]:
    """Run `iterate_responsivity` on the sum of the Gram matrices of all blocks."""
    from mapmaker.kernels.cleaning import iterate_responsivity

    gram = np.zeros((basis.shape[1], basis.shape[1]))
    empty = True
    for block in blocks():
        _check_detectors(block, basis)
        gram += block @ block.T
        empty = False
    if empty:
        return False, 0
    return iterate_responsivity(gram, basis, basis[1:], tolerance, max_iterations, step, c)


def _check_detectors(block: np.ndarray, basis: np.ndarray) -> None:
    if len(block) != basis.shape[1]:
        raise argument_error("blocks", f"{len(block)} detectors", f"{basis.shape[1]}, those of basis, are")


def _iterate_by_passes(
    blocks: Blocks, basis: np.ndarray, tolerance: float, max_iterations: int, step: float, *, c: np.ndarray
) -> tuple[bool, int]:
    """Run `iterate_responsivity` without the Gram matrix, with c orthogonal to all rows of the basis but the first."""
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
