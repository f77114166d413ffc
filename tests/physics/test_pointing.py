"""Hour angles, elevations and parallactic angles against the spherical triangle and plain astropy."""

import subprocess
import sys

import numpy as np
import pytest

from surveysim.telescope.directions import (
    INTERPOLATION_S,
    STEP_DOWN_RAD,
    FieldCentre,
    Site,
    horizontal,
    hour_angle_dec,
)
from surveysim.telescope.horizon_frame import HorizonFrame, from_horizon, to_horizon
from surveysim.telescope.patterns.raster import Raster, raster_path
from surveysim.telescope.pointing import (
    SIDEREAL_RAD_S,
    observation_pointing,
    schedule,
    sky_vector,
    survey_angles,
)

DEG = np.pi / 180
ARCMIN = DEG / 60
ARCSEC = DEG / 3600
HOUR = 15 * DEG
LIMITS = {"max_hour_angle_rad": 4 * HOUR, "min_elevation_rad": 35 * DEG, "duration_s": 440.0}
CSO = Site(19.8225 * DEG, -155.4761 * DEG, 4070.0)
LYNX = FieldCentre((8 + 49 / 60 + 12 / 3600) * HOUR, (44 + 50 / 60 + 24 / 3600) * DEG)
SDS1 = FieldCentre((2 + 18 / 60) * HOUR, -5 * DEG)
COSMOS = FieldCentre((10 + 29 / 3600) * HOUR, (2 + 12 / 60 + 21 / 3600) * DEG)
FIELDS = pytest.mark.parametrize("field", [LYNX, SDS1, COSMOS], ids=["lynx", "sds1", "cosmos"])
YEARS = pytest.mark.parametrize("year, mjd", [(2003.9, 52960.0), (2030.0, 62502.0)])

PRECESSION = 20.05 * ARCSEC  # of the pole towards the equinox, a year
# Annual aberration (20.5 arcsec) and nutation (9 arcsec in declination, 17 in longitude) move a place by less
# than this, besides precession; they turn north at the field by less than this over cos(dec).
APPARENT = 50 * ARCSEC


def one_day(mjd, n=801):
    """Times over a day, in which the hour angle takes every value."""
    return mjd + np.linspace(0.0, 1.0, n)


def local_sidereal_rad(mjd, site):
    """Mean sidereal time, linear in time (Meeus, eq. 12.4; what is left out is 0.4 arcsec a century^2)."""
    greenwich_deg = 280.46061837 + 360.98564736629 * (mjd - 51544.5)
    return greenwich_deg * DEG + site.longitude_rad


def mean_of_date(field, year):
    """Right ascension and declination with first-order precession from J2000."""
    t = year - 2000.0
    m = 46.12 * ARCSEC
    ra = field.ra_rad + t * (m + PRECESSION * np.sin(field.ra_rad) * np.tan(field.dec_rad))
    return ra, field.dec_rad + t * PRECESSION * np.cos(field.ra_rad)


def angle_difference(a, b):
    return (a - b + np.pi) % (2 * np.pi) - np.pi


@FIELDS
@YEARS
def test_elevation_at_transit(field, year, mjd):
    elevation, _, _ = horizontal(field, CSO, one_day(mjd, n=2881))
    _, dec = mean_of_date(field, year)
    expected = np.pi / 2 - abs(CSO.latitude_rad - dec)
    # 15 s from transit, H = 1.1e-3, cost H^2 / 2 cos(lat) cos(dec) / sin(zenith distance): 0.4 arcsec.
    assert abs(elevation.max() - expected) < APPARENT
    # The catalogue's own declination differs by precession, 20.05 arcsec cos(ra) a year.
    catalogue = np.pi / 2 - abs(CSO.latitude_rad - field.dec_rad)
    assert abs(elevation.max() - catalogue) < APPARENT + PRECESSION * (year - 2000)


