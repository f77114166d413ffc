"""Band powers of 100 skies beside those of NaMaster: `python -m docs.namaster_comparison` prints two tables.

It needs `pymaster`, which the project does not install otherwise. Bins have constant C_l, as those of NaMaster: the
"beam" of the coupling has l(l+1) / 2 pi, which undoes the flat spectrum of band powers.
"""

from collections.abc import Callable

import healpy as hp
import numpy as np
import pymaster as nmt

import mapmaker as mm
from docs.spectra_study import BEAM, PIXEL, TAPER, N, cmb, skies
from mapmaker.curved_spectra import healpix_window
from mapmaker.transfer_function import pixel_window

EDGES = np.arange(0.0, 5201, 300)
SHOWN = slice(1, 10)  # NaMaster has no power outside its bins


def flat(spectrum: Callable[[np.ndarray], np.ndarray]) -> str:
    """Compare band powers of the same 100 pairs of maps."""
    coupling = mm.flat_coupling(
        TAPER, PIXEL, edges_ell=EDGES, beam=lambda ell: BEAM(ell) * ell * (ell + 1) / (2 * np.pi)
    )
    ell, rng = np.arange(2e4), np.random.default_rng(5)
    beam, bins, side = (
        [ell, np.sqrt(BEAM(ell) * pixel_window(ell, PIXEL))],
        nmt.NmtBinFlat(EDGES[:-1], EDGES[1:]),
        N * PIXEL,
    )
    empty = nmt.NmtFieldFlat(side, side, TAPER, [np.zeros((N, N))], beam=beam)
    workspace = nmt.NmtWorkspaceFlat()
    workspace.compute_coupling_matrix(empty, empty, bins)
    ours, theirs = [], []
    for _, sky in zip(range(100), skies(spectrum, rng), strict=False):
        maps = sky + 10 * rng.standard_normal((2, N, N))
        fields = [nmt.NmtFieldFlat(side, side, TAPER, [item], beam=beam) for item in maps]
        ours.append(mm.realized_band_powers(maps, coupling)[SHOWN])
        theirs.append(workspace.decouple_cell(nmt.compute_coupled_cell_flat(*fields, bins))[0][SHOWN])
    expected = (coupling.windows @ (spectrum(coupling.window_ell) * mm.flat_spectrum_psd(coupling.window_ell)))[SHOWN]
    error = np.std(ours, axis=0)
    pulls = [(np.mean(found, axis=0) - expected) / error * 10 for found in (ours, theirs)]
    both = (
        np.mean(theirs, axis=0) / np.mean(ours, axis=0),
        np.diag(np.corrcoef(np.transpose(ours), np.transpose(theirs)), 9),
    )
    text = "| l | deviation [standard errors] | NaMaster's | ratio of means | correlation |\n"
    text += "|---:|---:|---:|---:|---:|\n"
    for row in zip(coupling.ell[SHOWN], *pulls, *both, strict=True):
        text += "| {:.0f} | {:+.1f} | {:+.1f} | {:.4f} | {:.4f} |\n".format(*row)
    return text


def curved(nside: int = 64) -> tuple[float, float]:
    """Largest relative differences of the binned coupling and of the cross-power, on a cap."""
    x, _, z = hp.pix2vec(nside, np.arange(12 * nside**2))
    taper, ell, edges = np.clip(z - 0.3, 0, None) ** 0.7 * (1 + 0.2 * x), np.arange(3.0 * nside), np.arange(2.0, 129, 9)
    coupling = mm.curved_coupling(taper, edges_ell=edges, beam=np.ones_like)
    maps = np.random.default_rng(0).normal(size=(2, taper.size))
    order = {"n_iter": 3, "n_iter_mask": 3, "lmax": 3 * nside - 1}
    fields = [nmt.NmtField(taper, [item], **order) for item in maps]
    workspace = nmt.NmtWorkspace()
    workspace.compute_coupling_matrix(*fields, nmt.NmtBin.from_lmax_linear(3 * nside - 1, 1))
    modes = (2 * ell + 1) * ((ell >= edges[:-1, None]) & (ell < edges[1:, None]))
    mean = modes / modes.sum(axis=1, keepdims=True) / np.mean(taper**2)
    matrix = (mean @ workspace.get_coupling_matrix())[:, 1:]
    ours = coupling.response[:, 1:] / (healpix_window(ell, nside) * mm.flat_spectrum_psd(ell))[1:]
    large = matrix > 1e-3 * matrix.max()
    own, together = coupling.field.pseudo_power(maps), coupling.field.pseudo_power(maps.sum(axis=0))
    cross, theirs = (together - own.sum(axis=0)) / 2, mean @ nmt.compute_coupled_cell(*fields)[0]
    return np.abs(ours / matrix - 1)[large].max(), np.abs(cross / theirs - 1).max()


if __name__ == "__main__":
    print(flat(lambda ell: 2e-4 * ell * (ell + 1)))
    print(flat(cmb))
    print(curved())
