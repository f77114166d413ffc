"""The scene's own sky after scans and cleaning, beside the sky that went in.

The sky passes the observations that carry the signal simulations, without noise. The amplitude transfer function is
measured with the simulated skies, mode by mode: ``T(k) = sum <in out> / sum <in in>``, with the cross-spectra of
tapered maps that come out with those that went in. Maps are sharpened by a Laplacian before they are tapered, so that
the taper does not mix long waves of a steep spectrum, which cleaning removes, into short ones (Das, Hajian and Spergel
2009, PRD 79, 083008, section III). The own sky is recovered where its cross-spectrum is T times the
spectrum of what went in: the map that came out, divided by its transfer, is then the map that went in.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mapmaker.binning import weighted_mean
from mapmaker.geometry import MapGeometry
from mapmaker.spectrum import ring_mean
from surveysim.reduction.analysis import AnalysisSetup
from surveysim.reduction.input_map import input_map
from surveysim.reduction.setup import Setup
from surveysim.results.sky_fluxes import SourceFlux, source_fluxes
from surveysim.survey.coadds import CoAdds


@dataclass(frozen=True)
class SkyRecovery:
    """The scene's own sky before and after the scans and one cleaning, on the scored patch.

    Attributes
    ----------
    name
        Data set of the cleaning.
    geometry
        Pixels of the patch.
    input_mk, output_mk : (n, n)
        The sky through the beam, averaged over pixels, and the map of it without noise [mK RJ].
    weight : (n, n)
        Weights of the map; 0 where there is none.
    bin_width
        Width of the bins in multipole.
    ell : (n_bin,)
    transfer, transfer_error : (n_bin,)
        Amplitude transfer function of the simulated skies, and its standard error.
    own_transfer : (n_bin,)
        The same of the own sky.
    correlation : (n_bin,)
        Correlation of its map with what went in.
    recovered, recovered_error : (n_bin,)
        Cross-spectrum of the own sky, its map divided by the transfer function of each mode, over the spectrum of what
        went in; modes have the weight of that function, squared, as noise has it after the division. The error is the
        scatter of simulated skies against the transfer function of the others; NaN of a single one.
    total, total_error
        The same of all scored bins together.
    transfer_plane : (2 n_bin, n_bin)
        Transfer function of the simulated skies against ell_y, from -ell_max, and ell_x, from 0, in squares of one bin.
    fluxes
        Fluxes of point sources, sources of catalogues and clusters.
    """

    name: str
    geometry: MapGeometry
    input_mk: np.ndarray
    output_mk: np.ndarray
    weight: np.ndarray
    bin_width: float
    ell: np.ndarray
    transfer: np.ndarray
    transfer_error: np.ndarray
    own_transfer: np.ndarray
    correlation: np.ndarray
    recovered: np.ndarray
    recovered_error: np.ndarray
    total: float
    total_error: float
    transfer_plane: np.ndarray
    fluxes: tuple[SourceFlux, ...]


def sky_recoveries(setup: Setup, coadds: CoAdds) -> dict[str, SkyRecovery]:
    """Compare the scene's sky with what comes back, by data set with a transfer function of its own.

    Empty without a sky, a score, or an observation with signal simulations that has a kept scan.
    """
    analysis = setup.analysis
    if analysis.own_sky is None or not coadds.signal_weight.any():
        return {}
    skies = analysis.signal_skies_mk[: analysis.own_sky + 1]
    inputs = np.stack([input_map(analysis, sky) for sky in skies])
    return {
        name: _recovery(setup, coadds, place, name, inputs)
        for place, name in enumerate(analysis.transfer_function_names)
        if coadds.signal_weight[place].any()
    }


@dataclass(frozen=True)
class _Spectra:
    """Spectra of skies (n_sky, n_y, n_x // 2 + 1), the own one last: of in and out, and of both."""

    power: np.ndarray
    left: np.ndarray
    cross: np.ndarray

    def transfer(self, skies: Sequence[int]) -> np.ndarray:
        """Amplitude transfer function of each mode from some skies; 0 without power."""
        return _over(self.cross[skies].sum(axis=0), self.power[skies].sum(axis=0))


def _recovery(setup: Setup, coadds: CoAdds, place: int, name: str, inputs: np.ndarray) -> SkyRecovery:
    analysis, own = setup.analysis, setup.analysis.own_sky
    rings, weight = analysis.region.rings, coadds.signal_weight[place]
    outputs = weighted_mean(coadds.signal_maps[: own + 1, place, 1], weight)
    # The sky is known where the map has no sample; both are masked alike.
    found = _spectra(analysis, inputs * (weight > 0), outputs)
    cross, power = (_in_rings(analysis, item) for item in (found.cross, found.power))
    transfer, error = _ratio(cross[:own], power[:own])
    bins, total = _recovered(analysis, found)
    side = (analysis.geometry.pixel_rad, *inputs.shape[:0:-1])
    geometry = MapGeometry(analysis.geometry.ra0_rad, analysis.geometry.dec0_rad, *side)
    modes = _beyond_last(analysis, found.transfer(range(own)), transfer[-1])
    maps = inputs[own], outputs[own]
    return SkyRecovery(
        name=name,
        geometry=geometry,
        input_mk=inputs[own],
        output_mk=outputs[own],
        weight=weight,
        bin_width=float(rings.edges_ell[1] - rings.edges_ell[0]),
        ell=rings.ell,
        transfer=transfer,
        transfer_error=error,
        own_transfer=_over(cross[own], power[own]),
        correlation=_over(cross[own], np.sqrt(power[own] * ring_mean(found.left[own], rings))),
        recovered=bins[0],
        recovered_error=bins[1],
        total=float(total[0]),
        total_error=float(total[1]),
        transfer_plane=_plane(analysis, found.cross[:own].sum(axis=0), found.power[:own].sum(axis=0)),
        fluxes=source_fluxes(setup, coadds, name, geometry=geometry, maps=maps, weight=weight, transfer=modes),
    )


def _spectra(analysis: AnalysisSetup, inputs: np.ndarray, outputs: np.ndarray) -> _Spectra:
    before, after = (_modes(analysis, maps) for maps in (inputs, outputs))
    return _Spectra(np.abs(before) ** 2, np.abs(after) ** 2, (before.conj() * after).real)


def _modes(analysis: AnalysisSetup, maps: np.ndarray) -> np.ndarray:
    """Transform the Laplacian of maps (n_sky, n, n), tapered."""
    from scipy.fft import rfft2

    sharp = 4 * maps - sum(np.roll(maps, step, axis) for step in (-1, 1) for axis in (-2, -1))
    return rfft2(analysis.region.pad(analysis.region.taper * sharp), workers=1)


def _in_rings(analysis: AnalysisSetup, spectra: np.ndarray) -> np.ndarray:
    return np.array([ring_mean(item, analysis.region.rings) for item in spectra])


def _ratio(cross: np.ndarray, power: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ratio (n_bin,) of sums over skies (n_sky, n_bin), and its standard error from their scatter; NaN of one sky."""
    n_sky, found = len(cross), _over(cross.sum(axis=0), power.sum(axis=0))
    if n_sky < 2:
        return found, np.full(found.shape, np.nan)
    scatter = np.sqrt(np.sum((cross - found * power) ** 2, axis=0) * n_sky / (n_sky - 1))
    return found, _over(scatter, power.sum(axis=0))


def _over(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.divide(one, other, out=np.zeros_like(one), where=other > 0)


def _recovered(analysis: AnalysisSetup, found: _Spectra) -> tuple[np.ndarray, np.ndarray]:
    """Cross-spectrum of the own sky over that of the transfer function, and its error.

    Returns
    -------
    bins : (2, n_bin)
    total : (2,)
    """
    own = len(found.cross) - 1
    bins, total = _share(analysis, found, own, range(own))
    if own < 2:
        return np.stack([bins, np.full(bins.shape, np.nan)]), np.array([total, np.nan])
    tests = [_share(analysis, found, sky, [other for other in range(own) if other != sky]) for sky in range(own)]
    errors = np.std([item for item, _ in tests], axis=0, ddof=1)
    return np.stack([bins, errors]), np.array([total, np.std([item for _, item in tests], ddof=1)])


def _share(analysis: AnalysisSetup, found: _Spectra, sky: int, others: Sequence[int]) -> tuple[np.ndarray, float]:
    """Cross-spectrum of a sky over that of others' transfer function: of each bin (n_bin,), and of all scored ones.

    Modes of the map over its transfer function are weighted by the inverse of their noise, the square of that function.
    """
    transfer, region = found.transfer(others), analysis.region
    parts = np.stack([transfer * found.cross[sky], transfer**2 * found.power[sky]])
    got, expected = _in_rings(analysis, parts)
    modes = region.rings.n_modes[region.selected]
    sums = (np.sum(modes * item[region.selected]) for item in (got, expected))
    return _over(got, expected), float(_over(*map(np.array, sums)))


def _beyond_last(analysis: AnalysisSetup, transfer: np.ndarray, last: float) -> np.ndarray:
    """Transfer function of modes, that of the last bin beyond the bins, where the beam leaves nothing to measure."""
    outside = analysis.region.rings.bin_of_mode.reshape(transfer.shape) == len(analysis.region.rings.ell)
    return np.where(outside, last, transfer)


def _plane(analysis: AnalysisSetup, cross: np.ndarray, power: np.ndarray) -> np.ndarray:
    """Transfer function (2 n, n) in squares of ell_y and ell_x as wide as a bin; NaN in squares without a mode."""
    edges = analysis.region.rings.edges_ell
    n_pad = len(analysis.region.mode_weight)
    step = 2 * np.pi / (n_pad * analysis.geometry.pixel_rad)
    ell_y, ell_x = np.fft.fftfreq(n_pad, 1 / n_pad) * step, np.arange(cross.shape[1]) * step
    width, n = edges[1] - edges[0], len(edges) - 1
    row, column = np.floor(ell_y / width).astype(int) + n, np.floor(ell_x / width).astype(int)
    rows, columns = (row >= 0) & (row < 2 * n), column < n
    place = (row[rows, None] * n + column[columns]).ravel()
    sums = [np.bincount(place, item[np.ix_(rows, columns)].ravel(), 2 * n * n) for item in (cross, power)]
    found = np.full(2 * n * n, np.nan)
    return np.divide(sums[0], sums[1], out=found, where=sums[1] > 0).reshape(2 * n, n)