@FIELDS
@YEARS
def test_elevation_and_azimuth_follow_the_hour_angle(field, year, mjd):
    times = one_day(mjd)
    elevation, azimuth, _ = horizontal(field, CSO, times)
    ra, dec = mean_of_date(field, year)
    h = local_sidereal_rad(times, CSO) - ra
    lat = CSO.latitude_rad
    up = np.sin(lat) * np.sin(dec) + np.cos(lat) * np.cos(dec) * np.cos(h)
    north = np.cos(lat) * np.sin(dec) - np.sin(lat) * np.cos(dec) * np.cos(h)
    east = -np.cos(dec) * np.sin(h)
    level = np.cos(elevation)
    seen = np.array([level * np.sin(azimuth), level * np.cos(azimuth), np.sin(elevation)])
    apart = np.linalg.norm(seen - np.array([east, north, up]), axis=0)
    # UT1 - UTC is left out on both sides; second-order precession stays within the allowance.
    assert apart.max() < APPARENT


@FIELDS
@YEARS
def test_parallactic_angle_is_the_triangle_turned_by_precession(field, year, mjd):
    times = one_day(mjd)
    elevation, _, parallactic = horizontal(field, CSO, times)
    ra, dec = mean_of_date(field, year)
    h = local_sidereal_rad(times, CSO) - ra
    # tan q = sin H / (tan lat cos dec - sin dec cos H) counts from the pole of date.
    q_of_date = np.arctan2(np.sin(h), np.tan(CSO.latitude_rad) * np.cos(dec) - np.sin(dec) * np.cos(h))
    # Position angles grow by 20.05 arcsec sin(ra) / cos(dec) a year as the pole moves: 10 arcmin for
    # Lynx in 2030.
    turn = PRECESSION * (year - 2000) * np.sin(field.ra_rad) / np.cos(field.dec_rad)
    error = angle_difference(parallactic, q_of_date - turn)
    # A displacement s of the field turns its vertical by up to s tan(elevation), and its north by s tan(dec).
    tolerance = APPARENT * (1 / np.cos(elevation) + 1 / np.cos(dec))
    above = elevation > 20 * DEG
    assert (np.abs(error) < tolerance)[above].all()
    # Without precession it is the triangle to a few arcmin in the survey's own years.
    if year < 2010:
        assert np.abs(angle_difference(parallactic, q_of_date))[above].max() < 4 * ARCMIN


@FIELDS
def test_parallactic_angle_is_positive_in_the_west(field):
    times = one_day(52960.0)
    elevation, azimuth, parallactic = horizontal(field, CSO, times)
    clear = (elevation > 0) & (np.abs(np.sin(azimuth)) > 0.05)
    west = azimuth > np.pi
    np.testing.assert_array_equal(parallactic[clear] > 0, west[clear])
    # South of the zenith the zenith is north of the field at transit; north of it, south.
    at_transit = np.abs(parallactic[np.argmax(elevation)])
    assert abs(at_transit - (np.pi if field.dec_rad > CSO.latitude_rad else 0.0)) < 1 * DEG


def test_parallactic_angle_range_and_the_zenith():
    overhead = FieldCentre(LYNX.ra_rad, CSO.latitude_rad)
    elevation, azimuth, parallactic = horizontal(overhead, CSO, one_day(52960.0, n=5001))
    assert np.isfinite([elevation, azimuth, parallactic]).all()
    assert elevation.max() > 89.9 * DEG
    assert (parallactic > -np.pi).all() and (parallactic <= np.pi).all()


