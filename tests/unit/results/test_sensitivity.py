"""Sensitivity of a scene's detectors: NEP, NET and NEFD, their tables, saturation."""

import json
import math

import numpy as np
import pytest

from surveysim import load_scene, run
from surveysim.reduction.setup import prepare
from surveysim.results.sensitivity import (
    STATED,
    load_table,
    nep_table,
    saturation_warnings,
    sensitivities,
    sensitivity_entries,
    sensitivity_table,
)
from surveysim.runtime.engine import SERIAL
from surveysim.scene.sky import PointSource
from surveysim.scene.units import BOLTZMANN_J_K
from surveysim.telescope.array_noise import array_psd
from surveysim.telescope.diffraction import effective_area_m2
from surveysim.telescope.noise_levels import white_levels
from surveysim.timestreams.sky_maps import source_peak_mk
from tests.camera import BAND, BOLOMETER, CAMERA, HORNS, PHOTON, QUIET, SITE, STATED_SKY
from tests.pages import read_page


@pytest.fixture
def setup_of(tmp_path):
    def load(text, overrides=None):
        path = tmp_path / "scene.toml"
        path.write_text(QUIET + text)
        return prepare(load_scene(path, BAND | HORNS | (overrides or {})))

    return load


def without_layout(text):
    """A scene without [instrument.layout]."""
    before, _, rest = text.partition("[instrument.layout]")
    return before + rest[rest.index("\n[") :]


def test_one_sky_where_it_is_stated_and_quartiles_of_a_site(setup_of):
    assert list(sensitivities(setup_of(PHOTON + STATED_SKY))) == [STATED]
    found = sensitivities(setup_of(PHOTON + CAMERA + SITE))
    # Quantiles of Mauna Kea: paper, section 1.2.
    assert [item.pwv_mm for item in found.values()] == pytest.approx([1.0, 1.68, 2.92])
    assert (np.diff([item.load_w for item in found.values()]) > 0).all()
    stated = '[photon]\npsd = "1 mK2/Hz"\ncoherent_fraction = 0.1\ncoherence = "field"\n'
    assert sensitivities(setup_of(stated)) == {}


@pytest.mark.parametrize("detector", [BOLOMETER, '[detector]\npsd = "0.1 mK2 / Hz"\n', ""])
def test_terms_add_up_to_the_noise_of_the_streams(setup_of, detector):
    """NET^2 of a second is half of the one-sided PSD."""
    setup = setup_of(PHOTON + CAMERA + SITE + detector)
    for item in sensitivities(setup).values():
        level = white_levels(setup.scene, setup.air.water.opacity, item.pwv_mm, item.elevation_rad)
        psd = level.photon_mk2_hz + level.detector_mk2_hz
        assert item.net_mk_rts**2 == pytest.approx(psd / 2, rel=1e-12)


def test_flux_of_a_source_and_of_the_nefd_see_one_area(setup_of):
    """The drawn peak of a source of 1 mJy, over the NET, is one over the NEFD: with an aperture, and without."""
    source = PointSource.model_validate(
        {"ra": "132.3 deg", "dec": "44.8 deg", "flux": "1 mJy", "flux_frequency": "90 GHz", "spectral_index": 0}
    )
    load = '[photon.load]\nsky = "30 K"\noptics = "10 K"\n'
    for setup in (setup_of(PHOTON + STATED_SKY), setup_of(PHOTON + load)):
        (item,) = sensitivities(setup).values()
        peak_mk = source_peak_mk(source, setup.scene.instrument.band, effective_area_m2(setup.scene))
        assert peak_mk == pytest.approx(item.net_mk_rts / item.nefd_mjy_rts, rel=1e-9)


def test_shares_of_the_elements(setup_of):
    """Loads add up, and so do the shares of the squared NEP with that of the detector."""
    setup = setup_of(PHOTON + STATED_SKY + BOLOMETER)
    item = sensitivities(setup)[STATED]
    entry = sensitivity_entries(setup, {STATED: item})[0]
    assert [row["name"] for row in entry["elements"]] == ["sky", "mirrors", "filter", "stop", "lens"]
    assert item.load_w == pytest.approx(sum(row["load_w"] for row in entry["elements"]), rel=1e-12)
    photons = item.nep2["shot"] + item.nep2["wave"]
    assert sum(row["nep2_share"] for row in entry["elements"]) == pytest.approx(photons / item.nep_w_rthz**2, rel=1e-12)
    assert sum(element.nep2 for element in item.elements) == pytest.approx(photons, rel=1e-12)


def test_flux_density(setup_of):
    """A flux S gives the Rayleigh-Jeans temperature A S / 2 k: 1 mJy on 78.54 m2 is 28.4 uK."""
    item = sensitivities(setup_of(PHOTON + CAMERA + SITE, {"optics.aperture_efficiency": 1}))["median"]
    kelvin_per_mjy = math.pi * 25 * 1e-29 / (2 * BOLTZMANN_J_K)
    assert kelvin_per_mjy == pytest.approx(28.4e-6, rel=2e-3)
    assert item.nefd_mjy_rts == pytest.approx(1e-3 * item.net_mk_rts / kelvin_per_mjy, rel=1e-12)
    half = sensitivities(setup_of(PHOTON + CAMERA + SITE, {"optics.aperture_efficiency": 0.5}))["median"]
    assert half.nefd_mjy_rts == pytest.approx(2 * item.nefd_mjy_rts, rel=1e-12)


