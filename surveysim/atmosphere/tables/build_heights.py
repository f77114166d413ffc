"""Build `opacity_heights.npy`, optical depth by height, air temperature, frequency and water, with `am`.

``python -m surveysim.atmosphere.tables.build_heights``; ten minutes on one core.

The air is that of `surveysim.atmosphere.standard_air`. Ozone is 280 Dobson units in a layer 22 km above the sea.

Layers add their optical depths, so one spectrum of each layer serves all heights. For a fixed layer the optical depth
is a quadratic in its water (lines and foreign continuum are linear, self broadening and self continuum quadratic), so
three spectra serve all columns of water.
"""

from pathlib import Path

import numpy as np

from surveysim.atmosphere.opacity_tables import EDGES_GHZ, HEIGHTS_M, HEIGHTS_TABLE, OFFSETS_K, PWV_MM
from surveysim.atmosphere.standard_air import TOP_M, VAPOUR_SCALE_M, air_pressure_mbar, air_temperature_k
from surveysim.atmosphere.tables.am_spectra import am_opacity, cell_optical_depth, layer

OZONE_CM2, OZONE_HEIGHT_M, OZONE_WIDTH_M = 7.5e18, 22e3, 5e3
# Lower boundaries of the layers above the sea; the last layer has no upper boundary.
LAYERS_M = 1e3 * np.r_[np.arange(0, 9, 0.5), np.arange(9, 14, 1.0), 14, 17, 20, 24, 28, 33, 40]
WET_M = 17e3  # no water above: less than 5e-3 of the column of any height, all of it at low pressure
CEILING = 600.0  # so large that no window at sea level has a kink below it
SEA_LEVEL_WATER_MM = 20.0  # column for which the quadratic of each layer is made


def water_shares(base_m: np.ndarray, ground_m: float) -> np.ndarray:
    """Fraction of the water column in each layer: 0 below the ground and above `WET_M`."""
    above = np.exp(-np.clip(np.append(base_m, np.inf) - ground_m, 0, None) / VAPOUR_SCALE_M)
    share = np.where(base_m < WET_M, above[:-1] - above[1:], 0.0)
    return share / share.sum()


def ozone_columns_cm2(base_m: np.ndarray) -> np.ndarray:
    """Ozone [molecules / cm^2] in each layer."""
    grid = np.arange(0.0, TOP_M + 1)
    density = np.exp(-0.5 * ((grid - OZONE_HEIGHT_M) / OZONE_WIDTH_M) ** 2)
    return OZONE_CM2 * np.add.reduceat(density, np.searchsorted(grid, base_m)) / density.sum()


def layer_coefficients(offset_k: float) -> np.ndarray:
    """Coefficients (3, n_layers, n) of each layer's optical depth as a quadratic in its water [mm]."""
    pressure, temperature = air_pressure_mbar(LAYERS_M, offset_k), air_temperature_k(LAYERS_M, offset_k)
    ozone, waters = ozone_columns_cm2(LAYERS_M), SEA_LEVEL_WATER_MM * water_shares(LAYERS_M, 0.0)
    found = []
    for i, water in enumerate(waters):
        # An empty layer above sets the upper boundary.
        top = layer(pressure[i + 1], temperature[i + 1], air=False) if i + 1 < len(pressure) else ""
        columns = [{"ozone_cm2": ozone[i]}, *({"water_mm": water * part} for part in (0, 0.5, 1) if water)]
        dry, *wet = (_opacity(top + layer(pressure[i], temperature[i], **column)) for column in columns)
        none, half, full = wet or (0 * dry,) * 3
        linear, quadratic = 4 * half - 3 * none - full, 2 * (full - 2 * half + none)
        found.append([dry, linear / (water or 1), quadratic / (water or 1) ** 2])
    return np.swapaxes(found, 0, 1)


def _opacity(layers: str) -> np.ndarray:
    return am_opacity(layers, first_ghz=EDGES_GHZ[0], last_ghz=EDGES_GHZ[-1])[0]


def optical_depths(coefficients: np.ndarray) -> np.ndarray:
    """Optical depth (n_height, n_cell, n_pwv) of cells, from the layers' coefficients at one temperature offset."""
    dry, linear, quadratic = coefficients
    found = []
    for height_m in HEIGHTS_M:
        share = water_shares(LAYERS_M, height_m)
        constant = dry[height_m <= LAYERS_M].sum(axis=0)
        first, second = share @ linear, share**2 @ quadratic
        depths = (constant + pwv * (first + pwv * second) for pwv in PWV_MM)
        found.append([cell_optical_depth(depth, ceiling=CEILING) for depth in depths])
    return np.swapaxes(found, 1, 2)


def main() -> None:
    """Build the table."""
    depth = np.stack([optical_depths(layer_coefficients(offset_k)) for offset_k in OFFSETS_K], axis=1)
    path = Path(__file__).with_name(HEIGHTS_TABLE)
    np.save(path, depth.astype(np.float32))
    print(path, depth.shape)


if __name__ == "__main__":
    main()
