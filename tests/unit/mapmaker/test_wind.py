"""Wind from layers whose delays are known exactly: waves with straight fronts, cut into scans."""

import math

import numpy as np
import pytest

from mapmaker.timestreams import FocalPlane, Timestreams
from mapmaker.wind import N_PAIR_BINS, fit_wind, measure_wind, scan_velocities, wind_transforms

ARCMIN = math.radians(1 / 60)
RATE, SAMPLES, SCANS = 10.0, 150, 6
BOUNDS = SAMPLES * np.column_stack([np.arange(SCANS), np.arange(SCANS) + 1])
AT_REST = np.zeros((SCANS, 2))
DIRECTION = np.array([0.6, -0.8])


def hexagon(rings=3):
    """A hexagon of detectors 40 arcsec apart."""
    a, b = np.meshgrid(np.arange(-rings, rings + 1), np.arange(-rings, rings + 1))
    kept = np.abs(a + b) <= rings
    x, y = (a + b / 2)[kept], (b * math.sqrt(3) / 2)[kept]
    return FocalPlane(x * ARCMIN / 1.5, y * ARCMIN / 1.5, ARCMIN)


def fronts(plane, delay_s_rad, rng, slope=-8 / 3, low_hz=0.01, late_s=0.0):
    """Red noise with straight fronts, seen by a detector at r later by r . delay + late; (n_det, n_samp).

    Scans are independent. Frequencies lie between those of the taper, from below one cycle a scan, so that no bin
    holds a pure tone.
    """
    t = (np.arange(SAMPLES) + 0.5) / RATE
    scans = []
    for delay in np.broadcast_to(delay_s_rad, (SCANS, 2)):
        f = np.exp(rng.uniform(math.log(low_hz), math.log(1.2), 300))
        amplitude = f ** ((slope + 1) / 2) * rng.standard_normal(300)
        late = plane.x_rad * delay[0] + plane.y_rad * delay[1] + late_s
        waves = amplitude * np.exp(1j * (2 * np.pi * t[:, None] * f + rng.uniform(0, 2 * np.pi, 300)))
        scans.append((np.exp(-2j * np.pi * late[:, None] * f) @ waves.T).real)
    return np.hstack(scans)


@pytest.fixture
def rng():
    return np.random.default_rng(20031028)


@pytest.mark.parametrize("speed", [12.0, 31.0, 90.0])
@pytest.mark.parametrize("slope", [-11 / 3, -8 / 3, 0.0])
def test_planted_delay_whatever_the_spectrum(rng, speed, slope):
    plane = hexagon()
    data = fronts(plane, DIRECTION / (speed * ARCMIN), rng, slope)
    fit = measure_wind(data, BOUNDS, plane, sample_rate_hz=RATE, scan_velocity_rad_s=AT_REST)
    # What is left is of the second order in the delay over the array: 2 arcmin at 12 arcmin/s are a sixth of a second.
    assert fit.speed_rad_s == pytest.approx(speed * ARCMIN, rel=2e-3)
    assert fit.velocity_rad_s == pytest.approx(speed * ARCMIN * DIRECTION, rel=4e-3)
    assert fit.angle_rad == pytest.approx(math.atan2(-0.8, 0.6), abs=2e-3)
    assert fit.flag == ""
    assert fit.highest_hz == pytest.approx(1.0)


def test_bare_frequencies_would_fail_the_planted_delay(rng):
    """The taper's shift is what the first test is about: without it the third bin is a tenth off."""
    plane = hexagon()
    slow = DIRECTION / (31 * ARCMIN)
    data = fronts(plane, slow, rng, -11 / 3).reshape(len(plane.x_rad), SCANS, SAMPLES)
    taper = 0.5 - 0.5 * np.cos(2 * np.pi * (np.arange(SAMPLES) + 0.5) / SAMPLES)
    d = np.fft.rfft((data - data.mean(axis=2, keepdims=True)) * taper)[..., 3]
    delay = np.array([plane.x_rad, plane.y_rad]).T @ slow
    first, last = np.argmin(delay), np.argmax(delay)
    phase = np.angle(np.sum(d[first].conj() * d[last]))
    shift = 1 + phase / (2 * np.pi * (3 / 15) * (delay[last] - delay[first]))
    assert shift > 0.04


