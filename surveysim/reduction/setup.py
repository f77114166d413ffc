"""What all observations of a scene share, prepared once: camera, scans, angles, factors, skies."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from threadpoolctl import threadpool_limits

from mapmaker.cleaning.responsivity import OBSERVATION, Responsivities
from mapmaker.geometry import MapGeometry, covering_geometry
from surveysim.atmosphere.weather import Water, site_water
from surveysim.reduction.cleaning_pipelines import ACTUAL, OPTIMAL, CleaningPipeline, pipelines
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
    reach,
    sky_coefficients,
)
from surveysim.reduction.resource_limits import Sizes, check_layer, check_memory, needed_memory
from surveysim.reduction.scored_region import ScoredRegion, padded_side, patch_side, scored_region
from surveysim.runtime.errors import InputError, OutOfRangeError, SceneError
from surveysim.runtime.rng import RandomPurpose, generator
from surveysim.scene.instrument import Instrument, OtherBand
from surveysim.scene.noise_and_sky import Excess, Photon
from surveysim.scene.scene import Scene
from surveysim.telescope.focal_plane import Camera, camera, mask_by_separation
from surveysim.telescope.lattice_noise import CirculantCorrelation, CirculantFactor
from surveysim.telescope.pixel_coherence import MOST_DENSE, DenseCorrelation
from surveysim.telescope.pointing import (
    Directions,
    FieldCentre,
    Pointing,
    Schedule,
    Site,
    hour_angle_dec,
    near_hour_angle_dec,
    observation_pointing,
    schedule,
    survey_angles,
)
from surveysim.telescope.raster import Raster, RasterPath, duration_s, mid_times, raster, samples_per_scan
from surveysim.telescope.responsivity import assumed_responsivity, band_responsivity, true_responsivity
from surveysim.timestreams.scan_blocks import Block, scan_blocks
from surveysim.timestreams.shared_parts import layer_strips, scene_sky, shared_noise, window_skies

if TYPE_CHECKING:
    from surveysim.atmosphere.screen_simulation import SlantStrips


@dataclass(frozen=True)
class Angles:
    """When each observation starts (n_obs,) [MJD UTC] and its angles at mid-scan, (n_obs, n_scan) [rad]."""

    start_mjd: np.ndarray
    elevation_rad: np.ndarray
    parallactic_rad: np.ndarray


@dataclass(frozen=True)
class Setup:
    """A scene made ready: nothing here depends on the observation but the angles' rows.

    `responsivity` (n_det,), the true one; `calibration`
    (1 + n_colour, n_det), responsivities that cleaning takes as known in the mapped band and the others, or None where
    it fits them; `pipelines` all ways of cleaning, those of the masked array last; `masked` indices of the detectors
    that it keeps, or None; `strips` the atmosphere's strips or None; `water` what the band makes of the site's water,
    None without a site, and `band_waters` what the other bands make of it; `band_responsivity` (n_colour, n_det);
    `blocks` that an observation is made in; `made` the parts that have been asked for.
    """

    scene: Scene
    camera: Camera
    raster: Raster
    blocks: tuple[Block, ...]
    geometry: MapGeometry
    sky_geometry: MapGeometry
    pipelines: tuple[CleaningPipeline, ...]
    responsivity: np.ndarray
    calibration: np.ndarray | None
    strips: "SlantStrips | None"
    water: Water | None
    band_waters: tuple[Water, ...]
    band_responsivity: np.ndarray
    masked: np.ndarray | None
    made: dict[str, Any] = field(default_factory=dict, repr=False, compare=False)

    def _once(self, name: str, make: Callable[[], Any]) -> Any:
        """A part made when it is first asked for: checks and plans need none of them."""
        if name not in self.made:
            with threadpool_limits(1):  # no bit may depend on the machine's cores
                self.made[name] = make()
        return self.made[name]

    @property
    def angles(self) -> Angles:
        """When observations begin, and their angles."""
        return self._once(
            "angles", lambda: _angles(self.scene, _times(self.scene, self.raster), mid_times(self.raster))
        )

    @property
    def band(self) -> ScoredRegion | None:
        """The scored area and multipoles; None without a score."""
        return self._once("band", lambda: scored_region(self.scene, self.geometry, self.sky_geometry))

    def _overlap(self, name: str, section: Photon | Excess | None) -> DenseCorrelation | CirculantCorrelation | None:
        # Photon and excess noise of one coherence share one correlation.
        key = f"overlap {section.coherence if section else 'none'}"
        return self._once(key, lambda: shared_noise(self.camera, section, name))

    @property
    def photon_overlap(self) -> DenseCorrelation | CirculantCorrelation | None:
        """Correlation of photon noise between detectors; None where they share nothing."""
        return self._overlap("photon", self.scene.photon)

    @property
    def excess_factor(self) -> np.ndarray | CirculantFactor | None:
        """Factor of the correlation of excess noise between detectors; None where they share nothing."""

        def make() -> np.ndarray | CirculantFactor | None:
            found = self._overlap("excess", self.scene.excess)
            return None if found is None else found.factor()

        return self._once("excess_factor", make)

    @property
    def sky_mk(self) -> np.ndarray | None:
        """The sky (n_y, n_x) on `sky_geometry`; None without one."""
        return self._once("sky_mk", lambda: scene_sky(self.scene, self.sky_geometry))

    @property
    def window_skies_mk(self) -> np.ndarray | None:
        """Skies (n_sky, n_y, n_x) of the window or None, the last of a point source where pipelines are compared."""
        return self._once("window_skies_mk", lambda: window_skies(self.scene, self.sky_geometry))

    @property
    def n_window_skies(self) -> int:
        """How many these are; 0 without a score."""
        score = self.scene.score
        return score.signal_sims.skies + bool(self.scene.cleaning.compare) if score else 0

    @property
    def n_det(self) -> int:
        """How many live detectors the camera has."""
        return len(self.responsivity)

    def samples(self, block: Block) -> slice:
        """Samples of one block among those of an observation."""
        per_scan = samples_per_scan(self.raster)
        return slice(block.first * per_scan, block.end * per_scan)

    @property
    def responsivities(self) -> Responsivities:
        """Responsivities for template cleaning of all detectors: a way to fit them, or known ones (n_det,)."""
        return self.scene.cleaning.responsivities if self.calibration is None else self.calibration[0]

    @property
    def stream_type(self) -> np.dtype:
        """Type of streams and maps."""
        return np.dtype(self.scene.numerics.precision)

    @property
    def data_sets(self) -> tuple[str, ...]:
        """Names of the data sets that are scored, in the order of their maps."""
        whole = [pipeline.data_set for pipeline in self.whole_pipelines]
        masked = [pipeline.data_set for pipeline in self.pipelines[len(whole) :]]
        simulated = self.scene.score.noise_only_sets if self.scene.score else ()
        return (ACTUAL, *simulated, *whole[1:], *([OPTIMAL] if self.chooses else ()), *masked)

    @property
    def whole_pipelines(self) -> tuple[CleaningPipeline, ...]:
        """Pipelines for all detectors, the scene's own first."""
        return tuple(pipeline for pipeline in self.pipelines if pipeline.detectors is None)

    @property
    def chooses(self) -> bool:
        """Whether the best pipeline of each observation makes a data set of its own."""
        return self.scene.score is not None and len(self.whole_pipelines) > 1

    @property
    def subtracts_bands(self) -> bool:
        """Whether a pipeline needs the other bands of the pixels."""
        return any(pipeline.uses("spectral") for pipeline in self.pipelines)

    @property
    def windows(self) -> tuple[str, ...]:
        """Data sets that have a signal window of their own; the others share the first."""
        own = {pipeline.data_set for pipeline in self.pipelines} | {OPTIMAL}
        return tuple(name for name in self.data_sets if name in own)

    def window_of(self, data_set: str) -> int:
        """Place of a data set's window among `windows`."""
        return self.windows.index(data_set) if data_set in self.windows else 0


