"""A scene made ready to draw time-streams: camera, observing, air and sky.

Nothing in these records depends on the observation, but for the rows of its angles. Costly parts are computed when
they are first asked for: checks and plans need none of them.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from mapmaker.geometry import MapGeometry
from mapmaker.timestreams import FocalPlane
from surveysim.atmosphere.dated_weather import DatedWeather
from surveysim.atmosphere.layers import Layer
from surveysim.atmosphere.weather import Water
from surveysim.runtime.errors import OutOfRangeError, SceneError
from surveysim.runtime.once import once
from surveysim.runtime.rng import RandomPurpose, generator
from surveysim.scene.noise_and_sky import Excess, Photon
from surveysim.scene.scene import Scene
from surveysim.telescope.beams import Beams, beams_of
from surveysim.telescope.directions import FieldCentre, Site, hour_angle_dec
from surveysim.telescope.focal_plane import Camera
from surveysim.telescope.horizon_frame import HorizonFrame, Horizons
from surveysim.telescope.lattice_noise import LatticeFactor, LatticePixels, WaferPixels
from surveysim.telescope.noise_levels import WhiteByDetector, WhiteLevels, white_by_detector
from surveysim.telescope.pixel_coherence import DensePixels, PixelCoherence
from surveysim.telescope.pointing import Pointing, Schedule, near_angles, observation_pointing, schedule, survey_angles
from surveysim.telescope.scan_pattern import ScanPattern
from surveysim.telescope.scans import ScanPath, Scans, duration_s, mid_times, samples_per_scan
from surveysim.timestreams.scan_blocks import Block
from surveysim.timestreams.shared_parts import photon_coherence, scene_sky, shared_noise

_NONE = PixelCoherence("none")


@dataclass(frozen=True, kw_only=True)
class CameraSetup(Camera):
    """A camera with the responsivities of its detectors and the correlations of their noise.

    Parameters
    ----------
    responsivity
        True responsivity (n_det,).
    photon, excess
        Sections of the scene; None without that noise.
    stop_emits
        Whether light of the stop reaches the detectors.
    true_plane
        Focal plane with the true positions of the detectors; `focal_plane` has those that are assumed.
    time_constant_s : (n_det,)
        True time constants; None without them.
    deconvolved_s : (n_det,)
        Time constants with which streams are deconvolved; None where they are not.
    readout_groups
        Detectors of each readout group, in the order of readout; none without crosstalk.
    """

    responsivity: np.ndarray
    photon: Photon | None
    excess: Excess | None
    stop_emits: bool = False
    true_plane: FocalPlane
    time_constant_s: np.ndarray | None = None
    deconvolved_s: np.ndarray | None = None
    readout_groups: tuple[np.ndarray, ...] = ()

    @once
    def beams(self) -> Beams:
        """Beams of the detectors: those of the table, or one."""
        widths = self.properties.beam_fwhm_rad
        return beams_of(self.focal_plane.fwhm_rad if widths is None else widths, self.responsivity)

    @once
    def photon_coherence(self) -> PixelCoherence:
        """Correlation of photon noise against separation."""
        return photon_coherence(self, self.photon, self.stop_emits) if self.photon else _NONE

    @once
    def excess_coherence(self) -> PixelCoherence:
        """Correlation of excess noise against separation."""
        return PixelCoherence(self.excess.coherence, self.illumination) if self.excess else _NONE

    @once
    def photon_correlation(self) -> DensePixels | LatticePixels | WaferPixels | None:
        """Correlation of photon noise between detectors; None where they share nothing."""
        return shared_noise(self, self.photon_coherence, "photon")

    @once
    def excess_correlation(self) -> DensePixels | LatticePixels | WaferPixels | None:
        """Correlation of excess noise between detectors; None where they share nothing."""
        if self.photon_coherence == self.excess_coherence:
            return self.photon_correlation
        return shared_noise(self, self.excess_coherence, "excess")

    @once
    def excess_factor(self) -> np.ndarray | LatticeFactor | None:
        """Factor of the correlation of excess noise; None where detectors share nothing."""
        found = self.excess_correlation
        return None if found is None else found.at(0.0).factor()


def camera_white(camera: CameraSetup, levels: WhiteLevels) -> WhiteByDetector:
    """Scale white-noise levels of a nominal detector to those of a camera."""
    coherence = camera.photon.coherence if camera.photon else "none"
    return white_by_detector(levels, coherence, camera.properties, camera.n_det)


@dataclass(frozen=True)
class Angles:
    """Start (n_obs,) [MJD UTC] of each observation, and its angles at mid-scan (n_obs, n_scan) [rad]."""

    start_mjd: np.ndarray
    elevation_rad: np.ndarray
    parallactic_rad: np.ndarray


@dataclass(frozen=True)
class ObservingSetup:
    """The scan pattern and when it is observed.

    Parameters
    ----------
    scans
        Record of the pattern: number and timing of scans.
    blocks
        Blocks of scans that an observation is drawn in.
    known_angles
        Angles of all observations, where another process has computed them.
    """

    scene: Scene
    pattern: ScanPattern
    scans: Scans
    blocks: tuple[Block, ...]
    known_angles: Angles | None = None

    @once
    def angles(self) -> Angles:
        """Starts and angles of all observations."""
        if self.known_angles is not None:
            return self.known_angles
        mid_time_s = mid_times(self.scans)
        shape = (self.scene.observations, len(mid_time_s))
        starts = observing_schedule(self.scene, self.scans)
        if starts is None:
            fixed = self.scene.fixed_pointing
            elevation, parallactic = np.full(shape, fixed.elevation_rad), np.full(shape, fixed.parallactic_angle_rad)
            return Angles(np.zeros(shape[0]), elevation, parallactic)
        where = field_centre(self.scene), observing_site(self.scene)
        return Angles(starts.start_mjd, *_survey_angles(*where, tuple(starts.start_mjd), tuple(mid_time_s)))

    def samples(self, block: Block) -> slice:
        """Samples of one block among those of an observation."""
        per_scan = samples_per_scan(self.scans)
        return slice(block.first * per_scan, block.end * per_scan)


@dataclass(frozen=True)
class AirSetup:
    """The atmosphere above the telescope.

    Parameters
    ----------
    layers
        Turbulent layers; none without an atmosphere.
    water
        Response of the band to the water of the site; None without a site.
    dated
        Dependence of the weather on the dates of the observations; None without.
    all_bands
        Detectors of all bands of the camera, which see the same strips; None for a camera of one band.
    """

    layers: tuple[Layer, ...]
    water: Water | None
    dated: DatedWeather | None = None
    all_bands: FocalPlane | None = None

    def block(self, n_obs: int) -> np.ndarray | None:
        """Blocks (n_obs,) with independent weather of the first observations; None where all are independent."""
        return None if self.dated is None or self.dated.block is None else self.dated.block[:n_obs]


@dataclass(frozen=True)
class SkySetup:
    """The astronomical sky, on a tangent-plane grid of half the pixel size of the map.

    Parameters
    ----------
    fwhm_rad
        Different widths (n_beam,) of the beams.
    """

    scene: Scene
    geometry: MapGeometry
    fwhm_rad: tuple[float, ...]

    @once
    def map_mk(self) -> np.ndarray | None:
        """Skies (n_beam, n_y, n_x) [mK RJ] that streams see through each beam; None without a sky."""
        return scene_sky(self.scene, self.geometry, self.fwhm_rad)


@dataclass(frozen=True)
class Simulation:
    """A scene made ready to draw time-streams."""

    scene: Scene
    camera: CameraSetup
    observing: ObservingSetup
    air: AirSetup
    sky: SkySetup

    @property
    def stream_type(self) -> np.dtype:
        """Type of streams and maps."""
        return np.dtype(self.scene.numerics.precision)


@lru_cache(maxsize=2)  # points of a sweep, and the pilot of a forecast, have angles in common
def _survey_angles(
    field: FieldCentre, site: Site, start_mjd: tuple[float, ...], mid_time_s: tuple[float, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Compute `survey_angles` once for equal surveys."""
    return survey_angles(field, site, np.array(start_mjd), np.array(mid_time_s))


