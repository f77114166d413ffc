"""Readout noise and lost data in maps: hits, noise and sigma(A) as in closed form, and surveys as forecast."""

import numpy as np
import pytest

from mapmaker.formats import read_timestreams
from surveysim import run
from surveysim.forecasting.forecast import forecast
from surveysim.reduction.observation import observe
from surveysim.reduction.setup import prepare
from surveysim.results.agreement import forecast_agreement
from surveysim.runtime.engine import SERIAL
from surveysim.scene.scene import load_scene
from surveysim.timestreams.expected_losses import sampled_share
from surveysim.timestreams.observation import draw_observation
from tests.scenes import SMALL_SCENE, WIDE_PATCH, without_sections

WHITE = without_sections(SMALL_SCENE, "atmosphere", "excess", "photon", "sky").replace('"average"', '"none"')
LOSSES = """
[glitches]
rate = "300 / h"
amplitude = "100 mK"
decay_time = "0.3 s"
found = 1

[dropped_samples]
rate = "200 / h"
length = "1 s"
shared = "group"
group_size = 6

[dead_time]
detectors = 0.15
scans = 0.2
"""


@pytest.fixture
def setup_of(tmp_path):
    def make(text, **overrides):
        (tmp_path / "scene.toml").write_text(text)
        keys = {key.replace("__", "."): value for key, value in overrides.items()}
        return prepare(load_scene(tmp_path / "scene.toml", keys))

    return make


def test_hits_are_those_of_the_samples_that_are_left_and_noise_goes_with_them(setup_of):
    """White noise: the sum of a pixel has the variance of a sample times its hits, with lost samples and without."""
    expected, kept = [], []
    for text in (WHITE, WHITE + LOSSES):
        setup, chi, n_pixel, hits = setup_of(text, scan__scans=10, observations=4), 0.0, 0, 0
        for observation in range(4):
            found = observe(setup, observation, with_signal_sims=False)
            places = found.hits[0] > 0
            variance = 2.5 * 10 / 2 * (1 - 1 / 60)  # of a sample, less the mean of a scan
            chi += np.sum(found.sums[0][places] ** 2 / found.hits[0][places]) / variance
            n_pixel, hits = n_pixel + places.sum(), hits + found.hits[0].sum()
            flags = draw_observation(setup, observation).flags
            kept.append(1.0 if flags is None else 1 - flags.mean())
            assert found.flagged == pytest.approx(1 - kept[-1], abs=1e-12)
            assert found.discarded == (0, 0)
        assert chi / n_pixel == pytest.approx(1, abs=4 * np.sqrt(2 / n_pixel))
        expected.append(hits)
    # All samples of the array are within the map.
    assert expected[1] / expected[0] == pytest.approx(np.mean(kept[4:]), abs=1e-9)
    share = float(sampled_share(setup.scene, np.array([2.5]))[0])
    # Scans and detectors are lost whole: 2 of 10 scans, and 2 or 3 of 18 detectors; the rest scatters by 2 %.
    assert np.mean(kept[4:]) == pytest.approx(share, abs=0.03)


def test_flagged_glitches_leave_no_trace_and_missed_ones_their_power(setup_of):
    """Glitches a thousand times the noise: found ones leave the PSD of white noise, missed ones add Campbell's."""
    glitches = LOSSES[: LOSSES.index("[dropped")].replace('"100 mK"', '"2000 mK"')
    clean = observe(setup_of(WHITE, scan__scans=30), 0, with_signal_sims=False)
    found = observe(setup_of(WHITE + glitches, scan__scans=30), 0, with_signal_sims=False)
    # Tails below a hundredth of a glitch stay: 20 mK in the first sample after the flags, in 2 % of the samples.
    assert found.white_mk2_hz == pytest.approx(clean.white_mk2_hz, rel=0.25)
    missed = observe(setup_of(WHITE + glitches.replace("found = 1", "found = 0"), scan__scans=30), 0, False)
    power = 2 * 300 / 3600 / 10**2 * 2000**2 / abs(1 + np.exp(-1 / 3)) ** 2
    assert missed.white_mk2_hz > 0.5 * power > 100 * clean.white_mk2_hz


