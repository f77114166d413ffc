"""Tracks of tables: columns, times, interpolation, flags and errors."""

from dataclasses import replace

import numpy as np
import pytest

from surveysim.output.scene_copy import scene_files
from surveysim.reduction.design_warnings import design_warnings
from surveysim.reduction.observation import observe
from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import InputError, SceneError
from surveysim.scene.scene import load_scene
from surveysim.scene.track_table import read_track
from surveysim.timestreams.simulation import observation_path
from tests.scenes import SCHEDULE, WHITE_NOISE_SCENE, with_scan, without_sections

TRACK = """\
pattern = "track"
track_table = "track.csv"
chunk = "10 s"
dither = "0 arcmin"
sample_rate = "10 Hz"
"""
ARCMIN = np.pi / 180 / 60
RA, DEC = np.radians(132.3), np.radians(44.84)  # the centre of the field
MJD = 52968.5


def csv(folder, names, *columns, name="track.csv"):
    path = folder / name
    rows = [",".join(f"{value:.12f}" for value in row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join([names, *rows, ""]))
    return path


def scene(folder, keys="", scheduled=False):
    text = with_scan(WHITE_NOISE_SCENE, TRACK + keys).replace("observations = 4", "observations = 1")
    path = folder / "scene.toml"
    path.write_text(without_sections(text, "fixed_pointing") + SCHEDULE if scheduled else text)
    return load_scene(path)


def curve(time_s):
    """Offsets in declination and, over its cosine, right ascension: sines of 5 arcmin with periods of 20 s and 13 s."""
    return 5 * ARCMIN * np.sin(2 * np.pi * time_s / 20), 5 * ARCMIN * np.sin(2 * np.pi * time_s / 13)


def sky_csv(folder, time_s, name="track.csv"):
    east, north = curve(time_s)
    ra, dec = np.degrees(RA + east / np.cos(DEC)), np.degrees(DEC + north)
    return csv(folder, "time [min], ra [deg], dec [deg]", time_s / 60, ra, dec, name=name)


@pytest.mark.parametrize(
    "kind, allowed", [("cubic", 3 / 128 * (0.5 * 2 * np.pi / 13) ** 4), ("linear", 1 / 8 * (0.5 * 2 * np.pi / 13) ** 2)]
)
def test_interpolation_is_as_exact_as_its_order(tmp_path, kind, allowed):
    """Errors up to 3/128 h^4 of the fourth derivative, or 1/8 h^2 of the second, of a sine; h is 0.5 s."""
    sky_csv(tmp_path, np.arange(0, 60.1, 0.5))
    setup = prepare(scene(tmp_path, f'interpolation = "{kind}"'))
    path, _ = observation_path(setup.observing, 0)
    assert setup.observing.scans.n_scans == 6 and np.bincount(path.scan).tolist() == [100] * 6
    np.testing.assert_allclose(path.time_s, (np.arange(600) + 0.5) / 10)
    east, north = curve(path.time_s)
    # The tangent plane's offsets differ from those of latitude and longitude by terms of second order.
    second = (5 * ARCMIN) ** 2
    error = np.abs(path.eta_rad - north).max()
    assert 0.5 * allowed * 5 * ARCMIN - second < error < allowed * 5 * ARCMIN + second
    assert np.abs(path.xi_rad - east).max() < allowed * 5 * ARCMIN + 2 * second


def test_chunks_end_before_the_track_and_leave_turnarounds_out(tmp_path):
    sky_csv(tmp_path, np.arange(0, 60.1, 0.5))
    scans = prepare(scene(tmp_path, 'turnaround = "3 s"')).observing.scans
    assert (scans.n_scans, scans.turnaround_s) == (4, 3.0)  # 52 s; a fifth chunk would begin at 52 s and end at 62 s


def test_speeds_are_those_between_rows(tmp_path):
    time_s = np.arange(0, 60.1, 0.5)
    sky_csv(tmp_path, time_s)
    found = scene(tmp_path).scan
    step = np.hypot(*(np.diff(item) for item in curve(time_s))) / 0.5
    # The cosine of the declination at the centre stands for those of the rows.
    assert found.speed_rad_s == pytest.approx(step.mean(), rel=2e-3)
    assert found.fastest_rad_s == pytest.approx(step.max(), rel=2e-3)


def test_azimuths_with_dates_are_the_same_track(tmp_path):
    """A track of the sky, converted to azimuth and elevation with its start, is read back to the same places."""
    time_s = np.arange(0, 60.01, 0.1)
    sky_csv(tmp_path, time_s)
    setup = prepare(scene(tmp_path, scheduled=True))
    path, pointing = observation_path(setup.observing, 0)
    azimuth, elevation = np.degrees(pointing.azimuth_rad), np.degrees(pointing.elevation_rad)
    start = np.full(len(azimuth), pointing.start_mjd)
    folder = tmp_path / "horizon"
    folder.mkdir()
    csv(folder, "time [s], start_mjd [d], az [deg], el [deg]", path.time_s, start, azimuth, elevation)
    again, seen = observation_path(prepare(scene(folder, scheduled=True)).observing, 0)
    assert seen.start_mjd == pytest.approx(pointing.start_mjd, abs=1e-12)
    np.testing.assert_allclose(again.xi_rad, path.xi_rad, atol=np.radians(1e-3 / 3600))
    np.testing.assert_allclose(again.eta_rad, path.eta_rad, atol=np.radians(1e-3 / 3600))


def test_flagged_samples_are_in_no_map(tmp_path):
    time_s = np.arange(0, 60.01, 0.1)
    east, north = curve(time_s)
    ra, dec = np.degrees(RA + east / np.cos(DEC)), np.degrees(DEC + north)
    flag = (time_s > 25.01) & (time_s < 30.01)
    csv(tmp_path, "time [s], ra [deg], dec [deg], flag", time_s, ra, dec, flag)
    setup = prepare(scene(tmp_path))
    path, _ = observation_path(setup.observing, 0)
    lost = path.flagged.sum()
    assert 49 <= lost <= 51 and path.flagged[np.abs(path.time_s - 27.5) < 2.4].all()
    assert observe(setup, 0, False).hits[0].sum() == setup.camera.n_det * (600 - lost)


def test_observations_of_a_table_follow_one_another(tmp_path):
    """Two observations, the second shifted; a survey of more is refused."""
    time_s = np.arange(0, 40.1, 0.5)
    east, north = curve(time_s)
    shift = 1 / 60
    columns = np.concatenate([[0 * time_s, time_s, np.degrees(RA + east), np.degrees(DEC + north)]] * 2, axis=1)
    columns[0, len(time_s) :], columns[3, len(time_s) :] = 1, columns[3, len(time_s) :] + shift
    path = csv(tmp_path, "observation, time [s], ra [deg], dec [deg]", *columns)
    assert read_track(path).n_obs == 2
    found = scene(tmp_path)
    two = prepare(found.model_copy(update={"observations": 2}))
    paths = [observation_path(two.observing, number)[0] for number in (0, 1)]
    np.testing.assert_allclose(paths[1].eta_rad - paths[0].eta_rad, np.radians(shift), rtol=1e-4)
    with pytest.raises(SceneError, match=r"observations: found 3; 2 or fewer are expected, as in scan.track_table"):
        load_scene(tmp_path / "scene.toml", {"observations": 3})


def test_low_fields_and_azimuths_without_a_schedule_are_refused(tmp_path):
    time_s = np.arange(0, 60.1, 0.5)
    csv(tmp_path, "mjd [d], az [deg], el [deg]", MJD + time_s / 86400, 10 + time_s / 60, 60 + 0 * time_s)
    with pytest.raises(SceneError, match=r"scan.track_table: found az and el with \[fixed_pointing\]; a section"):
        scene(tmp_path)
    low = tmp_path / "low"
    low.mkdir()
    csv(low, "mjd [d], ra [deg], dec [deg]", MJD + 0.5 + time_s / 86400, 132.3 + time_s / 1e4, 44.8 + 0 * time_s)
    with pytest.raises(
        SceneError, match=r"scan.track_table: found the field at .* in observation 0; schedule.min_elevation, 40"
    ):
        prepare(scene(low, scheduled=True))


ROWS = ["0, 10, 60", "1, 10.1, 60", "2, 10.2, 60", "3, 10.3, 60"]


SKY = "time [s], ra [deg], dec [deg]"
NUMBERED = "observation, ra [deg], dec [deg], time [s]"


@pytest.mark.parametrize(
    "names, rows, error",
    [
        (
            "time [s], ra [deg], dek [deg]",
            ROWS,
            "column 'dek': unknown; the columns observation, start_mjd, mjd, time,",
        ),
        ("time [s], ra [deg]", ["0, 10"], "column 'dec': missing; ra and dec are expected together"),
        ("ra [deg], dec [deg]", ["0, 10"], "columns 'time' and 'mjd': found neither; exactly one is expected"),
        ("time [s], az [deg], el [deg]", ROWS, "column 'az': found without a date; the column 'mjd', or 'start_mjd'"),
        (
            "time, ra [deg], dec [deg]",
            ROWS,
            "column 'time': found no unit, and one in brackets is expected, as time [s]",
        ),
        ("time [s], ra [m], dec [deg]", ROWS, "column 'ra': found the unit 'm'; one like deg is expected"),
        (f"{SKY}, flag", [f"{row}, 1" for row in ROWS], "column 'flag': found one in each row; rows without are"),
        (SKY, [*ROWS, "4, x, 60"], "row 5, column 'ra': found 'x'; a number is expected"),
        (SKY, [*ROWS, "4, 60"], "row 5: found 2 cells; 3 are expected"),
        (SKY, [*ROWS, "3, 10, 60"], "row 5, column 'time': found 3 s, and more than in the row before is allowed"),
        (SKY, [*ROWS, "4, 10, 91"], "row 5, column 'dec': found 91 deg, and -90 deg to 90 deg is allowed"),
        (SKY, [*ROWS, "4, nan, 0"], "row 5, column 'ra': found nan, and a number is allowed"),
        ("mjd [d], ra [deg], dec [deg]", ROWS, "row 1, column 'mjd': found 0, and 15020 to 88069 is allowed"),
        (SKY, ROWS[:3], "found 3 rows of observation 0; 4 or more are expected"),
        (NUMBERED, ["0, 1, 1, 0", "2, 1, 1, 0"], "row 2, column 'observation': found 2, and 0 at first, then"),
        ("", [], "found an empty file; names of columns like az [deg] are expected"),
    ],
)
def test_errors_name_the_file_and_the_row(tmp_path, names, rows, error):
    path = tmp_path / "track.csv"
    path.write_text("\n".join([names, *rows]) if names else "")
    with pytest.raises(InputError) as raised:
        read_track(path)
    assert str(raised.value).startswith(f"scan.track_table: {path}: {error}")


def test_missing_files_and_late_or_short_tracks_are_refused(tmp_path):
    with pytest.raises(SceneError, match=r"scan.track_table: .*track.csv: no such file in the folder of the scene"):
        scene(tmp_path)
    time_s = np.arange(0, 8.1, 0.5)
    sky_csv(tmp_path, time_s)
    with pytest.raises(
        SceneError, match=r"scan.chunk: found 10 s with a track of 8 s; a chunk that fits 1 to 100000 times"
    ):
        scene(tmp_path)
    folder = tmp_path / "late"
    folder.mkdir()
    sky_csv(folder, time_s + 1)
    with pytest.raises(
        SceneError, match=r"scan.track_table: found a track that begins 1 s after the start of an observation; 0.05 s"
    ):
        scene(folder)


def test_long_gaps_between_rows_get_a_warning(tmp_path):
    """Rows each 0.2 s, but for 15 s without any: samples of the second chunk lie there, or of none."""
    time_s = np.arange(0, 60.1, 0.2)
    sky_csv(tmp_path, time_s[(time_s < 8) | (time_s > 23)])
    (warning,) = (text for text in design_warnings(prepare(scene(tmp_path))) if "track_table" in text)
    assert warning.startswith("scan.track_table: row 41 is 15.4 s after the row before, and most rows 0.2 s;")
    (folder := tmp_path / "left_out").mkdir()
    sky_csv(folder, time_s[(time_s < 10.1) | (time_s > 14.9)])
    assert not any("track_table" in text for text in design_warnings(prepare(scene(folder, 'turnaround = "5 s"\n'))))


def test_ecsv_tables_are_read_as_csv_ones(tmp_path):
    from astropy.table import Table

    time_s = np.arange(0, 30.1, 0.5)
    found = read_track(sky_csv(tmp_path, time_s))
    table = Table({"time": time_s / 60, "ra": np.degrees(found.longitude_rad), "dec": np.degrees(found.latitude_rad)})
    for name, unit in (("time", "min"), ("ra", "deg"), ("dec", "deg")):
        table[name].unit = unit
    table.write(tmp_path / "track.ecsv")
    again = read_track(tmp_path / "track.ecsv")
    assert not again.on_horizon and again.start_mjd is None and again.flagged is None
    for name in ("time_s", "longitude_rad", "latitude_rad", "bounds"):
        np.testing.assert_allclose(getattr(again, name), getattr(found, name), atol=1e-10)
    text = (tmp_path / "track.ecsv").read_text().replace("\n0.05", "\nx.05", 1)
    (tmp_path / "wrong.ecsv").write_text(text)
    with pytest.raises(
        InputError, match=r"wrong.ecsv: row \d+, column 'time': found 'x.05[^']*'; a number is expected"
    ):
        read_track(tmp_path / "wrong.ecsv")


def test_a_single_track_without_a_date_can_be_repeated(tmp_path):
    sky_csv(tmp_path, np.arange(0, 60.1, 0.5))
    found = scene(tmp_path)
    setup = prepare(found.model_copy(update={"observations": 3}))
    paths = [observation_path(setup.observing, number)[0] for number in (0, 2)]
    assert np.array_equal(paths[0].xi_rad, paths[1].xi_rad)
    assert replace(paths[0]).straight is False


def test_output_directories_have_the_table(tmp_path):
    """Under a name of its own, so that the copied scene is whole."""
    sky_csv(tmp_path, np.arange(0, 60.1, 0.5))
    files = scene_files(scene(tmp_path))
    assert files["track_table.csv"] == (tmp_path / "track.csv").read_bytes()
    assert 'track_table = "track_table.csv"' in files["scene.toml"].decode()
