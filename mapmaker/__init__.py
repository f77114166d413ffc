"""Cleaning, map-making and map spectra for bolometer arrays: arrays in, arrays out.

The package takes detector positions, time-streams and maps. It knows nothing of scenes, weather or random numbers.
"""

from importlib import import_module
from typing import Any

_PUBLIC = {
    "FocalPlane": "timestreams",
    "Timestreams": "timestreams",
    "read_timestreams": "timestreams",
    "write_timestreams": "timestreams",
    "scan_bounds": "timestreams",
    "fill_flagged": "lost_samples",
    "TemplateOptions": "cleaning",
    "PolynomialOptions": "cleaning",
    "WindOptions": "cleaning",
    "PcaOptions": "cleaning",
    "LocalOptions": "cleaning",
    "SpectralOptions": "cleaning",
    "clean": "cleaning",
    "clean_in_order": "cleaning",
    "live_detectors": "cleaning",
    "measure_wind": "wind",
    "scan_velocities": "wind",
    "pair_bins": "correlations",
    "scan_covariances": "correlations",
    "correlation_profile": "correlations",
    "StreamBlock": "iterative",
    "IterationOptions": "iterative",
    "iterate_map": "iterative",
    "GlsOptions": "gls",
    "gls_map": "gls",
    "MapGeometry": "geometry",
    "covering_geometry": "geometry",
    "mean_direction": "geometry",
    "pixel_indices": "geometry",
    "finest_nside": "geometry",
    "BinnedMap": "binning",
    "bin_map": "binning",
    "coadd": "binning",
    "half_difference": "binning",
    "read_fits": "binning",
    "write_fits": "binning",
    "write_healpix": "binning",
    "tukey_taper": "spectrum",
    "annuli": "spectrum",
    "map_psd": "spectrum",
    "mode_ell": "spectrum",
    "coupled_psd": "spectrum",
    "ring_mean": "spectrum",
    "neighbour_correlation": "spectrum",
    "measure_transfer_function": "transfer_function",
    "measure_amplitude_transfer": "transfer_function",
    "beam_window": "transfer_function",
    "mode_pixel_window": "transfer_function",
    "gaussian_profile": "profiles",
    "beta_profile": "profiles",
    "arnaud_profile": "profiles",
    "profile_power": "matched_filter",
    "filter_depth": "matched_filter",
    "source_filter": "matched_filter",
    "filtered_map": "matched_filter",
    "source_amplitudes": "matched_filter",
    "ModeCoupling": "mode_coupling",
    "flat_coupling": "mode_coupling",
    "curved_coupling": "curved_spectra",
    "plane_distortion": "curved_spectra",
    "BandPowers": "cross_spectra",
    "Covariance": "cross_spectra",
    "cross_band_powers": "cross_spectra",
    "realized_band_powers": "cross_spectra",
    "monte_carlo_covariance": "cross_spectra",
    "chi_squared": "null_tests",
    "null_power": "null_tests",
    "null_test": "null_tests",
    "read_band_powers": "spectrum_files",
    "write_band_powers": "spectrum_files",
    "write_sacc": "spectrum_files",
    "flat_spectrum_psd": "bandpower",
    "flat_band_power": "bandpower",
    "estimate_amplitude": "bandpower",
}
__all__ = list(_PUBLIC)


def __getattr__(name: str) -> Any:
    # Loaded on first use: a kernel costs numba's import.
    if name in _PUBLIC:
        return getattr(import_module(f"mapmaker.{_PUBLIC[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