def test_saturation(setup_of):
    """The link of 100 pW/K carries 3.569 pW: G T_c (1 - t^4) / 4."""
    low = sensitivities(setup_of(PHOTON + STATED_SKY + BOLOMETER))
    assert low[STATED].saturation_w == pytest.approx(3.569e-12, rel=1e-3)
    assert saturation_warnings(low) == []
    high = sensitivities(setup_of(PHOTON + STATED_SKY + BOLOMETER, {"optics.sky": "400 K"}))
    (line,) = saturation_warnings(high)
    assert line == (
        f"detector.bolometer: {1e12 * high[STATED].load_w:.3g} pW of load (stated sky) saturate it; its link carries "
        "3.57 pW."
    )


def test_tables(setup_of):
    setup = setup_of(PHOTON + CAMERA + SITE + BOLOMETER)
    entries = sensitivity_entries(setup, sensitivities(setup))
    assert json.loads(json.dumps(entries)) == entries
    load, nep, sensitivity = load_table(entries), nep_table(entries), sensitivity_table(entries)
    assert load.title == "Load of a detector: median water, 1.68 mm, at an elevation of 55.0 deg"
    assert load.columns[0].values == ["CMB", "atmosphere", "mirrors", "filter", "stop", "lens"]
    files = nep.in_files
    parts = [files[f"nep_{name}"] for name in ("shot", "wave", "phonon", "amplifier")]
    np.testing.assert_allclose(np.sqrt(np.sum(np.square(parts), axis=0)), files["nep"], rtol=1e-12)
    assert nep.units["nep_phonon"] == "aW / Hz(1/2)"
    single, whole = sensitivity.in_files["nefd_mjy"], sensitivity.in_files["array_nefd_mjy"]
    ratio = sensitivity.in_files["array_noise_ratio"]
    np.testing.assert_allclose((single / whole) ** 2, setup.camera.n_det / np.array(ratio), rtol=1e-12)
    for item, worse in zip(sensitivities(setup).values(), ratio, strict=True):
        levels = white_levels(setup.scene, setup.air.water.opacity, item.pwv_mm, item.elevation_rad)
        mean = array_psd(setup.camera, setup.camera.photon_coherence, levels)
        alone = (levels.photon_mk2_hz + levels.detector_mk2_hz) / setup.camera.n_det
        assert worse == pytest.approx(mean / alone, rel=1e-12)
        assert worse > 1.1
    for table in (load, nep, sensitivity):
        table.quantities()


def test_detectors_of_a_table(setup_of, tmp_path):
    """NEPs of 1, 2 and 2e-17 W/sqrt(Hz) without photon noise to speak of: worth 1.5 of the first, 3 of the mean."""
    rows = "0 0 1e-17\n0 200 2e-17\n200 0 2e-17\n"
    head = "".join(f"# - {{name: {name}, unit: arcsec, datatype: float64}}\n" for name in "xy")
    head += "# - {name: nep, unit: W Hz(-1/2), datatype: float64}\n"
    (tmp_path / "camera.ecsv").write_text(f"# %ECSV 1.0\n# ---\n# datatype:\n{head}x y nep\n{rows}")
    (tmp_path / "scene.toml").write_text(
        without_layout(QUIET) + PHOTON + "[optics]\nsky = '1e-6 K'\n[optics.stop]\ntemperature = '10 mK'\n[detector]\n"
    )
    keys = BAND | {"instrument.positions": "camera.ecsv", "instrument.horn_f_lambda": 1.0}
    setup = prepare(load_scene(tmp_path / "scene.toml", keys))
    item = sensitivities(setup)[STATED]
    entry = sensitivity_entries(setup, {STATED: item})[0]
    worth = np.sum((1e-17 / np.array([1e-17, 2e-17, 2e-17])) ** 2)
    assert entry["array_noise_ratio"] == pytest.approx(1, abs=1e-6)
    best = 1e3 * 1e-17 / (math.sqrt(2) * item.w_per_k_cmb)
    assert entry["array_net_mkcmb_rts"] == pytest.approx(best / math.sqrt(worth), rel=1e-4)


def test_results_of_a_run(tmp_path):
    """Tables, summary, page and a warning of a detector that saturates."""
    (tmp_path / "scene.toml").write_text(QUIET + PHOTON + STATED_SKY + BOLOMETER)
    out, keys = tmp_path / "out", {"optics.sky": "400 K", "observations": 2}
    run(load_scene(tmp_path / "scene.toml", BAND | HORNS | keys), out, engine=SERIAL, figures=False)
    summary = json.loads((out / "summary.json").read_text())
    assert {f"tables/{name}.ecsv" for name in ("load", "nep", "sensitivity")} <= set(summary["files"])
    assert "saturate it; its link carries 3.57 pW." in summary["warnings"][0]
    text = read_page(out / "report.html").text
    for words in (
        "Load of a detector: stated sky, at an elevation of 55.0 deg",
        "Mirrors at 270 K, emissivity 5 %.",
        "A stop at 4 K.",
        "Thermal noise of a link of 100 pW / K from 165 to 100 mK",
        "saturate it",
    ):
        assert words in text
