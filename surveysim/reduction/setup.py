"""A scene made ready: checked, and taken apart into camera, observing, air, sky and analysis."""

import math
from collections.abc import Hashable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from mapmaker.cleaning.responsivity import OBSERVATION
from mapmaker.geometry import MapGeometry, covering_geometry
from surveysim.atmosphere.dated_weather import DatedWeather
from surveysim.atmosphere.layers import Layer
from surveysim.atmosphere.weather import Water, site_water
from surveysim.reduction.analysis import AnalysisSetup
from surveysim.reduction.cleaning_pipelines import CleaningPipeline, pipelines
from surveysim.reduction.consistency import (
    check_bands,
    check_dead_time,
    check_excess,
    check_healpix,
    check_levels,
    check_masked,
    check_score,
    check_size,
    check_sky,
    check_templates,
    sky_coefficients,
)
from surveysim.reduction.curved_tracks import curved_motions
from surveysim.reduction.detector_weights import beams_of, detector_weights
from surveysim.reduction.layer_checks import check_changes
from surveysim.reduction.maker_checks import check_maker
from surveysim.reduction.motion_checks import check_motion
from surveysim.reduction.mount_check import check_mount
from surveysim.reduction.resource_limits import Sizes, check_layer, check_memory, needed_memory
from surveysim.reduction.response_checks import check_response
from surveysim.reduction.scored_region import padded_side, patch_side
from surveysim.reduction.signal_sims import carriers
from surveysim.reduction.sky_checks import check_contents, check_signal_spectrum
from surveysim.reduction.splits import SurveySplits, survey_splits
from surveysim.reduction.splits import check_bins as check_split_bins
from surveysim.runtime.errors import InputError, OutOfRangeError, SceneError
from surveysim.scene.bands import errors_of
from surveysim.scene.scene import Scene
from surveysim.scene.weather_table import KEY as TABLE_KEY
from surveysim.telescope.diffraction import with_beam
from surveysim.telescope.focal_plane import Camera, CameraExtent, camera, camera_extent, mask_by_separation
from surveysim.telescope.noise_levels import stop_emits
from surveysim.telescope.pixel_coherence import MOST_DENSE
from surveysim.telescope.pointing import Schedule
from surveysim.telescope.pointing_errors import true_focal_plane
from surveysim.telescope.responsivity import assumed_responsivity, camera_responsivity
from surveysim.telescope.scan_pattern import ScanPattern, scan_pattern
from surveysim.telescope.scans import Scans, duration_s, samples_per_scan
from surveysim.telescope.table_checks import check_table
from surveysim.telescope.time_constants import assumed_time_constants, true_time_constants
from surveysim.timestreams.scan_blocks import Block, scan_blocks
from surveysim.timestreams.shared_parts import air_layers
from surveysim.timestreams.sharing import check_groups, readout_groups
from surveysim.timestreams.simulation import (
    AirSetup,
    CameraSetup,
    ObservingSetup,
    Simulation,
    SkySetup,
    field_centre,
    observing_schedule,
    observing_site,
)
from surveysim.timestreams.survey_weather import survey_dates

SAMPLE_S = 8e-8  # of a detector-sample, about
SIGNAL_SIMS = 1.2  # time of the signal simulations of an observation, about, in that of its other work
QUICK_S = 2.0
TYPICAL_VARIANCE = 0.04  # relative variance of sigma from one observation, about, as of a square degree


@dataclass(frozen=True)
class Setup(Simulation):
    """A scene made ready to draw and to analyse: camera, observing, air, sky and analysis.

    `others` are the other bands of the camera, made ready to draw; none unless a pipeline subtracts them.
    `bright_sky_mk` (n_y, n_x) is subtracted from the streams before cleaning, in passes of an iterative map-maker.
    """

    analysis: AnalysisSetup
    others: tuple[Simulation, ...] = ()
    bright_sky_mk: np.ndarray | None = None

    @property
    def key(self) -> Hashable:
        """Scene, blocks and pipelines: all else follows from the scene."""
        return self.scene, self.observing.blocks, self.analysis.pipeline_names