@lru_cache(maxsize=2)
def prepare(scene: Scene) -> Setup:
    """Make a scene ready. Raises SceneError when the scene can't be run, with key, found and allowed."""
    try:
        return _prepare(scene)
    except SceneError:
        raise
    except InputError as error:
        raise SceneError(str(error)) from None


def _prepare(scene: Scene) -> Setup:
    cam = camera(scene.instrument)
    lines = _raster(scene)
    check_templates(scene, cam)
    check_size(scene, cam)
    geometry = _geometry(scene, cam, scene.map.pixel_rad)
    # Half a map pixel holds the beam's multipoles with room to spare.
    sky_geometry = _geometry(scene, cam, scene.map.pixel_rad / 2)
    masked = None
    if scene.score and scene.score.mask_separation_f_lambda:
        masked = mask_by_separation(cam.positions_f_lambda, scene.score.mask_separation_f_lambda)
        check_masked(scene, masked)
    check_score(scene, geometry, lines)
    check_healpix(scene)
    check_excess(scene)
    check_sky(scene, sky_geometry)
    ways = pipelines(scene.cleaning, masked)
    n_det = len(cam.focal_plane.x_rad)
    responsivity, of_bands = true_responsivity(scene, n_det), band_responsivity(scene, n_det)
    times, water = _times(scene, lines, near_hour_angle_dec), _water(scene, scene.instrument)
    lowest = _lowest(scene, cam, times, mid_times(lines))
    check_levels(scene, water, lowest)
    check_sources(scene, sky_geometry)
    setup = Setup(
        scene=scene,
        camera=cam,
        raster=lines,
        blocks=_blocks(scene, cam, lines, ways),
        geometry=geometry,
        sky_geometry=sky_geometry,
        pipelines=ways,
        responsivity=responsivity,
        calibration=assumed_responsivity(scene, np.vstack([responsivity[None], of_bands])),
        strips=layer_strips(scene, cam),
        water=water,
        band_waters=tuple(_water(scene, colour) for colour in scene.instrument.bands),
        band_responsivity=of_bands,
        masked=masked,
    )
    if setup.n_det > MOST_DENSE:
        _check_torus(setup)
    elements = check_layer(scene, setup.strips, water, cam.radius_rad, lines, lowest)
    check_memory(needed_memory(scene, _sizes(setup, elements)))
    return setup


