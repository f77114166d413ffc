"""Directions of detectors on the sky against astropy: each from its own azimuth and elevation to ICRS."""

import numpy as np
import pytest

from mapmaker.detector_places import array_homography
from mapmaker.geometry import MapGeometry, plane_directions
from surveysim.telescope.directions import FieldCentre, Site, hour_angle_dec
from surveysim.telescope.horizon_frame import HorizonFrame
from surveysim.telescope.patterns.azimuth import AzimuthSweeps, azimuth_path
from surveysim.telescope.patterns.raster import Raster, raster_path
from surveysim.telescope.pointing import SIDEREAL_RAD_S, observation_pointing, survey_angles

DEG = np.pi / 180
ARCMIN, ARCSEC = DEG / 60, DEG / 3600
CAMERA_ANGLE = 0.4
TURN = SIDEREAL_RAD_S * 86400  # of the sky in a day [rad]
CSO = Site(19.8225 * DEG, -155.4761 * DEG, 4070.0)
ATACAMA = Site(-22.9856 * DEG, -67.7403 * DEG, 5612.0)  # Cerro Chajnantor
# Field, site, hours from transit at the start, and throw [deg].
PLACES = {
    "dec 40": (FieldCentre(132.3 * DEG, 40 * DEG), CSO, -2.0, 1.0),
    "dec 80": (FieldCentre(132.3 * DEG, 80 * DEG), CSO, -2.0, 1.0),
    "a throw of 20 degrees": (FieldCentre(132.3 * DEG, 40 * DEG), CSO, -2.0, 20.0),
    "20 degrees near the pole": (FieldCentre(132.3 * DEG, 80 * DEG), CSO, -2.0, 20.0),
    "near the zenith": (FieldCentre(132.3 * DEG, 20.5 * DEG), CSO, -0.2, 1.0),
    "a southern site": (FieldCentre(132.3 * DEG, -45 * DEG), ATACAMA, 1.0, 5.0),
}


def raster(throw_deg):
    """Path of a raster along RA."""
    scans = Raster(**timing(throw_deg), step_rad=throw_deg / 4 * DEG)
    return lambda frame: raster_path(scans, "ra", np.zeros(2))


def azimuth(throw_deg):
    """Path of azimuth scans."""
    scans = AzimuthSweeps(**timing(throw_deg), sweep_rad_s=throw_deg * DEG / 20, in_azimuth=False, turning=None)
    return lambda frame: azimuth_path(scans, 0, np.zeros(2), frame)


def timing(throw_deg):
    """Half an hour, with 20 samples a scan."""
    times = {"n_scans": 5, "scan_s": 20.0, "turnaround_s": 350.0, "dither_rad": 0.0, "sample_rate_hz": 1.0}
    return times | {"speed_rad_s": throw_deg * DEG / 20, "fastest_rad_s": throw_deg * DEG / 20}


def pointing_of(field, site, hours, path_of):
    """Pointing that begins some hours from transit."""
    start_mjd = 52963.0 + (hours * 15 * DEG - hour_angle_dec(field, site, np.array([52963.0]))[0][0]) / TURN
    frame = HorizonFrame(field, site, start_mjd)
    path = path_of(frame)
    elevation, parallactic = survey_angles(field, site, np.array([start_mjd]), path.mid_time_s)
    angles = {"elevation_rad": elevation[0], "parallactic_rad": parallactic[0], "camera_angle_rad": CAMERA_ANGLE}
    return observation_pointing(path, frame, **angles)


def astropy_places(pointing, site, x_rad, y_rad):
    """ICRS right ascension and declination (n_det, n_samp) of detectors, from the boresight's azimuth and elevation."""
    from astropy import units as u
    from astropy.coordinates import AltAz, EarthLocation, SkyCoord
    from astropy.time import Time
    from astropy.utils import iers

    zero = np.zeros(2)
    table = {"MJD": [0, 1e6] * u.day, "UT1_UTC": zero * u.s, "PM_x": zero * u.arcsec, "PM_y": zero * u.arcsec}
    place = EarthLocation.from_geodetic(site.longitude_rad * u.rad, site.latitude_rad * u.rad, site.height_m * u.m)
    with iers.conf.set_temp("auto_download", False), iers.earth_orientation_table.set(iers.IERS(table)):
        time = Time(pointing.start_mjd + pointing.time_s / 86400, format="mjd", scale="utc")
        frame = AltAz(obstime=time, location=place)
        boresight = SkyCoord(az=pointing.azimuth_rad * u.rad, alt=pointing.elevation_rad * u.rad, frame=frame)
        # Azimuths increase clockwise as seen from inside, position angles counter-clockwise. x is clockwise of y.
        clockwise = np.arctan2(x_rad, y_rad) - CAMERA_ANGLE
        seen = [
            boresight.directional_offset_by(turn * u.rad, np.arctan(radius) * u.rad).icrs
            for turn, radius in zip(clockwise, np.hypot(x_rad, y_rad), strict=True)
        ]
    return np.array([item.ra.rad for item in seen]), np.array([item.dec.rad for item in seen])


def separation(ra, dec, other_ra, other_dec):
    """Angles between neighbouring directions [rad], by the haversine."""
    across = np.cos(dec) * np.cos(other_dec) * np.sin((ra - other_ra) / 2) ** 2
    return 2 * np.arcsin(np.sqrt(np.sin((dec - other_dec) / 2) ** 2 + across))


@pytest.mark.filterwarnings("ignore:ERFA")
@pytest.mark.parametrize("pattern", [raster, azimuth])
@pytest.mark.parametrize("name", PLACES)
def test_detectors_look_where_astropy_says(name, pattern):
    """Within 0.1 arcsec for arrays of 30 arcmin: aberration magnifies them by up to 1e-4, 0.09 arcsec at their edge."""
    field, site, hours, throw_deg = PLACES[name]
    pointing = pointing_of(field, site, hours, pattern(throw_deg))
    if pattern is azimuth:
        assert np.ptp(pointing.elevation_rad) < 0.001 * ARCSEC
    turn = np.arange(4) * 1.6
    x, y = 15 * ARCMIN * np.array([np.sin(turn), np.cos(turn)]) * np.linspace(0, 1, 4)
    expected = astropy_places(pointing, site, x, y)
    tangent = MapGeometry(field.ra_rad, field.dec_rad, 1.0, 1, 1)
    h = array_homography(field.dec_rad, pointing.xi_rad, pointing.eta_rad, pointing.array_angle_rad)
    depth = 1 + np.outer(x, h[6]) + np.outer(y, h[7])
    xi = (h[0] + np.outer(x, h[1]) + np.outer(y, h[2])) / depth
    eta = (h[3] + np.outer(x, h[4]) + np.outer(y, h[5])) / depth
    error = separation(*plane_directions(tangent, xi, eta), *expected)
    assert error.max() < 0.1 * ARCSEC
    assert error[0].max() < 0.001 * ARCSEC  # the boresight itself
