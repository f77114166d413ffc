"""A scene made ready: checked, and taken apart into camera, observing, air, sky and analysis."""

from collections.abc import Hashable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from mapmaker.cleaning.responsivity import OBSERVATION
from mapmaker.geometry import MapGeometry, covering_geometry
from surveysim.atmosphere.water import Season, seasons
from surveysim.atmosphere.weather import Water, site_water
from surveysim.reduction.analysis import AnalysisSetup
from surveysim.reduction.cleaning_pipelines import CleaningPipeline, pipelines
from surveysim.reduction.consistency import (
    check_excess,
    check_healpix,
    check_levels,
    check_masked,
    check_motion,
    check_score,
    check_size,
    check_sky,
    check_sources,
    check_templates,
    sky_coefficients,
)
from surveysim.reduction.detector_weights import beams_of, detector_weights
from surveysim.reduction.resource_limits import Sizes, check_layer, check_memory, needed_memory
from surveysim.reduction.scored_region import padded_side, patch_side
from surveysim.runtime.errors import InputError, SceneError
from surveysim.scene.instrument import Instrument, OtherBand
from surveysim.scene.scene import Scene
from surveysim.telescope.diffraction import with_beam
from surveysim.telescope.focal_plane import Camera, camera, mask_by_separation
from surveysim.telescope.noise_levels import stop_emits
from surveysim.telescope.pixel_coherence import MOST_DENSE
from surveysim.telescope.pointing import Schedule
from surveysim.telescope.responsivity import assumed_responsivity, band_responsivity, camera_responsivity
from surveysim.telescope.scan_pattern import scan_pattern
from surveysim.telescope.scans import Scans, mid_times, samples_per_scan
from surveysim.telescope.table_checks import check_table
from surveysim.timestreams.scan_blocks import Block, scan_blocks
from surveysim.timestreams.shared_parts import layer_strips
from surveysim.timestreams.simulation import (
    AirSetup,
    CameraSetup,
    ObservingSetup,
    Simulation,
    SkySetup,
    observing_schedule,
    observing_site,
)

SAMPLE_S = 8e-8  # of a detector-sample, about
SIGNAL_SIMS = 1.2  # time of the signal simulations of an observation, about, in that of its other work
QUICK_S = 1.5


@dataclass(frozen=True)
class Setup(Simulation):
    """A scene made ready to draw and to analyse: camera, observing, air, sky and analysis."""

    analysis: AnalysisSetup

    @property
    def key(self) -> Hashable:
        """Scene, blocks and pipelines: all else follows from the scene."""
        return self.scene, self.observing.blocks, self.analysis.pipeline_names


@lru_cache(maxsize=2)
def prepare(scene: Scene) -> Setup:
    """Make a scene ready. Raises SceneError when the scene can't be run, with key, found and allowed."""
    try:
        return _prepare(with_beam(scene))
    except SceneError:
        raise
    except InputError as error:
        raise SceneError(str(error)) from None


def _prepare(scene: Scene) -> Setup:
    cam = camera(scene.instrument, scene.seed)
    pattern = scan_pattern(scene.scan)
    scans = pattern.scans(scene.scan)
    extent = pattern.extent_rad(scans) + scans.dither_rad / 2 + cam.radius_rad
    n_det = len(cam.focal_plane.x_rad)
    check_templates(scene, cam)
    check_size(scene, n_det, extent)
    geometry = _geometry(scene, extent, scene.map.pixel_rad)
    # Half a map pixel holds the beam's multipoles with room to spare.
    sky_geometry = _geometry(scene, extent, scene.map.pixel_rad / 2)
    masked = None
    if scene.score and scene.score.mask_separation_f_lambda:
        masked = mask_by_separation(cam.positions_f_lambda, scene.score.mask_separation_f_lambda)
        check_masked(scene, masked)
    check_score(scene, geometry, scans)
    check_healpix(scene)
    check_excess(scene)
    check_sky(scene, sky_geometry)
    scene_pipelines = pipelines(scene.cleaning, masked)
    check_table(scene, cam)
    responsivity, of_bands = camera_responsivity(scene, cam), band_responsivity(scene, n_det)
    times, water = observing_schedule(scene, scans), _water(scene, scene.instrument)
    lowest = _lowest(scene, cam, times, mid_times(scans))
    levels = check_levels(scene, water, lowest)
    check_sources(scene, sky_geometry)
    cam_setup = CameraSetup(
        cam.focal_plane,
        cam.f_lambda_rad,
        cam.illumination,
        cam.lattices,
        cam.properties,
        cam.counts,
        cam.band,
        cam.polarizations,
        responsivity=responsivity,
        band_responsivity=of_bands,
        photon=scene.photon,
        excess=scene.excess,
        stop_emits=stop_emits(scene),
    )
    weight = detector_weights(cam_setup, levels)
    waters = tuple(_water(scene, band) for band in scene.instrument.bands)
    air = AirSetup(layer_strips(scene, cam), water, waters, _seasons(scene, times))
    calibration = assumed_responsivity(scene, np.vstack([responsivity[None], of_bands]))
    setup = Setup(
        scene=scene,
        camera=cam_setup,
        observing=ObservingSetup(scene, pattern, scans, _blocks(scene, n_det, scans, scene_pipelines)),
        air=air,
        sky=SkySetup(scene, sky_geometry, tuple(cam_setup.beams.fwhm_rad.tolist())),
        analysis=AnalysisSetup(
            scene,
            geometry,
            sky_geometry,
            scene_pipelines,
            calibration,
            masked,
            n_det,
            weight,
            beams_of(cam_setup, weight),
        ),
    )
    _ = setup.camera.photon_coherence
    if setup.camera.n_det > MOST_DENSE:
        _check_torus(setup.camera)
    elements = check_layer(scene, air, radius_rad=cam.radius_rad, scans=scans, lowest_rad=lowest)
    check_memory(needed_memory(scene, _sizes(setup, elements)))
    return setup