@FIELDS
def test_sky_vector_maps_horizontal_offsets_to_the_sky(field):
    """A step in azimuth and elevation, carried to ICRS by astropy, is the one that `sky_vector` gives."""
    from astropy import units as u
    from astropy.coordinates import AltAz, EarthLocation, SkyCoord
    from astropy.time import Time
    from astropy.utils import iers

    limits = LIMITS | {"min_elevation_rad": 30 * DEG}
    times = schedule(field, CSO, "2003-11-20", nights=3, n_observations=30, **limits).start_mjd
    with iers.conf.set_temp("auto_download", False), iers.conf.set_temp("auto_max_age", None):
        place = EarthLocation.from_geodetic(CSO.longitude_rad * u.rad, CSO.latitude_rad * u.rad, CSO.height_m * u.m)
        frame = AltAz(obstime=Time(times, format="mjd"), location=place)
        centre = SkyCoord(field.ra_rad * u.rad, field.dec_rad * u.rad)
        seen = centre.transform_to(frame)
        step_az, step_el = 0.3 * ARCMIN, 0.5 * ARCMIN
        aside = SkyCoord(
            az=seen.az + step_az / np.cos(seen.alt) * u.rad, alt=seen.alt + step_el * u.rad, frame=frame
        ).icrs
        offset = centre.spherical_offsets_to(SkyCoord(aside.ra, aside.dec))
    elevation, azimuth, parallactic = horizontal(field, CSO, times)
    xi, eta = sky_vector(parallactic, step_az, step_el)
    # UT1 is in astropy's answer only: its 0.4 s of 2003 turn q by up to 6 arcsec / cos(el), 1e-4 rad below 70
    # deg; the curvature of a parallel of elevation, step tan(el) / 2, is as small.
    step = np.hypot(step_az, step_el)
    assert np.abs(offset[0].to_value(u.rad) - xi).max() < 1e-3 * step
    assert np.abs(offset[1].to_value(u.rad) - eta).max() < 1e-3 * step
    # UT1 = UTC costs less than 0.9 s of hour angle.
    assert np.abs(seen.alt.to_value(u.rad) - elevation).max() < 14 * ARCSEC
    apart = np.abs(angle_difference(seen.az.to_value(u.rad), azimuth)) * np.cos(elevation)
    assert apart.max() < 14 * ARCSEC


def test_sky_vector_axes():
    quarter = np.pi / 2
    np.testing.assert_allclose(sky_vector(0.0, 0.0, 1.0), (0, 1), atol=1e-15)  # y to the north
    np.testing.assert_allclose(sky_vector(0.0, 1.0, 0.0), (-1, 0), atol=1e-15)  # x to the west, clockwise
    np.testing.assert_allclose(sky_vector(quarter, 0.0, 1.0), (1, 0), atol=1e-15)  # y to the east
    np.testing.assert_allclose(sky_vector(quarter, 1.0, 0.0), (0, 1), atol=1e-15)


def night_hour_angles(field, times):
    ra, _ = mean_of_date(field, 2003.9)
    return angle_difference(local_sidereal_rad(times, CSO), ra)


@FIELDS
def test_schedule_stays_in_the_visible_hours(field):
    starts = schedule(field, CSO, "2003-11-20", nights=20, n_observations=500, **LIMITS).start_mjd
    assert starts.shape == (500,)
    assert (np.diff(starts) * 86400 > LIMITS["duration_s"] - 1e-4).all()  # mjd resolves a microsecond
    ends = starts + LIMITS["duration_s"] / 86400
    for times in (starts, ends):
        elevation, _, _ = horizontal(field, CSO, times)
        assert elevation.min() > LIMITS["min_elevation_rad"] - ARCSEC  # diurnal aberration, 0.3 arcsec
        assert np.abs(night_hour_angles(field, times)).max() < LIMITS["max_hour_angle_rad"] + 2 * APPARENT


def test_schedule_is_even_over_nights_and_hour_angle():
    starts = schedule(LYNX, CSO, "2003-11-20", nights=20, n_observations=500, **LIMITS).start_mjd
    # Noon to noon of local mean time; nights follow each other in order, 25 observations each.
    night = np.floor(starts - 52963 + CSO.longitude_rad / (2 * np.pi) - 0.5)
    np.testing.assert_array_equal(night, np.repeat(np.arange(20), 25))
    by_night = starts.reshape(20, 25)
    slot_s = np.diff(by_night, axis=1) * 86400
    # Nothing but the elevation limit of date, arcsec from night to night, changes the slots.
    assert np.ptp(slot_s) < 0.1
    h = night_hour_angles(LYNX, by_night + LIMITS["duration_s"] / 2 / 86400)
    # The first night is symmetric about transit.
    assert abs(h[0].mean()) < 2 * APPARENT / np.cos(LYNX.dec_rad)
    # Over all nights the starts fill what a slot leaves over; 20 of them leave gaps below 1.9 / 20.
    first = h[:, 0] - h[:, 0].min()
    left_over = (slot_s.mean() - LIMITS["duration_s"]) * SIDEREAL_RAD_S
    assert 0.85 * left_over < first.max() < left_over


