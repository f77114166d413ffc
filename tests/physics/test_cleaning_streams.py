"""The algorithms on simulated observations of the Lynx survey, in all weathers."""

from pathlib import Path

import numpy as np
import pytest

import surveysim
from mapmaker.cleaning import (
    LocalOptions,
    PcaOptions,
    PolynomialOptions,
    TemplateOptions,
    WindOptions,
    clean,
    clean_in_order,
    slowness,
)
from mapmaker.wind import measure_wind, scan_velocities
from surveysim.reduction.setup import prepare
from surveysim.telescope.pointing import sky_vector
from surveysim.timestreams.observation import draw_observation
from surveysim.timestreams.observed_block import observation_weather
from surveysim.timestreams.simulation import observation_path

LYNX = Path(__file__).parents[2] / "scenarios" / "lynx.toml"
RATE_HZ = 10.0
TEMPLATE = TemplateOptions(1e-8, 100)
# Table 1's octiles of B2 [mK^2 rad^(-5/3)]: the worst and the middle quarter.
BAD_MK2, TYPICAL_MK2 = 980.0, (170.0, 580.0)


@pytest.fixture(scope="module")
def setup():
    scene = surveysim.load_scene(LYNX, {"observations": 60}).model_copy(update={"score": None})
    return prepare(scene)


def _observations(setup, low_mk2, high_mk2, n):
    """The first n observations in weather between the two."""
    b2 = [observation_weather(setup, i).b2 for i in range(setup.scene.observations)]
    return [
        draw_observation(setup, i) for i in np.flatnonzero((np.array(b2) > low_mk2) & (np.array(b2) < high_mk2))[:n]
    ]


@pytest.fixture(scope="module")
def bad(setup):
    return _observations(setup, BAD_MK2, np.inf, 5)


@pytest.fixture(scope="module")
def typical(setup):
    return _observations(setup, *TYPICAL_MK2, 5)


def _clean(name, streams, options):
    return clean(name, streams.data_mk, streams.scan_bounds, streams.focal_plane, options=options)


def _wind_options(streams, sign=1.0):
    velocity = scan_velocities(streams)
    fit = measure_wind(
        streams.data_mk, streams.scan_bounds, streams.focal_plane, sample_rate_hz=RATE_HZ, scan_velocity_rad_s=velocity
    )
    return WindOptions(sign * slowness(fit.velocity_rad_s, velocity), RATE_HZ, 1e-8, 100)


def _low_power(cleaned, streams):
    """Mean power from 0.1 to 0.5 Hz under a Hann taper."""
    scans = np.stack([cleaned.data_mk[:, start:stop] for start, stop in streams.scan_bounds[cleaned.kept]])
    f_hz = np.fft.rfftfreq(scans.shape[2], 1 / RATE_HZ)
    power = np.abs(np.fft.rfft(scans * np.hanning(scans.shape[2]))) ** 2
    return power[..., (f_hz > 0.1) & (f_hz < 0.5)].mean()


def test_pca_takes_one_or_two_modes(bad, typical):
    """The paper's "typically only one or two eigenvectors", in nine scans of ten."""
    removed = np.concatenate([_clean("pca", streams, PcaOptions(3.0)).removed for streams in bad + typical])
    assert np.mean((removed >= 1) & (removed <= 2)) > 0.9


def test_leading_mode_is_the_average_template_in_bad_weather(bad):
    for streams in bad:
        average = _clean("average", streams, TEMPLATE)
        assert average.kept.all()
        for s, (start, stop) in enumerate(streams.scan_bounds):
            scan = streams.data_mk[:, start:stop].astype(np.float64)
            scan -= scan.mean(axis=1, keepdims=True)
            mode = np.linalg.eigh(scan @ scan.T)[1][:, -1] @ scan
            template = np.mean(scan / average.responsivity[s][:, None], axis=0)
            assert abs(np.corrcoef(mode, template)[0, 1]) > 0.99


