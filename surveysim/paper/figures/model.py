"""Figures 1 and 2 of the paper: opacities of the sites, and the thin-screen model."""

from fractions import Fraction
from math import cos, degrees, pi, sin, sqrt, tan

import numpy as np

from surveysim.atmosphere.opacity import band_opacity, optical_depth
from surveysim.atmosphere.screen_simulation import add_atmosphere
from surveysim.atmosphere.thin_screen import mean_removed_variance
from surveysim.atmosphere.weather import b2_quantile
from surveysim.reduction.setup import Setup
from surveysim.report.figures.spec import Panel, PaperFigure, Series
from surveysim.runtime.errors import SceneError
from surveysim.runtime.rng import RandomPurpose, normal_deviates
from surveysim.scene.passband import top_hat
from surveysim.scene.place import shipped_place
from surveysim.scene.sites import median_water_mm, water_mm
from surveysim.telescope.scans import samples_per_scan

BANDS_HZ = (150e9, 275e9)  # bands of the paper's figure 1
BANDWIDTH = 0.15  # Bolocam's
SITE_LOOKS = {
    "mauna_kea": ("Mauna Kea", "vermilion -"),
    "south_pole": ("South Pole", "blue --"),
    "alma": ("ALMA", "green -."),
    "ccat": ("CCAT", "purple :"),
}

DRAW = 1  # realization of the layer, with an rms near the expected one
THICKNESS_M = 100.0  # drawn thickness of the layer: the model only requires it to be much smaller than the height


def opacity_figure() -> PaperFigure:
    """Figure 1: zenith optical depth against water vapour at four sites, with a panel for each band."""
    longest = max(water_mm(site)[1][-1] for site in SITE_LOOKS)
    bands = " and ".join(f"{hz / 1e9:g}" for hz in BANDS_HZ)
    medians = ", ".join(f"{SITE_LOOKS[site][0]} {median_water_mm(site):g} mm" for site in SITE_LOOKS)
    caption = (
        f"Zenith optical depth against the column of precipitable water vapour, averaged over bands of"
        f" {100 * BANDWIDTH:g} % around {bands} GHz, from tables of the am model of each site's atmosphere."
        f" Points are at the median columns: {medians}. At equal water the air above the South Pole absorbs"
        f" most, but it holds the least."
    )
    panels = tuple(_opacity_panel(hz, longest) for hz in BANDS_HZ)
    return PaperFigure(1, "Opacity and water vapour", caption, panels, columns=2)


def _opacity_panel(frequency_hz: float, longest_mm: float) -> Panel:
    lines, points = [], []
    for site in SITE_LOOKS:
        name, look = SITE_LOOKS[site]
        band = band_opacity(shipped_place(site), top_hat(frequency_hz, BANDWIDTH))
        pwv_mm = np.linspace(band.pwv_mm[0], min(longest_mm, band.pwv_mm[-1]), 100)
        lines.append(Series(name, "line", pwv_mm, optical_depth(band, pwv_mm), look))
        median = np.array([median_water_mm(site)])
        points.append(Series("", "points", median, optical_depth(band, median), look))
    title, x_label = f"{frequency_hz / 1e9:g} GHz", "Precipitable water vapour [mm]"
    deepest = max(series.y.max() for series in lines)
    series, x_range, y_range = (*lines, *points), (0.0, longest_mm), (0.0, 1.05 * deepest)
    return Panel(title, x_label, "Zenith optical depth", series, x_range=x_range, y_range=y_range)


# ---------------------------------------------------------------- figure 2


def screen_figure(setup: Setup) -> PaperFigure:
    """Figure 2: the thin-screen model to scale, for the camera, layer and median weather of the scene.

    Panels are the beams from the side, the beams at the layer, their footprints in the layer, and time-streams of two
    detectors at the edges of the field of view in one realization.

    Raises
    ------
    SceneError
        For a scene without [atmosphere].
    """
    if setup.scene.atmosphere is None:
        raise SceneError(f"scene {setup.scene.name!r}: found no [atmosphere]; one is expected")
    panels = (_side_panel(setup), _crossing_panel(setup), _layer_panel(setup), _emission_panel(setup))
    return PaperFigure(2, "The thin-screen model", _screen_caption(setup), panels, columns=2)


