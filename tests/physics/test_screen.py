"""Realizations of the thin screen against the closed forms.

Most checks need no random numbers: the covariance of a strip follows from its factors, and that of bilinear
look-ups and of any estimate linear in them from the covariance. The Monte Carlo checks then show that draws
have the covariance of the factors; their tolerance is 4.5 standard deviations, where a variance from n
independent normals is known to sqrt(2/n).
"""

import math

import numpy as np
import pytest
import scipy.fft

from surveysim.atmosphere.screen_simulation import StripCache, add_atmosphere, draw_strips, strip_step
from surveysim.atmosphere.strip_factors import build_strip
from surveysim.atmosphere.thin_screen import Screen, cross_psd, mean_removed_variance, structure_function, temporal_psd
from surveysim.runtime.rng import NormalDeviates
from tests.deviates import deviates

ARCMIN = math.radians(1.0 / 60.0)
SCAN_RAD, SPEED, HALF_WIDTH = 465.0 * ARCMIN, 31.0 * ARCMIN, 4.1 * ARCMIN
KOLMOGOROV = Screen(11.0 / 3.0, 8.0 / 1000.0)
SCREENS = [
    KOLMOGOROV,
    Screen(11 / 3, 8 / 375),
    Screen(11 / 3, 8 / 6000),
    Screen(11 / 3, 8 / 1000, 0.5),
    Screen(2.0, 8 / 1000),
    Screen(2.5, 8 / 1000),
    Screen(3.0, 8 / 1000),
    Screen(3.9, 8 / 1000),
    Screen(4.5, 8 / 1000, 0.5),
    Screen(20 / 3, 8 / 1000, 0.5),
    Screen(2 / 3, 8 / 1000, 0.5),
]


def survey_strip(screen, length_rad=SCAN_RAD):
    return build_strip(screen, length_rad=length_rad, half_width_rad=HALF_WIDTH, step_rad=strip_step(screen, 0.0))


