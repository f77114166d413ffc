"""Cleaning pipelines: algorithms in order, their options, and the data set of each."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mapmaker.cleaning import (
    TEMPLATE_CLEANINGS,
    TIME_FILTERS,
    Cleaned,
    HighpassOptions,
    LocalOptions,
    NotchOptions,
    PcaOptions,
    PolynomialOptions,
    SpectralOptions,
    TemplateOptions,
    TimePolynomialOptions,
    WindOptions,
    clean_in_order,
    detectors_needed,
)
from mapmaker.cleaning.responsivity import SCAN, Responsivities
from mapmaker.cleaning.time_filters import TimeFilterOptions
from mapmaker.timestreams import FocalPlane
from surveysim.scene.analysis import PCA_KEYS, Cleaning

ACTUAL, OPTIMAL = "actual", "optimal"
_ANY_RATE_HZ = 1e10  # sample rate above the frequencies of all filters


@dataclass(frozen=True)
class CleaningPipeline:
    """Cleaning steps in order, for all detectors or (`detectors`) some, and the name of their data set."""

    data_set: str
    steps: tuple[str, ...]
    detectors: np.ndarray | None = None

    @property
    def label(self) -> str:
        """Names of the steps, joined."""
        return "+".join(self.steps)

    @property
    def spatial_step(self) -> str | None:
        """Name of the one step that is no filter in time, "none" without any; None for several."""
        found = [name for name in self.steps if name not in ("none", *TIME_FILTERS)]
        return "none" if not found else found[0] if len(found) == 1 else None

    def uses(self, name: str) -> bool:
        """Tell whether a step is the named algorithm."""
        return name in self.steps

    @property
    def takes_responsivities(self) -> bool:
        """Return whether a step subtracts templates times responsivities."""
        return not set(self.steps).isdisjoint(TEMPLATE_CLEANINGS)

    @property
    def rows(self) -> np.ndarray | slice:
        """Index of the detectors in the streams."""
        return slice(None) if self.detectors is None else self.detectors


def pipelines(section: Cleaning, masked: np.ndarray | None) -> tuple[CleaningPipeline, ...]:
    """List the scene's own pipeline, those it is compared with, and its own on the masked array."""
    found = [CleaningPipeline(ACTUAL, section.algorithm)]
    found += [CleaningPipeline("+".join(steps), steps) for steps in section.compare]
    if masked is not None:
        found.append(CleaningPipeline(f"masked_{len(masked)}", section.algorithm, masked))
    return tuple(found)


@dataclass(frozen=True)
class AuxiliaryData:
    """Inputs of cleaning other than the streams.

    Attributes
    ----------
    delays_s_rad : (n_scan, 2)
        Slowness of the layer, by which the wind model shifts.
    other_bands_mk : (n_band, n_det, n_samp)
        Streams of the other bands of all detectors.
    calibration : (1 + n_band, n_det)
        Known responsivities in the mapped band and the others; None where they are fitted.
    first_guess : (n_scan, n_det)
        Responsivities of the pipeline's detectors that fits to the mapped band begin with; None without any.
    """

    delays_s_rad: np.ndarray
    other_bands_mk: np.ndarray
    calibration: np.ndarray | None = None
    first_guess: np.ndarray | None = None


def step_options(
    section: Cleaning,
    name: str,
    auxiliary: AuxiliaryData,
    sample_rate_hz: float,
    *,
    responsivities: Responsivities,
    first_guess: np.ndarray | None = None,
) -> Any:
    """Make the record of options of one step."""
    template = (section.tolerance, section.max_iterations, responsivities, first_guess)
    if name in TIME_FILTERS:
        return filter_options(section, name, sample_rate_hz)
    if name == "wind":
        return WindOptions(auxiliary.delays_s_rad, sample_rate_hz, *template)
    if name == "spectral":
        return SpectralOptions(auxiliary.other_bands_mk)
    if name == "pca":
        return _pca_options(section)
    if name == "local":
        return LocalOptions(section.neighbour_radius)
    if name == "polynomial":
        return PolynomialOptions(section.order, section.regions, *template)
    return TemplateOptions(*template)


def filter_options(section: Cleaning, name: str, sample_rate_hz: float) -> TimeFilterOptions:
    """Make the record of options of a filter in time."""
    if name == "highpass":
        return HighpassOptions(section.highpass_frequency_hz, sample_rate_hz, section.highpass_order)
    if name == "notch":
        return NotchOptions(section.notch_frequencies_hz, section.notch_widths_hz, sample_rate_hz)
    return TimePolynomialOptions(section.time_order)


def _pca_options(section: Cleaning) -> PcaOptions:
    criterion = section.pca_criterion
    key = PCA_KEYS.get(criterion)
    return PcaOptions(criterion=criterion, **({} if key is None else {criterion: getattr(section, key)}))


def needed_detectors(section: Cleaning, name: str) -> int:
    """Count the detectors that one step needs."""
    nothing = AuxiliaryData(np.zeros((1, 2)), np.zeros((1, 1, 1)))
    return detectors_needed(name, step_options(section, name, nothing, _ANY_RATE_HZ, responsivities=SCAN))


def apply_pipeline(
    section: Cleaning,
    pipeline: CleaningPipeline,
    data_mk: np.ndarray,
    *,
    scan_bounds: np.ndarray,
    focal_plane: FocalPlane,
    auxiliary: AuxiliaryData,
    sample_rate_hz: float,
) -> Cleaned:
    """Clean the streams (n_det, n_samp) of the detectors of a pipeline.

    The other bands are cleaned by the same steps before their spectral common mode is subtracted.

    Parameters
    ----------
    data_mk, focal_plane
        Streams and positions of the pipeline's detectors alone.
    auxiliary
        Auxiliary data of all detectors.
    """
    others = auxiliary.other_bands_mk[:, pipeline.rows]
    known = [section.responsivities] * (1 + len(others))
    if auxiliary.calibration is not None:
        known = list(auxiliary.calibration[:, pipeline.rows])
    # Steps of the mapped band and of the others, which differ in the responsivities.
    bands: list[list[tuple[str, Any]]] = [[] for _ in known]
    for name in pipeline.steps:
        if name == "spectral" and bands[0]:
            alike = zip(bands[1:], others, strict=True)
            others = np.array([_cleaned_alike(steps, band_mk, scan_bounds, focal_plane) for steps, band_mk in alike])
        of_rows = replace(auxiliary, other_bands_mk=others)
        for band, (steps, responsivities) in enumerate(zip(bands, known, strict=True)):
            guess = None if band else auxiliary.first_guess
            options = step_options(
                section, name, of_rows, sample_rate_hz, responsivities=responsivities, first_guess=guess
            )
            steps.append((name, options))
    return clean_in_order(bands[0], data_mk, scan_bounds, focal_plane)


def _cleaned_alike(
    steps: list[tuple[str, Any]], band_mk: np.ndarray, scan_bounds: np.ndarray, focal_plane: FocalPlane
) -> np.ndarray:
    """Clean another band; its discarded scans are NaN, so the mapped band loses them too."""
    cleaned = clean_in_order(steps, band_mk, scan_bounds, focal_plane)
    for start, stop in scan_bounds[~cleaned.kept]:
        cleaned.data_mk[:, start:stop] = np.nan
    return cleaned.data_mk