def test_one_plane_wave(rng):
    plane = hexagon()
    slowness = DIRECTION / (31 * ARCMIN)
    t = (np.arange(SAMPLES) + 0.5) / RATE - (slowness @ [plane.x_rad, plane.y_rad])[:, None]
    data = np.hstack([np.cos(2 * np.pi * 0.24 * t + phase) for phase in rng.uniform(0, 6, SCANS)])
    fit = measure_wind(data, BOUNDS, plane, sample_rate_hz=RATE, scan_velocity_rad_s=AT_REST, highest_hz=0.3)
    assert fit.velocity_rad_s == pytest.approx(31 * ARCMIN * DIRECTION, rel=2e-3)


def test_slopes_lie_on_the_sinusoid(rng):
    plane = hexagon()
    slowness = DIRECTION / (31 * ARCMIN)
    fit = measure_wind(fronts(plane, slowness, rng), BOUNDS, plane, sample_rate_hz=RATE, scan_velocity_rad_s=AT_REST)
    assert fit.sinusoid == pytest.approx(2 * np.pi * slowness, rel=4e-3)
    used = np.isfinite(fit.slope)
    assert used.sum() >= N_PAIR_BINS // 2
    angle = fit.pair_angle_rad[used]
    model = fit.sinusoid[0] * np.cos(angle) + fit.sinusoid[1] * np.sin(angle)
    assert fit.slope[used] == pytest.approx(model, abs=0.01 * np.abs(model).max())
    assert (fit.slope_error[used] < 0.01 * np.abs(model).max()).all()
    assert fit.goodness < 1
    assert fit.speed_error_rad_s < 0.01 * fit.speed_rad_s
    assert fit.angle_error_rad < 0.01


def test_slopes_are_those_of_each_pair(rng):
    """Delays that bend over the array, against a loop over pairs: a bin has the mean of dt / r, weighted by r^2."""
    plane = hexagon()
    late = 4e-3 * (plane.x_rad / ARCMIN) ** 3
    fit = measure_wind(
        fronts(plane, DIRECTION / (31 * ARCMIN), rng, late_s=late),
        BOUNDS,
        plane,
        sample_rate_hz=RATE,
        scan_velocity_rad_s=AT_REST,
    )
    # What the sinusoid leaves of the delays, so that the width of a bin does not matter.
    rest = late + (DIRECTION / (31 * ARCMIN) - fit.sinusoid / (2 * np.pi)) @ [plane.x_rad, plane.y_rad]
    total, weight = np.zeros((2, N_PAIR_BINS))
    for i, j in np.ndindex(len(rest), len(rest)):
        x, y = plane.x_rad[j] - plane.x_rad[i], plane.y_rad[j] - plane.y_rad[i]
        if np.hypot(x, y) > 1.2 * 40 / 60 * ARCMIN:
            where = round((math.atan2(y, x) + math.pi) * N_PAIR_BINS / (2 * math.pi)) % N_PAIR_BINS
            total[where] += (rest[j] - rest[i]) * np.hypot(x, y)
            weight[where] += x**2 + y**2
    used = weight > 0
    assert (np.isfinite(fit.slope) == used).all()
    angle = fit.pair_angle_rad[used]
    model = fit.sinusoid[0] * np.cos(angle) + fit.sinusoid[1] * np.sin(angle)
    bend = 2 * np.pi * total[used] / weight[used]
    assert np.abs(bend).max() > 0.02 * np.abs(model).max()
    assert fit.slope[used] - model == pytest.approx(bend, abs=0.05 * np.abs(bend).max())


def alternating(speed, along=DIRECTION):
    return np.outer((-1.0) ** np.arange(SCANS), along) * speed * ARCMIN


