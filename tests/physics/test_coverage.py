"""Hit maps of the scan patterns against the densities of their definitions, and maps of white noise against hits."""

import numpy as np
import pytest

from mapmaker.geometry import boresight_pixels
from surveysim.reduction.observation import observe
from surveysim.reduction.setup import prepare
from surveysim.scene.scene import load_scene
from surveysim.timestreams.simulation import observation_path
from tests.scenes import SCHEDULE, WHITE_NOISE_SCENE, with_scan, without_sections

ARCMIN = np.pi / 180 / 60
COMMON = 'dither = "0 arcmin"\nsample_rate = "50 Hz"\n'
# 22 radial periods of 10 s, after which the rose nearly closes.
DAISY = f'pattern = "daisy"\nradius = "8 arcmin"\nradial_period = "10 s"\nduration = "220 s"\nchunk = "11 s"\n{COMMON}'
# Periods whose ratio is the golden one: pairs of phases are evenly spread.
LISSAJOUS = f"""pattern = "lissajous"
amplitude_x = "8 arcmin"
amplitude_y = "5 arcmin"
period_x = "5 s"
period_y = "8.0901699 s"
duration = "20 min"
chunk = "20 s"
{COMMON}"""
# Closes after 13 x 10 x 2 x sqrt(2) arcmin at 2 arcmin/s, 2 x sqrt(2) of these along the axes: 260 s.
PONG = f"""pattern = "pong"
width = "18 arcmin"
height = "14 arcmin"
spacing = "1 arcmin"
velocity = "2 arcmin / s"
terms = 100
duration = "260 s"
chunk = "13 s"
{COMMON}"""
AZIMUTH = f"""pattern = "azimuth"
speed = "10 arcmin / s"
throw = "40 arcmin"
scans = 60
turnaround = "2 s"
{COMMON}"""
RASTER = f"""speed = "4 arcmin / s"
scans = 20
duration = "5 s"
turnaround = "2 s"
step = "1 arcmin"
{COMMON}"""


def observed(folder, scan, single=False):
    """Sums and hits of one observation of white noise, and its setup."""
    text = with_scan(WHITE_NOISE_SCENE, scan).replace('pixel = "30 arcsec"', 'pixel = "20 arcsec"')
    if 'pattern = "azimuth"' in scan:
        text = without_sections(text, "fixed_pointing") + SCHEDULE
    path = folder / "scene.toml"
    path.write_text(text.replace("rings = 2", "rings = 0").replace("dead = [5]", "") if single else text)
    setup = prepare(load_scene(path))
    result = observe(setup, 0, False)
    return result.sums[0].astype(float), result.hits[0], setup


def centres(setup, hits):
    """Offsets of the pixels' centres from that of the field, along columns and rows [arcmin]."""
    side = np.degrees(setup.analysis.geometry.pixel_rad) * 60
    return tuple((np.arange(n) - (n - 1) / 2) * side for n in hits.shape[::-1])


def test_hits_of_a_daisy_have_its_radial_density(tmp_path):
    """The radius is that of a sine, so a share (2 / pi) arcsin(r / R) of the samples is within r.

    Pixels of 20 arcsec blur the radius by 0.1 arcmin rms; each of 44 petals is a sample of the phases.
    """
    _, hits, setup = observed(tmp_path, DAISY, single=True)
    x, y = centres(setup, hits)
    radius = np.hypot(x, y[:, None])
    assert hits.sum() == 11_000
    for limit in (2, 4, 6, 7.5):
        share = hits[radius < limit].sum() / hits.sum()
        slope = 2 / np.pi / np.sqrt(8**2 - limit**2)
        assert share == pytest.approx(2 / np.pi * np.arcsin(limit / 8), abs=0.1 * slope)
    # All directions alike: the hits within quarters differ by less than the petal that one quarter has more.
    quarter = [hits[:, x > 0][y > 0].sum(), hits[:, x < 0][y > 0].sum(), hits[:, x > 0][y < 0].sum()]
    np.testing.assert_allclose(np.array(quarter) / hits.sum(), 0.25, atol=1 / 44)


