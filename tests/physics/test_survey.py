"""The whole chain against closed forms: what goes into the streams must come out of the maps."""

from pathlib import Path

import numpy as np
import pytest

from mapmaker.bandpower import estimate_amplitude, flat_band_power, flat_spectrum_psd
from mapmaker.binning import weighted_mean
from mapmaker.cleaning.templates import QUADRATIC, template_basis
from mapmaker.spectrum import map_psd
from mapmaker.transfer_function import beam_window, pixel_window
from surveysim.atmosphere.thin_screen import at_elevation, temporal_psd
from surveysim.reduction.setup import prepare
from surveysim.scene.passband import top_hat
from surveysim.scene.scene import load_scene
from surveysim.survey.run import run_observations
from surveysim.survey.scores import score_survey
from surveysim.timestreams.low_frequency import excess_psd, excess_variance
from surveysim.timestreams.observation import draw_observation
from tests.scenes import SMALL_SCENE

LYNX = Path(__file__).parents[2] / "scenarios" / "lynx.toml"
STREAMS = ("atmosphere", "excess", "photon", "detector", "sky")


def survey(tmp_path, keep=(), **overrides):
    """Setup and sums of the small scene with only the streams in `keep`, one ring of scans enlarged to a survey."""
    text = SMALL_SCENE
    for name in STREAMS:
        if name not in keep:
            text = without_section(text, name)
    path = tmp_path / "scene.toml"
    path.write_text(text)
    settings = {
        "observations": 24,
        "scan.scans": 12,
        "scan.duration": "7.5 s",
        "scan.step": "2 arcmin",
        "map.pixel": "20 arcsec",
        "score.size": "24 arcmin",
        "score.ell_bin": 1000,
        "score.signal_sims.observations": 4,
        "instrument.responsivity_scatter": 0.0,
    }
    setup = prepare(load_scene(path, settings | overrides))
    return setup, run_observations(setup, None)


def without_section(text, name):
    """Scene text less the section `name` and its tables."""
    blocks = text.replace("\n[", "\n\0[").split("\0")
    heads = (f"[{name}]", f"[{name}.", f"[[{name}.")
    return "".join(block for block in blocks if not block.startswith(heads))


def test_white_streams_give_the_map_noise_of_their_hits(tmp_path):
    setup, coadds = survey(tmp_path, ("detector",), **{"cleaning.algorithm": "none"})
    white = setup.scene.detector.psd_mk2_hz * setup.observing.scans.sample_rate_hz / 2
    # The removed mean takes 1 / n of each scan's variance.
    variance = white * (1 - 1 / 75)
    signal = weighted_mean(coadds.sums[0], coadds.weight[0])
    hits = coadds.hits[0]
    # The weights scatter by their own noise estimates, which costs their relative variance in the co-add; the mean
    # over pixels has sqrt(2 / n_pix) of error.
    deep = hits > 20
    scaled = np.mean(signal[deep] ** 2 * hits[deep]) / variance
    assert scaled == pytest.approx(1 + setup.analysis.region.noise_scatter, abs=4 * np.sqrt(2 / deep.sum()))
    # And 1 / sqrt(hits) pixel by pixel: the lower and upper half in hits agree.
    half = hits > np.median(hits[deep])
    low, high = deep & ~half, deep & half
    ratio = np.mean(signal[high] ** 2 * hits[high]) / np.mean(signal[low] ** 2 * hits[low])
    assert ratio == pytest.approx(1, abs=4 * np.sqrt(2 / high.sum() + 2 / low.sum()))


def test_band_power_of_white_noise_against_its_closed_form(tmp_path):
    setup, coadds = survey(tmp_path, ("detector",), **{"cleaning.algorithm": "none", "score.jackknives": 24})
    score = score_survey(setup, coadds, ("actual",))["actual"]
    band, scale = setup.analysis.region, (1e3 * top_hat(143e9, 0.0).cmb_per_rj) ** 2
    variance = setup.scene.detector.psd_mk2_hz * setup.observing.scans.sample_rate_hz / 2 * (1 - 1 / 75)
    hits = coadds.hits[0][band.patch, band.patch]
    taper2 = band.taper**2
    assert hits[band.taper > 0.01].min() > 0
    pixel = setup.analysis.geometry.pixel_rad
    noise = scale * variance * pixel**2 * np.sum(taper2[hits > 0] / hits[hits > 0]) / taper2.sum()
    ell = band.rings.ell
    signal = flat_spectrum_psd(ell) * beam_window(ell, np.radians(1 / 60)) * pixel_window(ell, pixel)
    signal = signal * score.transfer_function.transmission
    expected = flat_band_power(np.full(ell.shape, noise), signal, band.rings.n_modes, band.selected)
    # What chance takes through the weights is given back to first order; 1 % for the next.
    assert score.band.sigma_ukcmb2 == pytest.approx(expected, rel=0.01 + 3 * score.budget.noise)


