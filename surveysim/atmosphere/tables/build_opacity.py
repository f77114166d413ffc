"""Build the opacity tables of sites with their own air, with the `am` atmospheric model.

``python -m surveysim.atmosphere.tables.build_opacity [SITE ...]``; about five minutes on one core for all.

For a fixed profile shape the monochromatic optical depth is a quadratic in the water column (lines and foreign
continuum are linear, self broadening and self continuum quadratic). So three spectra give the table of a site: at 1.7
mm above Mauna Kea, spectrum and quadratic differ by 5e-4 of the optical depth.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from surveysim.atmosphere.tables.am_spectra import am_opacity, cell_optical_depth, layer

FIRST_GHZ, LAST_GHZ = 80, 420
CEILING = 50.0  # opaque; only three cells at 380 GHz reach it
# A standard ozone column of 280 Dobson units, a layer about 22 km above the sea.
OZONE_CM2, OZONE_HEIGHT_M, OZONE_WIDTH_M = 7.5e18, 22e3, 5e3
GRAVITY_M_S2, GAS_CONSTANT_J_KG_K = 9.80665, 287.05
# Lower boundaries of the layers above the ground; the last layer has no upper boundary.
LAYERS_M = 1e3 * np.array(
    [0, 0.2, 0.4, 0.7, 1, 1.5, 2, 2.5, 3, 4, 5, 6, 7, 8.5, 10, 12, 14, 17, 20, 24, 28, 33, 40], dtype=float
)
WET_MM = (0.05, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0, 1.4, 1.8, 2.3, 3.0, 3.8, 4.8, 6.0)
POLAR_MM = (0.03, 0.06, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.55, 0.75, 1.0, 1.3, 1.6, 2.0)


@dataclass(frozen=True)
class Site:
    """Atmosphere of one site.

    Temperature and the logarithm of the vapour density are linear between knots of the height above ground. Above the
    last knot the vapour has the slope between the last two.
    """

    altitude_m: float
    pressure_mbar: float
    temperature: tuple  # (height km, K) knots
    vapour: tuple  # (height km, ln of relative density) knots
    pwv_median_mm: float
    pwv_mm: tuple
    profile: str


# Medians of PWV: Sayers et al. (2010), sections 3.1 and 3.4. Exponential vapour of 2 km: the usual assumption for
# Mauna Kea and the Atacama; Giovanelli et al. (2001) measure 1.1 km in the median above Chajnantor, which
# makes d tau / d PWV there 12 % larger.
SITES = {
    # Tropical standard atmosphere: 620 mbar at 4070 m, a cool night at the summit (272 K), 6 K/km up to a cold
    # tropopause at 16.6 km above the sea, and a stratosphere that warms to 255 K.
    "mauna_kea": Site(
        4070.0,
        620.0,
        ((0, 272), (12.5, 197), (14, 197), (20, 218), (36, 255)),
        ((0, 0.0), (2, -1.0)),
        1.68,
        WET_MM,
        "tropical, 6 K/km from 272 K; exponential vapour, scale height 2 km",
    ),
    # Winter (June to August): radiosondes have 214 K at the ground below an inversion of 20 K in 400 m, 230 K at
    # 500 mbar, 206 K at 300 mbar, 186 K in the polar vortex. That air holds 0.305 mm when saturated over ice (Murphy &
    # Koop 2005), so the median column is nearly saturated: saturation in the inversion, and above it a relative
    # humidity that falls by e in 6.9 km, make it 0.25 mm.
    "south_pole": Site(
        2835.0,
        680.0,
        (
            (0, 214),
            (0.4, 234),
            (1, 233),
            (2.1, 230),
            (3.5, 219),
            (5.4, 206),
            (7.8, 197),
            (12, 190),
            (16, 186),
            (37, 240),
        ),
        (
            (0, -2.37),
            (0.4, 0),
            (1, -0.2),
            (2.1, -0.69),
            (3.5, -2.18),
            (5.4, -4.17),
            (7.8, -5.83),
            (12, -7.55),
            (16, -8.8),
        ),
        0.25,
        POLAR_MM,
        "winter, inversion from 214 K to 234 K in 400 m; vapour saturated over ice in the inversion, less above",
    ),
    # Chajnantor plateau: 555 mbar and 270 K (site testing of ALMA), tropopause as at Mauna Kea.
    "alma": Site(
        5060.0,
        555.0,
        ((0, 270), (11.5, 197), (13, 197), (19, 218), (35, 255)),
        ((0, 0.0), (2, -1.0)),
        1.00,
        WET_MM,
        "tropical, 6.3 K/km from 270 K; exponential vapour, scale height 2 km",
    ),
    # Cerro Chajnantor: the same air 540 m higher.
    "ccat": Site(
        5600.0,
        515.0,
        ((0, 267), (11, 197), (12.5, 197), (18.5, 218), (34.5, 255)),
        ((0, 0.0), (2, -1.0)),
        0.83,
        WET_MM,
        "tropical, 6.4 K/km from 267 K; exponential vapour, scale height 2 km",
    ),
}


def _knots(pairs: Sequence[tuple[float, float]], height_m: np.ndarray) -> np.ndarray:
    """Interpolate linearly between knots of (height km, value); extrapolate with the last slope."""
    height, value = np.array(pairs, dtype=float).T
    beyond = np.maximum(height_m / 1e3 - height[-1], 0) * (value[-1] - value[-2]) / (height[-1] - height[-2])
    return np.interp(height_m / 1e3, height, value) + beyond


def temperature_k(site: Site, height_m: np.ndarray) -> np.ndarray:
    """Air temperature [K] at heights above the ground; constant above the last knot."""
    return _knots((*site.temperature, (1e3, site.temperature[-1][1])), height_m)


def vapour_density(site: Site, height_m: np.ndarray) -> np.ndarray:
    """Density of water vapour at heights above the ground, any unit."""
    return np.exp(_knots(site.vapour, height_m))


def layers(site: Site) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Pressure [mbar] and temperature [K] at the base of each layer, and its fractions of the water and ozone."""
    height = np.linspace(0.0, 80e3, 80001)
    temperature, vapour = temperature_k(site, height), vapour_density(site, height)
    ozone = np.exp(-0.5 * ((height + site.altitude_m - OZONE_HEIGHT_M) / OZONE_WIDTH_M) ** 2)
    inverse = GRAVITY_M_S2 / GAS_CONSTANT_J_KG_K / temperature
    depth = np.concatenate([[0.0], np.cumsum(0.5 * (inverse[1:] + inverse[:-1]) * np.diff(height))])
    pressure = site.pressure_mbar * np.exp(-depth)
    base = np.searchsorted(height, LAYERS_M)
    shares = [np.add.reduceat(density, base) / density.sum() for density in (vapour, ozone)]
    return pressure[base], temperature[base], *shares