def test_hits_of_a_lissajous_figure_have_arcsine_densities(tmp_path):
    """Along both axes, and independently of each other."""
    _, hits, setup = observed(tmp_path, LISSAJOUS, single=True)
    x, y = centres(setup, hits)
    share = hits / hits.sum()
    for axis, amplitude, place in ((0, 8, x), (1, 5, y)):
        for limit in (-0.8, -0.3, 0.0, 0.5, 0.9):
            edge = (place[1] + place[0]) / 2 + np.round((limit * amplitude - (place[1] + place[0]) / 2) * 3) / 3
            found = share.sum(axis=axis)[place < edge].sum()
            # 240 and 148 periods; a fraction of a period at the end.
            assert found == pytest.approx(0.5 + np.arcsin(edge / amplitude) / np.pi, abs=1 / 148)
    east, north = share[:, np.abs(x) < 4].sum(), share[np.abs(y) < 2.5].sum()
    assert share[np.abs(y) < 2.5][:, np.abs(x) < 4].sum() == pytest.approx(east * north, abs=2 / 148)


@pytest.mark.parametrize("terms, even", [(100, 0.02), (5, 0.05)])
def test_hits_of_a_pong_are_uniform_in_its_box(tmp_path, terms, even):
    """In cells of 4 by 3 across the box, each crossed by several lines; rounded corners enhance its rim."""
    _, hits, setup = observed(tmp_path, PONG.replace("terms = 100", f"terms = {terms}"), single=True)
    x, y = centres(setup, hits)
    half_x, half_y = (n * np.sqrt(2) / 2 for n in setup.scene.scan.vertices)
    assert hits[:, np.abs(x) > half_x + 1 / 6].sum() == hits[np.abs(y) > half_y + 1 / 6].sum() == 0
    cell = [
        hits[(y >= low_y) & (y < low_y + 4)][:, (x >= low_x) & (x < low_x + 4)].sum()
        for low_x in (-8, -4, 0, 4)
        for low_y in (-6, -2, 2)
    ]
    expected = hits.sum() * 16 / (4 * half_x * half_y)
    np.testing.assert_allclose(np.mean(cell), expected, rtol=even)
    np.testing.assert_allclose(cell, np.mean(cell), rtol=even)


@pytest.mark.parametrize(
    "scan", [RASTER, DAISY, LISSAJOUS, PONG, AZIMUTH], ids=["raster", "daisy", "lissajous", "pong", "azimuth"]
)
def test_white_noise_of_a_map_goes_as_its_hits(tmp_path, scan):
    """Squares of sums over hits average to the variance of a sample, less the part that scan means take.

    Of h samples of a scan of n in a pixel, the scan's mean takes h^2 / n from the variance of their sum.
    """
    sums, hits, setup = observed(tmp_path, scan)
    _, pointing = observation_path(setup.observing, 0)
    boresight = pointing.xi_rad, pointing.eta_rad, pointing.array_angle_rad
    pixels = boresight_pixels(setup.analysis.geometry, *boresight, plane=setup.camera.focal_plane)
    in_scan = np.bincount(pointing.scan)[0]
    left = hits.ravel().astype(float)
    for row in pixels.reshape(-1, in_scan):  # of a detector and a scan
        left -= np.bincount(row, minlength=hits.size) ** 2 / in_scan
    deep = hits.ravel() > 0
    assert np.array_equal(np.bincount(pixels.ravel(), minlength=hits.size), hits.ravel()) and deep.sum() > 400
    variance = 2.5 * 50 / 2  # mK^2/Hz, one-sided, at 50 Hz
    found = sums.ravel()[deep] ** 2 / left[deep] / variance
    assert found.mean() == pytest.approx(1, abs=4 * np.sqrt(2 / len(found)))
    # In shallow pixels as in deep ones.
    for part in np.array_split(found[np.argsort(hits.ravel()[deep], kind="stable")], 4):
        assert part.mean() == pytest.approx(1, abs=4 * np.sqrt(2 / len(part)))
