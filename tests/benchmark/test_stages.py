"""One benchmark a stage of an observation, in the order in which they run, after floors for comparison."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.fft import irfft, next_fast_len, rfft

from mapmaker.geometry import boresight_pixels
from mapmaker.kernels.pixels import bin_samples
from mapmaker.stream_psd import hann_psd, white_level
from mapmaker.wind import measure_wind, scan_velocities
from surveysim.reduction import cleaned_block, signal_maps
from surveysim.reduction import noise_only_sets as sets
from surveysim.reduction import observation as reduction
from surveysim.reduction.cleaning_pipelines import AuxiliaryData, CleaningPipeline, apply_pipeline
from surveysim.reduction.layer_delays import layer_motion, measured_delays
from surveysim.reduction.map_noise import map_noise
from surveysim.runtime.rng import RandomPurpose, generator, normal_deviates
from surveysim.survey.coadds import add_observations, empty_coadds, observation_sums
from surveysim.timestreams.atmosphere import add_atmosphere
from surveysim.timestreams.low_frequency import add_low_frequency_noise
from surveysim.timestreams.observation import Stopwatch
from surveysim.timestreams.photon import add_photon_noise
from tests.benchmark.conftest import FLOOR, OBSERVATION


def test_floor_normal_deviates(per_sample, lynx):
    rng = generator(lynx.setup.scene.seed, RandomPurpose.DETECTOR, OBSERVATION)
    per_sample(FLOOR, lambda: rng.standard_normal(lynx.data_mk.shape, dtype=np.float32))


def test_floor_own_deviates(per_sample, lynx):
    deviates, out = lynx.observed_block.deviates(RandomPurpose.DETECTOR), np.empty_like(lynx.data_mk)
    per_sample("floor: own deviates", lambda: deviates.fill(out))


def test_floor_fft_pair(per_sample, lynx):
    """As many and as long transforms as the excess noise takes, forth and back."""
    n_scans = lynx.setup.observing.scans.n_scans
    n = next_fast_len(2 * lynx.data_mk.shape[1] // n_scans, real=True)
    data = np.ones((len(lynx.data_mk), n_scans, n), np.float32)
    per_sample("floor: FFT pair", lambda: irfft(rfft(data), n))


def test_floor_copy(per_sample, lynx):
    out = np.empty_like(lynx.data_mk)
    per_sample("floor: copy", lambda: np.copyto(out, lynx.data_mk))


def test_atmosphere(per_sample, lynx):
    data, block = np.zeros_like(lynx.data_mk), lynx.observed_block
    per_sample("atmosphere", lambda: add_atmosphere(data, block))


def test_excess(per_sample, lynx):
    data, block = np.zeros_like(lynx.data_mk), lynx.observed_block
    per_sample("excess", lambda: add_low_frequency_noise(data, block))


def test_white_noise(per_sample, lynx):
    data, block = np.zeros_like(lynx.data_mk), lynx.observed_block
    per_sample("photon and detector", lambda: add_photon_noise(data, block))


def test_pixels(per_sample, lynx):
    pointing, streams = lynx.pointing, lynx.streams
    boresight = (pointing.xi_rad, pointing.eta_rad, pointing.array_angle_rad)
    per_sample("pixels", lambda: boresight_pixels(lynx.setup.analysis.geometry, *boresight, plane=streams.focal_plane))


def test_wind(per_sample, lynx):
    streams, rate = lynx.streams, lynx.setup.observing.scans.sample_rate_hz
    velocity = scan_velocities(streams)
    arguments = (streams.data_mk, streams.scan_bounds, streams.focal_plane)
    options = {"sample_rate_hz": rate, "scan_velocity_rad_s": velocity}
    per_sample("wind, measured", lambda: measure_wind(*arguments, **options))


@pytest.mark.parametrize("algorithm", ["average", "planar", "quadratic", "polynomial", "wind", "pca", "local"])
def test_cleaning(per_sample, lynx, algorithm):
    streams, rate = lynx.streams, lynx.setup.observing.scans.sample_rate_hz
    section = lynx.setup.scene.cleaning.model_copy(
        update={"sigma_cut": 3.0, "neighbour_radius": 1.2, "order": 3, "regions": 1}
    )
    pipeline = CleaningPipeline("actual", (algorithm,))
    delays = measured_delays([layer_motion(streams, rate)], streams.focal_plane)
    auxiliary = AuxiliaryData(delays, np.zeros((0, *streams.data_mk.shape), np.float32))
    options = {"scan_bounds": streams.scan_bounds, "focal_plane": streams.focal_plane}
    options |= {"auxiliary": auxiliary, "sample_rate_hz": rate}
    per_sample(f"cleaning, {algorithm}", lambda: apply_pipeline(section, pipeline, streams.data_mk, **options))


def test_spectra(per_sample, lynx):
    n_scans, rate = lynx.setup.observing.scans.n_scans, lynx.setup.observing.scans.sample_rate_hz
    kept = np.ones(n_scans, bool)
    per_sample("Hann spectra", lambda: hann_psd(lynx.data_mk, n_scans, kept, rate))


def test_binning(per_sample, lynx):
    n_pixel = lynx.setup.analysis.geometry.n_y * lynx.setup.analysis.geometry.n_x
    bounds = lynx.streams.scan_bounds
    kept = np.ones(len(bounds), bool)
    total, hits = np.zeros(n_pixel), np.zeros(n_pixel, np.int64)
    per_sample("binning", lambda: bin_samples(lynx.data_mk, lynx.index, bounds, kept, total, hits))


@pytest.mark.parametrize("name", ["uncorrelated", "white"])
def test_simulated_set(per_sample, lynx, name):
    setup, n_det = lynx.setup, len(lynx.data_mk)
    psd = np.tile(lynx.result.clean_psd, (n_det, 1))
    white = white_level(psd, 150, setup.observing.scans.sample_rate_hz, setup.scene.score.white_noise_above_hz)
    drawn = normal_deviates(setup.scene.seed, sets.NOISE_ONLY_SETS[name].purpose, OBSERVATION)
    n_scans = setup.observing.scans.n_scans
    draw, rows = sets.NOISE_ONLY_SETS[name].draw, slice(0, n_det)
    per_sample(f"simulated set, {name}", lambda: draw(setup, drawn, rows, psd=psd, white=white, n_scans=n_scans))


def test_signal_simulation_of_one_sky(per_sample, lynx):
    """A sky through the streams of the whole and the masked array, with cleaning and without."""
    options = {"delays_s_rad": None, "watch": Stopwatch()}
    part = cleaned_block.reduce_block(lynx.setup, OBSERVATION, lynx.pointing, lynx.block, **options)
    maps, skies = signal_maps.empty_signal_maps(lynx.setup.analysis, 1), lynx.setup.analysis.signal_skies_mk[:1]
    per_sample("signal simulation, one sky", lambda: signal_maps.add_signal_maps(maps, part, skies))


def test_weights(per_sample, lynx):
    """The noise of the maps of all data sets."""
    maps = list(zip(lynx.result.sums, lynx.result.hits, strict=True))
    per_sample("weights", lambda: [map_noise(lynx.setup.analysis.region, *item) for item in maps])


def test_coadds(per_sample, lynx):
    """All data sets and the signal simulations into the sums and the sign-flipped sums."""
    coadds = empty_coadds(lynx.setup.analysis)
    per_sample(
        "co-adds",
        lambda: add_observations(
            lynx.setup.analysis,
            coadds,
            [observation_sums(lynx.setup.analysis, replace(lynx.result, observation=coadds.done))],
        ),
    )


@pytest.mark.parametrize("with_signal_sims", [False, True], ids=["bare", "with simulations"])
def test_observe(per_sample, lynx, with_signal_sims):
    name = "observation, with signal simulations" if with_signal_sims else "whole observation"
    per_sample(name, lambda: reduction.observe(lynx.setup, OBSERVATION, with_signal_sims))
