"""Scores of the same data from other lowest multipoles and with other bin weights."""

import numpy as np

from mapmaker.bandpower import BandPower, flat_band_power_fixed_weights
from surveysim.forecasting.validity import resolution_ell
from surveysim.reduction.data_set import scaled_name
from surveysim.reduction.setup import Setup
from surveysim.survey.coadds import CoAdds
from surveysim.survey.scores import DataSetScore, rescore, sector_sigma

ALTERNATIVE_NINTHS = (2, 4, 6, 8, 9, 10, 11)  # ninths of the scene's lowest scored multipole


def alternatives(setup: Setup, coadds: CoAdds, scores: dict[str, DataSetScore]) -> list[dict[str, float | str]]:
    """Score the same data from other lowest multipoles, and with the same bin weights for all data sets.

    `weights` is "own" (each data set weights its bins by its own noise), "actual" (all use the noise of the actual
    data) or "own, 2-D" (modes are also weighted by direction; the scene's range only). Masked sets are scaled by their
    fraction of the detectors.
    """
    lowest = lowest_multipoles(setup)
    rows = [_alternative(setup, scores, weights, ell) for weights in ("own", "actual") for ell in lowest]
    if setup.analysis.region.sectors is not None:
        sigma = {name: sector_sigma(setup.analysis, coadds, item) for name, item in scores.items()}
        ell_min = setup.scene.score.ell_min
        rows.append(
            _alternative_row(
                setup, scores, weights="own, 2-D", band=scores["actual"].band, ell_min=ell_min, sigma_ukcmb2=sigma
            )
        )
    return rows


def lowest_multipoles(setup: Setup) -> list[int]:
    """Bin edges around the scene's lowest multipole, none below the resolution of scans and taper."""
    score = setup.scene.score
    ninths = np.array(ALTERNATIVE_NINTHS) * score.ell_min / 9
    edges = np.unique(np.round(ninths / score.ell_bin).astype(int) * score.ell_bin)
    used = (edges >= resolution_ell(setup.scene)) & (edges + score.ell_bin <= score.ell_max)
    return edges[used].tolist()


def _alternative(setup: Setup, scores: dict[str, DataSetScore], weights: str, ell_min: int) -> dict[str, float | str]:
    reference = scores["actual"]
    band = rescore(setup.analysis, reference, ell_min).band
    used, modes = band.weight > 0, setup.analysis.region.rings.n_modes
    sigma = {}
    for name, item in scores.items():
        if weights == "own":
            sigma[name] = rescore(setup.analysis, item, ell_min).band.sigma_ukcmb2
        else:
            sigma[name] = flat_band_power_fixed_weights(
                item.quoted_psd, item.signal_psd, modes, used, weighting_noise_psd_ukcmb2=reference.quoted_psd
            )
    return _alternative_row(setup, scores, weights=weights, band=band, ell_min=ell_min, sigma_ukcmb2=sigma)


def _alternative_row(
    setup: Setup,
    scores: dict[str, DataSetScore],
    *,
    weights: str,
    band: BandPower,
    ell_min: int,
    sigma_ukcmb2: dict[str, float],
) -> dict[str, float | str]:
    row: dict[str, float | str]
    row = {"weights": weights, "ell_min": ell_min, "ell_eff": band.ell_eff, "fwhm_ell": band.fwhm_ell}
    for name, item in scores.items():
        share = item.n_det / setup.camera.n_det
        row[scaled_name(name) if share < 1 else name] = share * sigma_ukcmb2[name]
    return row