def atmosphere_temperature_k(site: Site) -> float:
    """Emission temperature [K] of the vapour: mean of the profile, weighted by vapour density."""
    height = np.linspace(0.0, 40e3, 40001)
    return float(np.average(temperature_k(site, height), weights=vapour_density(site, height)))


def configuration(site: Site, pwv_mm: float) -> str:
    """Layers of am for a zenith spectrum of optical depth."""
    return "".join(
        layer(pressure, temperature, ozone_cm2=ozone * OZONE_CM2, water_mm=water * pwv_mm)
        for pressure, temperature, water, ozone in reversed(list(zip(*layers(site), strict=True)))
    )


def build(name: str) -> Path:
    """Write the table of one site and return its path."""
    from astropy import units
    from astropy.table import QTable

    site = SITES[name]
    half = site.pwv_mm[-1] / 2
    (dry, version), (middle, _), (wet, _) = (
        am_opacity(configuration(site, pwv), first_ghz=FIRST_GHZ, last_ghz=LAST_GHZ) for pwv in (0.0, half, 2 * half)
    )
    linear, quadratic = (4 * middle - 3 * dry - wet) / (2 * half), (wet - 2 * middle + dry) / (2 * half**2)
    table = QTable({"frequency": np.arange(FIRST_GHZ + 0.5, LAST_GHZ) * units.GHz})
    for pwv in site.pwv_mm:
        depth = cell_optical_depth(dry + pwv * (linear + pwv * quadratic), ceiling=CEILING)
        table[f"pwv_{pwv:g}"] = [float(f"{value:.5g}") for value in depth]
    table.meta = {
        "what": "zenith optical depth of the transmission averaged over cells of 1 GHz, for columns of water [mm]",
        "site": name,
        "profile": site.profile,
        "ground_pressure": f"{site.pressure_mbar:g} mbar",
        "pwv_median": f"{site.pwv_median_mm:g} mm",
        "atmosphere_temperature": round(atmosphere_temperature_k(site), 1),
        "pwv": list(site.pwv_mm),
        "ceiling": CEILING,
        "model": version,
    }
    path = Path(__file__).with_name(f"opacity_{name}.ecsv")
    table.write(path, overwrite=True)
    return path


def main() -> None:
    """Build the tables of the named sites, or of all."""
    parser = argparse.ArgumentParser(description="Build the opacity tables with am.")
    parser.add_argument("site", nargs="*", help=f"of {', '.join(SITES)}; all without")
    for name in parser.parse_args().site or SITES:
        print(build(name))


if __name__ == "__main__":
    main()