@lru_cache(maxsize=2)
def prepare(scene: Scene) -> Setup:
    """Make a scene ready. Raises SceneError when the scene can't be run, with key, found and allowed."""
    try:
        return _prepare(_with_beams(scene))
    except SceneError:
        raise
    except InputError as error:
        raise SceneError(str(error)) from None


def _with_beams(scene: Scene) -> Scene:
    """Fill in the beams of all bands where they follow from the aperture."""
    own, others = with_beam(scene), []
    for item in scene.others:
        with errors_of(item, scene):
            others.append(with_beam(item))
    band = scene.band and scene.band.model_copy(update={"others": tuple(others)})
    return own.model_copy(update={"band": band}) if others else own


@dataclass(frozen=True)
class _Common:
    """Parts of a scene that are the same in all bands of its camera."""

    cameras: dict[str, Camera]
    extent: CameraExtent
    pattern: ScanPattern
    scans: Scans
    n_streams: int
    blocks: tuple[Block, ...]
    geometry: MapGeometry
    sky_geometry: MapGeometry
    times: Schedule | None
    dated: DatedWeather | None
    layers: tuple[Layer, ...]


def _common(scene: Scene) -> _Common:
    bands = {item.band_name: item for item in (scene, *scene.others)}  # the first error is the band's own
    cameras: dict[str, Camera] = {}
    for name, item in bands.items():
        with errors_of(item, scene):
            cameras[name] = camera(item.instrument, item.seed)
            check_table(item, cameras[name])
    extent = camera_extent([cameras[name] for name in sorted(cameras)])  # to the last bit the same in all bands
    pattern = scan_pattern(scene.scan)
    scans = pattern.scans(scene.scan, field_centre(scene), observing_site(scene) if scene.schedule else None)
    reach = _reach(pattern.extent_rad(scans, _lowest_allowed(scene)) + scans.dither_rad / 2, extent.radius_rad)
    for name, item in bands.items():
        with errors_of(item, scene):
            check_size(item, cameras[name].n_det, reach)
    n_streams = max(_streams(item, cameras[name]) for name, item in bands.items())
    times = observing_schedule(scene, scans)
    return _Common(
        cameras,
        extent,
        pattern,
        scans,
        n_streams,
        _blocks(scene, n_streams, scans),
        _geometry(scene, reach, scene.map.pixel_rad),
        # Half a map pixel holds the beam's multipoles with room to spare.
        _geometry(scene, reach, scene.map.pixel_rad / 2),
        times,
        survey_dates(scene, times, duration_s=duration_s(scans)),
        air_layers(scene, extent),
    )


def _reach(extent_rad: float, radius_rad: float) -> float:
    """Bound of a detector's offsets in the tangent plane [rad], for boresights up to an extent along both axes."""
    depth = 1 - math.sqrt(2) * extent_rad * radius_rad
    return (extent_rad + math.sqrt(1 + 2 * extent_rad**2) * radius_rad) / depth if depth > 0 else math.inf


def _lowest_allowed(scene: Scene) -> float:
    """Lowest elevation [rad] of the field's centre that the scene allows."""
    return scene.schedule.min_elevation_rad if scene.schedule else scene.fixed_pointing.elevation_rad


def _simulation(scene: Scene, common: _Common) -> Simulation:
    cam = common.cameras[scene.band_name]
    tau_s = true_time_constants(scene, cam)
    cam_setup = CameraSetup(
        cam.focal_plane,
        cam.f_lambda_rad,
        cam.illumination,
        cam.lattices,
        cam.properties,
        cam.counts,
        cam.band,
        cam.polarizations,
        responsivity=camera_responsivity(scene, cam),
        photon=scene.photon,
        excess=scene.excess,
        stop_emits=stop_emits(scene),
        true_plane=true_focal_plane(scene, cam.focal_plane),
        time_constant_s=tau_s,
        deconvolved_s=assumed_time_constants(scene, tau_s),
        readout_groups=readout_groups(cam, scene.crosstalk.group_size) if scene.crosstalk else (),
    )
    all_bands = common.extent.focal_plane if len(common.cameras) > 1 else None
    return Simulation(
        scene=scene,
        camera=cam_setup,
        observing=ObservingSetup(scene, common.pattern, common.scans, common.blocks),
        air=AirSetup(common.layers, _water(scene, common.dated), common.dated, all_bands),
        sky=SkySetup(scene, common.sky_geometry, tuple(cam_setup.beams.fwhm_rad.tolist())),
    )