def lattice_structure(strip):
    """Structure function (n_x/2 + 1, n_lane, n_lane) that draws of a strip have, from the factors."""
    density = np.zeros((strip.n_x // 2 + 1, strip.n_lane, strip.n_lane))
    for k in range(len(strip.start) - 1):
        columns = strip.lane_columns[strip.start[k] : strip.start[k + 1]].astype(float)
        parts = 1.0 if k in (0, strip.n_x // 2) else 2.0
        density[k] = parts * columns.T @ columns / strip.n_x
    covariance = scipy.fft.irfft(density, n=strip.n_x, axis=0)[: strip.n_x // 2 + 1]
    variance = np.diagonal(covariance[0])
    ramp = (strip.ramp_std * strip.step_rad * np.arange(strip.n_x // 2 + 1)) ** 2
    return variance[:, None] + variance - 2.0 * covariance + ramp[:, None, None]


def structure_between(strip, structure, p, q):
    """Structure function of bilinear look-ups at p and q, each (n, 2) in lattice steps (x, lane)."""
    nodes, weights = zip(*(_corners(point) for point in (p, q)), strict=True)
    nodes, weights = np.concatenate(nodes, axis=1), np.concatenate([weights[0], -weights[1]], axis=1)
    lag = np.abs(nodes[:, :, None, 0] - nodes[:, None, :, 0])
    pairs = structure[lag, nodes[:, :, None, 1], nodes[:, None, :, 1]]
    return -0.5 * np.einsum("ni,nij,nj->n", weights, pairs, weights)


def _corners(p):
    low = np.floor(p).astype(int)
    s, t = (p - low).T
    nodes = low[:, None] + np.array([[0, 0], [1, 0], [0, 1], [1, 1]])
    return nodes, np.stack([(1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t], axis=1)


@pytest.mark.parametrize("screen", SCREENS, ids=str)
def test_structure_function_on_the_lattice(screen):
    strip = survey_strip(screen)
    structure = lattice_structure(strip)
    used = int(strip.length_rad / strip.step_rad)
    assert used * strip.step_rad >= SCAN_RAD
    lane = np.arange(strip.n_lane)
    x = np.arange(used + 1)[:, None, None]
    distance = strip.step_rad * np.hypot(x, lane[:, None] - lane)
    # Exact but for modes left out (1e-9 each) and negative eigenvalues (1e-5 of the variance at one step).
    assert strip.clipped_fraction < 1e-5
    np.testing.assert_allclose(structure[: used + 1], structure_function(screen, distance), rtol=3e-4, atol=1e-30)


@pytest.mark.parametrize("screen", SCREENS[:-1], ids=str)
def test_structure_function_of_look_ups(screen):
    """Within 3 % from 0.67 arcmin to a scan's length along, and to 8 arcmin across and oblique."""
    strip = survey_strip(screen)
    structure = lattice_structure(strip)
    rng = np.random.default_rng(1)
    width = (strip.n_lane - 1) * strip.step_rad
    for lag in np.array([0.67, 1.0, 2.0, 4.0, 8.0, 60.0, 465.0]) * ARCMIN:
        for across in (0.0, 0.7, 1.0):
            if across * lag > width - strip.step_rad:
                continue
            shift = np.array([math.sqrt(1.0 - across**2), across]) * lag / strip.step_rad
            lanes = rng.random(300) * (strip.n_lane - 1 - shift[1])
            p = np.stack([rng.random(300) * 9.0, lanes], axis=1)
            measured = structure_between(strip, structure, p, np.minimum(p + shift, [np.inf, strip.n_lane - 1.001]))
            assert measured.mean() == pytest.approx(structure_function(screen, lag), rel=0.03)


def test_look_ups_of_a_rough_field():
    """b = 2/3: the field is rough down to the step, so look-ups lose power; within 3 % from 4 arcmin."""
    screen = SCREENS[-1]
    strip = survey_strip(screen)
    structure = lattice_structure(strip)
    p = np.random.default_rng(1).random((2000, 2)) * [9.0, strip.n_lane - 1.001]
    for lag_arcmin, loss in ((0.67, 0.22), (4.0, 0.03), (60.0, 0.01)):
        measured = structure_between(strip, structure, p, p + [lag_arcmin * ARCMIN / strip.step_rad, 0.0]).mean()
        assert 1.0 - 1.15 * loss < measured / structure_function(screen, lag_arcmin * ARCMIN) <= 1.0


def test_large_outer_scale_of_a_steep_spectrum():
    """A very smooth field decorrelates slowly: its strip must be longer, and is then as exact as any."""
    screen = Screen(20 / 3, 8 / 1000, 5.0)
    strip = survey_strip(screen)
    assert strip.n_x > survey_strip(KOLMOGOROV).n_x
    along = lattice_structure(strip)[1:700, 3, 9]
    distance = strip.step_rad * np.hypot(np.arange(1, 700), 6)
    np.testing.assert_allclose(along, structure_function(screen, distance), rtol=2e-3)


@pytest.mark.parametrize("length_arcmin", [60.0, 465.0])
@pytest.mark.parametrize("screen", [KOLMOGOROV, Screen(11 / 3, 8 / 375), Screen(11 / 3, 8 / 6000)], ids=str)
def test_what_cleaning_leaves(screen, length_arcmin):
    """Variance over the field of view after a plane (2 %) and a quadratic (10 %) are removed, by look-ups."""
    strip = survey_strip(screen, length_arcmin * ARCMIN)
    structure = lattice_structure(strip)
    grid = np.arange(-5, 6) * 0.7 * ARCMIN
    x, y = (a.ravel() for a in np.meshgrid(grid, grid))
    x, y = 0.87 * x - 0.5 * y, 0.5 * x + 0.87 * y  # turned, so that detectors and lattice do not line up
    x, y = x[np.hypot(x, y) < 4.0 * ARCMIN], y[np.hypot(x, y) < 4.0 * ARCMIN]
    exact = structure_function(screen, np.hypot(x[:, None] - x, y[:, None] - y))
    position = np.stack([x - x.min() + 20.3 * strip.step_rad, y + strip.half_width_rad], axis=1) / strip.step_rad
    i, j = (a.ravel() for a in np.indices(exact.shape))
    looked_up = structure_between(strip, structure, position[i], position[j]).reshape(exact.shape)
    linear = np.stack([x**0, x, y], axis=1)
    for shapes, tolerance in ((linear, 0.02), (np.column_stack([linear, x * x, x * y, y * y]), 0.1)):
        keep = np.eye(x.size) - shapes @ np.linalg.pinv(shapes)
        # (1 - P) D (1 - P) = -2 (1 - P) C (1 - P)
        assert np.trace(keep @ looked_up @ keep) == pytest.approx(np.trace(keep @ exact @ keep), rel=tolerance)


@pytest.mark.parametrize("screen", SCREENS, ids=str)
def test_gradient_across_the_field_of_view(screen):
    """Variance of the least-squares slope across the wind and along it, against quadrature."""
    strip = survey_strip(screen)
    structure = lattice_structure(strip)
    position = strip.step_rad * np.arange(strip.n_lane)
    centred = position - position.mean()
    slope = centred / (centred @ centred)
    expected = -0.5 * slope @ structure_function(screen, np.abs(position[:, None] - position)) @ slope
    lag = np.abs(np.arange(strip.n_lane)[:, None] - np.arange(strip.n_lane))
    assert -0.5 * slope @ structure[0] @ slope == pytest.approx(expected, rel=2e-3)
    assert -0.5 * slope @ structure[lag, 3, 3] @ slope == pytest.approx(expected, rel=2e-3)


# ---------------------------------------------------------------- time streams


def lattice_cross_periodogram(strip, structure, lanes, duration_s, bins):
    """Expected Hann cross-periodograms [1/Hz] of two lanes sampled at lattice points, at bins / duration."""
    n = int(duration_s * SPEED / strip.step_rad)
    interval = strip.step_rad / SPEED
    taper = 1.0 - np.cos(2.0 * np.pi * np.arange(n) / n)
    contrast = np.exp(-2j * np.pi * np.outer(bins, np.arange(n)) / n) * taper
    i, j = lanes
    lag = np.arange(n)[:, None] - np.arange(n)
    # The contrasts have zero sum, so the unknown variances drop out.
    covariance = -0.5 * structure[np.abs(lag), i, j]
    power = np.einsum("kn,nm,km->k", contrast, covariance, contrast.conj()).real
    return 2.0 * interval * power / (taper @ taper), np.asarray(bins) / (n * interval), n * interval


def convolved(psd, f_hz, duration_s):
    """A one-sided PSD as a Hann periodogram sees it: convolved with the taper, both signs of frequency."""
    fine = np.geomspace(1e-6, 25.0 / duration_s, 600)
    fine = np.unique(np.concatenate([fine, np.arange(1, 25 * 40) / (40.0 * duration_s)]))
    model = psd(fine)

    def response(offset):
        t = offset * duration_s
        return (np.sinc(t) + 0.5 * np.sinc(t - 1.0) + 0.5 * np.sinc(t + 1.0)) ** 2 * duration_s / 1.5

    return np.array(
        [np.trapezoid(model * (response(fine - f) + response(fine + f)), fine) for f in np.atleast_1d(f_hz)]
    )


@pytest.mark.slow
def test_temporal_psd_and_coherence_across_the_wind():
    """Hann periodogram of a 15 s scan at 0.13-0.8 Hz within 2 %; coherence at 4 and 8 arcmin to 0.003."""
    strip = survey_strip(KOLMOGOROV)
    structure = lattice_structure(strip)
    bins = np.arange(2, 13)
    auto, f, duration = lattice_cross_periodogram(strip, structure, (0, 0), 15.0, bins)
    expected = convolved(lambda nu: temporal_psd(KOLMOGOROV, nu, SPEED), f, duration)
    np.testing.assert_allclose(auto, expected, rtol=0.02)
    for lanes_apart in (6, 12):
        dy = lanes_apart * strip.step_rad
        cross, _, _ = lattice_cross_periodogram(strip, structure, (1, 1 + lanes_apart), 15.0, bins)
        expected_cross = convolved(lambda nu, dy=dy: cross_psd(KOLMOGOROV, nu, SPEED, dy), f, duration)
        np.testing.assert_allclose(cross / auto, expected_cross / expected, atol=3e-3)


def draw_streams(screen, n_scan, n_samp, rate_hz, offsets_rad, velocity, layer_velocity, amplitude=1.0, seed=5):
    """Streams (n_scan, n_det, n_samp) of independent scans with the same geometry."""
    bounds = np.arange(n_scan)[:, None] * n_samp + [0, n_samp]
    data = np.zeros((len(offsets_rad), n_scan * n_samp))
    strips = StripCache(screen, HALF_WIDTH, strip_step(screen, 0.0))
    add_atmosphere(
        data,
        bounds,
        sample_rate_hz=rate_hz,
        offsets_rad=np.broadcast_to(offsets_rad, (n_scan, *np.shape(offsets_rad))),
        velocity_rad_s=np.broadcast_to(velocity, (n_scan, 2)),
        layer_velocity_rad_s=np.broadcast_to(layer_velocity, (n_scan, 2)),
        amplitude_mk=np.full(n_scan, amplitude),
        strips=strips,
        deviates=deviates(seed),
    )
    return data.reshape(len(offsets_rad), n_scan, n_samp).transpose(1, 0, 2)


@pytest.mark.parametrize(
    ("velocity", "wind"), [((4.0, 0.0), (-27.0, 0.0)), ((2.0, 3.5), (20.0, -9.0)), ((0.0, -4.0), (0.0, -4.0))]
)
def test_drawn_structure_function(velocity, wind):
    """Any two samples of a scan differ as D of their distance in the layer, 0 to 465 arcmin."""
    n_scan, rate = 2000, 0.2
    velocity, wind = np.array(velocity) * ARCMIN, np.array(wind) * ARCMIN
    offsets = np.array([(0.0, 0.0), (0.67, 0.1), (-2.9, 2.2), (1.0, -3.8)]) * ARCMIN
    streams = draw_streams(KOLMOGOROV, n_scan, 4, rate, offsets, velocity, wind)
    track = np.arange(4)[:, None] / rate * (velocity - wind)
    position = (offsets[:, None] + track).reshape(-1, 2)
    values = streams.reshape(n_scan, -1)
    measured = np.square(values[:, :, None] - values[:, None, :]).mean(axis=0)
    distance = np.linalg.norm(position[:, None] - position, axis=-1)
    expected = structure_function(KOLMOGOROV, distance)
    apart = distance > 1e-9
    np.testing.assert_allclose(measured[apart] / expected[apart], 1.0, atol=4.5 * math.sqrt(2.0 / n_scan))
    np.testing.assert_allclose(measured[~apart], 0.0, atol=1e-5 * structure_function(KOLMOGOROV, ARCMIN))


def test_drawn_gradient():
    """Slope across the wind between detectors, from short scans, against quadrature."""
    n_scan = 4000
    y = np.linspace(-4.0, 4.0, 9) * ARCMIN
    offsets = np.stack([np.zeros(9), y], axis=1)
    streams = draw_streams(KOLMOGOROV, n_scan, 2, 10.0, offsets, (SPEED, 0.0), (0.0, 0.0))
    weight = y / (y @ y)
    expected = -0.5 * weight @ structure_function(KOLMOGOROV, np.abs(y[:, None] - y)) @ weight
    measured = np.square(streams[:, :, 0] @ weight).mean()
    assert measured == pytest.approx(expected, rel=4.5 * math.sqrt(2.0 / n_scan))


def test_drawn_mean_removed_variance():
    """304.4 mK^2 (B2 = 280, 31 arcmin/s, 15 s, zenith).

    Few modes rule a scan's variance; the scatter from scan to scan, measured, gives the tolerance.
    """
    n_scan = 3000
    amplitude = math.sqrt(280.0)
    streams = draw_streams(KOLMOGOROV, n_scan, 301, 20.0, [(0.0, 0.0)], (SPEED, 0.0), (0.0, 0.0), amplitude)
    variance = streams[:, 0].var(axis=1)
    error = variance.std() / math.sqrt(n_scan)
    assert error < 0.04 * 304.4
    assert variance.mean() == pytest.approx(280.0 * mean_removed_variance(KOLMOGOROV, SPEED, 15.0), abs=4.5 * error)


def test_drawn_temporal_psd():
    """Hann periodograms of drawn scans, through the look-up; bins 3-10 each known to 1/sqrt(n_scan)."""
    n_scan, n_samp, rate = 1500, 300, 20.0
    streams = draw_streams(KOLMOGOROV, n_scan, n_samp, rate, [(1.0 * ARCMIN, 0.2 * ARCMIN)], (0.0, SPEED), (0.0, 0.0))
    taper = 1.0 - np.cos(2.0 * np.pi * np.arange(n_samp) / n_samp)
    series = streams[:, 0] - streams[:, 0].mean(axis=1, keepdims=True)
    bins = np.arange(3, 11)
    periodogram = np.abs(np.fft.rfft(series * taper)) ** 2 * 2.0 / (rate * taper @ taper)
    duration = n_samp / rate
    expected = convolved(lambda nu: temporal_psd(KOLMOGOROV, nu, SPEED), bins / duration, duration)
    np.testing.assert_allclose(periodogram[:, bins].mean(axis=0) / expected, 1.0, atol=4.5 / math.sqrt(n_scan) + 0.01)


def test_no_motion_gives_constant_streams():
    offsets = np.array([(0.0, 0.0), (2.0, -2.0)]) * ARCMIN
    streams = draw_streams(KOLMOGOROV, 3, 50, 10.0, offsets, (0.001, 0.002), (0.001, 0.002))
    np.testing.assert_allclose(np.ptp(streams, axis=2), 0.0, atol=1e-12)
    assert np.all(np.abs(streams[:, 0, 0] - streams[:, 1, 0]) > 0.0)


def test_detector_outside_the_strip():
    with pytest.raises(ValueError, match="half_width_rad allows"):
        draw_streams(KOLMOGOROV, 1, 5, 10.0, [(0.0, 0.0), (0.0, 5.0 * ARCMIN)], (SPEED, 0.0), (0.0, 0.0))


def test_strips_take_as_many_deviates_as_they_say():
    strip = build_strip(
        KOLMOGOROV, length_rad=30.0 * ARCMIN, half_width_rad=HALF_WIDTH, step_rad=strip_step(KOLMOGOROV, 0.0)
    )
    asked = []

    class Told(NormalDeviates):
        def fill(self, out, first=0):
            asked.append((out.size, first))
            super().fill(out, first)

    for between, of_fills in ((strip.n_deviates, [2]), (strip.n_deviates + 5, [1, 1])):
        first = [7, 7 + between]
        asked.clear()
        both = draw_strips(strip, Told(deviates(8).words), first)
        for one, position in zip(both, first, strict=True):
            np.testing.assert_array_equal(one, draw_strips(strip, deviates(8), [position])[0])
        assert asked == [(n * strip.n_deviates, position) for n, position in zip(of_fills, first, strict=False)]


def test_strips_come_in_powers_of_two():
    strips = StripCache(KOLMOGOROV, HALF_WIDTH, strip_step(KOLMOGOROV, 0.0))
    assert strips.strip_for(300.0 * ARCMIN) is strips.strip_for(301.0 * ARCMIN)
    for length in np.array([0.0, 1.0, 30.0, 300.0]) * ARCMIN:
        assert strips.strip_for(length).length_rad >= length
