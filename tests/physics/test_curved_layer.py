"""The layer along curved tracks against the closed form at the places of the samples in the layer.

Most checks need no random numbers: the covariance of a strip follows from its factors, and the structure function of
look-ups from it. The places are computed here from the geometry of the layer, apart from the program. The Monte Carlo
checks then show that streams have the covariance of the factors; their tolerance is 4.5 standard deviations, where a
variance from n independent normals is known to sqrt(2/n).
"""

import math
from dataclasses import dataclass

import numpy as np
import pytest
import scipy.fft

from surveysim.atmosphere.curved_tracks import add_along_curves, curved_tracks
from surveysim.atmosphere.scan_trends import draw_trends, strip_points
from surveysim.atmosphere.screen_simulation import SlantStrips, add_along_tracks, draw_strips, scan_tracks, strip_step
from surveysim.atmosphere.strip_factors import build_strip
from surveysim.atmosphere.thin_screen import Screen, structure_function
from surveysim.atmosphere.wide_strips import factorize_wide
from tests.deviates import deviates

DEG, ARCMIN = math.radians(1.0), math.radians(1.0 / 60.0)
KOLMOGOROV = Screen(11.0 / 3.0, 6e-3)


@dataclass(frozen=True)
class Track:
    """A scan of a telescope with detectors at some offsets [rad] from a boresight, in a wind [rad/s]."""

    azimuth_rad: np.ndarray
    elevation_rad: np.ndarray
    time_s: np.ndarray
    wind_rad_s: complex
    offsets_rad: np.ndarray  # complex: azimuth on the sky, elevation

    @property
    def places_rad(self):
        """Places (n_det, n) of the samples in the layer, east and north as a complex number."""
        centre = self.elevation_rad.mean()
        slant = 1 / math.sin(centre)
        away = np.exp(1j * (math.pi / 2 - self.azimuth_rad))  # from the zenith
        right = -1j * away
        boresight = away * (1 / math.tan(centre) + slant * (centre - self.elevation_rad))
        offset = self.offsets_rad[:, None]
        seen = boresight + slant * (offset.real * right - offset.imag * away)
        return seen - self.wind_rad_s * slant * self.time_s

    def tracks(self, radius_rad=0.0):
        slant = 1 / math.sin(self.elevation_rad.mean())
        return curved_tracks(
            azimuth_rad=self.azimuth_rad[None],
            elevation_rad=self.elevation_rad[None],
            time_s=self.time_s[None],
            centre_rad=self.elevation_rad.mean(keepdims=True),
            layer_velocity_rad_s=slant * np.array([[self.wind_rad_s.real, self.wind_rad_s.imag]]),
            radius_rad=radius_rad or np.abs(self.offsets_rad).max(),
        )


def hexagon(radius_rad):
    return radius_rad * np.append(0, np.exp(1j * math.pi / 3 * np.arange(6)))


def daisy(elevation, wind, n=150):
    t = np.linspace(0, 15, n)
    radial = 6 * ARCMIN * np.sin(2 * math.pi * t / 4.0)
    x, y = radial * np.cos(2 * math.pi * t / 13), radial * np.sin(2 * math.pi * t / 13)
    return Track(2.0 + x / math.cos(elevation), elevation + y, t, wind, hexagon(3 * ARCMIN))


def lissajous(elevation, wind, n=200):
    t = np.linspace(0, 20, n)
    x, y = 20 * ARCMIN * np.sin(2 * math.pi * t / 7), 12 * ARCMIN * np.sin(2 * math.pi * t / 4.3)
    return Track(-1.0 + x / math.cos(elevation), elevation + y, t, wind, hexagon(4 * ARCMIN))


def sweep(elevation, wind, n=300, throw=20 * DEG, legs=1):
    t = np.linspace(0, 20 * legs, n)
    x = throw * np.abs((t / 20 + 1) % 2 - 1) - throw / 2
    return Track(0.5 + x / math.cos(elevation), np.full(n, elevation), t, wind, hexagon(39 * ARCMIN))