def test_one_observation_a_night_covers_the_hour_angles():
    starts = schedule(LYNX, CSO, "2003-11-20", nights=40, n_observations=40, **LIMITS).start_mjd
    mid = np.sort(night_hour_angles(LYNX, starts + LIMITS["duration_s"] / 2 / 86400))
    reach = LIMITS["max_hour_angle_rad"] - LIMITS["duration_s"] / 2 * SIDEREAL_RAD_S
    # Multiples of the golden ratio leave gaps of at most 1.9 times the mean one (three-distance theorem).
    gaps = np.diff(np.concatenate([[-reach], mid, [reach]]))
    assert gaps.max() < 1.95 * 2 * reach / 40


def test_fewer_observations_than_nights_are_spread():
    starts = schedule(LYNX, CSO, "2003-11-20", nights=40, n_observations=4, **LIMITS).start_mjd
    assert (np.abs(np.diff(starts) - 10.0) < 0.5).all()


def test_field_too_low():
    southern = FieldCentre(1.0, -60 * DEG)
    with pytest.raises(ValueError, match=r"never rises above 10\.\d\d deg .* limit is 35\.00 deg"):
        schedule(southern, CSO, "2003-11-20", nights=1, n_observations=1, **LIMITS)
    never = FieldCentre(1.0, -80 * DEG)
    with pytest.raises(ValueError, match=r"never rises above -9\.\d\d deg"):
        schedule(never, CSO, "2003-11-20", nights=1, n_observations=1, **LIMITS)


def test_too_many_observations_says_how_many_fit():
    # Eight hours of hour angle are 8 * 60 / 1.00274 = 478.7 min, room for 65.3 observations of 440 s; but the
    # elevation limit takes 0.7 min of them.
    found = r"70 observations of 7\.3 min .* 1 night\(s\).* 478\.0 min a night, so 65 would fit"
    with pytest.raises(ValueError, match=found):
        schedule(LYNX, CSO, "2003-11-20", nights=1, n_observations=70, **LIMITS)
    assert schedule(LYNX, CSO, "2003-11-20", nights=1, n_observations=65, **LIMITS).start_mjd.size == 65
    assert schedule(LYNX, CSO, "2003-11-20", nights=2, n_observations=70, **LIMITS).start_mjd.size == 70
    limits = LIMITS | {"min_elevation_rad": 64.9 * DEG, "duration_s": 7200.0}
    with pytest.raises(ValueError, match="so 0 would fit"):
        schedule(LYNX, CSO, "2003-11-20", nights=3, n_observations=1, **limits)


def test_circumpolar_field_from_the_pole():
    pole, field = Site(-90 * DEG, 0.0, 2835.0), FieldCentre(1.0, -45 * DEG)
    starts = schedule(
        field,
        pole,
        "2003-06-01",
        nights=2,
        n_observations=20,
        max_hour_angle_rad=12 * HOUR,
        min_elevation_rad=40 * DEG,
        duration_s=440.0,
    ).start_mjd
    elevation, _, parallactic = horizontal(field, pole, starts)
    assert np.abs(elevation - 45 * DEG).max() < APPARENT + 4 * PRECESSION
    # The zenith is the southern pole of date, at position angle pi but for precession since 2000.
    assert np.abs(angle_difference(parallactic, np.pi)).max() < (APPARENT + 4 * PRECESSION) / np.cos(45 * DEG)


