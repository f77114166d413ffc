"""What all observations of a scene share, prepared once: camera, scans, angles, factors, skies."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from threadpoolctl import threadpool_limits

from mapmaker.cleaning.responsivity import OBSERVATION, Responsivities
from mapmaker.geometry import MapGeometry, covering_geometry
from surveysim.band import Band, scored_band
from surveysim.blocks import Block, scan_blocks
from surveysim.checks import (
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
)
from surveysim.coherence import MOST_DENSE, Overlap, correlation_matrix, overlap
from surveysim.instrument import Camera, camera, mask_by_separation
from surveysim.lattice import Torus, TorusRoot, embed
from surveysim.pointing import (
    FieldCentre,
    Pointing,
    Site,
    observation_pointing,
    schedule,
    survey_angles,
)
from surveysim.recipes import ACTUAL, OPTIMAL, Recipe, recipes
from surveysim.responsivity import assumed_responsivity, colour_responsivity, true_responsivity
from surveysim.scan import Raster, RasterPath, duration_s, raster, samples_per_scan
from surveysim.scene import Scene, SceneError
from surveysim.sections import Colour, Excess, Instrument, Photon
from surveysim.streams import Stage, generator
from surveysim.weather import Water, site_water


@dataclass(frozen=True)
class Angles:
    """When each observation starts (n_obs,) [MJD UTC] and its angles at mid-scan, (n_obs, n_scan) [rad]."""

    start_mjd: np.ndarray
    elevation_rad: np.ndarray
    parallactic_rad: np.ndarray


@dataclass(frozen=True)
class Setup:
    """A scene made ready: nothing here depends on the observation but the angles' rows.

    `photon_overlap` and `excess_factor`, what detectors share of these noises, None where they share nothing;
    `responsivity` (n_det,), the true one; `calibration` (1 + n_colour, n_det), responsivities that cleaning takes as
    known in the mapped band and the others, or None where it fits them; `recipes` all ways of cleaning, those of the
    masked array last; `masked` indices of the detectors that it keeps, or None; `sky_mk` on `sky_geometry` or None;
    `window_skies_mk` (n_sky, n_y, n_x) or None, the last of a point source where recipes are compared; `strips` the
    atmosphere's strips or None; `water` what the band makes of the site's water, None without a site, and
    `colour_waters` what the other bands make of it; `colour_responsivity` (n_colour, n_det); `blocks` that an
    observation is made in.
    """

    scene: Scene
    camera: Camera
    raster: Raster
    blocks: tuple[Block, ...]
    angles: Angles
    geometry: MapGeometry
    sky_geometry: MapGeometry
    band: Band | None
    recipes: tuple[Recipe, ...]
    responsivity: np.ndarray
    calibration: np.ndarray | None
    photon_overlap: Overlap | Torus | None
    excess_factor: np.ndarray | TorusRoot | None
    strips: object | None
    water: Water | None
    colour_waters: tuple[Water, ...]
    colour_responsivity: np.ndarray
    sky_mk: np.ndarray | None
    window_skies_mk: np.ndarray | None
    masked: np.ndarray | None

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
        whole = [recipe.data_set for recipe in self.whole_recipes]
        masked = [recipe.data_set for recipe in self.recipes[len(whole) :]]
        simulated = self.scene.score.simulated if self.scene.score else ()
        return (ACTUAL, *simulated, *whole[1:], *([OPTIMAL] if self.chooses else ()), *masked)

    @property
    def whole_recipes(self) -> tuple[Recipe, ...]:
        """Recipes for all detectors, the scene's own first."""
        return tuple(recipe for recipe in self.recipes if recipe.detectors is None)

    @property
    def chooses(self) -> bool:
        """Whether the best recipe of each observation makes a data set of its own."""
        return self.scene.score is not None and len(self.whole_recipes) > 1

    @property
    def subtracts_colours(self) -> bool:
        """Whether a recipe needs the other bands of the pixels."""
        return any(recipe.uses("spectral") for recipe in self.recipes)

    @property
    def windows(self) -> tuple[str, ...]:
        """Data sets that have a signal window of their own; the others share the first."""
        own = {recipe.data_set for recipe in self.recipes} | {OPTIMAL}
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
    except ValueError as error:
        raise SceneError(str(error)) from None