def lattice_structure(strip, lanes):
    """Structure function (n_x/2 + 1, n, n) that draws of a strip have between some lanes, from the factors."""
    frequency, n_dense = np.arange(strip.n_x // 2 + 1), len(strip.start) - 1
    density = np.zeros((len(frequency), len(lanes), len(lanes)))
    for k in range(n_dense):
        columns = strip.columns[strip.start[k] : strip.start[k + 1]][:, lanes].astype(float)
        density[k] = columns.T @ columns
    wave = np.arange(strip.amplitude.shape[1])
    sides = np.where((wave == 0) | (2 * wave == strip.n_y), 1.0, 2.0)
    apart = np.abs(np.subtract.outer(lanes, lanes))
    for lag in np.unique(apart) if strip.n_across else ():
        across = np.square(strip.amplitude, dtype=float) @ (sides * np.cos(2 * np.pi * wave * lag / strip.n_y))
        density[n_dense : n_dense + len(across), apart == lag] = across[:, None]
    density *= (np.where((frequency == 0) | (2 * frequency == strip.n_x), 1.0, 2.0) / strip.n_x)[:, None, None]
    covariance = scipy.fft.irfft(density, n=strip.n_x, axis=0)[: strip.n_x // 2 + 1]
    variance = np.diagonal(covariance[0])
    ramp = (strip.ramp_std * strip.step_rad * frequency) ** 2
    return variance[:, None] + variance - 2.0 * covariance + ramp[:, None, None]


def also(slow, *fast):
    """Parameters, those of the list `slow` for tests that are marked so."""
    marked = [pytest.param(*(item if isinstance(item, tuple) else (item,)), marks=pytest.mark.slow) for item in slow]
    return [*fast, *marked]


@pytest.mark.parametrize(
    "screen, length, width",
    also(
        [(Screen(11 / 3, 6e-3, 0.5), 25, 12), (Screen(3.0, 6e-3), 30, 10), (Screen(3.9, 6e-3), 25, 5)]
        + [(Screen(2 / 3, 6e-3, 0.5), 20, 5), (Screen(5.0, 6e-3, 0.1), 8, 4)],
        (KOLMOGOROV, 60, 12),
        (KOLMOGOROV, 4, 3),
    ),
    ids=str,
)
def test_structure_function_of_wide_strips(screen, length, width):
    """Within 3e-4 on the lattice, along, across and oblique; lengths in beams."""
    step = screen.beam_rad / 20
    sides = {"length_rad": length * screen.beam_rad, "half_width_rad": 0.5 * width * screen.beam_rad}
    strip = build_strip(screen, **sides, step_rad=step, factorize=factorize_wide)
    assert strip.n_across > 0 and strip.n_lane > width * 20
    lanes = np.array(sorted({0, 1, 2, strip.n_lane // 5, strip.n_lane // 2, strip.n_lane - 2, strip.n_lane - 1}))
    used = int(strip.length_rad / step) + 1
    distance = step * np.hypot(np.arange(used)[:, None, None], np.subtract.outer(lanes, lanes))
    found = lattice_structure(strip, lanes)[:used]
    np.testing.assert_allclose(found, structure_function(screen, distance), rtol=3e-4, atol=1e-30)
    assert strip.clipped_fraction < 1e-5


@pytest.mark.parametrize("height, tolerances", also([(6000, (0.02, 0.05)), (375, (0.02, 0.3))], (1000, (0.02, 0.05))))
def test_what_cleaning_leaves_of_wide_strips(height, tolerances):
    """Variance over an 8 arcmin field of view after a plane and a quadratic are removed, by look-ups."""
    screen = Screen(11 / 3, 8 / height)
    sides = {"length_rad": 15 * DEG, "half_width_rad": 1 * DEG}
    strip = build_strip(screen, **sides, step_rad=strip_step(screen, 0.0), factorize=factorize_wide)
    x, y = (a.ravel() for a in np.meshgrid(*[np.arange(-5, 6) * 0.7 * ARCMIN] * 2))
    x, y = 0.87 * x - 0.5 * y, 0.5 * x + 0.87 * y
    inside = np.hypot(x, y) < 4 * ARCMIN
    x, y = x[inside][::2], y[inside][::2]
    looked_up = between_look_ups(strip, np.stack([y, x], axis=1) / strip.step_rad + [0.5 * strip.n_lane + 0.3, 40.7])
    exact = structure_function(screen, np.hypot(x[:, None] - x, y[:, None] - y))
    linear = np.stack([x**0, x, y], axis=1)
    shapes = linear, np.column_stack([linear, x * x, x * y, y * y])
    for shape, tolerance in zip(shapes, tolerances, strict=True):
        keep = np.eye(x.size) - shape @ np.linalg.pinv(shape)
        assert np.trace(keep @ looked_up @ keep) == pytest.approx(np.trace(keep @ exact @ keep), rel=tolerance)


def test_draws_of_a_wide_strip_have_the_covariance_of_its_factors():
    n_draw, step = 1500, 6e-3 / 12
    strip = build_strip(KOLMOGOROV, length_rad=0.03, half_width_rad=0.015, step_rad=step, factorize=factorize_wide)
    lane, column = np.array([0, 1, 9, 35, strip.n_lane - 1]), np.array([0, 2, 11, 60])
    values = np.empty((n_draw, len(lane), len(column)))
    for k, row in enumerate(values):
        row[:] = draw_strips(strip, deviates(k), [0])[0][np.ix_(lane, column)]
    flat = values.reshape(n_draw, -1)
    found = np.square(flat[:, :, None] - flat[:, None]).mean(axis=0)
    y, x = (a.ravel() for a in np.meshgrid(lane, column, indexing="ij"))
    distance = step * np.hypot(x[:, None] - x, y[:, None] - y)
    far = distance > 0
    expected = structure_function(KOLMOGOROV, distance[far])
    np.testing.assert_allclose(found[far] / expected, 1.0, atol=4.5 * math.sqrt(2.0 / n_draw))


TRACKS = {
    "daisy": daisy(0.9, 0j),
    "daisy in wind": daisy(0.9, 31 * ARCMIN * np.exp(2j)),
    "lissajous": lissajous(0.6, 5 * ARCMIN * np.exp(-1j)),
    "sweep": sweep(45 * DEG, 30 * ARCMIN * np.exp(0.3j)),
    "sweep without wind": sweep(60 * DEG, 0j),
    "low sweep with the wind": sweep(20 * DEG, 60 * ARCMIN * np.exp(-0.5j)),
    "low sweep against the wind": sweep(20 * DEG, -60 * ARCMIN * np.exp(-0.5j)),
    "high sweep": sweep(80 * DEG, 20 * ARCMIN * 1j, throw=10 * DEG),
    "three sweeps in a minute": sweep(45 * DEG, 0j, legs=3),
}


def on_strip(track, tracks, strips):
    """Places (n_det, n, 2) of the samples on the strip, lane and column, as the kernels find them."""
    turned = (tracks.cosine[0] - 1j * tracks.sine[0]) * np.conj(track.offsets_rad)[:, None]
    x = tracks.x_rad[0] + 0.5 * tracks.length_rad[0] + turned.real
    y = tracks.y_rad[0] + strips.strip_half_width_rad + turned.imag
    return np.stack([y, x], axis=-1) / strips.step_rad


@pytest.mark.parametrize("name", TRACKS)
def test_places_on_the_rectangle_are_those_in_the_layer(name):
    """Distances of all pairs of samples, detectors and times; and the rectangle holds them all."""
    track = TRACKS[name]
    tracks = track.tracks()
    strips = strips_of(track, tracks)
    place = on_strip(track, tracks, strips)
    found = (place[..., 1] + 1j * place[..., 0]).ravel()[::3] * strips.step_rad
    expected = track.places_rad.ravel()[::3]
    gap = np.abs(found[:, None] - found) - np.abs(expected[:, None] - expected)
    assert np.abs(gap).max() < 1e-12
    assert place.min() >= 0 and place[..., 0].max() <= strips.n_lane - 1
    assert (
        place[..., 1].max() * strips.step_rad
        <= tracks.length_rad[0]
        <= strips.strip_for(tracks.length_rad[0]).length_rad
    )


def between_look_ups(strip, place):
    """Structure function (n, n) of bilinear look-ups at places (n, 2), lane and column, from the strip's factors."""
    low = np.minimum(place.astype(int), [strip.n_lane - 2, strip.n_x - 2])
    corner = low[:, None] + [[0, 0], [0, 1], [1, 0], [1, 1]]
    share = 1 - np.abs(place[:, None] - corner)
    lanes, row = np.unique(corner[..., 0], return_inverse=True)
    row, structure = row.reshape(corner.shape[:2]), lattice_structure(strip, lanes)
    lag = np.abs(corner[:, :, None, None, 1] - corner[..., 1])
    field = -0.5 * structure[lag, row[:, :, None, None], row]
    weight = share.prod(axis=-1)
    covariance = np.einsum("ia,iajb,jb->ij", weight, field, weight)
    variance = np.diagonal(covariance)
    return variance[:, None] + variance - 2 * covariance


def strips_of(track, tracks, **keys):
    cache = SlantStrips(KOLMOGOROV, np.abs(track.offsets_rad).max(), 0.0, **keys)
    return cache.at(math.sin(track.elevation_rad.mean()), float(tracks.half_width_rad[0]))


FEW = ("daisy in wind", "lissajous", "sweep", "high sweep")


@pytest.mark.parametrize("name", also([name for name in TRACKS if name not in FEW], *FEW))
def test_structure_function_of_look_ups_along_tracks(name):
    """Within 0.2 % of that of the places in the layer, in space and time, after bilinear interpolation."""
    track = TRACKS[name]
    tracks = track.tracks()
    strips = strips_of(track, tracks)
    some = np.random.default_rng(3).permutation(track.offsets_rad.size * track.time_s.size)[:12]
    place, expected = on_strip(track, tracks, strips).reshape(-1, 2)[some], track.places_rad.ravel()[some]
    found = between_look_ups(strips.strip_for(float(tracks.length_rad[0])), place)
    apart = np.abs(expected[:, None] - expected)
    far = apart > 0
    np.testing.assert_allclose(found[far], structure_function(KOLMOGOROV, apart[far]), rtol=2e-3)


def drawn(track, n_draw, thin, interpolation="linear"):
    """Streams (n_draw, n_det * n) of every `thin`-th sample of independent scans along a track, amplitude 1."""
    tracks = track.tracks()
    strips = strips_of(track, tracks, interpolation=interpolation)
    points = strip_points(strips, tracks.corner_rad(strips), tracks.direction, tracks.length_rad)
    offsets = np.stack([track.offsets_rad.real, track.offsets_rad.imag], axis=1)
    streams, bounds = [], np.array([[0, len(track.time_s)]])
    for draw in range(n_draw):
        data = np.zeros((len(offsets), len(track.time_s)), np.float32)
        add_along_curves(
            data,
            bounds,
            tracks=tracks,
            offsets_rad=offsets,
            amplitude_mk=np.ones((1, len(track.time_s))),
            strips=strips,
            deviates=deviates(2 * draw),
            trends=draw_trends(points, deviates(2 * draw + 1)),
        )
        streams.append(data[:, ::thin].ravel())
    return np.array(streams, float)


def agrees_with_places(track, n_draw, thin):
    values, place = drawn(track, n_draw, thin), track.places_rad[:, ::thin].ravel()
    found = np.square(values[:, :, None] - values[:, None]).mean(axis=0)
    apart = np.abs(place[:, None] - place)
    far = apart > 1e-6
    ratio = found[far] / structure_function(KOLMOGOROV, apart[far])
    np.testing.assert_allclose(ratio, 1.0, atol=4.5 * math.sqrt(2.0 / n_draw))


def test_drawn_structure_function_along_a_daisy():
    agrees_with_places(TRACKS["daisy in wind"], 400, 31)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lissajous", "sweep", "high sweep"])
def test_drawn_structure_function_along_tracks(name):
    agrees_with_places(TRACKS[name], 400, 41)


@pytest.mark.parametrize(
    "interpolation, wind",
    [("linear", 0j), ("linear", 200 * ARCMIN * np.exp(-2j)), ("nearest", 30 * ARCMIN), ("cubic", 30 * ARCMIN * 1j)],
)
def test_a_straight_track_through_the_curved_code(interpolation, wind):
    """A telescope that moves up at constant speed: the bits of straight scans, but for rounding."""
    n, rate, speed, azimuth, elevation = 200, 20.0, 40 * ARCMIN, 0.7, 50 * DEG
    t = np.arange(n) / rate
    track = Track(np.full(n, azimuth), elevation + speed * (t - t.mean()), t, wind, hexagon(4 * ARCMIN))
    tracks = track.tracks()
    found = drawn(track, 2, 1, interpolation)
    strips = strips_of(track, tracks, interpolation=interpolation)
    assert not strips.wide
    # The same in the frame of straight scans, whose strips hold a circle around the detectors too.
    ahead = tracks.direction[0] * tracks.radius_rad
    motion = np.diff(track.places_rad[0, [0, -1]])[0] / t[-1]
    offsets = track.places_rad[:, 0] - track.places_rad[0, 0]
    straight = scan_tracks(
        np.array([[0, n]]),
        sample_rate_hz=rate,
        offsets_rad=np.stack([offsets.real, offsets.imag], axis=1)[None],
        velocity_rad_s=np.array([[motion.real, motion.imag]]),
        layer_velocity_rad_s=np.zeros((1, 2)),
        strips=strips,
        extent_rad=np.stack([-ahead, ahead])[None],
    )
    np.testing.assert_allclose(straight.length_rad, tracks.length_rad, rtol=1e-12)
    np.testing.assert_allclose(straight.corner_rad, tracks.corner_rad(strips), rtol=1e-12)
    points = strip_points(strips, straight.corner_rad, straight.direction, straight.length_rad)
    for draw, streams in enumerate(found):
        data = np.zeros((len(offsets), n), np.float32)
        add_along_tracks(
            data,
            np.array([[0, n]]),
            sample_rate_hz=rate,
            tracks=straight,
            amplitude_mk=np.ones(1),
            strips=strips,
            deviates=deviates(2 * draw),
            trends=draw_trends(points, deviates(2 * draw + 1)),
        )
        np.testing.assert_allclose(streams.reshape(data.shape), data, atol=2e-5 * np.ptp(data))