def test_sigma_is_one_over_the_samples_in_the_forecast(setup_of):
    losses = LOSSES.replace('"0.3 s"', '"0 s"')  # no tails of glitches in the noise
    setups = [setup_of(text, observations=4) for text in (WHITE, WHITE + losses)]
    sigma = [forecast(setup).scores["actual"].band.sigma_ukcmb2 for setup in setups]
    share = float(sampled_share(setups[1].scene, np.array([2.5]))[0])
    assert sigma[0] / sigma[1] == pytest.approx(share, rel=1e-6)


def test_tails_of_found_glitches_are_in_the_forecast(setup_of):
    """As those of missed glitches of the amplitude where the flags end, with the samples that are left."""
    found = LOSSES[: LOSSES.index("[dropped")].replace('"100 mK"', '"3000 mK"')
    rest = 3000 * np.exp(-14 / 3)  # the first sample below a hundredth, at 10 Hz
    missed = found.replace('"3000 mK"', f'"{rest} mK"').replace("found = 1", "found = 0")
    setups = [setup_of(WHITE + text, observations=4) for text in (found, missed)]
    sigma = [forecast(setup).scores["actual"].band.sigma_ukcmb2 for setup in setups]
    share = float(sampled_share(setups[0].scene, np.array([2.5]))[0])
    assert sigma[1] / sigma[0] == pytest.approx(share, rel=1e-6)


def test_files_have_the_flags(setup_of, tmp_path):
    setup = setup_of(WHITE + LOSSES, observations=1)
    observe(setup, 0, False, tmp_path / "0000.h5")
    np.testing.assert_array_equal(read_timestreams(tmp_path / "0000.h5").flags, draw_observation(setup, 0).flags)


@pytest.mark.parametrize("cleaning", ["planar", "wind"])
def test_cleaning_works_with_lost_data(setup_of, cleaning):
    """In a bright layer: dead detectors take no part in the templates, and filled gaps follow the layer.

    The same layer without losses leaves within 10 % as much; dead detectors that read 0, or the mean, would leave their
    part of the gradient, tens of times that.
    """
    keys = {"cleaning.algorithm": cleaning, "instrument.layout.rings": 4, "scan.scans": 8, "scan.duration": "15 s"}
    keys |= {"atmosphere.b2": "[20000, 50000, 100000] mK2 rad(-5/3)", "score.mask_separation_f_lambda": None}
    left, passed = [], []
    losses = (
        LOSSES.replace("200 / h", "40 / h").replace("300 / h", "60 / h").replace("scans = 0.2", "")
    )  # the same scans
    for text in (SMALL_SCENE, SMALL_SCENE + losses):
        found = [observe(setup_of(text, **keys), number, with_signal_sims=True) for number in range(2)]
        assert [item.discarded for item in found] == [(0,), (0,)]
        left.append(np.mean([item.clean_psd[2:6] for item in found]))
        maps = np.sum([np.sum(item.signal_maps[:, 0] ** 2, axis=(0, 2, 3)) for item in found], axis=0)
        passed.append(maps[1] / maps[0])
    assert left[1] == pytest.approx(left[0], rel=0.1)
    assert passed[1] == pytest.approx(passed[0], rel=0.1)


CASES = {
    "noise": """
[readout_noise.detector]
knee = "0.5 Hz"
slope = 1.5

[readout_noise.group]
knee = "0.5 Hz"
slope = 1
group_size = 6

[readout_noise.array]
knee = "2 Hz"
slope = 2

[[lines]]
frequency = "1.3 Hz"
width = "0.1 Hz"
rms = "2 mK"
shared = "detector"
""",
    "losses": LOSSES.replace("found = 1", "found = 0.3").replace('"100 mK"', '"30 mK"').replace("200 / h", "60 / h"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_surveys_are_as_forecast(setup_of, name):
    """sigma(A) to 10 % and three errors, as the cleaned atmosphere is; masked arrays are of 7 detectors."""
    keys = WIDE_PATCH | {"observations": 80, "cleaning.responsivities": "known", "score.signal_sims.observations": 8}
    result = run(setup_of(SMALL_SCENE + CASES[name], **keys).scene, engine=SERIAL)
    found = forecast_agreement(result)
    for data_set in ("actual", "uncorrelated", "white"):
        item = found[data_set]
        assert abs(item.sigma) < max(0.1, 3 * item.sigma_error), (data_set, item)
        assert abs(item.psd) < 0.2 + 3 * item.psd_error, (data_set, item)