def field_centre(scene: Scene) -> FieldCentre:
    """Centre of the field of a scene."""
    return FieldCentre(scene.field.ra_rad, scene.field.dec_rad)


def observing_site(scene: Scene) -> Site:
    """Site of a scene with a schedule."""
    return Site(scene.schedule.latitude_rad, scene.schedule.longitude_rad, scene.schedule.height_m)


def survey_horizons(scene: Scene, times: Schedule | None) -> Horizons | None:
    """Horizons of all observations; None at fixed pointing."""
    return None if times is None else Horizons(field_centre(scene), observing_site(scene), times.start_mjd)


def observing_schedule(scene: Scene, scans: Scans) -> Schedule | None:
    """Starts of the observations; None at a fixed elevation.

    Raises SceneError for nights that do not hold the observations.
    """
    plan = scene.schedule
    if plan is None:
        return None
    if scans.starts_mjd is not None:
        return _given_schedule(scene, scans.starts_mjd[: scene.observations], mid_times(scans))
    try:
        return schedule(
            field_centre(scene),
            observing_site(scene),
            plan.first_night,
            nights=plan.nights,
            n_observations=scene.observations,
            max_hour_angle_rad=plan.max_hour_angle_rad,
            min_elevation_rad=plan.min_elevation_rad,
            duration_s=duration_s(scans),
        )
    except OutOfRangeError as error:
        raise SceneError(f"schedule: {error}") from None


