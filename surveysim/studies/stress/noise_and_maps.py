"""Cases of extreme noise, maps and correlations."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from mapmaker.binning import bin_map
from mapmaker.correlations import correlation_profile, pair_bins, scan_covariances
from mapmaker.gls import GlsOptions, gls_map
from mapmaker.iterative import StreamBlock
from mapmaker.stream_psd import low_frequency_variance
from surveysim.reduction.setup import Setup, prepare
from surveysim.runtime.rng import normal_deviates
from surveysim.scene.scene import Scene
from surveysim.studies.stress.case import N_SAMP, RATE_HZ, STIFF, Outcome, agrees
from surveysim.studies.stress.cleaning import plane_of, planted
from surveysim.telescope.pixel_coherence import correlation_factor
from surveysim.timestreams.low_frequency import add_excess
from surveysim.timestreams.observation import draw_observation
from surveysim.timestreams.simulation import observation_path


def excess(scene: Scene) -> Outcome:
    """Check the variance below the band limit that a spectral index implies."""
    section, n_det, n_scans = scene.excess, 100, 64
    data = np.zeros((n_det, n_scans * N_SAMP), np.float32)
    add_excess(
        data,
        section,
        variance_mk2=section.variance_mk2[0],
        n_scans=n_scans,
        sample_rate_hz=RATE_HZ,
        factor=np.eye(n_det),
        deviates=normal_deviates(2, "stress"),
    )
    found = low_frequency_variance(data, n_scans, RATE_HZ, section.band_limit_hz).mean()
    # At worst the lowest mode has it all: two deviates a scan.
    tolerance = 4 * section.variance_mk2[0] / math.sqrt(n_det * n_scans)
    return agrees(found, section.variance_mk2[0], tolerance, "variance below the band limit [mK^2]")


def white_excess(scene: Scene) -> Outcome:
    """Check that low-frequency noise with index 0 has no correlation between samples."""
    section, n_det = scene.excess, 200
    data = np.zeros((n_det, 16 * N_SAMP), np.float32)
    add_excess(
        data,
        section,
        variance_mk2=1.0,
        n_scans=16,
        sample_rate_hz=RATE_HZ,
        factor=np.eye(n_det),
        deviates=normal_deviates(2, "stress"),
    )
    scans = data.reshape(n_det, 16, N_SAMP)
    found = np.sum(scans[..., 1:] * scans[..., :-1]) / np.sum(scans**2)
    return agrees(found, 0.0, 4 / math.sqrt(data.size), "correlation of neighbouring samples")


def correlation(scene: Scene, least: float) -> Outcome:
    """Factor a correlation matrix with the eigenvalues `least`, 1 and 2 - least."""
    turn = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    matrix = turn * [least, 1.0, 2.0 - least] @ turn.T
    factor = correlation_factor(matrix)
    return agrees(np.abs(factor @ factor.T - matrix).max(), 0.0, 1e-12, "departure of the factor's square")


def twins(scene: Scene) -> Outcome:
    """Check pixels that are all in one place."""
    factor = correlation_factor(np.ones((37, 37)))
    return agrees(np.abs(factor @ factor.T - 1).max(), 0.0, 1e-12, "departure of the factor's square")


def gains(scene: Scene) -> Outcome:
    """Check a correlation profile measured with gains over six decades."""
    setup = prepare(scene)
    plane, streams = setup.camera.focal_plane, draw_observation(setup, 0)
    bins, gain = pair_bins(plane), np.geomspace(1e-3, 1e3, len(plane.x_rad))[:, None]
    profiles = [
        correlation_profile(scan_covariances(data, streams.scan_bounds), bins).log_profile
        for data in (streams.data_mk.astype(float), gain * streams.data_mk)
    ]
    return agrees(np.abs(profiles[1] - profiles[0]).max(), 0.0, 1e-10, "change of the profile of ln C")


def pairs(scene: Scene, places: np.ndarray) -> Outcome:
    """Check the recovery of a profile linear in theta^2 with gains over two decades."""
    bins = pair_bins(plane_of(places))
    gain, distant = np.linspace(-2, 2, len(places)), ~bins.adjacent
    shape = -((bins.theta_rad / bins.theta_rad[-1]) ** 2)
    logs = shape[bins.bin[distant]] + gain[bins.first[distant]] + gain[bins.second[distant]]
    return agrees(np.abs(bins.solve @ logs - (shape - shape.mean())).max(), 0.0, 1e-9, "departure of the profile")


def _blocks(setup: Setup, ratio: float) -> StreamBlock:
    path, _ = observation_path(setup.observing, 0)
    n_det, n_pix = setup.camera.n_det, setup.analysis.geometry.n_x * setup.analysis.geometry.n_y
    bounds = np.arange(setup.observing.scans.n_scans)[:, None] * N_SAMP + [0, N_SAMP]
    data = planted(n_det, ratio, n_scans=setup.observing.scans.n_scans)
    # A tenth of the map is enough to be crossed often; the rest stays without a hit.
    index = np.random.default_rng(9).integers(0, n_pix // 10, data.shape)
    return StreamBlock(data, index, bounds, setup.camera.focal_plane)


def unhit(scene: Scene) -> Outcome:
    """Check a map with pixels without hits."""
    setup = prepare(scene)
    block = _blocks(setup, 0.0)
    item = bin_map(
        setup.analysis.geometry,
        block.data_mk,
        block.index,
        block.scan_bounds,
        kept=np.ones(len(block.scan_bounds), bool),
    )
    finite = np.isfinite(item.signal_mk).all() and not item.signal_mk[item.hits == 0].any()
    return agrees(float(finite), 1.0, 0.0, f"finite, and 0 in {np.sum(item.hits == 0)} pixels without a hit")


def likelihood_map(scene: Scene) -> Outcome:
    """Check a maximum-likelihood map of data with a common mode."""
    setup, maps = prepare(scene), []
    for ratio in (1e3, STIFF):
        blocks = partial(_as_list, _blocks(setup, ratio))
        found = gls_map(setup.analysis.geometry, blocks, sample_rate_hz=RATE_HZ, options=GlsOptions())
        maps.append(found.map.signal_mk[found.map.hits > 0])
    return agrees(np.std(maps[1] - maps[0]) / np.std(maps[0]), 0.0, 1e-2, "change of the map over its noise")


def _as_list(block: StreamBlock) -> list[StreamBlock]:
    return [block]
