"""Which cleaning is best for one observation: figures of merit for a flat CMB spectrum and for a point source.

A recipe that removes more noise removes more signal, and which wins depends on the weather (paper, section 4.3).
Its noise is that of the observation's own map; what it leaves of the signal is measured once a survey, on the
observations of `REFERENCE`.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from mapmaker.bandpower import flat_spectrum_psd
from mapmaker.binning import bin_map
from mapmaker.geometry import boresight_pixels
from mapmaker.window import beam_window
from surveysim.observation import add_sky_signal, draw_colours, draw_observation
from surveysim.recipes import apply_recipe, what_is_beside
from surveysim.scene import Scene
from surveysim.setup import Setup, observation_path, prepare

REFERENCE = (0, 1)  # one along each direction
TARGETS = ("cmb", "point_source")


def merits(setup: Setup, transmission: np.ndarray, maps: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Figures of merit (n_recipe, 2) of one observation's maps, sums and hits (n_y, n_x) of each recipe.

    For a flat spectrum ``sum n/2 (M T / N)^2`` over the scored bins, sigma(A)^-2 up to a factor; for a point source
    ``sum n B^2 T / N`` over all bins, its squared signal to noise. N is the noise of the map in each bin, T
    (n_recipe, 2, n_bin) what the recipe leaves of the signal's power, n the modes of a bin.
    """
    band, rings = setup.band, setup.band.rings
    rows = band.patch
    noise = np.array([band.ring_noise(total[rows, rows], hits[rows, rows]) for total, hits in maps])
    beam = beam_window(rings.ell, setup.scene.instrument.beam_fwhm_rad)
    flat = flat_spectrum_psd(rings.ell) * beam * transmission[:, 0] / noise
    point = beam * transmission[:, 1] / noise
    return np.stack(
        [(rings.n_modes / 2 * flat**2)[:, band.selected].sum(axis=1), (rings.n_modes * point).sum(axis=1)], 1
    )


def best_places(merits: np.ndarray) -> np.ndarray:
    """Place of the recipe with the highest merit, of merits (n_recipe, ...); -1 where none has any."""
    merits = np.nan_to_num(merits)
    return np.where(merits.max(axis=0) > 0, merits.argmax(axis=0), -1)


@lru_cache(maxsize=2)
def transmissions(scene: Scene) -> np.ndarray:
    """What each recipe leaves of the power of a flat CMB sky and of point sources, (n_recipe, 2, n_bin)."""
    setup = prepare(scene)
    powers = sum(_signal_powers(setup, observation % scene.observations) for observation in REFERENCE)
    # A recipe that discards all scans of the reference leaves nothing.
    return np.divide(powers[:, :, 1], powers[:, :, 0], out=np.zeros_like(powers[:, :, 0]), where=powers[:, :, 0] > 0)


def _signal_powers(setup: Setup, observation: int) -> np.ndarray:
    """Power (n_recipe, 2 signals, 2, n_bin) of sky signals binned without and with cleaning, of one observation."""
    streams = draw_observation(setup, observation)
    _, pointing = observation_path(setup, observation)
    plane, bounds = streams.focal_plane, streams.scan_bounds
    index = boresight_pixels(setup.geometry, pointing.xi_rad, pointing.eta_rad, streams.array_angle_rad, plane)
    rate = setup.raster.sample_rate_hz
    beside = what_is_beside(setup.whole_recipes, streams, draw_colours(setup, observation), rate)
    powers = np.zeros((len(setup.whole_recipes), len(TARGETS), 2, len(setup.band.rings.ell)))
    for s, sky in enumerate((setup.window_skies_mk[0], setup.window_skies_mk[-1])):
        signal = np.zeros_like(streams.data_mk)
        add_sky_signal(setup, pointing, sky, signal, setup.responsivity)
        for r, recipe in enumerate(setup.whole_recipes):
            base, both = (
                apply_recipe(setup.scene.cleaning, recipe, data, bounds, plane, beside, rate)
                for data in (streams.data_mk, streams.data_mk + signal)
            )
            kept = both.kept & base.kept
            for state, data in enumerate((signal, both.data_mk - base.data_mk)):
                powers[r, s, state] = _ring_power(setup, data, index, bounds, kept)
    return powers


def _ring_power(setup: Setup, data_mk, index, bounds, kept) -> np.ndarray:
    """Power of the map of some streams in each bin of multipole, (n_bin,)."""
    item, rows = bin_map(setup.geometry, data_mk, index, bounds, kept), setup.band.patch
    return setup.band.ring_noise(item.weighted_sum[rows, rows], np.ones_like(setup.band.taper))