def _prepare(scene: Scene) -> Setup:
    common = _common(scene)
    cam, scans, geometry = common.cameras[scene.band_name], common.scans, common.geometry
    check_mount(scene, common.pattern, scans, common.times)
    check_maker(scene, scans)
    check_templates(scene, cam, scans)
    check_dead_time(scene, cam)
    for band in (scene, *scene.others):
        check_groups(band, common.cameras[band.band_name])
    check_bands(scene, common.cameras)
    masked = None
    if scene.score and scene.score.mask_separation_f_lambda:
        masked = mask_by_separation(cam.positions_f_lambda, scene.score.mask_separation_f_lambda)
        check_masked(scene, masked)
    check_score(scene, geometry, scans)
    check_split_bins(scene, geometry)
    check_signal_spectrum(scene)
    check_healpix(scene)
    check_excess(scene)
    check_response(scene)
    check_changes(scene)
    check_sky(scene, common.sky_geometry)
    scene_pipelines = pipelines(scene.cleaning, masked)
    _check_blocks(scene, common, scene_pipelines)
    drawn = _simulation(scene, common)
    lowest = _lowest(scene, common.times, scans)
    weight = detector_weights(drawn.camera, check_levels(scene, drawn.air.water, lowest))
    others = _others(scene, common) if "spectral" in scene.cleaning.named else ()
    for item in (drawn, *others):
        with errors_of(item.scene, scene):
            check_contents(item.scene, item.sky.geometry, item.sky.fwhm_rad)
    calibration = _calibration(scene, (drawn, *others))
    setup = Setup(
        **vars(drawn),
        analysis=AnalysisSetup(
            scene,
            geometry,
            drawn.sky,
            scene_pipelines,
            calibration,
            masked,
            drawn.camera.n_det,
            weight,
            beams_of(drawn.camera, weight),
            _splits(scene, cam, common),
        ),
        others=others,
    )
    for item in (drawn, *others):
        _ = item.camera.photon_coherence
        if item.camera.n_det > MOST_DENSE:
            _check_torus(item.camera)
    radius = common.extent.radius_rad
    motions = curved_motions(scene, common.pattern, scans, common.times)
    elements = check_layer(scene, drawn.air, radius_rad=radius, scans=scans, lowest_rad=lowest, curved=motions)
    check_memory(needed_memory(scene, _sizes(setup, elements)))
    return setup


def _others(scene: Scene, common: _Common) -> tuple[Simulation, ...]:
    found = []
    for item in scene.others:
        with errors_of(item, scene):
            found.append(_simulation(item, common))
    return tuple(found)


def _splits(scene: Scene, cam: Camera, common: _Common) -> SurveySplits | None:
    starts = None if common.times is None else common.times.start_mjd
    return survey_splits(scene, cam.focal_plane, starts, None if common.dated is None else common.dated.block)


def _calibration(scene: Scene, bands: tuple[Simulation, ...]) -> np.ndarray | None:
    """Responsivities (n_band, n_det) that cleaning assumes, its own band first; None where it fits them."""
    known = [assumed_responsivity(scene.cleaning, band.scene, band.camera.responsivity) for band in bands]
    return None if known[0] is None else np.stack(known)


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
        n_bands=1 + len(setup.others),
        n_pixel=geometry.n_x * geometry.n_y,
        n_patch=patch_side(scene.score.size_rad, geometry) if scored else 0,
        n_pad=padded_side(scene.score.size_rad, geometry) if scored else 0,
        n_set=len(setup.analysis.data_set_names),
        n_transfer=len(setup.analysis.transfer_function_names),
        n_sky=setup.analysis.n_signal_skies,
        n_split=setup.analysis.splits.n_map if setup.analysis.splits else 0,
        n_beam=len(setup.camera.beams.fwhm_rad),
        strip_elements=strip_elements,
        n_coefficients=sky_coefficients(scene.sky.curved_lmax, setup.sky.geometry) if curved else 0,
    )