def test_shifting_with_the_wind_takes_more_in_bad_weather_and_against_it_less(bad):
    for streams in bad:
        average = _low_power(_clean("average", streams, TEMPLATE), streams)
        along = _low_power(_clean("wind", streams, _wind_options(streams)), streams)
        against = _low_power(_clean("wind", streams, _wind_options(streams, -1.0)), streams)
        planar = _low_power(_clean("planar", streams, TEMPLATE), streams)
        assert planar < along < 0.98 * average
        assert against > 1.05 * average


def test_shifting_with_the_wind_hardly_helps_in_typical_weather(typical):
    """The paper found no gain; here it is within two percent of the variance.

    Of 45 observations 44 have ratios from 0.991 to 1.002, and one has 1.06; the median does not see it.
    """
    ratios = []
    for streams in typical:
        average = _clean("average", streams, TEMPLATE).data_mk.var()
        ratios.append(_clean("wind", streams, _wind_options(streams)).data_mk.var() / average)
    assert 0.98 < np.median(ratios) < 1.002


def test_higher_orders_and_smaller_regions_leave_less(bad):
    for streams in bad:
        orders = [PolynomialOptions(order, 1, 1e-8, 100) for order in range(4)]
        left = [_clean("polynomial", streams, options).data_mk.var() for options in orders]
        assert np.all(np.diff(left) < 0)
        assert _clean("polynomial", streams, PolynomialOptions(1, 3, 1e-8, 100)).data_mk.var() < left[1]


def test_local_templates_after_the_average_take_shared_noise(bad):
    """More than the 1 / 7 of white noise that each loses with six neighbours; those at the edge have fewer."""
    for streams in bad:
        average = _clean("average", streams, TEMPLATE)
        steps = [("average", TEMPLATE), ("local", LocalOptions())]
        both = clean_in_order(steps, streams.data_mk, streams.scan_bounds, streams.focal_plane)
        assert both.kept.all() and np.array_equal(both.responsivity, average.responsivity)
        assert 0.2 < both.data_mk.var() / average.data_mk.var() < 0.75


@pytest.mark.slow
def test_scans_that_go_along_with_the_wind_hold_nothing_to_fit_to(monkeypatch):
    """Bad weather, wind at the speed of short scans and along them: one fit a scan loses every second scan, those.

    Over 25 draws of layer and noise in the same weather. Noise lets 2.3 % of the 325 scans fit (30 of 1300 in 100 other
    draws, with a scatter of 0.6 in 13): 5 % are three standard deviations more.
    """
    point = surveysim.load_sweep(
        LYNX.with_name("horn_spacing_280.toml"), {"instrument.layout.field_of_view": "8 arcmin"}
    )
    scene = point.points[0].scene
    setup = prepare(scene)
    weather, (_, pointing) = observation_weather(setup, 5), observation_path(setup.observing, 5)
    layer = np.stack(sky_vector(pointing.scan_parallactic_rad, *weather.wind_rad_s), axis=-1)
    relative = np.linalg.norm(pointing.velocity_rad_s - layer, axis=-1) / np.linalg.norm(layer, axis=-1)
    along = relative < 0.1
    assert weather.b2 > BAD_MK2 and along.sum() == 13 and relative[~along].min() > 1.9
    monkeypatch.setattr("surveysim.timestreams.observed_block.survey_weather", lambda *scene, dated: weather)
    kept = []
    for seed in range(25):
        streams = draw_observation(prepare(scene.model_copy(update={"seed": seed})), 5)
        kept.append(_clean("planar", streams, TEMPLATE).kept)
        scans = np.stack([streams.data_mk[:, start:stop].mean(axis=0) for start, stop in streams.scan_bounds])
        variance = scans.var(axis=1, dtype=np.float64)
        assert variance[along].mean() < 0.01 * variance[~along].mean()
        assert _clean("planar", streams, TemplateOptions(1e-8, 100, "observation")).kept.all()
    assert np.all(np.array(kept)[:, ~along]) and np.mean(np.array(kept)[:, along]) < 0.05