# Eigenvectors of the correlations differ in their last bits, or in a degenerate space altogether, between
# numbers of BLAS threads; a run must not depend on the machine's cores.
@threadpool_limits.wrap(limits=1)
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
    ways = recipes(scene.cleaning, masked)
    excess = shared_noise(cam, scene.excess, "excess")
    n_det = len(cam.focal_plane.x_rad)
    responsivity, of_colours = true_responsivity(scene, n_det), colour_responsivity(scene, n_det)
    angles, water = _angles(scene, cam, lines), _water(scene, scene.instrument)
    check_levels(scene, water, float(angles.elevation_rad.min()))
    check_sources(scene, sky_geometry)
    return Setup(
        scene=scene,
        band=scored_band(scene, geometry, sky_geometry),
        camera=cam,
        raster=lines,
        blocks=_blocks(scene, cam, lines, ways),
        angles=angles,
        geometry=geometry,
        sky_geometry=sky_geometry,
        recipes=ways,
        responsivity=responsivity,
        calibration=assumed_responsivity(scene, np.vstack([responsivity[None], of_colours])),
        photon_overlap=shared_noise(cam, scene.photon, "photon"),
        excess_factor=None if excess is None else excess.factor(),
        strips=_strips(scene, cam),
        water=water,
        colour_waters=tuple(_water(scene, colour) for colour in scene.instrument.colours),
        colour_responsivity=of_colours,
        sky_mk=_sky(scene, sky_geometry),
        window_skies_mk=_window_skies(scene, sky_geometry),
        masked=masked,
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


def _blocks(scene: Scene, cam: Camera, lines: Raster, ways: tuple[Recipe, ...]) -> tuple[Block, ...]:
    """Blocks of an observation; raises SceneError for a scan too long, or recipes that need an observation whole."""
    n_det, n_samp, most = len(cam.focal_plane.x_rad), samples_per_scan(lines), scene.numerics.stream_bytes
    colours = len(scene.instrument.colours) * any(recipe.uses("spectral") for recipe in ways)
    # In single precision whatever the streams have: it is not to change what is drawn.
    scan_bytes = n_det * n_samp * (1 + colours) * np.dtype(np.float32).itemsize
    key = f"numerics.stream_memory: found {most / 1e6:.4g} MB"
    if scan_bytes > most:
        raise SceneError(
            f"{key}; the {scan_bytes / 1e6:.4g} MB of one scan of {n_samp} samples of {n_det} detectors or more are "
            "expected: more memory, or a shorter scan.duration"
        )
    found = scan_blocks(lines.n_scans, scan_bytes, most)
    if len(found) > 1 and any(recipe.uses("wind") for recipe in ways):
        raise SceneError(
            f"{key}, which cuts an observation into {len(found)} blocks; 'wind' cleaning measures the wind of a whole "
            f"one, whose {scan_bytes * lines.n_scans / 1e6:.4g} MB or more are expected, or another cleaning.algorithm"
        )
    together = scene.cleaning.responsivities == OBSERVATION and any(recipe.takes_responsivities for recipe in ways)
    if len(found) > 1 and together:
        raise SceneError(
            f"{key}, which cuts an observation into {len(found)} blocks; cleaning.responsivities 'observation' needs a "
            f"whole one, whose {scan_bytes * lines.n_scans / 1e6:.4g} MB or more are expected, or 'survey' in its place"
        )
    return found


def _geometry(scene: Scene, cam: Camera, pixel_rad: float) -> MapGeometry:
    return covering_geometry(scene.field.ra_rad, scene.field.dec_rad, pixel_rad, reach(scene, cam))


def _angles(scene: Scene, cam: Camera, lines: Raster) -> Angles:
    shape = (scene.observations, scene.scan.scans)
    if scene.fixed_pointing:
        fixed = scene.fixed_pointing
        elevation, parallactic = np.full(shape, fixed.elevation_rad), np.full(shape, fixed.parallactic_angle_rad)
        return Angles(np.zeros(shape[0]), elevation, parallactic)
    plan = scene.schedule
    field = FieldCentre(scene.field.ra_rad, scene.field.dec_rad)
    site = Site(plan.latitude_rad, plan.longitude_rad, plan.height_m)
    try:
        times = schedule(
            field,
            site,
            plan.first_night,
            plan.nights,
            scene.observations,
            plan.max_hour_angle_rad,
            plan.min_elevation_rad,
            duration_s(lines),
        )
    except ValueError as error:
        raise SceneError(f"schedule: {error}") from None
    mid_time = raster(lines, "ra", np.zeros(2)).mid_time_s
    angles = Angles(times.start_mjd, *survey_angles(field, site, times, mid_time))
    middle = {"elevation_rad": angles.elevation_rad, "parallactic_rad": angles.parallactic_rad}
    check_motion(scene, cam, field, site, times, mid_time_s=mid_time, **middle)
    return angles


def shared_noise(cam: Camera, section: Photon | Excess | None, name: str) -> Overlap | Torus | None:
    """What detectors share of a noise by overlap, None where they share nothing."""
    if section is None or section.coherence == "none":
        return None
    n_det = len(cam.focal_plane.x_rad)
    if n_det <= MOST_DENSE:
        return overlap(correlation_matrix(cam.positions_f_lambda, section.coherence, cam.illumination))
    if cam.pitch_rad is None:
        raise SceneError(
            f"{name}.coherence: found {section.coherence!r} for the {n_det} detectors of a table of positions; "
            f"{MOST_DENSE} or fewer are expected, or an instrument.layout, whose lattice makes noise that more share, "
            "or coherence 'none'"
        )
    try:
        return embed(cam.cells, cam.pitch_rad / cam.f_lambda_rad, section.coherence, cam.illumination)
    except ValueError as error:
        raise SceneError(f"{name}.coherence: {error}") from None


def screen(scene: Scene):
    """The layer as the telescope sees it at the zenith; raises SceneError where there is none of these numbers."""
    from surveysim.atmosphere.spectrum import Screen

    air = scene.atmosphere
    outer = math.inf if air.outer_scale_m is None else air.outer_scale_m / air.layer_height_m
    try:
        return Screen(air.index, air.illuminated_aperture_m / air.layer_height_m, outer)
    except ValueError as error:
        raise SceneError(f"atmosphere: {error}") from None


def _strips(scene: Scene, cam: Camera):
    if scene.atmosphere is None:
        return None
    from surveysim.atmosphere.screen import SlantStrips

    numerics = scene.numerics
    numbers = numerics.screen_step, numerics.interpolation, numerics.precision
    return SlantStrips(screen(scene), cam.radius_rad, cam.closest_rad, *numbers)


def _water(scene: Scene, band: Instrument | Colour) -> Water | None:
    air = scene.atmosphere
    if air is None or air.site is None:
        return None
    return site_water(air, band.frequency_hz, band.bandwidth)


def _sky(scene: Scene, geometry: MapGeometry) -> np.ndarray | None:
    if scene.sky is None:
        return None
    from surveysim.sky import draw_sky

    instrument = scene.instrument
    rng = generator(scene.seed, Stage.SKY)
    return draw_sky(scene.sky, geometry, instrument.cmb_per_rj, instrument.beam_fwhm_rad, rng)


def _window_skies(scene: Scene, geometry: MapGeometry) -> np.ndarray | None:
    if scene.score is None:
        return None
    from surveysim.sky import central_source, flat_cmb_sky

    window, instrument = scene.score.window, scene.instrument
    skies = [
        flat_cmb_sky(
            geometry,
            window.band_power_ukcmb2,
            instrument.cmb_per_rj,
            instrument.beam_fwhm_rad,
            generator(scene.seed, Stage.WINDOW_SKY, realization=sky),
        )
        for sky in range(window.skies)
    ]
    if scene.cleaning.compare:
        skies.append(central_source(geometry, instrument.beam_fwhm_rad))
    return np.stack(skies)


def observation_path(setup: Setup, observation: int) -> tuple[RasterPath, Pointing]:
    """The boresight of one observation: scans along RA and Dec in turn, dithered, the camera turned."""
    rng = generator(setup.scene.seed, Stage.POINTING, observation)
    dither = (rng.random(2) - 0.5) * setup.raster.dither_rad
    turn = (rng.random() - 0.5) * setup.scene.instrument.camera_rotation_rad
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
    wanted = min(pairs, max(1, scene.score.window.observations // 2))
    first = 2 * (np.arange(wanted) * pairs // wanted)
    chosen[first] = True
    chosen[np.minimum(first + 1, scene.observations - 1)] = True
    return chosen