def _screen_caption(setup: Setup) -> str:
    air, field_rad = setup.scene.atmosphere, 2 * setup.camera.radius_rad
    height, wind = air.layer_height_m, air.wind_median_rad_s
    seen_mk = edge_streams(setup)[1].std()
    return (
        f"The thin-screen model to scale. Each detector sees a column {air.illuminated_aperture_m:g} m wide, at"
        f" the survey's median elevation of {degrees(_elevation_rad(setup)):.0f} degrees, through a layer {height:g} m"
        f" above the telescope. Its thickness, drawn as {THICKNESS_M:g} m, does not matter. Lengths in the plane of"
        f" the layer are angles times its height: a field of view of {_arcmin(field_rad):.1f} arcmin is only"
        f" {height * field_rad:.1f} m wide, and the median wind of {_arcmin(wind):.0f} arcmin/s is {height * wind:.1f}"
        f" m/s. The last panel is one realization of the layer's emission over {setup.scene.scan.duration_s:g} s, for"
        f" b = {_fraction(air.spectral_index)} and the median B2 of {_median_b2(setup):.0f} mK^2"
        f" rad^({_fraction(2 - air.spectral_index)}) (rms {seen_mk:.0f} mK, where the model's is"
        f" {_expected_mk(setup):.0f} mK), seen by"
        f" detectors at two edges of the field with the telescope at rest: nearly the same signal,"
        f" {_delay_s(setup):.2f} s later."
    )