def test_scan_velocity_is_added_to_the_layers(rng):
    plane = hexagon()
    wind, scan = 31 * ARCMIN * DIRECTION, alternating(4)
    relative = wind - scan
    slowness = relative / np.sum(relative**2, axis=1, keepdims=True)
    fit = measure_wind(fronts(plane, slowness, rng), BOUNDS, plane, sample_rate_hz=RATE, scan_velocity_rad_s=scan)
    assert fit.velocity_rad_s == pytest.approx(wind, rel=4e-3)
    assert fit.flag == ""


def test_scans_that_disagree_are_flagged(rng):
    plane = hexagon()
    # The same layer in all scans, as if the boresight rested: no wind has these delays.
    data = fronts(plane, DIRECTION / (31 * ARCMIN), rng)
    data += 0.01 * data.std() * rng.standard_normal(data.shape)
    fit = measure_wind(data, BOUNDS, plane, sample_rate_hz=RATE, scan_velocity_rad_s=alternating(4))
    assert fit.flag == "forward and backward scans disagree"


def test_wind_near_the_scan_speed_is_flagged(rng):
    plane = hexagon()
    wind, scan = 9 * ARCMIN * DIRECTION, alternating(5)
    relative = wind - scan
    slowness = relative / np.sum(relative**2, axis=1, keepdims=True)
    fit = measure_wind(fronts(plane, slowness, rng), BOUNDS, plane, sample_rate_hz=RATE, scan_velocity_rad_s=scan)
    assert fit.speed_rad_s == pytest.approx(9 * ARCMIN, rel=0.05)
    assert fit.flag == "wind not far above the scan speed"


def test_two_speeds_are_flagged(rng):
    plane = hexagon()
    data = fronts(plane, DIRECTION / (31 * ARCMIN), rng) + fronts(plane, DIRECTION / (12 * ARCMIN), rng)
    data += 0.02 * data.std() * rng.standard_normal(data.shape)
    assert (
        measure_wind(data, BOUNDS, plane, sample_rate_hz=RATE, scan_velocity_rad_s=AT_REST).flag
        == "more than one layer"
    )


@pytest.mark.slow
def test_two_directions_are_flagged(rng):
    """Both fronts have one delay along their mean direction, so that only what lies across it can tell."""
    plane, across, found = hexagon(), np.array([0.8, 0.6]), []
    for _ in range(5):
        data = sum(fronts(plane, (DIRECTION + side * across) / (31 * ARCMIN), rng) for side in (-1.7, 1.7))
        data += 0.02 * data.std() * rng.standard_normal(data.shape)
        found.append(measure_wind(data, BOUNDS, plane, sample_rate_hz=RATE, scan_velocity_rad_s=AT_REST).flag)
    assert set(found) <= {"more than one layer", "delays too uncertain"}
    assert "more than one layer" in found


def test_detectors_in_wrong_places_are_flagged(rng):
    plane = hexagon()
    order = rng.permutation(len(plane.x_rad))
    data = fronts(plane, DIRECTION / (31 * ARCMIN), rng)[order]
    assert measure_wind(data, BOUNDS, plane, sample_rate_hz=RATE, scan_velocity_rad_s=AT_REST).flag != ""


def test_noise_alone_has_no_wind(rng):
    plane = hexagon()
    fit = measure_wind(
        rng.standard_normal((len(plane.x_rad), SCANS * SAMPLES)),
        BOUNDS,
        plane,
        sample_rate_hz=RATE,
        scan_velocity_rad_s=AT_REST,
    )
    assert fit.flag == "no coherent delay"
    assert np.isnan([*fit.velocity_rad_s, fit.speed_rad_s, fit.angle_rad, fit.goodness, *fit.slope]).all()


def test_one_stream_in_all_detectors_has_no_wind(rng):
    plane = hexagon()
    data = fronts(plane, np.zeros(2), rng)
    assert (
        measure_wind(data, BOUNDS, plane, sample_rate_hz=RATE, scan_velocity_rad_s=AT_REST).flag == "no coherent delay"
    )


