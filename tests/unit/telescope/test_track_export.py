"""Tracks that are exported and read back: the same positions, starts and flags."""

import numpy as np
import pytest

import surveysim
from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import InputError
from surveysim.scene.scene import load_scene
from surveysim.timestreams.simulation import observation_path
from tests.scenes import SCHEDULE, WHITE_NOISE_SCENE, with_scan, without_sections

ARCSEC = np.pi / 180 / 3600
DAISY = """pattern = "daisy"
frame = "horizon"
radius = "20 arcmin"
radial_period = "7 s"
duration = "1 min"
chunk = "11.33 s"
dither = "2 arcmin"
sample_rate = "20 Hz"
"""
AZIMUTH = """pattern = "azimuth"
speed = "1 deg / s"
throw = "8 deg"
scans = 4
acceleration = "1 deg / s2"
turnarounds = "flagged"
dither = "2 arcmin"
sample_rate = "20 Hz"
"""
WHOLE = without_sections(WHITE_NOISE_SCENE, "fixed_pointing").replace("30 arcsec", "2 arcmin") + SCHEDULE
SCENES = {"raster": WHOLE, "daisy": with_scan(WHOLE, DAISY), "azimuth": with_scan(WHOLE, AZIMUTH)}
COLUMNS = ["observation", "start_mjd", "time", "az", "el", "ra", "dec"]


def reading(text, scans, name):
    """The scene with the track of a file in its place."""
    keys = f"""pattern = "track"
track_table = "{name}"
chunk = "{scans.scan_s!r} s"
turnaround = "{scans.turnaround_s!r} s"
dither = "0 arcmin"
sample_rate = "{scans.sample_rate_hz} Hz"
"""
    return with_scan(text, keys)


@pytest.mark.parametrize("kind", SCENES)
@pytest.mark.parametrize("columns", ["all", "az and el", "ra and dec"])
def test_track_is_read_back(tmp_path, kind, columns):
    """Within 0.01 arcsec, whichever directions the file has, and with the flags of turnarounds."""
    path = tmp_path / "scene.toml"
    path.write_text(SCENES[kind])
    setup = prepare(load_scene(path))
    table = surveysim.track(path, tmp_path / "whole.ecsv", observations=3)
    assert table.colnames == COLUMNS + ["flag"] * (kind == "azimuth")
    table.remove_columns({"all": [], "az and el": ["ra", "dec"], "ra and dec": ["az", "el"]}[columns])
    for name in table.colnames:  # plain numbers, as of other programs
        table[name] = getattr(table[name], "value", table[name])
    names = [f"{name} [deg]" if name in ("az", "el", "ra", "dec") else name for name in table.colnames]
    names = [{"time": "time [s]", "start_mjd": "start_mjd [d]"}.get(name, name) for name in names]
    rows = "\n".join(",".join(map(repr, map(float, row))) for row in table)
    (tmp_path / "track.csv").write_text(f"{','.join(names)}\n{rows}\n")
    file = "whole.ecsv" if columns == "all" else "track.csv"
    path.write_text(reading(SCENES[kind], setup.observing.scans, file).replace("observations = 4", "observations = 3"))
    again = prepare(load_scene(path))
    assert again.observing.scans.n_scans == setup.observing.scans.n_scans
    for number in range(3):
        (_, one), (_, other) = (observation_path(item.observing, number) for item in (setup, again))
        assert other.start_mjd == one.start_mjd
        np.testing.assert_allclose(other.time_s, one.time_s, rtol=0, atol=1e-9)
        assert np.array_equal(other.scan, one.scan)
        for name in ("xi_rad", "eta_rad", "elevation_rad", "azimuth_rad"):
            np.testing.assert_allclose(getattr(other, name), getattr(one, name), rtol=0, atol=0.01 * ARCSEC)
        assert (one.flagged is None) == (other.flagged is None) == (kind != "azimuth")
        assert one.flagged is None or np.array_equal(other.flagged, one.flagged)


def test_fixed_pointing_has_no_dates_and_no_horizon(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(WHITE_NOISE_SCENE)
    table = surveysim.track(path)
    assert table.colnames == ["observation", "time", "ra", "dec"] and len(table) == 4 * 4 * 60
    assert list(tmp_path.iterdir()) == [path]


def test_files_that_exist_and_observations_that_do_not_are_refused(tmp_path):
    path, out = tmp_path / "scene.toml", tmp_path / "track.ecsv"
    path.write_text(WHITE_NOISE_SCENE)
    with pytest.raises(InputError, match=r"observations: found 5; 1 to 4 is expected"):
        surveysim.track(path, observations=5)
    out.write_text("mine")
    with pytest.raises(surveysim.OutputError, match=r"track.ecsv: exists; another name, or --force \(force=True\), is"):
        surveysim.track(path, out)
    assert out.read_text() == "mine"
    surveysim.track(path, out, force=True, observations=1)
    assert out.read_text().startswith("# %ECSV")