def column_edges(
    elevation_rad: float, offset_rad: float, aperture_m: float, heights_m: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Horizontal positions (n,) [m] of both edges of a detector's beam, seen from the side.

    The atmosphere is in the near field: the beam is a column as wide as the aperture, which is centred at the origin.

    Parameters
    ----------
    elevation_rad, offset_rad
        Elevation of the telescope, and offset of the detector in elevation [rad].
    aperture_m
        Diameter of the illuminated aperture [m].
    heights_m
        Heights above the telescope, (n,) [m].
    """
    # The mirror is common: the columns of all detectors start at its rim.
    rim_x, rim_y = 0.5 * aperture_m * sin(elevation_rad), -0.5 * aperture_m * cos(elevation_rad)
    run = 1 / tan(elevation_rad + offset_rad)
    return -rim_x + (heights_m + rim_y) * run, rim_x + (heights_m - rim_y) * run


def _side_panel(setup: Setup) -> Panel:
    """Panel of the central beam from the telescope to above the layer."""
    height, elevation = setup.scene.atmosphere.layer_height_m, _elevation_rad(setup)
    top, middle = 1.2 * height, height / tan(elevation)
    x = np.array([-0.3 * height, middle + 0.7 * height])
    layer = np.full(2, height)
    ends = (layer - THICKNESS_M / 2, layer + THICKNESS_M / 2)
    series = (
        Series("turbulent layer", "band", x, layer, "sky", *ends),
        _column("column of the central detector", setup, 0.0, heights_m=np.array([0.0, top]), look="black"),
        _arrow("wind", (middle + 0.15 * height, height), 0.4 * height, "vermilion"),
    )
    labels = ("The telescope and the layer", "Horizontal distance [m]", "Height above the telescope [m]")
    return Panel(*labels, series, square=True, x_range=(x[0], x[1]), y_range=(0.0, top))


def _crossing_panel(setup: Setup) -> Panel:
    """Panel of the central beam and both edge beams around the layer."""
    air, elevation, radius = setup.scene.atmosphere, _elevation_rad(setup), setup.camera.radius_rad
    reach = 1.5 * air.illuminated_aperture_m
    heights = air.layer_height_m + reach * np.array([-1.0, 1.0])
    middle = air.layer_height_m / tan(elevation)
    named = {
        f"{_arcmin(radius):.0f} arcmin below": (-radius, "vermilion --"),
        "central detector": (0.0, "black"),
        f"{_arcmin(radius):.0f} arcmin above": (radius, "blue -."),
    }
    series = tuple(_column(name, setup, offset, heights_m=heights, look=look) for name, (offset, look) in named.items())
    labels = ("Columns where they cross the layer", "Horizontal distance [m]", "Height above the telescope [m]")
    x_range = (middle - 1.7 * reach, middle + 1.7 * reach)
    return Panel(*labels, series, square=True, x_range=x_range, y_range=(heights[0], heights[1]))


def _layer_panel(setup: Setup) -> Panel:
    """Panel of the footprints in the layer, with the motion of the layer in one second."""
    air, plane = setup.scene.atmosphere, setup.camera.focal_plane
    x, y = air.layer_height_m * plane.x_rad, air.layer_height_m * plane.y_rad
    first, last = _edge_pair(setup)
    radius, moved = air.illuminated_aperture_m / 2, air.layer_height_m * air.wind_median_rad_s
    series = (
        _circle("footprint upwind", (x[first], y[first]), radius, "vermilion --"),
        _circle("footprint downwind", (x[last], y[last]), radius, "blue -."),
        _circle("air of the upwind one, 1 s later", (x[first] + moved, y[first]), radius, "grey :"),
        Series(f"centres of all {len(x)}", "points", x, y, "black"),
        _arrow("motion of the layer in 1 s", (x[first], -1.4 * radius), moved, "vermilion"),
    )
    labels = ("Footprints in the layer", "Along the wind [m]", "Across the wind [m]")
    along, across = (-1.7 * radius, moved + 1.7 * radius), (-1.8 * radius, 1.8 * radius)
    return Panel(*labels, series, square=True, x_range=along, y_range=across)


def _emission_panel(setup: Setup) -> Panel:
    """Panel of one realization over a scan: time-streams of both edge detectors, and their difference."""
    time_s, upwind, downwind = edge_streams(setup)
    series = (
        Series("upwind edge", "line", time_s, upwind, "vermilion --"),
        Series("downwind edge", "line", time_s, downwind, "blue -."),
        Series("their difference", "line", time_s, downwind - upwind, "black"),
    )
    return Panel("Emission of the layer over a scan", "Time [s]", "Rayleigh-Jeans temperature [mK]", series)


def edge_streams(setup: Setup) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time [s] and time-streams (n,) [mK] of the detectors at the upwind and the downwind edge, telescope at rest.

    One scan at median B2, wind and elevation, with the wind along the camera's x axis; the common mean is removed.
    """
    air, rate = setup.scene.atmosphere, setup.scene.scan.sample_rate_hz
    n = samples_per_scan(setup.observing.scans)
    plane, pair = setup.camera.focal_plane, list(_edge_pair(setup))
    offsets = np.stack([plane.x_rad[pair], plane.y_rad[pair]], axis=-1)[None]
    data = np.zeros((2, n), np.float32)
    wind = np.array([[air.wind_median_rad_s, 0.0]])
    bounds, rest, sine = np.array([[0, n]]), np.zeros((1, 2)), sin(_elevation_rad(setup))
    amplitude, strips = np.array([sqrt(_median_b2(setup) / sine)]), setup.air.layers[0].strips.at(sine)
    add_atmosphere(
        data,
        bounds,
        sample_rate_hz=rate,
        offsets_rad=offsets / sine,
        velocity_rad_s=rest,
        layer_velocity_rad_s=wind / sine,
        amplitude_mk=amplitude,
        strips=strips,
        deviates=normal_deviates(setup.scene.seed, RandomPurpose.ATMOSPHERE, DRAW),
    )
    return np.arange(n) / rate, *(data - data.mean())


def _edge_pair(setup: Setup) -> tuple[int, int]:
    """Detectors that a wind along x reaches first and last."""
    x = setup.camera.focal_plane.x_rad
    return int(np.argmin(x)), int(np.argmax(x))


def _delay_s(setup: Setup) -> float:
    first, last = setup.camera.focal_plane.x_rad[list(_edge_pair(setup))]
    return float((last - first) / setup.scene.atmosphere.wind_median_rad_s)


def _elevation_rad(setup: Setup) -> float:
    return float(np.median(setup.observing.angles.elevation_rad))


def _median_b2(setup: Setup) -> float:
    return float(b2_quantile(setup.scene.atmosphere, setup.air.water, np.zeros(1))[0])


def _expected_mk(setup: Setup) -> float:
    """Expected rms [mK] of a mean-removed scan."""
    speed, duration = setup.scene.atmosphere.wind_median_rad_s, setup.scene.scan.duration_s
    sine = sin(_elevation_rad(setup))
    variance = mean_removed_variance(setup.air.layers[0].strips.screen, speed / sine, duration)
    return sqrt(_median_b2(setup) / sine * variance)


def _arcmin(angle_rad: float) -> float:
    return degrees(angle_rad) * 60


def _fraction(value: float) -> str:
    return str(Fraction(value).limit_denominator(100))


# ---------------------------------------------------------------- drawn shapes


def _column(label: str, setup: Setup, offset_rad: float, *, heights_m: np.ndarray, look: str) -> Series:
    """Series of both edges of a detector's beam."""
    aperture = setup.scene.atmosphere.illuminated_aperture_m
    near, far = column_edges(_elevation_rad(setup), offset_rad, aperture, heights_m)
    return Series(label, "line", np.r_[near, np.nan, far], np.r_[heights_m, np.nan, heights_m], look)


def _circle(label: str, centre: tuple[float, float], radius: float, look: str) -> Series:
    turn = np.linspace(0, 2 * pi, 121)
    return Series(label, "line", centre[0] + radius * np.cos(turn), centre[1] + radius * np.sin(turn), look)


def _arrow(label: str, start: tuple[float, float], length: float, look: str) -> Series:
    """Series of an arrow along x."""
    (x, y), head = start, 0.12 * length
    tip = x + length
    up = np.array([0.0, 0.0, 0.5, 0.0, -0.5]) * head
    return Series(label, "line", np.array([x, tip, tip - head, tip, tip - head]), y + up, look)
