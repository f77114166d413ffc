"""Beams and effective areas of apertures against closed forms and the literature."""

import math

import numpy as np
import pytest

from surveysim.output.scene_copy import scene_files
from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import load_scene, scene_hash
from surveysim.telescope.diffraction import aperture_efficiency, beam_width, effective_area_m2
from surveysim.telescope.illumination import UNIFORM, GaussianIllumination
from tests.scenes import SMALL_SCENE

UNIFORM = UNIFORM


def test_uniform_circular_aperture():
    """2 J1(x) / x is sqrt(1/2) at x = 1.61634: a FWHM of 2 * 1.61634 / pi = 1.02899 lambda / D."""
    assert beam_width(UNIFORM) == pytest.approx(1.02899, abs=1e-5)
    assert aperture_efficiency(UNIFORM) == pytest.approx(1, rel=1e-13)


@pytest.mark.parametrize("taper_db", [5, 8, 10, 12, 15])
def test_tapers_of_the_literature(taper_db):
    """(1.02 + 0.0135 T) lambda / D (Goldsmith, Quasioptical Systems, 1998, section 6.6): within its own 1 %."""
    assert beam_width(GaussianIllumination(taper_db)) == pytest.approx(1.02 + 0.0135 * taper_db, rel=0.01)


def test_strong_taper_is_a_gaussian_beam():
    """A field exp(-k u^2 / 2) without an edge has the far-field intensity exp(-(pi w)^2 / 4k) at w lambda / D."""
    taper = 120.0
    kappa = taper * math.log(10) / 10
    assert beam_width(GaussianIllumination(taper)) == pytest.approx(
        2 * math.sqrt(math.log(2) * kappa) / math.pi, rel=1e-5
    )


@pytest.mark.parametrize("taper_db", [0.5, 3, 10, 30])
def test_efficiency_of_a_gaussian_taper(taper_db):
    """2 (1 - exp(-k/2))^2 / ((k/2)^2) / ((1 - exp(-k)) / k) / 2: with k of the intensity (Goldsmith, section 6.4.1)."""
    kappa = taper_db * math.log(10) / 10
    expected = 4 * (1 - math.exp(-kappa / 2)) ** 2 / (kappa * (1 - math.exp(-kappa)))
    assert aperture_efficiency(GaussianIllumination(taper_db)) == pytest.approx(expected, rel=1e-12)


def test_obscuration_narrows_and_takes_area():
    widths = [beam_width(UNIFORM, ratio) for ratio in (0, 0.1, 0.3, 0.6)]
    assert (np.diff(widths) < 0).all()
    for ratio in (0.1, 0.6):
        assert aperture_efficiency(UNIFORM, ratio) == pytest.approx(1 - ratio**2, rel=1e-12)


def test_thin_ring():
    """J0(x) is sqrt(1/2) at x = 1.12627: 2 * 1.12627 / pi = 0.71701 lambda / D."""
    assert beam_width(UNIFORM, 0.9999) == pytest.approx(0.71701, abs=1e-4)


@pytest.fixture
def scene_of(tmp_path):
    def load(overrides, without=()):
        path = tmp_path / "scene.toml"
        path.write_text("".join(line for line in SMALL_SCENE.splitlines(True) if not line.startswith(without)))
        return load_scene(path, overrides)

    return load


ANGLES = ("beam_fwhm = ", "f_lambda = ")
LARGE = {"optics.aperture": "10 m"}


def test_beam_of_a_scene_follows_from_its_aperture(scene_of):
    """143 GHz and 10 m: lambda / D is 43.24 arcsec."""
    one = math.degrees(299792458 / 143e9 / 10) * 3600
    instrument = prepare(scene_of(LARGE, ANGLES)).scene.instrument
    assert math.degrees(instrument.f_lambda_rad) * 3600 == pytest.approx(one, rel=1e-12)
    assert instrument.beam_fwhm_rad / instrument.f_lambda_rad == pytest.approx(1.02899, abs=1e-5)
    tapered = {"instrument.edge_taper": "10 dB", "optics.central_obscuration": "2 m"}
    setup = prepare(scene_of(LARGE | tapered, ANGLES))
    expected = beam_width(GaussianIllumination(10.0), 0.2) * instrument.f_lambda_rad
    assert setup.camera.focal_plane.fwhm_rad == pytest.approx(expected, rel=1e-12)
    assert setup.camera.f_lambda_rad == instrument.f_lambda_rad


def test_stated_angles_stay(scene_of):
    scene = scene_of({"optics.aperture": "10 m"})
    assert prepare(scene).scene is scene
    stated = prepare(scene_of(LARGE, "f_lambda = ")).scene.instrument
    assert stated.beam_fwhm_rad == prepare(scene_of({})).scene.instrument.beam_fwhm_rad
    assert stated.f_lambda_rad == pytest.approx(299792458 / 143e9 / 10, rel=1e-12)


def test_apertures_count_in_the_hash(scene_of):
    hashes = {scene_hash(prepare(scene_of({"optics.aperture": item}, ANGLES)).scene) for item in ("10 m", "11 m")}
    assert len(hashes) == 2


def test_a_prepared_scene_is_copied_to_the_output(scene_of):
    """The copy leaves the angles out as the file does."""
    setup = prepare(scene_of(LARGE, ANGLES))
    text = scene_files(setup.scene)["scene.toml"].decode()
    assert 'aperture = "10 m"' in text and not any(f"\n{angle}" in text for angle in ANGLES)
    assert scene_files(setup.scene) == scene_files(scene_of(LARGE, ANGLES))


@pytest.mark.parametrize("key", ["beam_fwhm", "f_lambda"])
def test_an_angle_without_an_aperture(scene_of, key):
    with pytest.raises(SceneError, match=f"instrument.{key}: missing; an angle, or 'optics.aperture'"):
        scene_of({}, f"{key} = ")


@pytest.mark.parametrize("aperture", ["1 mm", "1e8 m"])
def test_an_aperture_of_no_use(scene_of, aperture):
    with pytest.raises(
        SceneError, match="optics.aperture: found .* m, with a beam of .* arcsec; one of 0.001 arcsec to"
    ):
        prepare(scene_of({"optics.aperture": aperture}, ANGLES))


def test_effective_area(scene_of):
    """A stated share, that of the illumination, or lambda^2 over the solid angle of a Gaussian beam."""
    full = math.pi * 25
    uniform = scene_of({"optics.aperture": "10 m", "optics.central_obscuration": "1 m"})
    assert effective_area_m2(uniform) == pytest.approx(0.99 * full, rel=1e-12)
    stated = scene_of({"optics.aperture": "10 m", "optics.aperture_efficiency": 0.6})
    assert effective_area_m2(stated) == pytest.approx(0.6 * full, rel=1e-12)
    bare = scene_of({"instrument.beam_fwhm": "1 arcmin"})
    omega = 1.1330900354567985 * math.radians(1 / 60) ** 2
    assert effective_area_m2(bare) == pytest.approx((299792458 / 143e9) ** 2 / omega, rel=1e-12)
