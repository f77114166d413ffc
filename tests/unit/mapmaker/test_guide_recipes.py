"""The guide's recipes for real data, on data that are less tidy than its own.

Fields across RA 0 and near a pole, scans numbered from 100 with turnarounds between them, dead detectors, one that is
NaN, a scan that is NaN, and observations of unequal noise.
"""

import numpy as np
import pytest

import mapmaker as mm
from tests.docs.pages import PAGES, blocks

RECIPES = {
    block.file: block.text for path in PAGES if path.name == "mapmaker.md" for block in blocks(path) if block.file
}
RATE_HZ, N_SCAN, N, GAP, ARCMIN = 10.0, 9, 160, 20, np.pi / 180 / 60
SIDE = np.arange(-2, 3) * 0.8 * ARCMIN
DEAD, STUCK, UNKNOWN = 3, 11, 17
SOURCE_MK = 40.0
CENTRES = [(0.0, -30.0), (359.98, 44.84), (123.0, 88.0)]


def streams(centre_deg, noise_mk, seed, ra_turns=0):
    rng = np.random.default_rng(seed)
    plane = mm.FocalPlane(*(axis.ravel() for axis in np.meshgrid(SIDE, SIDE)), ARCMIN)
    whole, n_det = N_SCAN * (N + GAP), len(plane.x_rad)
    along = (np.arange(N) - N / 2 + 0.5) * 4 * ARCMIN / RATE_HZ
    east, scan = np.full(whole, 40 * ARCMIN), np.full(whole, -1)
    for k in range(N_SCAN):
        samples = slice(k * (N + GAP), k * (N + GAP) + N)
        east[samples], scan[samples] = along * (-1) ** k, 100 + k
    north = np.repeat((np.arange(N_SCAN) - (N_SCAN - 1) / 2) * 1.5 * ARCMIN, N + GAP)
    geometry = mm.MapGeometry(*np.radians(centre_deg), 1e-4, 1, 1)
    ra, dec = _directions(geometry, east, north)
    squared = (east - plane.x_rad[:, None]) ** 2 + (north + plane.y_rad[:, None]) ** 2
    source = SOURCE_MK * np.exp(-4 * np.log(2) * squared / ARCMIN**2)
    air = 20 * np.cumsum(rng.standard_normal(whole)) / np.sqrt(N)
    data = air + source + noise_mk * rng.standard_normal((n_det, whole))
    data[DEAD], data[STUCK], data[UNKNOWN] = 0.0, 7.5, np.nan
    data[5, 4 * (N + GAP) + 10] = np.nan  # a glitch
    angle = np.zeros(whole)
    return mm.Timestreams(data, np.arange(whole) / RATE_HZ, ra + 2 * np.pi * ra_turns, dec, angle, scan, plane)


def _directions(geometry, xi, eta):
    from mapmaker.geometry import plane_directions

    return plane_directions(geometry, xi, eta)


def follow(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = {}
    exec(compile(RECIPES[name], name, "exec"), found)
    return found


def offset_of_peak(item, centre_deg):
    """Distance [arcmin] of the brightest pixel from the source."""
    from mapmaker.geometry import plane_offsets

    row, column = np.unravel_index(np.argmax(item.signal_mk), item.signal_mk[0].shape)
    g = item.geometry
    place = (g.n_x / 2 - 0.5 - column) * g.pixel_rad, (row + 0.5 - g.n_y / 2) * g.pixel_rad
    source = plane_offsets(g, *np.radians(centre_deg))
    return np.hypot(place[0] - source[0], place[1] - source[1]) / ARCMIN


@pytest.mark.parametrize("centre_deg", CENTRES, ids=str)
def test_clean_and_map(centre_deg, tmp_path, monkeypatch, capsys):
    mm.write_timestreams(tmp_path / "mine.h5", streams(centre_deg, 1.0, 1))
    found = follow("clean_and_map.py", tmp_path, monkeypatch)
    said = capsys.readouterr().out
    assert f"{N_SCAN - 1} of {N_SCAN} scans kept" in said and "nan" not in said  # without the one with the glitch
    item = mm.read_fits(tmp_path / "mine.fits")
    # Three detectors and one scan are not in the map; the array's turnaround lies off it.
    assert item.hits.sum() == (found["index"][:, _kept_samples(found)] >= 0).sum()
    assert len(found["index"]) == 22 and item.weight_unit == "count"
    assert offset_of_peak(item, centre_deg) < 0.5
    assert 0.5 * SOURCE_MK < item.signal_mk.max() < 1.1 * SOURCE_MK


def _kept_samples(found):
    return np.concatenate([np.arange(*b) for b in found["bounds"][found["cleaned"].kept]])


@pytest.mark.parametrize("centre_deg", CENTRES[:2], ids=str)
@pytest.mark.parametrize("n_obs", [4, 5])
def test_coadd(centre_deg, n_obs, tmp_path, monkeypatch, capsys):
    """Noise of 1 to 5 mK: signs alone would leave the source in the noise, as weights differ by 25 times."""
    levels = np.linspace(1, 5, n_obs)
    for k, level in enumerate(levels):
        path = tmp_path / f"outputs/streams/timestreams/{k:04d}.h5"
        mm.write_timestreams(path, streams(centre_deg, level, k, ra_turns=k % 2))
    found = follow("coadd.py", tmp_path, monkeypatch)
    # The source and its negative ring are in the variance too, so that a weight is less than that of noise alone.
    assert (np.diff(found["weights"]) < 0).all() and 0.5 < found["weights"][-1] * levels[-1] ** 2 < 1.1
    item, noise = mm.read_fits(tmp_path / "coadd.fits"), found["noise"]
    assert item.weight_unit == "mK-2" and offset_of_peak(item, centre_deg) < 0.5
    centre = noise.weight > np.quantile(noise.weight[noise.weight > 0], 0.5)
    scaled = noise.signal_mk * np.sqrt(noise.weight)
    # Of unit variance, but for what cleaning takes; signs in place of differences leave the source at 10 and more.
    assert scaled[centre].std() == pytest.approx(1, abs=0.15) and np.abs(scaled).max() < 6
    assert np.abs(item.signal_mk * np.sqrt(item.weight)).max() > 30
    assert "nan" not in capsys.readouterr().out


def test_wind(tmp_path, monkeypatch, capsys):
    """A file without the attributes that simulations have; its glitch is left out by the reader's own choice."""
    made = streams(CENTRES[0], 1.0, 4)
    made.data_mk[5] = np.nan_to_num(made.data_mk[5])
    mm.write_timestreams(tmp_path / "outputs/streams/timestreams/0004.h5", made)
    found = follow("wind.py", tmp_path, monkeypatch)
    assert found["rate_hz"] == pytest.approx(RATE_HZ)
    assert np.isfinite(found["profile"].log_profile).all()
    assert "flag: delays too uncertain" in capsys.readouterr().out  # the air is one for all detectors


def test_live_detectors():
    made = streams(CENTRES[0], 1.0, 4)
    live = mm.live_detectors(made.data_mk, made.scan_bounds)
    assert sorted(np.flatnonzero(~live)) == [DEAD, STUCK, UNKNOWN]
    some = made.subset(live)
    assert some.data_mk.shape == (22, made.data_mk.shape[1]) and len(some.focal_plane.x_rad) == 22
    assert not mm.live_detectors(made.data_mk, []).any()