def _streams(scene: Scene, cam: Camera) -> int:
    """Count the time-streams that the cleaning of one band takes together, those of other bands too."""
    return cam.n_det * (1 + len(scene.others) * ("spectral" in scene.cleaning.named))


def _scan_bytes(n_streams: int, scans: Scans) -> int:
    # In single precision for any type of the streams, so that draws do not depend on it.
    return n_streams * samples_per_scan(scans) * np.dtype(np.float32).itemsize


def _blocks(scene: Scene, n_streams: int, scans: Scans) -> tuple[Block, ...]:
    return scan_blocks(scans.n_scans, _scan_bytes(n_streams, scans), scene.numerics.max_block_bytes)


def _check_blocks(scene: Scene, common: _Common, scene_pipelines: tuple[CleaningPipeline, ...]) -> None:
    """Raise SceneError for pipelines that need an observation whole where it is cut into blocks."""
    together = scene.cleaning.responsivities == OBSERVATION and any(
        pipeline.takes_responsivities for pipeline in scene_pipelines
    )
    if len(common.blocks) > 1 and together:
        whole = _scan_bytes(common.n_streams, common.scans) * common.scans.n_scans
        raise SceneError(
            f"numerics.max_block_memory: found {scene.numerics.max_block_bytes / 1e6:.4g} MB, which cuts an observation"
            f" into {len(common.blocks)} blocks; cleaning.responsivities 'observation' needs it whole:"
            f" {whole / 1e6:.4g} MB or more is expected, or 'survey' in its place"
        )


def _geometry(scene: Scene, extent_rad: float, pixel_rad: float) -> MapGeometry:
    if pixel_rad >= math.pi / 2:
        raise SceneError(f"map.pixel: found {math.degrees(scene.map.pixel_rad):.4g} deg; less than 90 deg is expected")
    return covering_geometry(scene.field.ra_rad, scene.field.dec_rad, pixel_rad, extent_rad)


def _lowest(scene: Scene, times: Schedule | None, scans: Scans) -> float:
    """Lowest elevation of the field at all scans [rad]; raises SceneError where the sky moves too far within one."""
    if times is None:
        return scene.fixed_pointing.elevation_rad
    return check_motion(scene, observing_site(scene), times, scans)


def _water(scene: Scene, dated: DatedWeather | None) -> Water | None:
    if (place := scene.place) is None:
        return None
    water = site_water(scene.atmosphere, place, scene.instrument.band)
    if dated is not None and "pwv" in dated.known:
        try:
            water.response(dated.known["pwv"])
        except OutOfRangeError as error:
            raise SceneError(f"{TABLE_KEY}: {error}") from None
    return water


def signal_sim_observations(scene: Scene) -> np.ndarray:
    """Observations (n_obs,) bool that carry the signal simulations; none without a score."""
    asked, n_obs = scene.score and scene.score.signal_sims.observations, scene.observations
    return carriers(asked, n_obs) if asked else np.zeros(n_obs, bool)


def is_quick(setup: Setup, target_error: float | None = None) -> bool:
    """Return whether this process simulates a survey about as soon as worker processes have started.

    A survey with a target error counts up to its likely end.
    """
    n_obs = setup.scene.observations
    if target_error is not None:
        n_obs = min(n_obs, math.ceil(TYPICAL_VARIANCE / target_error**2))
    return work_s(setup, n_obs) < QUICK_S


def work_s(setup: Setup, n_obs: int) -> float:
    """Estimate the time [s] of the first `n_obs` observations in one process, to a factor of about two."""
    scans = setup.observing.scans
    samples = setup.camera.n_det * scans.n_scans * samples_per_scan(scans)
    n_with_sims = int(signal_sim_observations(setup.scene)[:n_obs].sum())
    return samples * SAMPLE_S * (n_obs + n_with_sims * SIGNAL_SIMS)
