"""Figures of merit: noise of a single map in bins of multipole, what pipelines leave of signals, and which one wins."""

import numpy as np
import pytest

from surveysim import run
from surveysim.reduction.figure_of_merit import figures_of_merit
from surveysim.reduction.observation import transfer_functions
from surveysim.reduction.setup import prepare
from surveysim.results.summary import summary
from surveysim.runtime.engine import SERIAL
from surveysim.scene.scene import load_scene
from tests.scenes import write_scene

LYNX = "scenarios/lynx.toml"


@pytest.fixture(scope="module")
def setup():
    return prepare(load_scene(LYNX, {"cleaning.compare": ["planar", "quadratic"], "observations": 4}))


def test_noise_of_white_maps_in_bins(setup):
    """Sums of H samples of variance 9 have it in every bin, to sqrt(2 / n) of its modes."""
    rng = np.random.default_rng(1)
    n = len(setup.analysis.region.taper)
    hits = rng.integers(5, 30, (n, n))
    found = np.mean(
        [setup.analysis.region.ring_noise(3 * np.sqrt(hits) * rng.standard_normal((n, n)), hits) for _ in range(40)],
        axis=0,
    )
    error = 9 * np.sqrt(2 / setup.analysis.region.rings.n_modes / 40)
    # Bins narrower than the taper's resolution scatter less than their modes say, and share them.
    assert (np.abs(found - 9) < 5 * error).all()
    assert np.isinf(setup.analysis.region.ring_noise(np.zeros((n, n)), np.zeros((n, n), int))).all()


def test_merit_falls_with_noise_and_with_what_is_taken_of_the_signal(setup):
    """A flat band power's goes as (T / N)^2, a source's as T / N."""
    rng = np.random.default_rng(2)
    shape = (setup.analysis.geometry.n_y, setup.analysis.geometry.n_x)
    hits = np.full(shape, 10)
    total = rng.standard_normal(shape)
    transmission = np.ones((3, 2, len(setup.analysis.region.rings.ell)))
    transmission[2] = 0.5
    found = figures_of_merit(setup.analysis, transmission, [(total, hits), (2 * total, hits), (total, hits)])
    np.testing.assert_allclose(found[1] / found[0], [1 / 16, 1 / 4], rtol=1e-12)
    np.testing.assert_allclose(found[2] / found[0], [1 / 4, 1 / 2], rtol=1e-12)


def test_higher_orders_leave_less_on_large_scales(setup):
    transmission = transfer_functions(setup)
    ell = setup.analysis.region.rings.ell
    large, small = (ell > 1500) & (ell < 3500), ell > 9000
    for signal in (0, 1):
        average, planar, quadratic = transmission[:, signal]
        assert (average[large] > planar[large]).all() and (planar[large] > quadratic[large]).all()
        # Where structures are far smaller than the array, all leave nearly everything.
        assert (transmission[:, signal][:, small].mean(axis=1) > 0.85).all() and (transmission[:, signal] < 1.1).all()
    assert (transmission[:, 1][:, small] > 0.85).all()
    # What is left of n modes that lose a share f of one sky scatters by 2 sqrt(f / n): the product of both, twice.
    scatter = 2 * np.sqrt(0.15 / setup.analysis.region.rings.n_modes[small])
    assert (transmission[:, 0][:, small] > 0.85 - 3 * scatter).all()


def test_without_templates_only_the_scan_s_mean_is_lost(tmp_path):
    path = write_scene(tmp_path)
    scene = load_scene(path, {"cleaning.algorithm": "none", "cleaning.compare": ["average"]})
    none, average = transfer_functions(prepare(scene))
    ell = prepare(scene).analysis.region.rings.ell
    high = ell > 3000  # scans of 24 arcmin, whose means take little of that
    assert (none[:, high].mean(axis=1) > 0.85).all()
    # For a point source in every bin: each loses its share of a template of 18 detectors.
    assert (none[1, high] > average[1, high] + 0.01).all()


@pytest.mark.slow
def test_who_wins_in_the_lynx_survey():
    """Average and planar alike within their errors, quadratic worse; planar wins more often in poor weather."""
    result = run(load_scene(LYNX, {"cleaning.compare": ["planar", "quadratic"], "observations": 120}), engine=SERIAL)
    sigma = {name: item.band.sigma_ukcmb2 for name, item in result.scores.items()}
    assert sigma["planar"] / sigma["actual"] == pytest.approx(1, abs=0.04)
    assert sigma["quadratic"] / sigma["actual"] > 1.04
    assert sigma["optimal"] < 1.01 * min(sigma["actual"], sigma["planar"])
    entries = summary(result)["cleaning"]
    shares = [entries[name]["best_for_cmb"] for name in ("actual", "planar", "quadratic")]
    assert sum(shares) == pytest.approx(1) and shares[2] < 0.15 and min(shares[:2]) > 0.2
    removed = [entries[name]["point_source_flux_removed"] for name in ("actual", "planar", "quadratic")]
    # 2.94 beams at once over 115 detectors, a template each, on peaks of 0.9 of the height: 2.8 %; 2 % for the mean.
    np.testing.assert_allclose(removed, [0.048, 0.105, 0.19], rtol=0.25)