def test_longitudes_wrap():
    """204.5239 degrees east are 155.4761 west: the same nights, transits and visibility."""
    east = Site(CSO.latitude_rad, CSO.longitude_rad + 2 * np.pi, CSO.height_m)
    plans = [schedule(LYNX, site, "2003-11-20", nights=2, n_observations=5, **LIMITS).start_mjd for site in (CSO, east)]
    # Of longitudes and times rounded to 1e-11 days.
    np.testing.assert_allclose(plans[1], plans[0], rtol=0, atol=1e-10)


def astropy_directions(field, site, mjd):
    """Elevation, azimuth, parallactic angle, hour angle and declination of date by astropy.coordinates."""
    from astropy import units as u
    from astropy.coordinates import AltAz, EarthLocation, HADec, SkyCoord
    from astropy.coordinates.erfa_astrom import ErfaAstromInterpolator, erfa_astrom
    from astropy.time import Time
    from astropy.utils import iers

    zero = np.zeros(2)
    table = {"MJD": [0, 1e6] * u.day, "UT1_UTC": zero * u.s, "PM_x": zero * u.arcsec, "PM_y": zero * u.arcsec}
    centre = SkyCoord(field.ra_rad * u.rad, field.dec_rad * u.rad, frame="icrs")
    place = EarthLocation.from_geodetic(site.longitude_rad * u.rad, site.latitude_rad * u.rad, site.height_m * u.m)
    with iers.conf.set_temp("auto_download", False), iers.earth_orientation_table.set(iers.IERS(table)):
        where = {"obstime": Time(mjd, format="mjd", scale="utc"), "location": place}
        turned = centre.transform_to(HADec(**where))
        with erfa_astrom.set(ErfaAstromInterpolator(INTERPOLATION_S * u.s)):
            seen = centre.transform_to(AltAz(**where))
            below = SkyCoord(az=seen.az, alt=seen.alt - STEP_DOWN_RAD * u.rad, frame=AltAz(**where)).icrs
            nadir = centre.position_angle(below)
    return [item.to_value(u.rad) for item in (seen.alt, seen.az, nadir + 180 * u.deg, turned.ha, turned.dec)]


