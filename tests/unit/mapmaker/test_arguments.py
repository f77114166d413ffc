"""Every public function of mapmaker refuses arguments that do not fit: no crash, no silence.

One table: how each function is called rightly, and what each argument may be changed to.
"""

from dataclasses import replace

import numpy as np
import pytest

import mapmaker as mm
from mapmaker.binning import checked_map
from mapmaker.cleaning.responsivity import fit_responsivity
from mapmaker.cleaning.templates import AVERAGE, subtract_average, subtract_mean, template_basis, template_streams
from mapmaker.geometry import boresight_pixels
from mapmaker.gls import measure_noise, measure_scan_noise
from mapmaker.iterative import significant, subtract_sky
from mapmaker.spectrum import mode_psd
from mapmaker.transfer_function import pixel_window

N_DET, N_SAMP, N_SCAN, SIDE = 19, 240, 3, 12
PIXEL = 1e-4
RNG = np.random.default_rng(8)
BOUNDS = np.array([[0, 80], [80, 160], [160, 240]])
RING = np.array([(a, b) for a in range(-2, 3) for b in range(-2, 3) if abs(a + b) < 3]) * 2e-4
PLANE = mm.FocalPlane(RING[:, 0] + RING[:, 1] / 2, RING[:, 1] * 0.866, 3e-4)
DATA = 10 * np.cumsum(RNG.standard_normal(N_SAMP)) / 15 + RNG.standard_normal((N_DET, N_SAMP))
GEOMETRY = mm.MapGeometry(2.3, 0.7, PIXEL, SIDE, SIDE)
INDEX = RNG.integers(-1, SIDE * SIDE, DATA.shape).astype(np.int32)
INDEX[0, 0] = INDEX[-1, -1] = 3  # on the map
KEPT = np.ones(N_SCAN, bool)
TEMPLATES = mm.TemplateOptions(1e-6, 100)
TAPER = mm.tukey_taper(SIDE, SIDE, PIXEL, size_rad=SIDE * PIXEL, edge_fraction=0.5)
EDGES = np.array([3000.0, 10000.0, 25000.0])
RINGS = mm.annuli(SIDE, SIDE, PIXEL, edges_ell=EDGES, taper=TAPER)
SKIES, HALF, USED = RNG.standard_normal((3, SIDE, SIDE)), np.ones((SIDE, SIDE // 2 + 1)), np.ones(2, bool)
FILTER = mm.source_filter(HALF, np.ones(2), transfer=np.ones(2), mask=USED, rings=RINGS, pixel_rad=PIXEL)
MAP = mm.bin_map(GEOMETRY, DATA, INDEX, BOUNDS, kept=KEPT)
BLOCK = mm.StreamBlock(DATA, INDEX, BOUNDS, PLANE, 1.0)
GLS = mm.GlsOptions(band_edges_hz=(0.0, np.inf), max_modes=1)
BINS = {"signal_psd": np.ones(3), "n_modes": np.full(3, 9.0), "mask": np.ones(3, bool)}
STREAMS = {
    "data_mk": DATA,
    "time_s": np.arange(N_SAMP) / 10,
    "ra_rad": np.full(N_SAMP, 2.3) + np.arange(N_SAMP) * 1e-6,
    "dec_rad": np.full(N_SAMP, 0.7),
    "array_angle_rad": np.zeros(N_SAMP),
    "scan": np.repeat(np.arange(N_SCAN), 80),
    "focal_plane": PLANE,
}
PAIRS = mm.pair_bins(PLANE)
COUPLING = mm.flat_coupling(TAPER, PIXEL, edges_ell=EDGES, beam=np.ones_like)
REALIZED = RNG.standard_normal((9, 2))


def changed(array, place, value):
    array = np.array(array)
    array[place] = value
    return array


def wrong_arrays(array, *, finite=True, least=None):
    """Arrays and other values that no array of real numbers may be."""
    array = np.asarray(array)
    yield from (array[..., :-1], array[None], array.astype(complex), array.astype(str), array.astype(object))
    yield from (np.zeros(0), None, "data", np.ma.masked_array(array, np.arange(array.size).reshape(array.shape) == 1))
    if finite:
        yield changed(array.astype(float), (0,) * array.ndim, np.nan)
        yield changed(array.astype(float), (-1,) * array.ndim, np.inf)
    if least is not None:
        yield changed(array.astype(float), (0,) * array.ndim, least - 1)


def wrong_numbers(least=None, above=None):
    yield from (np.nan, np.inf, 1j, "1", None, [1.0, 2.0])
    if least is not None:
        yield least - 1
    if above is not None:
        yield from (above, above - 1)


def wrong_pixels():
    """Sides of pixels whose powers, or whose numbers of pixels, no float and no integer holds, among others."""
    return [*wrong_numbers(above=0), 1e-320, 1e-300, 1.6, 1e300]


WRONG_BOUNDS = [
    BOUNDS.astype(float),
    BOUNDS[0],
    BOUNDS[:, :1],
    BOUNDS.astype(str),
    BOUNDS.astype(complex),
    BOUNDS + 1,
    BOUNDS - 1,
    BOUNDS[:, ::-1],
    np.array([[0, 80], [40, 120], [160, 240]]),
    np.array([[5, 5]]),
    np.array([[0, 2**40]]),
    None,
]
WRONG_INDEX = [
    INDEX[:, :-1],
    INDEX[0],
    INDEX.astype(float),
    INDEX.astype(object),
    INDEX + SIDE * SIDE,
    changed(INDEX, (3, 7), SIDE * SIDE),
    changed(INDEX, (3, 7), -2),
    changed(INDEX.astype(np.int64), (0, 0), 2**40),
    np.zeros((0, 0), np.int32),
    np.where(INDEX < 0, 255, INDEX % 100).astype(np.uint8),  # -1 in this type
]
WRONG_KEPT = [KEPT[:1], KEPT[:0], np.ones(N_SCAN + 1, bool), KEPT.astype(int), np.arange(2), KEPT[None], None, "yes"]
WRONG_SIZES = [0, -1, 2.5, np.nan, "12", None, True, 1j, 2**31, 2**64, 10**400]
WRONG_STREAMS = [*wrong_arrays(DATA[:, :-1], finite=False), DATA[:-1]]
WRONG_WEIGHTS = [[1.0], [1.0, np.nan], [1.0, -1.0], [np.inf, 1.0], ["1", "1"], [1j, 1.0], 1.0, [[1.0, 1.0]], None, []]
WRONG_MAPS = [
    replace(MAP, **{name: value})
    for name, values in (
        ("weighted_sum", list(wrong_arrays(MAP.weighted_sum))),
        ("weight", list(wrong_arrays(MAP.weight, least=0))),
        ("hits", [MAP.hits[:-1], MAP.hits - 999, MAP.hits.astype(float), None]),
        ("weight_unit", ["Jy", None]),
    )
    for value in values
]


def binned(tmp_path):
    """Functions of binned maps that take any of the wrong ones."""
    yield lambda item: mm.coadd([MAP, item], [1.0, 1.0])
    yield lambda item: mm.half_difference(MAP, item)
    yield lambda item: mm.write_fits(tmp_path / "a.fits", item, {})
    yield lambda item: mm.write_healpix(tmp_path / "a.fits", item, 512)
    yield lambda item: significant(item, 1e-4, 5.0, 0.1)
    yield checked_map


# Name, function, right arguments, and wrong values of some of them.
TABLE = [
    (mm.fill_flagged, {"data_mk": DATA, "scan_bounds": BOUNDS, "flagged": DATA > 0},
     {"data_mk": [DATA[0], DATA[:-1], DATA.astype(complex), "abc", None], "scan_bounds": WRONG_BOUNDS,
      "flagged": [(DATA > 0)[:-1], (DATA > 0)[0], DATA, None, "abc"]}),
    (mm.bin_map, {"geometry": GEOMETRY, "data_mk": DATA, "index": INDEX, "bounds": BOUNDS, "kept": KEPT},
     {"data_mk": [*wrong_arrays(DATA)], "index": WRONG_INDEX, "bounds": WRONG_BOUNDS, "kept": WRONG_KEPT}),
    (mm.coadd, {"maps": [MAP, MAP], "weights": [1.0, 2.0]}, {"weights": WRONG_WEIGHTS, "maps": [[], [MAP]]}),
    (mm.MapGeometry, {"ra0_rad": 2.3, "dec0_rad": 0.7, "pixel_rad": PIXEL, "n_x": 3, "n_y": 4},
     {"ra0_rad": wrong_numbers(), "dec0_rad": wrong_numbers(least=-1), "pixel_rad": wrong_pixels(),
      "n_x": WRONG_SIZES, "n_y": WRONG_SIZES}),
    (mm.covering_geometry, {"ra0_rad": 2.3, "dec0_rad": 0.7, "pixel_rad": PIXEL, "half_extent_rad": 1e-3},
     {"pixel_rad": wrong_pixels(), "half_extent_rad": wrong_numbers(above=0)}),
    (mm.mean_direction, {"ra_rad": np.ones(3), "dec_rad": np.ones(3)},
     {"ra_rad": [*wrong_arrays(np.ones(3))], "dec_rad": [*wrong_arrays(np.ones(3))]}),
    (mm.finest_nside, {"pixel_rad": PIXEL}, {"pixel_rad": wrong_pixels()}),
    (boresight_pixels, {"geometry": GEOMETRY, "xi_rad": np.zeros(4), "eta_rad": np.zeros(4),
                        "plane_angle_rad": np.zeros(4), "plane": PLANE},
     {name: wrong_arrays(np.zeros(4), finite=False) for name in ("eta_rad", "plane_angle_rad")}),
    (mm.FocalPlane, {"x_rad": PLANE.x_rad, "y_rad": PLANE.y_rad, "fwhm_rad": 1e-4},
     {"x_rad": wrong_arrays(PLANE.x_rad), "y_rad": wrong_arrays(PLANE.y_rad), "fwhm_rad": wrong_numbers(above=0)}),
    (PLANE.subset, {"detectors": [1, 2]},
     {"detectors": [[N_DET], [-N_DET - 1], [1.5], np.ones(3, bool), [], "1", None, np.zeros(N_DET, bool), [[1]]]}),
    (mm.Timestreams, STREAMS,
     {"data_mk": WRONG_STREAMS,
      **{name: wrong_arrays(STREAMS[name]) for name in ("time_s", "ra_rad", "dec_rad", "array_angle_rad")},
      "scan": [np.zeros(N_SAMP), np.zeros(3, int), np.arange(N_SAMP) % 2, np.full(N_SAMP, 255, np.uint8), None]}),
    (mm.scan_bounds, {"scan": [0, 0, 1]},
     {"scan": [[0, 1, 0], [0.0, 1.0], ["a"], [], [[0]], np.array([1, 255], np.uint8), np.array([2**16 - 1], "u2"),
               np.array([2**64 - 1], "u8")]}),
    (mm.live_detectors, {"data_mk": DATA, "scan_bounds": BOUNDS},
     {"data_mk": [DATA[0], DATA.astype(complex), np.zeros((0, 0))], "scan_bounds": WRONG_BOUNDS}),
    *[(mm.clean, {"name": name, "data_mk": DATA, "scan_bounds": BOUNDS, "focal_plane": PLANE, "options": options},
       {"name": ["cubic", None, ["average"]], "data_mk": WRONG_STREAMS, "scan_bounds": WRONG_BOUNDS,
        "options": [None, "fast", object]})
      for name, options in {"average": TEMPLATES, "polynomial": mm.PolynomialOptions(1, 1, 1e-6, 100),
                            "wind": mm.WindOptions(np.full((3, 2), 1e-2), 10.0, 1e-6, 100), "pca": mm.PcaOptions(3.0),
                            "local": mm.LocalOptions(), "spectral": mm.SpectralOptions(DATA[None])}.items()],
    *[(subtract, {"data_mk": DATA, "scan_bounds": BOUNDS, "focal_plane": PLANE, "options": TEMPLATES},
       {"data_mk": WRONG_STREAMS, "scan_bounds": WRONG_BOUNDS}) for subtract in (subtract_mean, subtract_average)],
    (fit_responsivity, {"blocks": lambda: [DATA], "basis": template_basis(PLANE, AVERAGE), "options": TEMPLATES},
     {"blocks": [lambda: [DATA[:-1]], lambda: [np.ones((N_DET + 1, 9))]]}),
    (template_streams, {"data_mk": DATA, "scan_bounds": BOUNDS, "focal_plane": PLANE,
                        "responsivity": np.ones((N_SCAN, N_DET)), "exponents": AVERAGE, "place_rad": (0.0, 0.0)},
     {"data_mk": WRONG_STREAMS, "responsivity": wrong_arrays(np.ones((N_SCAN, N_DET)), finite=False),
      "place_rad": [(0.0,), (0.0, np.nan), "ab", None]}),
    (mm.clean_in_order, {"steps": [("average", TEMPLATES)], "data_mk": DATA, "scan_bounds": BOUNDS,
                         "focal_plane": PLANE},
     {"steps": [[], [("average",)], ["average"], [("cubic", TEMPLATES)]], "data_mk": WRONG_STREAMS}),
    (mm.TemplateOptions, {"tolerance": 1e-8, "max_iterations": 9, "responsivities": np.ones(3)},
     {"tolerance": wrong_numbers(above=0), "max_iterations": WRONG_SIZES,
      "responsivities": ["all", [0.0, 1.0], [np.nan], [[1.0]], [1j], []]}),
    (mm.PolynomialOptions, {"order": 1, "regions": 1, "tolerance": 1e-8, "max_iterations": 9},
     {"order": [-1, 1.5, 10**6, "1"], "regions": WRONG_SIZES}),
    (mm.PcaOptions, {"sigma_cut": 3.0}, {"sigma_cut": [*wrong_numbers(above=0), 1e200]}),
    (mm.HighpassOptions, {"corner_hz": 0.2, "sample_rate_hz": 9.0, "order": 2},
     {"corner_hz": [*wrong_numbers(above=0), 4.5], "sample_rate_hz": wrong_numbers(above=0), "order": [0, 1.5, 21]}),
    (mm.NotchOptions, {"frequencies_hz": (1.4, 3.0), "widths_hz": (0.0, 0.1), "sample_rate_hz": 9.0},
     {"frequencies_hz": [(0.0, 1.0), (1.0, 4.5), (1.0,), (1.0, np.nan), "ab", None],
      "widths_hz": [(0.0,), (-0.1, 0.0), (0.0, 9.0), "ab", None], "sample_rate_hz": wrong_numbers(above=0)}),
    (mm.TimePolynomialOptions, {"order": 1}, {"order": [0, 1.5, 21, "1"]}),
    (mm.LocalOptions, {"neighbour_radius": 1.2}, {"neighbour_radius": wrong_numbers(above=1)}),
    (mm.WindOptions, {"slowness_s_rad": np.zeros((3, 2)), "sample_rate_hz": 9.0, "tolerance": 1e-8,
                      "max_iterations": 9},
     {"slowness_s_rad": wrong_arrays(np.zeros((3, 2))), "sample_rate_hz": wrong_numbers(above=0)}),
    (mm.SpectralOptions, {"others_mk": DATA[None]},
     {"others_mk": [DATA, DATA[None].astype(complex), None, np.zeros((0, 1, 2))]}),
    (mm.StreamBlock, {"data_mk": DATA, "index": INDEX, "scan_bounds": BOUNDS, "focal_plane": PLANE, "weight": 1.0},
     {"data_mk": WRONG_STREAMS, "index": [INDEX[:, :-1], INDEX.astype(float), INDEX - 2], "scan_bounds": WRONG_BOUNDS,
      "weight": wrong_numbers(least=0)}),
    (mm.iterate_map, {"geometry": GEOMETRY, "observations": lambda: [BLOCK],
                      "clean_block": lambda b: mm.clean("none", b.data_mk, b.scan_bounds, PLANE, options=None),
                      "options": mm.IterationOptions(max_iterations=1)},
     {"observations": [lambda: [], lambda: [replace(BLOCK, index=INDEX + SIDE * SIDE)]]}),
    (mm.IterationOptions, {"threshold": 5.0, "loss": 0.2, "tolerance": 1e-3, "max_iterations": 9},
     {"threshold": wrong_numbers(above=0), "loss": [*wrong_numbers(least=0), 1.0], "tolerance": wrong_numbers(above=0),
      "max_iterations": WRONG_SIZES}),
    (mm.gls_map, {"geometry": GEOMETRY, "observations": lambda: [BLOCK], "sample_rate_hz": 10.0, "options": GLS,
                  "sky_mk": np.zeros((1, SIDE, SIDE))},
     {"observations": [lambda: [], lambda: [replace(BLOCK, index=INDEX + SIDE * SIDE)]],
      "sample_rate_hz": wrong_numbers(above=0),
      "sky_mk": [v for v in wrong_arrays(np.zeros((1, SIDE, SIDE))) if v is not None]}),
    (mm.GlsOptions, {"band_edges_hz": (0.0, 1.0)},
     {"band_edges_hz": [(1.0,), (1.0, 1.0), (-1.0, 1.0), (0.0, np.nan), (np.nan, 1.0), (0, np.inf, np.inf), "ab", None],
      "max_modes": [-1, 1.5, "1"], "eigenvalue_cut": wrong_numbers(least=1),
      "folds": [1, 2.5, "2", None]}),
    (mm.DestripeOptions, {"baseline": 10}, {"baseline": [0, 1, 1.5, "2", True, None]}),
    (mm.destriped_map, {"geometry": GEOMETRY, "observations": lambda: [BLOCK], "options": mm.DestripeOptions(10)},
     {"observations": [lambda: [], lambda: [replace(BLOCK, index=INDEX + SIDE * SIDE)]]}),
    (mm.SolveOptions, {"tolerance": 1e-5, "max_iterations": 9},
     {"tolerance": wrong_numbers(above=0), "max_iterations": WRONG_SIZES}),
    (measure_scan_noise, {"data_mk": DATA, "scan_bounds": BOUNDS, "focal_plane": PLANE,
                     "sample_rate_hz": 10.0, "options": GLS},
     {"data_mk": [changed(DATA, (0, 0), np.nan), DATA[0], DATA.astype(complex)],
      "sample_rate_hz": wrong_numbers(above=0), "scan_bounds": [*WRONG_BOUNDS, np.zeros((0, 2), int)]}),
    (measure_noise, {"data_mk": DATA, "scan_bounds": BOUNDS, "focal_plane": PLANE,
                     "sample_rate_hz": 10.0, "options": GLS},
     {"data_mk": [changed(DATA, (0, 0), np.nan), DATA[0], DATA.astype(complex)],
      "sample_rate_hz": wrong_numbers(above=0), "scan_bounds": [*WRONG_BOUNDS, np.zeros((0, 2), int)]}),
    (subtract_sky, {"block": BLOCK, "sky_mk": np.zeros((1, SIDE, SIDE))},
     {"sky_mk": wrong_arrays(np.zeros((1, SIDE, SIDE)))}),
    (mm.measure_wind, {"data_mk": DATA, "scan_bounds": BOUNDS, "focal_plane": PLANE, "sample_rate_hz": 10.0,
                       "scan_velocity_rad_s": np.zeros((3, 2))},
     {"data_mk": [*WRONG_STREAMS, changed(DATA, (0, 0), np.nan)], "scan_bounds": [*WRONG_BOUNDS, BOUNDS[:2]],
      "sample_rate_hz": [*wrong_numbers(above=0), 1.5], "scan_velocity_rad_s": wrong_arrays(np.zeros((3, 2)))}),
    (mm.scan_covariances, {"data_mk": DATA, "scan_bounds": BOUNDS},
     {"data_mk": [*wrong_arrays(DATA[:, :-1], finite=False), changed(DATA, (0, 0), np.nan)][1:],
      "scan_bounds": WRONG_BOUNDS}),
    (mm.correlation_profile, {"covariances_mk2": mm.scan_covariances(DATA, BOUNDS), "bins": PAIRS},
     {"covariances_mk2": [np.ones((3, N_DET - 1, N_DET - 1)), np.ones((N_DET, N_DET)),
                          np.full((1, N_DET, N_DET), np.nan),
                          np.ones((0, N_DET, N_DET)), np.ones((1, N_DET, N_DET), complex)]}),
    (mm.tukey_taper, {"n_y": 9, "n_x": 9, "pixel_rad": PIXEL, "size_rad": 5e-4, "edge_fraction": 0.5},
     {"n_y": WRONG_SIZES, "n_x": WRONG_SIZES, "pixel_rad": wrong_pixels(), "size_rad": wrong_numbers(above=0),
      "edge_fraction": [*wrong_numbers(least=0), 1.1]}),
    (mm.mode_ell, {"n_y": 9, "n_x": 9, "pixel_rad": PIXEL},
     {"n_y": WRONG_SIZES, "n_x": WRONG_SIZES, "pixel_rad": wrong_pixels()}),
    (mm.annuli, {"n_y": SIDE, "n_x": SIDE, "pixel_rad": PIXEL, "edges_ell": EDGES, "taper": TAPER},
     {"n_y": [SIDE + 1, *WRONG_SIZES], "pixel_rad": wrong_pixels(), "taper": [*wrong_arrays(TAPER), 0 * TAPER],
      "edges_ell": [EDGES[::-1], EDGES[:1], [1.0, np.nan], EDGES[None], "ab", [1e9, 2e9], None, []]}),
    *[(of, {"map_mk": np.ones((2, SIDE, SIDE)), "taper": TAPER, "pixel_rad": PIXEL} | more,
       {"map_mk": [np.ones(SIDE), np.ones((SIDE, SIDE + 4)), np.full((SIDE, SIDE), np.nan),
                   np.ones((SIDE, SIDE), complex)],
        "taper": [*wrong_arrays(TAPER), 0 * TAPER], "pixel_rad": wrong_pixels()})
      for of, more in ((mode_psd, {}), (mm.map_psd, {"rings": RINGS}))],
    (mm.ring_mean, {"values": np.ones(RINGS.bin_of_mode.size), "rings": RINGS},
     {"values": [np.ones(3), np.full(RINGS.bin_of_mode.size, np.nan), "a", None,
                 np.ones(RINGS.bin_of_mode.size, complex)]}),
    (mm.coupled_psd, {"sky_psd": np.ones((24, 13)), "sky_shape": (24, 24), "taper": TAPER, "pixel_rad": PIXEL},
     {"sky_psd": wrong_arrays(np.ones((24, 13)), least=0),
      "sky_shape": [(24, 25, 26), (24,), (23, 24), (2.5, 24), ("a", 1)],
      "taper": [np.ones(3), np.full((SIDE, SIDE), np.nan), 0 * TAPER], "pixel_rad": wrong_pixels(),
      "cells_per_pixel": WRONG_SIZES}),
    (mm.neighbour_correlation, {"taper": TAPER, "rings": RINGS}, {"taper": [*wrong_arrays(TAPER), 0 * TAPER]}),
    *[(of, {"ell": np.ones(3), name: 1e-4},
       {"ell": [[1.0, np.nan], "ab", [1j], None], name: [*wrong_numbers(least=0), 1e300]})
      for of, name in ((mm.beam_window, "fwhm_rad"), (pixel_window, "pixel_rad"))],
    (mm.mode_pixel_window, {"n_y": 8, "n_x": 8, "cell_rad": PIXEL, "pixel_rad": PIXEL},
     {"n_y": WRONG_SIZES, "n_x": WRONG_SIZES, "cell_rad": wrong_pixels(), "pixel_rad": wrong_pixels()}),
    (mm.measure_transfer_function,
     {"psd_cleaned": np.ones((3, 4)), "psd_reference": np.ones((3, 4)), "ell": np.ones(4)},
     {"psd_cleaned": wrong_arrays(np.ones((3, 4)), least=0), "psd_reference": wrong_arrays(np.ones((3, 4)), least=0),
      "ell": wrong_arrays(np.ones(4))}),
    (mm.measure_amplitude_transfer,
     {"cleaned": SKIES, "reference": SKIES, "taper": TAPER, "pixel_rad": PIXEL, "rings": RINGS},
     {"cleaned": wrong_arrays(SKIES), "reference": [*wrong_arrays(SKIES), 0 * SKIES], "pixel_rad": wrong_pixels(),
      "taper": [*wrong_arrays(TAPER), 0 * TAPER]}),
    (mm.gaussian_profile, {"ell": np.ones(3), "fwhm_rad": 1e-4},
     {"ell": [[1.0, np.nan], "ab", [1j], None], "fwhm_rad": [*wrong_numbers(above=0), 1e300]}),
    (mm.beta_profile, {"ell": np.ones(3), "core_radius_rad": 1e-4, "beta": 1.0},
     {"ell": [[1.0, np.nan], [0.0], "ab", [1j], None], "core_radius_rad": [*wrong_numbers(above=0), 1e300],
      "beta": [*wrong_numbers(above=1 / 3), 1e3]}),
    (mm.arnaud_profile, {"ell": np.ones(3), "theta_500_rad": 1e-4},
     {"ell": [[1.0, np.nan], "ab", [1j], None], "theta_500_rad": [*wrong_numbers(above=0), 1e300]}),
    (mm.profile_power, {"profile": np.ones_like, "edges_ell": EDGES},
     {"edges_ell": [EDGES[::-1], EDGES[:1], [1.0, np.nan], -EDGES[::-1], "ab", None]}),
    (mm.filter_depth, {"noise_psd": np.ones(2), "power": np.ones(2), "transmission": np.ones(2), "mask": USED},
     {"noise_psd": [np.ones(3), np.zeros(2), np.full(2, np.nan), "ab"],
      "power": [*wrong_arrays(np.ones(2), least=0), np.zeros(2)],
      "transmission": wrong_arrays(np.ones(2), least=0), "mask": [np.ones(2), np.zeros(2, bool), [1, 0], None]}),
    (mm.source_filter, {"profile": HALF, "noise_psd": np.ones(2), "transfer": np.ones(2), "mask": USED,
                         "rings": RINGS, "pixel_rad": PIXEL},
     {"profile": [*wrong_arrays(HALF), 0 * HALF], "noise_psd": [np.ones(3), np.zeros(2), np.full(2, np.nan), "ab"],
      "transfer": wrong_arrays(np.ones(2)), "mask": [np.ones(3, bool), np.ones(2), np.zeros(2, bool), None],
      "pixel_rad": wrong_pixels()}),
    (mm.filtered_map, {"item": FILTER, "map_mk": SKIES[0], "weight": TAPER},
     {"map_mk": [*wrong_arrays(SKIES[0]), np.ones((SIDE + 1, SIDE))],
      "weight": wrong_arrays(TAPER, least=0)}),
    (mm.source_amplitudes, {"item": FILTER, "map_mk": SKIES[0], "weight": TAPER, "row": [3.0], "column": [4.5]},
     {"row": [[np.nan], [[1.0]], [1.0, 2.0], None, "1"], "column": [[np.inf], [], [1j]]}),
    (mm.flat_spectrum_psd, {"ell": np.ones(3)}, {"ell": [[np.nan], [-1.0], "ab", [1j], None, [np.inf]]}),
    (mm.flat_band_power, {"noise_psd_ukcmb2": np.ones(3), **BINS},
     {"noise_psd_ukcmb2": [np.ones(2), 0 * np.ones(3), np.full(3, np.nan), np.ones(3, complex), ["a"] * 3],
      "signal_psd": [np.zeros(3), np.full(3, np.nan), np.ones(2), np.ones(3, complex)],
      "n_modes": [np.zeros(3), np.full(3, np.inf), np.ones(2), None],
      "mask": [np.ones(3), np.zeros(3, bool), [1, 0, 1], None]}),
    (mm.estimate_amplitude, {"psd_ukcmb2": np.ones((2, 3)), "noise_psd_ukcmb2": np.ones(3), **BINS},
     {"psd_ukcmb2": [np.ones((2, 4)), np.full(3, np.nan), np.ones(3, complex), "abc", None]}),
    (mm.flat_coupling, {"taper": TAPER, "pixel_rad": PIXEL, "edges_ell": EDGES, "beam": np.ones_like},
     {"taper": [*wrong_arrays(TAPER)][1:] + [0 * TAPER], "pixel_rad": wrong_pixels(),
      "edges_ell": [EDGES[::-1], EDGES[:1], [1.0, np.nan], EDGES[None], "ab", [1e9, 2e9], -EDGES[::-1], None, []],
      "beam": [lambda ell: -ell, lambda ell: ell[:-1], lambda ell: ell * np.nan, lambda ell: 0 * ell],
      "transfer": [np.ones(3), np.zeros(2), -np.ones(2), np.ones(2, complex), "ab"],
      "sky_shape": [(24, 25, 26), (24,), (2.5, 24), ("a", 1)], "cells_per_pixel": WRONG_SIZES[:-3]}),
    (mm.plane_distortion, {"taper": TAPER, "pixel_rad": PIXEL},
     {"taper": [*wrong_arrays(TAPER)][1:] + [0 * TAPER], "pixel_rad": wrong_pixels()}),
    (mm.curved_coupling, {"taper": np.ones(48), "edges_ell": [1.0, 3.0], "beam": np.ones_like},
     {"taper": [*wrong_arrays(np.ones(48)), np.zeros(48)],
      "edges_ell": [[3.0, 1.0], [1.0], [1.0, np.nan], [[1.0, 3.0]], "ab", [1.0, 5.0], [-1.0, 3.0], None, []],
      "beam": [lambda ell: -ell, lambda ell: ell[:-1]], "transfer": [np.ones(3), [0.0], "ab"]}),
    (mm.cross_band_powers, {"maps_uk": SKIES, "coupling": COUPLING},
     {"maps_uk": [*wrong_arrays(SKIES), SKIES[:1]], "signal_uk2": [np.ones(3), "ab", np.ones(2, complex)]}),
    (mm.realized_band_powers, {"maps_uk": SKIES, "coupling": COUPLING},
     {"maps_uk": [SKIES[..., :-1], SKIES[0], SKIES[:1], changed(SKIES, (0, 0, 0), np.nan), "ab", None]}),
    (mm.monte_carlo_covariance, {"realized_uk2": REALIZED},
     {"realized_uk2": [REALIZED[0], REALIZED[:1], REALIZED[None], REALIZED.astype(complex), "ab", None, []]}),
    (mm.chi_squared, {"residual_uk2": np.ones(2), "covariance": mm.Covariance(np.eye(2), 0)},
     {"residual_uk2": [np.ones(3), np.ones((1, 2)), np.full(2, np.nan), np.ones(2, complex), "ab", None, []],
      "covariance": [mm.Covariance(np.eye(3), 0), mm.Covariance(np.full((2, 2), np.nan), 0)],
      "mask": [np.ones(2), np.zeros(2, bool), [True], "ab"]}),
    (mm.null_power, {"pair_uk": SKIES[:2], "coupling": COUPLING},
     {"pair_uk": [SKIES, SKIES[0], SKIES[:2, :-1], changed(SKIES[:2], (0, 0, 0), np.nan), "ab", None]}),
    (mm.null_test, {"power": np.ones(2), "realized": REALIZED**2, "coupling": COUPLING},
     {"power": [np.ones(3), np.full(2, np.nan), np.zeros(2), "ab", None],
      "realized": [REALIZED[:1] ** 2, REALIZED[0] ** 2, REALIZED, None],
      "mask": [np.ones(2), np.zeros(2, bool), [True]], "common": [*wrong_numbers(least=0), 1.0]}),
]  # fmt: skip
CASES = [
    pytest.param(function, right, name, list(values), id=f"{row}-{function.__name__}-{name}")
    for row, (function, right, wrong) in enumerate(TABLE)
    for name, values in wrong.items()
]


@pytest.mark.parametrize("row", range(len(TABLE)), ids=lambda row: f"{row}-{TABLE[row][0].__name__}")
def test_right_arguments_pass(row):
    function, right, _ = TABLE[row]
    function(**right)


@pytest.mark.parametrize("function, right, name, values", CASES)
def test_wrong_arguments_are_refused(function, right, name, values):
    for value in values:
        with pytest.raises(ValueError) as caught:
            function(**(right | {name: value}))
        text = str(caught.value)
        assert "\n" not in text and len(text) < 300


def test_wrong_maps_are_refused(tmp_path):
    for function in binned(tmp_path):
        for number, item in enumerate(WRONG_MAPS):
            with pytest.raises(ValueError, match="found"):
                function(item)
                pytest.fail(f"map {number} passed")
    assert not list(tmp_path.iterdir())


def test_every_public_function_has_a_row():
    named = {function.__name__ for function, _, _ in TABLE}
    # These take records that have been checked, or files; maps are above.
    others = {"read_timestreams", "write_timestreams", "read_fits", "write_fits", "write_healpix", "half_difference"}
    others |= {"read_band_powers", "write_band_powers", "write_null_tests", "write_sacc"}
    records = {"BinnedMap", "Timestreams", "pixel_indices", "scan_velocities", "pair_bins", "measure_wind"}
    records |= {"ModeCoupling", "BandPowers", "Covariance", "ChiSquared", "NullTest"}
    assert set(mm.__all__) <= named | others | records


@pytest.mark.parametrize("kind", [">f8", ">f4", "<f4", "f2", "i2", ">i4", "u1", "i8"])
def test_other_real_types_are_converted(kind):
    """The same map from the same numbers, whatever their type and the order of their bytes."""
    data = np.rint(8 * RNG.standard_normal(DATA.shape)) % 50
    expected = mm.bin_map(GEOMETRY, data, INDEX, BOUNDS, kept=KEPT).weighted_sum
    found = mm.bin_map(GEOMETRY, data.astype(kind), INDEX.astype(">i8"), BOUNDS.astype(">u2"), kept=KEPT)
    np.testing.assert_array_equal(found.weighted_sum, expected)
    cleaned = mm.clean("none", data.astype(kind), BOUNDS.tolist(), PLANE, options=None)
    assert cleaned.data_mk.dtype == (np.float32 if kind in (">f4", "<f4") else np.float64)
    assert cleaned.data_mk.dtype.isnative
    np.testing.assert_allclose(cleaned.data_mk.mean(axis=1), 0, atol=1e-5)


def test_values_that_are_not_used_may_be_anything():
    data = DATA.copy()
    data[:, 80:160] = np.nan
    data[4, 3] = np.inf
    index = INDEX.copy()
    index[4, 3] = -1  # off the map
    found = mm.bin_map(GEOMETRY, data, index, BOUNDS, kept=np.array([True, False, True]))
    assert np.isfinite(found.weighted_sum).all() and found.hits.sum() == (index[:, np.r_[0:80, 160:240]] >= 0).sum()


def test_hits_do_not_overflow():
    many = replace(MAP, hits=np.full((1, SIDE, SIDE), 2**31 - 1, np.int32))
    assert mm.coadd([many, many], [1.0, 1.0]).hits.max() == 2 * (2**31 - 1)


def test_unsigned_pixels_in_a_map_that_has_the_largest():
    """Pixel 255 of a larger map is what -1 becomes in 8 bits."""
    large = replace(GEOMETRY, n_x=20, n_y=20)
    with pytest.raises(ValueError, match="index: found 255, which is -1 in the type uint8"):
        mm.bin_map(large, DATA, INDEX.astype(np.uint8), BOUNDS, kept=KEPT)


def test_no_scans_make_an_empty_map():
    for bounds in ([], np.zeros((0, 2)), np.zeros((0, 2), int)):
        assert not mm.bin_map(GEOMETRY, DATA, INDEX, bounds, kept=[]).hits.any()


def test_quantities_are_refused():
    """Numpy would drop the unit."""
    from astropy import units as u

    with pytest.raises(ValueError, match="fwhm_rad: found a quantity in arcmin; plain numbers in the unit of fwhm_rad"):
        mm.FocalPlane([0.0], [0.0], 1 * u.arcmin)
    with pytest.raises(ValueError, match="data_mk: found a quantity in K"):
        mm.bin_map(GEOMETRY, DATA * u.K, INDEX, BOUNDS, kept=KEPT)


@pytest.mark.parametrize(
    "tolerance, most", [(np.float16(1e-3), np.uint64(100)), (np.float32(1e-3), np.int8(100)), (1, 100)]
)
def test_options_of_any_type_of_number(tolerance, most):
    """The loop is compiled for one."""
    expected = mm.clean("average", DATA, BOUNDS, PLANE, options=mm.TemplateOptions(float(tolerance), 100))
    found = mm.clean("average", DATA, BOUNDS, PLANE, options=mm.TemplateOptions(tolerance, most))
    np.testing.assert_array_equal(found.data_mk, expected.data_mk)