def test_constant_streams_are_flagged():
    plane = hexagon()
    data = np.full((len(plane.x_rad), SCANS * SAMPLES), 5.0, np.float32)
    assert (
        measure_wind(data, BOUNDS, plane, sample_rate_hz=RATE, scan_velocity_rad_s=AT_REST).flag
        == "too few live detectors"
    )


def test_detectors_on_a_line_are_flagged(rng):
    plane = FocalPlane(np.arange(10) * ARCMIN, np.arange(10) * 2 * ARCMIN, ARCMIN)
    data = fronts(plane, DIRECTION / (31 * ARCMIN), rng)
    assert (
        measure_wind(data, BOUNDS, plane, sample_rate_hz=RATE, scan_velocity_rad_s=AT_REST).flag
        == "too few live detectors"
    )


def test_gains_and_dead_detectors_make_no_difference(rng):
    plane = hexagon()
    data = fronts(plane, DIRECTION / (31 * ARCMIN), rng)
    alive = measure_wind(
        data[1:], BOUNDS, plane.subset(np.arange(1, len(data))), sample_rate_hz=RATE, scan_velocity_rad_s=AT_REST
    )
    data *= np.exp(0.5 * rng.standard_normal(len(data)))[:, None]
    data[0, BOUNDS[2, 0] : BOUNDS[2, 1]] = 7
    fit = measure_wind(data, BOUNDS, plane, sample_rate_hz=RATE, scan_velocity_rad_s=AT_REST)
    assert fit.velocity_rad_s == pytest.approx(alive.velocity_rad_s, rel=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"data_mk": np.zeros((3, 900))}, "shape"),
        ({"scan_bounds": BOUNDS[:2], "scan_velocity_rad_s": np.zeros((2, 2))}, "at least 3"),
        ({"scan_velocity_rad_s": np.zeros((SCANS, 3))}, r"scan_velocity_rad_s: found the shape \(6, 3\)"),
        ({"scan_bounds": BOUNDS + [0, 1]}, "0 <= start < stop <= 900"),
        ({"scan_bounds": BOUNDS - np.outer(np.arange(SCANS) == 3, [0, 1])}, "one length"),
        ({"highest_hz": 0.2}, "highest_hz"),
        ({"highest_hz": 5.0}, "highest_hz"),
        ({"highest_hz": math.nan}, "highest_hz"),
        ({"scan_velocity_rad_s": np.full((SCANS, 2), math.nan)}, "scan_velocity_rad_s: found nan"),
    ],
)
def test_input_that_does_not_fit(rng, change, message):
    plane = hexagon()
    arguments = {
        "data_mk": rng.standard_normal((len(plane.x_rad), SCANS * SAMPLES)),
        "scan_bounds": BOUNDS,
        "focal_plane": plane,
        "sample_rate_hz": RATE,
        "scan_velocity_rad_s": AT_REST,
    }
    with pytest.raises(ValueError, match=message):
        measure_wind(**(arguments | change))


def _blocks(data, plane, edges):
    return [
        wind_transforms(data, BOUNDS[first:end], plane, sample_rate_hz=RATE)
        for first, end in zip(edges, edges[1:], strict=False)
    ]


@pytest.mark.parametrize("edges", [(0, SCANS), (0, 2, SCANS), range(SCANS + 1)])
def test_blocks_tell_the_wind_of_the_whole_bit_for_bit(rng, edges):
    plane = hexagon()
    data = fronts(plane, np.array([400.0, 300.0]), rng)
    whole = measure_wind(data, BOUNDS, plane, sample_rate_hz=RATE, scan_velocity_rad_s=AT_REST)
    found = fit_wind(_blocks(data, plane, edges), plane, scan_velocity_rad_s=AT_REST)
    assert np.isfinite(whole.velocity_rad_s).all() and found.flag == whole.flag
    for name in ("velocity_rad_s", "slope", "slope_error", "sinusoid"):
        np.testing.assert_array_equal(getattr(found, name), getattr(whole, name))