def _given_schedule(scene: Scene, start_mjd: np.ndarray, mid_time_s: np.ndarray) -> Schedule:
    """Schedule of starts that the scan pattern sets; raises SceneError for a field too low."""
    site = observing_site(scene)
    given = Schedule(start_mjd, *hour_angle_dec(field_centre(scene), site, start_mjd))
    lowest = near_angles(site, given, mid_time_s)[0].min(axis=1)
    wrong = np.flatnonzero(lowest < scene.schedule.min_elevation_rad)
    if len(wrong):
        raise SceneError(
            f"scan.track_table: found the field at {np.degrees(lowest[wrong[0]]):.1f} deg elevation in observation"
            f" {wrong[0]}; schedule.min_elevation, {np.degrees(scene.schedule.min_elevation_rad):g} deg, or more is"
            " expected"
        )
    return given


def drawn_offsets(observing: ObservingSetup, observation: int) -> tuple[np.ndarray, float]:
    """Draw the dither (2,) of an observation, over its range, and the angle of its camera [rad]."""
    along, across, turn = _pointing_numbers(observing.scene.seed, observation)
    return np.array([along, across]), turn * observing.scene.instrument.camera_rotation_range_rad


@lru_cache(maxsize=10_000)  # points of a sweep have them in common
def _pointing_numbers(seed: int, observation: int) -> tuple[float, ...]:
    return tuple(generator(seed, RandomPurpose.POINTING, observation).random(3) - 0.5)


def horizon_frame(observing: ObservingSetup, observation: int) -> HorizonFrame | None:
    """Horizon during one observation; None at fixed pointing."""
    scene = observing.scene
    if scene.schedule is None:
        return None
    return HorizonFrame(field_centre(scene), observing_site(scene), float(observing.angles.start_mjd[observation]))


def boresight_path(observing: ObservingSetup, observation: int) -> ScanPath:
    """Compute the scan pattern of one observation, dithered."""
    dither = drawn_offsets(observing, observation)[0] * observing.scans.dither_rad
    return observing.pattern.path(observing.scans, observation, dither, horizon_frame(observing, observation))


def observation_path(observing: ObservingSetup, observation: int) -> tuple[ScanPath, Pointing]:
    """Point one observation: the scan pattern, dithered, and the camera, turned."""
    path, angles = boresight_path(observing, observation), observing.angles
    pointing = observation_pointing(
        path,
        horizon_frame(observing, observation),
        elevation_rad=angles.elevation_rad[observation],
        parallactic_rad=angles.parallactic_rad[observation],
        camera_angle_rad=drawn_offsets(observing, observation)[1],
    )
    return path, pointing