def test_the_measured_noise_scatters_as_the_band_says(tmp_path):
    """The variance that chance gives weights, which scores give back: over white maps of even coverage."""
    (tmp_path / "scene.toml").write_text(SMALL_SCENE)
    band = prepare(
        load_scene(tmp_path / "scene.toml", {"score.size": "24 arcmin", "map.pixel": "20 arcsec"})
    ).analysis.region
    rng, hits, n_maps = np.random.default_rng(6), np.full(band.taper.shape, 100), 3000
    noise = [band.noise(10 * rng.standard_normal(hits.shape), hits)[0] for _ in range(n_maps)]
    assert np.mean(noise) == pytest.approx(1, abs=4 * np.sqrt(band.noise_scatter / n_maps))
    # The variance of n draws of little skewness is known to sqrt(2 / n), 2.6 %.
    assert np.var(noise) == pytest.approx(band.noise_scatter, rel=4 * np.sqrt(2 / n_maps))


def test_what_weights_take_by_chance_is_known_in_every_bin(tmp_path):
    """Co-adds of white maps with weights measured on themselves, corrected, have the noise of ideal weights."""
    (tmp_path / "scene.toml").write_text(SMALL_SCENE)
    band = prepare(
        load_scene(tmp_path / "scene.toml", {"score.size": "24 arcmin", "map.pixel": "30 arcsec"})
    ).analysis.region
    rng, n_obs, n_co = np.random.default_rng(8), 20, 300
    hits, powers = np.full(band.taper.shape, 100.0), []
    for _ in range(n_co):
        maps = 10 * rng.standard_normal((n_obs, *hits.shape))
        weights = 1 / np.array([band.noise(item, hits)[0] for item in maps])
        # As one map of n_obs times the hits whose noise would be 1 a sample.
        total = np.tensordot(weights, maps, axes=1) * n_obs / weights.sum()
        powers.append(band.ring_noise(total, n_obs * hits))
    found = np.mean(powers, axis=0) * (1 + (1 - 1 / n_obs) * band.chance(band.rings))
    error = np.std(powers, axis=0) / np.sqrt(n_co)
    # The second order of the weights' scatter d^2 is left: a few d^4.
    assert band.noise_scatter > 0.02
    assert found == pytest.approx(np.ones(len(found)), abs=4 * error.max() + 4 * band.noise_scatter**2)
    uncorrected = np.mean(powers, axis=0)
    assert uncorrected[band.selected][0] < 1 < uncorrected[-1]


def test_removing_scan_means_leaves_the_transfer_function_that_geometry_gives(tmp_path):
    setup, coadds = survey(
        tmp_path,
        ("detector",),
        **{"cleaning.algorithm": "none", "score.signal_sims.skies": 6, "score.signal_sims.observations": 24},
    )
    transfer_function = score_survey(setup, coadds, ("actual",))["actual"].transfer_function
    # A scan of length L along x turns exp(i k x) into itself less its mean, sinc(k_x L / 2) exp(i k x_0); what
    # stays in phase is 1 - sinc^2. Half of the scans run along x, half along y; W is the azimuthal mean.
    length = setup.observing.scans.speed_rad_s * setup.observing.scans.scan_s
    azimuth = (np.arange(3600) + 0.5) * (2 * np.pi / 3600)
    for ell, found, error in zip(
        transfer_function.ell, transfer_function.transmission, transfer_function.error, strict=True
    ):
        along = [np.sinc(ell * f(azimuth) * length / (2 * np.pi)) ** 2 for f in (np.cos, np.sin)]
        expected = np.mean((1 - 0.5 * (along[0] + along[1])) ** 2)
        # Below, the field holds few modes; above, where the beam leaves a hundredth, the steps that the means
        # of large-scale signal leave between scans show. 2 % of model error: scan ends weigh less in the taper.
        if 3000 < ell < 10000:
            assert found == pytest.approx(expected, abs=0.02 + 3 * error)


def test_a_flat_cmb_comes_back_with_its_band_power(tmp_path):
    power = 4000.0
    found, spread = [], []
    for seed in range(4):
        setup, coadds = survey(
            tmp_path,
            ("sky", "detector"),
            **{
                "seed": seed,
                "sky.cmb_band_power": f"{power} uK2",
                "sky.point_sources": [],
                "detector.psd": "1e-6 mK2 / Hz",
                "cleaning.algorithm": "none",
                "observations": 8,
            },
        )
        score = score_survey(setup, coadds, ("actual",))["actual"]
        band = setup.analysis.region
        patch = weighted_mean(coadds.sums[0], coadds.weight[0])[band.patch, band.patch]
        psd = map_psd(band.pad(patch), band.padded_taper, setup.analysis.geometry.pixel_rad, band.rings)
        psd *= (1e3 * top_hat(143e9, 0.0).cmb_per_rj) ** 2
        # The noise is next to nothing, and sign flips of 8 observations would hold an eighth of the sky: bins are
        # weighted by the sky's own variance, and its expectation is taken off.
        modes, selected = band.rings.n_modes, band.selected & (band.rings.ell < 9000)
        sky = power * score.signal_psd
        found.append(
            power
            + estimate_amplitude(psd, noise_psd_ukcmb2=sky, signal_psd=score.signal_psd, n_modes=modes, mask=selected)
        )
        spread.append(power * np.sqrt(2 / modes[selected].sum()))
    # Cosmic variance of four fields, and 1 % for the transfer functions, each of two skies.
    assert np.mean(found) == pytest.approx(power, abs=4 * np.mean(spread) / 2 + 0.01 * power)


