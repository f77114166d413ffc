"""Compute optical depths at random places with `am`, against which the opacity table of all heights is tested.

``python -m tests.data.build_opacity_points``; a minute on one core. Each point is a whole zenith spectrum of its own
air over one cell of 1 GHz, with layers that start at the ground and are 200 m thick there. The table has layers of 500
m that start at the sea, quadratics in the water and cubics between its heights and temperatures.
"""

from pathlib import Path

import numpy as np

from surveysim.atmosphere.opacity_tables import EDGES_GHZ, HEIGHTS_M, OFFSETS_K, PWV_MM
from surveysim.atmosphere.standard_air import VAPOUR_SCALE_M, air_pressure_mbar, air_temperature_k
from surveysim.atmosphere.tables.am_spectra import am_opacity, cell_optical_depth, layer
from surveysim.atmosphere.tables.build_heights import CEILING, ozone_columns_cm2, water_shares
from surveysim.atmosphere.tables.build_opacity import LAYERS_M

POINTS = Path(__file__).with_name("opacity_points.ecsv")
COLUMNS = ("height", "temperature", "pwv", "frequency", "optical_depth")
UNITS = ("m", "K", "mm", "GHz", "")


def random_places(n: int, seed: int = 17) -> list[tuple[float, float, float, float]]:
    """Draw height [m], temperature [K], water [mm] and centre of a cell [GHz]; less water at greater heights."""
    rng, found = np.random.default_rng(seed), []
    for _ in range(n):
        height_m = round(rng.uniform(HEIGHTS_M[0], HEIGHTS_M[-1]), 0)
        offset_k = np.clip(rng.uniform(OFFSETS_K[0], OFFSETS_K[-1]), OFFSETS_K[0] + 0.05, OFFSETS_K[-1] - 0.05)
        temperature_k = round(float(air_temperature_k(height_m, offset_k)), 1)  # within the table when rounded
        most_mm = PWV_MM[-1] * np.exp(-height_m / VAPOUR_SCALE_M)
        pwv_mm = float(f"{np.exp(rng.uniform(np.log(PWV_MM[0]), np.log(most_mm))):.4g}")
        found.append((height_m, temperature_k, pwv_mm, float(rng.choice(EDGES_GHZ[:-1])) + 0.5))
    return found


def direct_optical_depth(height_m: float, temperature_k: float, pwv_mm: float, frequency_ghz: float) -> float:
    """Optical depth of one cell above a place, by am."""
    offset_k = temperature_k - float(air_temperature_k(height_m, 0.0))
    base_m = height_m + LAYERS_M
    pressure, temperature = air_pressure_mbar(base_m, offset_k), air_temperature_k(base_m, offset_k)
    columns = zip(pressure, temperature, ozone_columns_cm2(base_m), water_shares(base_m, height_m), strict=True)
    text = "".join(layer(p, t, ozone_cm2=o, water_mm=w * pwv_mm) for p, t, o, w in reversed(list(columns)))
    spectrum, _ = am_opacity(text, first_ghz=frequency_ghz - 0.5, last_ghz=frequency_ghz + 0.5)
    return float(cell_optical_depth(spectrum, ceiling=CEILING)[0])


def main() -> None:
    """Write the table of points."""
    from astropy.table import Table

    rows = [(*place, float(f"{direct_optical_depth(*place):.6g}")) for place in random_places(200)]
    Table(rows=rows, names=COLUMNS, units=UNITS).write(POINTS, overwrite=True)


if __name__ == "__main__":
    main()