def _check_torus(setup: Setup) -> None:
    """Raise SceneError where there is no torus for the noise that so many detectors share: it is made, once."""
    _ = setup.photon_overlap, setup.excess_factor


def _sizes(setup: Setup, strip_elements: int) -> Sizes:
    scene, geometry = setup.scene, setup.geometry
    scored = scene.score is not None
    curved = scene.sky is not None and scene.sky.curved_lmax is not None
    return Sizes(
        n_det=setup.n_det,
        n_samp=samples_per_scan(setup.raster),
        n_scans=max(block.n_scans for block in setup.blocks),
        n_bands=1 + len(scene.instrument.bands) * setup.subtracts_bands,
        n_pixel=geometry.n_x * geometry.n_y,
        n_patch=patch_side(scene.score.size_rad, geometry) if scored else 0,
        n_pad=padded_side(scene.score.size_rad, geometry) if scored else 0,
        n_set=len(setup.data_sets),
        n_window=len(setup.windows),
        n_sky=setup.n_window_skies,
        strip_elements=strip_elements,
        n_coefficients=sky_coefficients(scene.sky.curved_lmax, setup.sky_geometry) if curved else 0,
    )


def _raster(scene: Scene) -> Raster:
    scan = scene.scan
    return Raster(
        scan.speed_rad_s,
        scan.scans,
        scan.duration_s,
        scan.turnaround_s,
        scan.step_rad,
        scan.dither_rad,
        scan.sample_rate_hz,
    )


def _blocks(scene: Scene, cam: Camera, lines: Raster, ways: tuple[CleaningPipeline, ...]) -> tuple[Block, ...]:
    """Blocks of an observation; raises SceneError for a scan too long, or pipelines that need an observation whole."""
    n_det, n_samp, most = len(cam.focal_plane.x_rad), samples_per_scan(lines), scene.numerics.max_block_bytes
    bands = len(scene.instrument.bands) * any(pipeline.uses("spectral") for pipeline in ways)
    # In single precision whatever the streams have: it is not to change what is drawn.
    scan_bytes = n_det * n_samp * (1 + bands) * np.dtype(np.float32).itemsize
    key = f"numerics.max_block_memory: found {most / 1e6:.4g} MB"
    if scan_bytes > most:
        raise SceneError(
            f"{key}; {scan_bytes / 1e6:.4g} MB or more is expected, for one scan of {n_samp} samples of {n_det} "
            "detectors, or a shorter scan.duration"
        )
    found = scan_blocks(lines.n_scans, scan_bytes, most)
    if len(found) > 1 and any(pipeline.uses("wind") for pipeline in ways):
        raise SceneError(
            f"{key}, which cuts an observation into {len(found)} blocks; 'wind' cleaning needs it whole: "
            f"{scan_bytes * lines.n_scans / 1e6:.4g} MB or more is expected, or another cleaning.algorithm"
        )
    together = scene.cleaning.responsivities == OBSERVATION and any(pipeline.takes_responsivities for pipeline in ways)
    if len(found) > 1 and together:
        raise SceneError(
            f"{key}, which cuts an observation into {len(found)} blocks; cleaning.responsivities 'observation' needs "
            f"it whole: {scan_bytes * lines.n_scans / 1e6:.4g} MB or more is expected, or 'survey' in its place"
        )
    return found


