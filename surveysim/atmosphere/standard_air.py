"""Air above a place of any height and temperature, for which the opacity table of all heights is made.

The tropical standard atmosphere (Anderson et al. 1986, AFGL-TR-86-0110, to 1 K) is warmer or colder by an offset: all
of it up to 8 km above the sea, falling linearly to none at 17 km. Pressure is hydrostatic from 1013.25 mbar at sea
level. Water vapour falls exponentially above the ground, with a scale height of 2 km.
"""

import numpy as np

TROPICAL = ((0, 299.7), (2, 287.7), (3, 283.7), (16, 197.0), (17, 194.8), (20, 206.7), (24, 219.2), (40, 254.0))
OFFSET_SHARE = ((0, 1.0), (8, 1.0), (17, 0.0))
SEA_LEVEL_MBAR = 1013.25
GRAVITY_M_S2, GAS_CONSTANT_J_KG_K = 9.80665, 287.05
VAPOUR_SCALE_M = 2000.0
TOP_M = 80e3


def air_temperature_k(height_m: np.ndarray | float, offset_k: float) -> np.ndarray:
    """Air temperature [K] at heights above the sea."""
    (knots, tropical), (steps, share) = (np.array(pairs).T for pairs in (TROPICAL, OFFSET_SHARE))
    km = np.asarray(height_m) / 1e3
    return np.interp(km, knots, tropical) + offset_k * np.interp(km, steps, share)


def air_pressure_mbar(height_m: np.ndarray | float, offset_k: float) -> np.ndarray:
    """Hydrostatic pressure [mbar] at heights above the sea."""
    grid = np.arange(0.0, TOP_M + 1)
    inverse = GRAVITY_M_S2 / GAS_CONSTANT_J_KG_K / air_temperature_k(grid, offset_k)
    depth = np.concatenate([[0.0], np.cumsum(0.5 * (inverse[1:] + inverse[:-1]))])
    return SEA_LEVEL_MBAR * np.exp(-np.interp(height_m, grid, depth))


def temperature_offset_k(height_m: float, temperature_k: float) -> float:
    """Offset [K] from the tropical atmosphere that gives a place its air temperature."""
    return float(temperature_k - air_temperature_k(height_m, 0.0))


def vapour_temperature_k(height_m: float, offset_k: float) -> float:
    """Emission temperature [K] of the vapour: mean of the profile, weighted by vapour density."""
    above = np.arange(0.0, 30e3, 10.0)
    return float(np.average(air_temperature_k(height_m + above, offset_k), weights=np.exp(-above / VAPOUR_SCALE_M)))