def _check_torus(cam: CameraSetup) -> None:
    """Raise SceneError where there is no torus for the noise that so many detectors share: it is made, once."""
    _ = cam.photon_correlation, cam.excess_factor


def _sizes(setup: Setup, strip_elements: int) -> Sizes:
    scene, geometry = setup.scene, setup.analysis.geometry
    scored = scene.score is not None
    curved = scene.sky is not None and scene.sky.curved_lmax is not None
    return Sizes(
        n_det=setup.camera.n_det,
        n_samp=samples_per_scan(setup.observing.scans),
        n_scans=max(block.n_scans for block in setup.observing.blocks),
        n_bands=1 + len(scene.instrument.bands) * setup.analysis.subtracts_bands,
        n_pixel=geometry.n_x * geometry.n_y,
        n_patch=patch_side(scene.score.size_rad, geometry) if scored else 0,
        n_pad=padded_side(scene.score.size_rad, geometry) if scored else 0,
        n_set=len(setup.analysis.data_set_names),
        n_transfer=len(setup.analysis.transfer_function_names),
        n_sky=setup.analysis.n_signal_skies,
        n_beam=len(setup.camera.beams.fwhm_rad),
        strip_elements=strip_elements,
        n_coefficients=sky_coefficients(scene.sky.curved_lmax, setup.sky.geometry) if curved else 0,
    )


def _blocks(scene: Scene, n_det: int, scans: Scans, scene_pipelines: tuple[CleaningPipeline, ...]) -> tuple[Block, ...]:
    """Blocks of an observation; raises SceneError for pipelines that need an observation whole."""
    n_samp, most = samples_per_scan(scans), scene.numerics.max_block_bytes
    bands = len(scene.instrument.bands) * any(pipeline.uses("spectral") for pipeline in scene_pipelines)
    # In single precision for any type of the streams, so that draws do not depend on it.
    scan_bytes = n_det * n_samp * (1 + bands) * np.dtype(np.float32).itemsize
    key = f"numerics.max_block_memory: found {most / 1e6:.4g} MB"
    found = scan_blocks(scans.n_scans, scan_bytes, most)
    together = scene.cleaning.responsivities == OBSERVATION and any(
        pipeline.takes_responsivities for pipeline in scene_pipelines
    )
    if len(found) > 1 and together:
        raise SceneError(
            f"{key}, which cuts an observation into {len(found)} blocks; cleaning.responsivities 'observation' needs "
            f"it whole: {scan_bytes * scans.n_scans / 1e6:.4g} MB or more is expected, or 'survey' in its place"
        )
    return found


def _geometry(scene: Scene, extent_rad: float, pixel_rad: float) -> MapGeometry:
    return covering_geometry(scene.field.ra_rad, scene.field.dec_rad, pixel_rad, extent_rad)


def _lowest(scene: Scene, cam: Camera, times: Schedule | None, mid_time_s: np.ndarray) -> float:
    """Lowest elevation of all scans [rad]; raises SceneError where the sky moves too far within one."""
    if times is None:
        return scene.fixed_pointing.elevation_rad
    return check_motion(scene, cam, observing_site(scene), times, mid_time_s)


def _water(scene: Scene, band: Instrument | OtherBand) -> Water | None:
    place = scene.place
    return None if place is None else site_water(scene.atmosphere, place, band.band)


def _seasons(scene: Scene, times: Schedule | None) -> tuple[Season, ...] | None:
    """Seasons of all observations; None without a schedule or without water by month."""
    if times is None or scene.atmosphere is None or not scene.atmosphere.pwv_by_month:
        return None
    return seasons(times.start_mjd, scene.schedule.longitude_rad)


def signal_sim_observations(scene: Scene) -> np.ndarray:
    """Observations (n_obs,) bool that carry the signal simulations: the first ones, in pairs of both directions.

    Longer surveys have the same.
    """
    chosen = np.zeros(scene.observations, bool)
    if scene.score is not None:
        chosen[: 2 * max(1, scene.score.signal_sims.observations // 2)] = True
    return chosen


def is_quick(setup: Setup) -> bool:
    """Return whether this process simulates a whole survey about as soon as worker processes have started."""
    samples = setup.camera.n_det * setup.observing.scans.n_scans * samples_per_scan(setup.observing.scans)
    with_sims = float(signal_sim_observations(setup.scene).mean())
    return samples * setup.scene.observations * SAMPLE_S * (1 + with_sims * SIGNAL_SIMS) < QUICK_S