def test_a_detector_dead_in_one_block_is_left_out_of_all(rng):
    plane = hexagon()
    data = fronts(plane, np.array([400.0, 300.0]), rng)
    data[3, BOUNDS[1, 0] : BOUNDS[1, 1]] = 5
    whole = measure_wind(data, BOUNDS, plane, sample_rate_hz=RATE, scan_velocity_rad_s=AT_REST)
    found = fit_wind(_blocks(data, plane, (0, 2, SCANS)), plane, scan_velocity_rad_s=AT_REST)
    np.testing.assert_array_equal(found.velocity_rad_s, whole.velocity_rad_s)
    assert np.isfinite(found.velocity_rad_s).all()


@pytest.mark.parametrize(
    ("edges", "velocity", "message"),
    [
        ((0,), AT_REST, "0 blocks found"),
        ((0, 2), AT_REST[:2], "2 scans found; at least 3"),
        ((0, 2, SCANS), AT_REST[1:], "scan_velocity_rad_s: found the shape"),
        ((0, 0, SCANS), AT_REST, "no scan found"),
    ],
)
def test_blocks_that_do_not_fit(rng, edges, velocity, message):
    plane = hexagon()
    data = rng.standard_normal((len(plane.x_rad), SCANS * SAMPLES))
    with pytest.raises(ValueError, match=message):
        fit_wind(_blocks(data, plane, edges), plane, scan_velocity_rad_s=velocity)


def test_blocks_of_other_rates_do_not_fit(rng):
    plane = hexagon()
    data = rng.standard_normal((len(plane.x_rad), SCANS * SAMPLES))
    blocks = [wind_transforms(data, BOUNDS[:3], plane, sample_rate_hz=rate) for rate in (RATE, 1.01 * RATE)]
    with pytest.raises(ValueError, match="2 blocks found; one or more with equal"):
        fit_wind(blocks, plane, scan_velocity_rad_s=AT_REST)


def test_not_a_number_in_the_data(rng):
    plane = hexagon()
    data = rng.standard_normal((len(plane.x_rad), SCANS * SAMPLES))
    data[4, 100] = math.nan
    with pytest.raises(ValueError, match=r"data_mk: found nan at \[4, 100\]"):
        measure_wind(data, BOUNDS, plane, sample_rate_hz=RATE, scan_velocity_rad_s=AT_REST)


def test_scan_velocities_across_zero_right_ascension():
    """A scan east and one north at 4 arcmin/s; with the array's y axis east of north by 30 degrees."""
    t = (np.arange(40) + 0.5) / RATE
    path = (t[:20] - t[:20].mean()) * 4 * ARCMIN
    ra, dec = np.concatenate([path, np.zeros(20)]), np.concatenate([np.zeros(20), path])
    scan = np.repeat([0, 1], 20)
    turn = math.radians(30)
    streams = Timestreams(np.zeros((7, 40)), t, ra % (2 * np.pi), dec, np.full(40, turn), scan, hexagon(1))
    # East is -x cos + y sin in an array turned by 30 degrees, north x sin + y cos.
    cos, sin = math.cos(turn), math.sin(turn)
    expected = 4 * ARCMIN * np.array([[-cos, sin], [sin, cos]])
    assert scan_velocities(streams) == pytest.approx(expected, abs=1e-4 * ARCMIN)


@pytest.mark.parametrize("radius_arcmin, refused", [(0.3, False), (3.0, True)])
def test_scans_that_are_not_straight_are_refused(radius_arcmin, refused):
    """A circle, in two scans; one smaller than the beam is a telescope at rest."""
    t, plane = np.arange(40) / 10, hexagon(1)
    radius = math.radians(radius_arcmin / 60)
    assert plane.fwhm_rad / 2 < math.radians(3 / 60)
    ra, dec = radius * np.cos(t * 6), radius * np.sin(t * 6)
    streams = Timestreams(np.zeros((7, 40)), t, ra % (2 * np.pi), dec, np.zeros(40), np.repeat([0, 1], 20), plane)
    if refused:
        with pytest.raises(
            ValueError, match="scan: found a scan, 0, whose boresight departs by .* arcmin from a const"
        ):
            scan_velocities(streams)
    else:
        assert scan_velocities(streams).shape == (2, 2)