def test_stream_psds_add_up(tmp_path):
    """Raw PSDs are atmosphere + excess + white, each from its closed form."""
    setup, coadds = survey(
        tmp_path,
        ("atmosphere", "excess", "detector"),
        **{
            "atmosphere.b2_probabilities": [0.5],
            "atmosphere.b2": "[280] mK2 rad(-5/3)",
            "atmosphere.wind_log_scatter": 0.0,
            "observations": 60,
            "scan.duration": "15 s",
        },
    )
    scene, air = setup.scene, setup.scene.atmosphere
    frequency = np.arange(76) / 15
    elevation = scene.fixed_pointing.elevation_rad
    amplitude, seen = (
        280 * np.sin(elevation) ** (1 - air.spectral_index),
        at_elevation(setup.air.layers[0].strips.screen, np.sin(elevation)),
    )
    wind, scan = air.wind_median_rad_s, setup.observing.scans.speed_rad_s
    # The layer passes at the vector difference of wind and scan, at all angles alike.
    angles = (np.arange(24) + 0.5) * (2 * np.pi / 24)
    speeds = np.hypot(wind - scan * np.cos(angles), scan * np.sin(angles))
    used = (frequency >= 0.3) & (frequency < 4.9)
    atmosphere = np.mean([temporal_psd(seen, frequency[used], w) for w in speeds], axis=0)
    variance = 2.05 * (280 / 46) ** (np.log(4.52 / 2.05) / np.log(580 / 46))
    excess = excess_psd(scene.excess, variance, 150, 300, 10.0)[::2]
    expected = amplitude * atmosphere + excess[used] + scene.detector.psd_mk2_hz
    found = np.mean(coadds.raw_psd, axis=0)[used]
    # 60 x 12 independent scans: the atmosphere, common to the detectors, has 1 / sqrt(720) = 3.7 % a bin; the Hann
    # taper's leakage of f^-8/3 adds up to 5 % at the lowest bins.
    assert np.allclose(found, expected, rtol=0.16)
    assert np.mean(found / expected) == pytest.approx(1, abs=0.02)


def test_excess_after_quadratic_cleaning_is_that_of_table_2():
    """Adjacent covariance 0.8, 1.1, 1.9, 5.8 mK^2 and the fraction 0.46 +- 0.03 of the paper's Table 2."""
    setup = prepare(load_scene(LYNX))
    section = setup.scene.excess
    overlap = setup.camera.excess_factor @ setup.camera.excess_factor.T
    templates = template_basis(setup.camera.focal_plane, QUADRATIC)
    kept = np.eye(len(overlap)) - templates.T @ templates
    left = kept @ overlap @ kept
    positions = setup.camera.positions_f_lambda
    apart = np.linalg.norm(positions[:, None] - positions[None], axis=-1)
    shared = left[(apart > 0.1) & (apart < 0.75)].mean()
    # The table gives one decimal: half of that, and a per cent for the rounding in the scene.
    for b2, expected in ((46, 0.8), (170, 1.1), (580, 1.9), (4000, 5.8)):
        assert shared * excess_variance(section, b2) == pytest.approx(expected, abs=0.01 * expected)
    assert shared / (np.trace(left) / len(left)) == pytest.approx(0.46, abs=0.03)


def test_neighbours_share_the_white_noise_that_the_paper_measures():
    """Section 5.1: 5 % above 2.5 Hz, here from the coherent tenth of the photon noise and the excess' tail."""
    scene = load_scene(LYNX, {"observations": 20, "schedule.nights": 4})
    setup = prepare(scene)
    positions = setup.camera.positions_f_lambda
    apart = np.linalg.norm(positions[:, None] - positions[None], axis=-1)
    adjacent = (apart > 0.1) & (apart < 0.75)
    found = []
    for observation in range(scene.observations):
        data = draw_observation(setup, observation).data_mk
        spectra = np.fft.rfft(data.reshape(len(data), 18, 150) * np.hanning(150))[:, :, 39:74].reshape(len(data), -1)
        cross = (spectra @ spectra.conj().T).real
        power = np.sqrt(np.outer(np.diag(cross), np.diag(cross)))
        found.append((cross / power)[adjacent].mean())
    # The median over weathers; the paper rounds to a per cent, and 20 observations scatter by about as much.
    assert np.median(found) == pytest.approx(0.05, abs=0.015)
