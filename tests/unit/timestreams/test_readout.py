"""Readout noise, lines and glitches against their closed forms, and what detectors have in common."""

import numpy as np
import pytest

from mapmaker.stream_psd import hann_power
from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import SceneError
from surveysim.runtime.rng import normal_deviates
from surveysim.scene.readout import GroupRedNoise, MicrophonicLine, RedNoise
from surveysim.scene.scene import load_scene
from surveysim.telescope.scans import samples_per_scan
from surveysim.timestreams.glitch_kernels import add_pulses
from surveysim.timestreams.glitches import draw_glitches, flagged_length, glitch_psd, kept_power, missed_moment
from surveysim.timestreams.lines import add_line
from surveysim.timestreams.observation import draw_observation
from surveysim.timestreams.observed_block import observed_block
from surveysim.timestreams.readout_noise import add_red_noise
from surveysim.timestreams.simulation import observation_path
from tests import naive
from tests.scenes import SMALL_SCENE, WHITE_NOISE_SCENE, write_scene

N, RATE, N_SCANS = 96, 10.0, 2000


def expected_power(psd):
    """Power of mean-removed, Hann-tapered scans of noise with a one-sided PSD, a function of frequency [Hz]."""
    edge = np.concatenate([np.geomspace(1e-6, 1e-2, 200)[:-1], np.geomspace(1e-2, RATE / 2, 3000)])
    f = np.sqrt(edge[1:] * edge[:-1])
    wave = np.exp(2j * np.pi * np.outer(f / RATE, np.arange(N)))
    tapered = (wave - wave.mean(axis=1, keepdims=True)) * np.hanning(N + 1)[:N]
    both = np.abs(np.fft.fft(tapered)[:, : N // 2 + 1]) ** 2 + np.abs(np.fft.fft(tapered.conj())[:, : N // 2 + 1]) ** 2
    return (psd(f) * np.diff(edge)) @ both / 2


def assert_chi_squared(power, expected, places):
    """Mean power of many scans against that expected, at places that the taper leaves uncorrelated."""
    z = (power / expected - 1)[places] * np.sqrt(N_SCANS)
    assert np.mean(z**2) == pytest.approx(1, abs=4 * np.sqrt(2 / len(z))), z


@pytest.mark.parametrize("slope", [0.5, 1.0, 2.0, 2.5])
def test_red_noise_has_its_psd_at_all_frequencies(slope):
    """Below the first frequency of a scan too: its trends are part of the mean-removed scan."""
    section, data = RedNoise(knee="0.7 Hz", slope=slope), np.zeros((1, N * N_SCANS), np.float32)
    deviates = normal_deviates(1, "lines"), normal_deviates(1, "trends")
    places = dict(n_scans=N_SCANS, sample_rate_hz=RATE, deviates=deviates)
    add_red_noise(data, section, psd_at_knee=3.0, stream=np.zeros(1, int), **places)
    power = hann_power(data, N_SCANS, np.ones(N_SCANS, bool))[0] / N_SCANS
    assert_chi_squared(power, expected_power(lambda f: 3 * (f / 0.7) ** -slope), slice(1, -2, 3))


def test_groups_share_a_stream_and_have_no_cross_power():
    section, stream = GroupRedNoise(knee="1 Hz", slope=1.0, group_size=2), np.array([0, 0, 1, 1, 2])
    data, deviates = np.zeros((5, N * N_SCANS), np.float32), (normal_deviates(1, "lines"), normal_deviates(1, "trends"))
    noise = dict(psd_at_knee=3.0, n_scans=N_SCANS, sample_rate_hz=RATE, deviates=deviates)
    add_red_noise(data, section, stream=stream, **noise)
    np.testing.assert_array_equal(data[[0, 2]], data[[1, 3]])
    spectrum = np.fft.rfft(data[[0, 2, 4]].reshape(3, N_SCANS, N) * np.hanning(N), axis=-1)[..., 3:-1:3]
    own = np.mean(np.abs(spectrum) ** 2, axis=1)
    for one, other in ((0, 1), (0, 2), (1, 2)):
        cross = np.mean(spectrum[one] * spectrum[other].conj(), axis=0) / np.sqrt(own[one] * own[other])
        # Real and imaginary parts have the variance 1 / 2n each.
        assert np.mean(np.abs(cross) ** 2) * N_SCANS == pytest.approx(1, abs=4 / np.sqrt(cross.size))


@pytest.mark.parametrize("width", ["0.001 Hz", "0.4 Hz"])
def test_a_line_has_its_psd_and_variance(width):
    """One much narrower than the resolution of a scan, between its frequencies, and a wide one."""
    line = MicrophonicLine(frequency="2.03 Hz", width=width, rms="5 mK", shared="array")
    data, deviates = np.zeros((2, N * N_SCANS), np.float32), normal_deviates(2, "lines")
    add_line(data, line, stream=np.zeros(2, int), n_scans=N_SCANS, sample_rate_hz=RATE, deviates=deviates)
    np.testing.assert_array_equal(data[0], data[1])
    assert data[0].var() == pytest.approx(25, rel=4 / np.sqrt(N_SCANS))
    sigma = max(line.width_hz / np.sqrt(8 * np.log(2)), 0.005)

    def gaussian(f):
        return 25 * np.exp(-((f - 2.03) ** 2) / (2 * sigma**2)) / np.sqrt(2 * np.pi * sigma**2)

    power = hann_power(data[:1], N_SCANS, np.ones(N_SCANS, bool))[0] / N_SCANS
    places = np.array([19, 20]) if width == "0.001 Hz" else np.arange(14, 26, 3)
    z = (power / expected_power(gaussian) - 1)[places] * np.sqrt(N_SCANS)
    assert (np.abs(z) < 4).all(), z


GLITCHES = """
[glitches]
rate = "3600 / h"
amplitude = "50 mK"
largest_amplitude = "5000 mK"
slope = 1.5
decay_time = "0.15 s"
found = 0.75
"""


@pytest.fixture
def make(tmp_path):
    """Prepare the white-noise scene with some text after it."""

    def made(text, **overrides):
        (tmp_path / "scene.toml").write_text(WHITE_NOISE_SCENE + text)
        return prepare(load_scene(tmp_path / "scene.toml", {key.replace("__", "."): v for key, v in overrides.items()}))

    return made


def first_block(setup):
    _, pointing = observation_path(setup.observing, 0)
    return observed_block(setup, 0, setup.observing.blocks[0], pointing)


def test_sections_add_to_the_same_draws_and_absent_ones_change_no_bit(make):
    """The white noise of a scene is that without readout noise, lines and glitches."""
    readout = '[readout_noise.array]\nknee = "1 Hz"\nslope = 1\n'
    line = '[[lines]]\nfrequency = "2 Hz"\nwidth = "0.1 Hz"\nrms = "1000 mK"\nshared = "array"\n'
    plain = draw_observation(make(""), 0)
    assert plain.flags is None
    for text in (readout, line):
        more = draw_observation(make(text), 0).data_mk - plain.data_mk
        assert more.std() > 1
        np.testing.assert_allclose(more, np.broadcast_to(more[0], more.shape), atol=2e-6 * np.abs(more).max() + 1e-5)
    glitched = draw_observation(make(GLITCHES), 0)
    assert ((glitched.data_mk - plain.data_mk).round(3) >= 0).all() and glitched.flags.any()


def test_pulses_are_those_of_the_twin():
    rng, data = np.random.default_rng(1), np.zeros((3, 60))
    events = rng.integers(0, 3, 40), rng.integers(0, 3, 40), rng.integers(-5, 20, 40), rng.uniform(1, 9, 40)
    for decay in (0.0, 0.6):
        found = data.copy()
        add_pulses(found, 20, *events, decay)
        np.testing.assert_allclose(found, naive.add_pulses(data, 20, *events, decay), atol=1e-4)


def test_glitches_have_their_rate_power_and_flags(make):
    """Campbell's theorem: power of the missed glitches, after flagged samples are left out."""
    setup = make(GLITCHES, detector__psd="1e-6 mK2 / Hz", scan__scans=40)
    section, rate = setup.scene.glitches, setup.observing.scans.sample_rate_hz
    events, streams = draw_glitches(first_block(setup)), draw_observation(setup, 0)
    n, expected = streams.data_mk.size, streams.data_mk.size * section.rate_hz / rate
    inside = (events.start >= 0).sum()
    assert inside == pytest.approx(expected, abs=4 * np.sqrt(expected))
    assert events.found.mean() == pytest.approx(0.75, abs=4 * np.sqrt(0.25 * 0.75 / len(events.found)))
    square = events.amplitude_mk**2
    missed = np.where(events.found, 0, square)
    moment = float(missed_moment(section, np.ones(1), rate, 2)[0])
    assert missed.mean() == pytest.approx(moment, abs=4 * missed.std() / np.sqrt(len(missed)))
    f = (np.arange(2000) + 0.5) * rate / 4000
    variance = glitch_psd(section, f, rate).mean() * rate / 2
    decay = np.exp(-1 / (section.decay_time_s * rate))
    assert variance == pytest.approx(section.rate_hz / rate / (1 - decay**2), rel=1e-3)
    lost = streams.flags.mean()
    length = flagged_length(section, rate)
    # Runs of one length are lost together: fewer independent samples by that number.
    wanted = 1 - np.exp(-0.75 * section.rate_hz / rate * length)
    assert lost == pytest.approx(wanted, abs=4 * np.sqrt(wanted * (1 - wanted) * length / n))


@pytest.mark.parametrize("slope", [0.0, 1.0, 2.0, 3.0, 4.5])
def test_moments_below_a_threshold(make, slope):
    """Against the mean over the amplitudes at evenly spaced numbers."""
    from surveysim.timestreams.glitches import glitch_amplitudes, least_found

    text = GLITCHES.replace("found = 0.75", "threshold = 5").replace("slope = 1.5", f"slope = {slope}")
    section = make(text).scene.glitches
    amplitude, white = glitch_amplitudes(section, (np.arange(100_000) + 0.5) / 100_000), np.array([1.0, 2000.0, 1e9])
    for order in (0, 2):
        below = amplitude < least_found(section, white, RATE)[:, None]
        wanted = np.mean(np.where(below, amplitude**order, 0), axis=1)
        np.testing.assert_allclose(missed_moment(section, white, RATE, order), wanted, rtol=2e-3, atol=2e-5)
    # The flags of a found glitch end at the first sample below a hundredth of it.
    rest = np.exp(-np.arange(99) / (section.decay_time_s * RATE))
    power = np.mean(np.where(below, amplitude, amplitude * rest[rest <= 0.01][0]) ** 2, axis=1)
    np.testing.assert_allclose(kept_power(section, white, RATE), power, rtol=2e-3)


def test_gaps_and_dead_detectors_have_their_shares(make):
    gaps = make('[dropped_samples]\nrate = "600 / h"\nlength = "0.5 s"\nshared = "detector"\n', scan__scans=40)
    lost, rate = draw_observation(gaps, 0).flags, gaps.observing.scans.sample_rate_hz
    length = round(0.5 * rate)
    wanted = 1 - np.exp(-600 / 3600 / rate * length)
    assert lost.mean() == pytest.approx(wanted, abs=4 * np.sqrt(wanted * length / lost.size))
    whole = make(
        '[dropped_samples]\nrate = "600 / h"\nlength = "0.5 s"\nshared = "group"\ngroup_size = 5\n', scan__scans=40
    )
    lost = draw_observation(whole, 0).flags
    assert lost.any() and not (lost[4] == lost[5]).all()
    np.testing.assert_array_equal(lost[:5], np.tile(lost[0], (5, 1)))


def test_dead_detectors_and_scans_are_those_of_the_observation(make):
    """In all blocks; their numbers are right in the mean."""
    text = "[dead_time]\ndetectors = 0.21\nscans = 0.3\n"
    whole = make(text, scan__scans=10)
    cut = make(text, scan__scans=10, numerics__max_block_memory="8 kB")
    assert len(cut.observing.blocks) > 2
    n, numbers = samples_per_scan(whole.observing.scans), []
    for observation in range(30):
        lost = draw_observation(whole, observation % whole.scene.observations).flags.reshape(-1, 10, n)
        dead, gone = lost.all(axis=(1, 2)), lost.all(axis=(0, 2))
        np.testing.assert_array_equal(lost, (dead[:, None] | gone)[..., None] & np.ones(n, bool))
        assert gone.sum() == 3
        numbers.append(dead.sum())
    np.testing.assert_array_equal(draw_observation(cut, 0).flags, draw_observation(whole, 0).flags)
    assert set(numbers) <= {int(0.21 * len(dead)), int(0.21 * len(dead)) + 1}


def test_effects_may_be_zero(make):
    """As at the first point of a sweep."""
    text = GLITCHES.replace("3600 / h", "0 / h") + "[dead_time]\ndetectors = 0\n"
    text += '[dropped_samples]\nrate = "0 / h"\nlength = "1 s"\nshared = "array"\n'
    text += '[[lines]]\nfrequency = "2 Hz"\nwidth = "0.1 Hz"\nrms = "0 mK"\nshared = "array"\n'
    text += '[readout_noise.array]\nknee = "1 Hz"\nslope = 1\npsd = "0 mK2 / Hz"\n'
    plain, same = draw_observation(make(""), 0), draw_observation(make(text), 0)
    np.testing.assert_array_equal(same.data_mk, plain.data_mk)
    assert not same.flags.any()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[readout_noise.group]\nknee = "1 Hz"\nslope = 1\n', "readout_noise.group.group_size: missing"),
        (
            '[[lines]]\nfrequency = "2 Hz"\nwidth = "1 Hz"\nrms = "1 mK"\nshared = "group"\n',
            r"lines.0.group_size: mi",
        ),
        (
            '[[lines]]\nfrequency = "1 kHz"\nwidth = "1 Hz"\nrms = "1 mK"\nshared = "array"\n',
            "half of scan.sample_rate",
        ),
        ("[readout_noise]\n", "at least one of 'detector', 'group' and 'array'"),
        (GLITCHES + "threshold = 5\n", "exactly one of 'found' and 'threshold'"),
        (GLITCHES.replace("5000 mK", "50 mK"), "largest_amplitude: found 50 mK; more than 'amplitude', 50 mK, is exp"),
        (GLITCHES.replace('largest_amplitude = "5000 mK"', ""), "slope: found without 'largest_amplitude'"),
        (
            '[glitches]\nrate = "1 Hz"\namplitude = "1 mK"\ndecay_time = "10 day"\nfound = 1\n',
            "glitches.decay_time: found 864000 s; 6 s or less is expected, scan.duration",
        ),
        (GLITCHES.replace("slope = 1.5", ""), "slope: missing; 'largest_amplitude' needs it"),
        (
            '[dropped_samples]\nrate="1 / h"\nlength="1 s"\nshared="array"\ngroup_size=3\n',
            "group_size: found with shar",
        ),
    ],
)
def test_sections_that_do_not_fit_are_refused(make, text, said):
    with pytest.raises(SceneError, match=said):
        make(text)


def test_too_few_detectors_are_left_for_the_cleaning(tmp_path):
    path = write_scene(tmp_path, SMALL_SCENE + "[dead_time]\ndetectors = 0.7\n")
    with pytest.raises(
        SceneError, match=r"dead_time.detectors: found 0.7, which may leave 5 of 18 detectors; 7 or more"
    ):
        prepare(load_scene(path, {"cleaning.algorithm": "quadratic"}))