def _geometry(scene: Scene, cam: Camera, pixel_rad: float) -> MapGeometry:
    return covering_geometry(scene.field.ra_rad, scene.field.dec_rad, pixel_rad, reach(scene, cam))


def _times(scene: Scene, lines: Raster, directions: Directions = hour_angle_dec) -> Schedule | None:
    """When observations begin; None at a fixed elevation. Raises SceneError for nights that do not hold them."""
    plan = scene.schedule
    if plan is None:
        return None
    limits = plan.max_hour_angle_rad, plan.min_elevation_rad
    numbers = plan.first_night, plan.nights, scene.observations
    try:
        return schedule(_field(scene), _site(scene), *numbers, *limits, duration_s(lines), directions)
    except OutOfRangeError as error:
        raise SceneError(f"schedule: {error}") from None


def _field(scene: Scene) -> FieldCentre:
    return FieldCentre(scene.field.ra_rad, scene.field.dec_rad)


def _site(scene: Scene) -> Site:
    return Site(scene.schedule.latitude_rad, scene.schedule.longitude_rad, scene.schedule.height_m)


def _lowest(scene: Scene, cam: Camera, times: Schedule | None, mid_time_s: np.ndarray) -> float:
    """Lowest elevation of all scans [rad]; raises SceneError where the sky moves too far within one."""
    if times is None:
        return scene.fixed_pointing.elevation_rad
    return check_motion(scene, cam, _site(scene), times, mid_time_s)


def _angles(scene: Scene, times: Schedule | None, mid_time_s: np.ndarray) -> Angles:
    shape = (scene.observations, len(mid_time_s))
    if times is None:
        fixed = scene.fixed_pointing
        elevation, parallactic = np.full(shape, fixed.elevation_rad), np.full(shape, fixed.parallactic_angle_rad)
        return Angles(np.zeros(shape[0]), elevation, parallactic)
    return Angles(times.start_mjd, *survey_angles(_field(scene), _site(scene), times, mid_time_s))


def _water(scene: Scene, band: Instrument | OtherBand) -> Water | None:
    air = scene.atmosphere
    if air is None or air.site is None:
        return None
    return site_water(air, band.frequency_hz, band.bandwidth)


def observation_path(setup: Setup, observation: int) -> tuple[RasterPath, Pointing]:
    """The boresight of one observation: scans along RA and Dec in turn, dithered, the camera turned."""
    rng = generator(setup.scene.seed, RandomPurpose.POINTING, observation)
    dither = (rng.random(2) - 0.5) * setup.raster.dither_rad
    turn = (rng.random() - 0.5) * setup.scene.instrument.camera_rotation_range_rad
    path = raster(setup.raster, ("ra", "dec")[observation % 2], dither)
    angles = setup.angles
    pointing = observation_pointing(
        path,
        angles.start_mjd[observation],
        angles.elevation_rad[observation],
        angles.parallactic_rad[observation],
        turn,
    )
    return path, pointing


def window_observations(scene: Scene) -> np.ndarray:
    """Observations (n_obs,) bool that carry the window skies: pairs of both directions, spread over the survey."""
    chosen = np.zeros(scene.observations, bool)
    if scene.score is None:
        return chosen
    pairs = max(1, scene.observations // 2)
    wanted = min(pairs, max(1, scene.score.signal_sims.observations // 2))
    first = 2 * (np.arange(wanted) * pairs // wanted)
    chosen[first] = True
    chosen[np.minimum(first + 1, scene.observations - 1)] = True
    return chosen