@pytest.mark.filterwarnings("ignore:ERFA")
def test_directions_are_those_of_astropy():
    """Within rounding, at sites, fields and dates anywhere; the last bits may depend on astropy's version."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        site = Site(*rng.uniform([-1.5, -6.2, 0], [1.5, 6.2, 5000]))
        field = FieldCentre(*rng.uniform([0, -1.5], [2 * np.pi, 1.5]))
        mjd = rng.uniform(15021, 109000) + rng.uniform(0, 20, 20)  # 1900 to 2157
        elevation, azimuth, parallactic, hour_angle, dec = astropy_directions(field, site, mjd)
        found = horizontal(field, site, mjd)
        np.testing.assert_allclose(found[0], elevation, rtol=0, atol=1e-13)
        assert np.abs(angle_difference(found[1], azimuth) * np.cos(elevation)).max() < 1e-13
        assert np.abs(angle_difference(found[2], parallactic)).max() < 1e-10  # rounding over STEP_DOWN_RAD
        turned, found_dec = hour_angle_dec(field, site, mjd)
        assert np.abs(angle_difference(turned, hour_angle)).max() < 1e-13
        np.testing.assert_allclose(found_dec, dec, rtol=0, atol=1e-13)
        assert (turned >= -np.pi).all() and (turned < np.pi).all()


def test_survey_angles_and_observation_pointing():
    scans = Raster(
        speed_rad_s=4 * ARCMIN,
        fastest_rad_s=4 * ARCMIN,
        n_scans=18,
        scan_s=15.0,
        turnaround_s=10.0,
        step_rad=2 * ARCMIN,
        dither_rad=0.0,
        sample_rate_hz=10.0,
    )
    path = raster_path(scans, "ra", np.zeros(2))
    plan = schedule(LYNX, CSO, "2003-11-20", nights=2, n_observations=5, **LIMITS)
    elevation, parallactic = survey_angles(LYNX, CSO, plan.start_mjd, path.mid_time_s)
    assert elevation.shape == parallactic.shape == (5, 18)
    one = horizontal(LYNX, CSO, plan.start_mjd[3:4] + path.mid_time_s[7] / 86400)
    # Interpolated nutation and aberration differ by 1e-6 arcsec between sets of times.
    np.testing.assert_allclose([elevation[3, 7], parallactic[3, 7]], [one[0][0], one[2][0]], atol=1e-10)

    frame = HorizonFrame(LYNX, CSO, plan.start_mjd[3])
    angles = {"elevation_rad": elevation[3], "parallactic_rad": parallactic[3], "camera_angle_rad": 0.4}
    pointing = observation_pointing(path, frame, **angles)
    np.testing.assert_array_equal(pointing.scan_array_angle_rad, parallactic[3] + 0.4)
    assert pointing.start_mjd == plan.start_mjd[3]
    assert pointing.xi_rad is path.xi_rad
    assert pointing.straight and pointing.flagged is None
    with pytest.raises(ValueError, match=r"\(18,\); got elevation \(5, 18\)"):
        observation_pointing(path, frame, **angles | {"elevation_rad": elevation})


@pytest.mark.parametrize("field, site", [(LYNX, CSO), (FieldCentre(4.0, -1.45), Site(-0.4, -1.19, 5190.0))])
def test_the_horizon_s_frame_at_the_field_centre_is_that_of_angles_alone(field, site):
    frame, time_s = HorizonFrame(field, site, 58849.3), np.linspace(0, 7200, 50)
    azimuth, elevation, vertical = to_horizon(frame, time_s, np.zeros(50), np.zeros(50))
    expected = horizontal(field, site, frame.start_mjd + time_s / 86400)
    np.testing.assert_allclose(elevation, expected[0], rtol=0, atol=1e-9)
    assert np.abs(angle_difference(azimuth, expected[1]) * np.cos(elevation)).max() < 1e-9
    # A point STEP_DOWN_RAD below the field is aberrated otherwise, by 1e-4 of the step.
    assert np.abs(angle_difference(vertical, expected[2])).max() < 1e-7


def test_directions_of_the_horizon_s_frame_come_back():
    frame, rng = HorizonFrame(LYNX, CSO, 58849.3), np.random.default_rng(1)
    (xi, eta), time_s = rng.uniform(-0.25, 0.25, (2, 200)), np.linspace(0, 20_000, 200)
    azimuth, elevation, _ = to_horizon(frame, time_s, xi, eta)
    # The gravity of the Sun bends aberrated light otherwise, by 4e-4 arcsec.
    np.testing.assert_allclose(from_horizon(frame, time_s, azimuth, elevation), [xi, eta], rtol=0, atol=3e-9)


OFFLINE = """
import socket, ssl, urllib.request, warnings
import numpy as np

def refuse(*args, **kwargs):
    raise AssertionError("the network was touched")

socket.socket = socket.create_connection = socket.getaddrinfo = urllib.request.urlopen = refuse
from surveysim.telescope.directions import FieldCentre, Site, horizontal
from surveysim.telescope.pointing import schedule
warnings.simplefilter("error")
field, site = FieldCentre(2.309, 0.7826), Site(0.34597, -2.71357, 4070.0)
for first, mjd in (("2003-11-20", 52963.0), ("2030-01-01", 62502.0), ("2060-01-01", 73459.0)):
    limits = {"max_hour_angle_rad": 1.0, "min_elevation_rad": 0.6, "duration_s": 440.0}
    plan = schedule(field, site, first, nights=40, n_observations=500, **limits)
    assert plan.start_mjd.size == 500
    assert np.isfinite(horizontal(field, site, mjd + np.linspace(0, 40, 1000))).all()
"""


def test_offline_and_silent_at_any_date():
    """In a fresh process: no file of the Earth's rotation, no leap seconds may have been read before."""
    done = subprocess.run([sys.executable, "-c", OFFLINE], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
