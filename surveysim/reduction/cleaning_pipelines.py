"""Which algorithms clean the streams, in which order, and the data set that each makes."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mapmaker.cleaning import (
    TEMPLATE_CLEANINGS,
    Cleaned,
    LocalOptions,
    PcaOptions,
    PolynomialOptions,
    SpectralOptions,
    TemplateOptions,
    WindOptions,
    clean_in_order,
    detectors_needed,
    slowness,
)
from mapmaker.cleaning.responsivity import SCAN, Responsivities
from mapmaker.timestreams import FocalPlane, Timestreams
from mapmaker.wind import measure_wind, scan_velocities
from surveysim.scene.analysis import Cleaning

LONGEST_DELAY = 0.2  # of a scan; the wind model allows a quarter
ACTUAL, OPTIMAL = "actual", "optimal"


@dataclass(frozen=True)
class Recipe:
    """Cleaning steps in order, and the data set that they make of some detectors (None: of all)."""

    data_set: str
    steps: tuple[str, ...]
    detectors: np.ndarray | None = None

    @property
    def label(self) -> str:
        """Its steps as one name."""
        return "+".join(self.steps)

    def uses(self, name: str) -> bool:
        """Whether one of its steps is the named algorithm."""
        return name in self.steps

    @property
    def takes_responsivities(self) -> bool:
        """Whether one of its steps subtracts templates times responsivities."""
        return not set(self.steps).isdisjoint(TEMPLATE_CLEANINGS)

    @property
    def rows(self) -> np.ndarray | slice:
        """Index of its detectors into the streams."""
        return slice(None) if self.detectors is None else self.detectors


def recipes(section: Cleaning, masked: np.ndarray | None) -> tuple[Recipe, ...]:
    """The scene's own cleaning, those that it compares with, and its own on a masked array."""
    found = [Recipe(ACTUAL, section.algorithm)]
    found += [Recipe("+".join(steps), steps) for steps in section.compare]
    if masked is not None:
        found.append(Recipe(f"masked_{len(masked)}", section.algorithm, masked))
    return tuple(found)


@dataclass(frozen=True)
class Beside:
    """What recipes know beside the streams: `delays_s_rad` (n_scan, 2), the slowness that a wind model shifts by,
    `colours_mk` (n_colour, n_det, n_samp) of all detectors, and their `calibration` (1 + n_colour, n_det),
    responsivities in the mapped band and the others, or None where they are fitted.
    """

    delays_s_rad: np.ndarray
    colours_mk: np.ndarray
    calibration: np.ndarray | None = None


def step_options(
    section: Cleaning, name: str, beside: Beside, sample_rate_hz: float, responsivities: Responsivities
) -> Any:
    """The record that one step takes."""
    template = (section.tolerance, section.max_iterations, responsivities)
    if name == "wind":
        return WindOptions(beside.delays_s_rad, sample_rate_hz, *template)
    if name == "spectral":
        return SpectralOptions(beside.colours_mk)
    if name == "pca":
        return PcaOptions(section.sigma_cut)
    if name == "local":
        return LocalOptions(section.reach)
    if name == "polynomial":
        return PolynomialOptions(section.order, section.regions, *template)
    return TemplateOptions(*template)


def needed_detectors(section: Cleaning, name: str) -> int:
    """How many detectors one step needs."""
    nothing = Beside(np.zeros((1, 2)), np.zeros((1, 1, 1)))
    return detectors_needed(name, step_options(section, name, nothing, 1.0, SCAN))


def apply_recipe(
    section: Cleaning,
    recipe: Recipe,
    data_mk: np.ndarray,
    scan_bounds: np.ndarray,
    focal_plane: FocalPlane,
    beside: Beside,
    sample_rate_hz: float,
) -> Cleaned:
    """Clean the streams (n_det, n_samp) of the recipe's detectors, which `data_mk` and `focal_plane` hold alone.

    Before their spectral common mode is subtracted, the other bands are cleaned by the same steps as the mapped one.
    """
    colours = beside.colours_mk[:, recipe.rows]
    known = [section.responsivities] * (1 + len(colours))
    if beside.calibration is not None:
        known = list(beside.calibration[:, recipe.rows])
    # Steps of the mapped band and of the others, which differ in the responsivities.
    bands: list[list[tuple[str, Any]]] = [[] for _ in known]
    for name in recipe.steps:
        if name == "spectral" and bands[0]:
            alike = zip(bands[1:], colours, strict=True)
            colours = np.array([_cleaned_alike(steps, colour, scan_bounds, focal_plane) for steps, colour in alike])
        of_rows = replace(beside, colours_mk=colours)
        for steps, responsivities in zip(bands, known, strict=True):
            steps.append((name, step_options(section, name, of_rows, sample_rate_hz, responsivities)))
    return clean_in_order(bands[0], data_mk, scan_bounds, focal_plane)


def _cleaned_alike(
    steps: list[tuple[str, Any]], colour_mk: np.ndarray, scan_bounds: np.ndarray, focal_plane: FocalPlane
) -> np.ndarray:
    """Streams of another band, cleaned; NaN in scans that are discarded, so that the mapped band's are too."""
    cleaned = clean_in_order(steps, colour_mk, scan_bounds, focal_plane)
    for start, stop in scan_bounds[~cleaned.kept]:
        cleaned.data_mk[:, start:stop] = np.nan
    return cleaned.data_mk


def what_is_beside(
    recipes: tuple[Recipe, ...],
    streams: Timestreams,
    colours_mk: np.ndarray,
    calibration: np.ndarray | None,
    sample_rate_hz: float,
) -> Beside:
    """What the recipes need to know of one observation beside its streams."""
    return Beside(measured_delays(recipes, streams, sample_rate_hz), colours_mk, calibration)


def measured_delays(recipes: tuple[Recipe, ...], streams: Timestreams, sample_rate_hz: float) -> np.ndarray:
    """Slowness (n_scan, 2) [s/rad] of the layer by the wind measured from the streams; 0 where none is of use.

    Measured only if a recipe shifts by it: elsewhere 0 too.
    """
    none = np.zeros((len(streams.scan_bounds), 2))
    if not any(recipe.uses("wind") for recipe in recipes):
        return none
    velocity = scan_velocities(streams)
    wind = measure_wind(streams.data_mk, streams.scan_bounds, streams.focal_plane, sample_rate_hz, velocity)
    if wind.flag:
        return none
    found, plane = slowness(wind.velocity_rad_s, velocity), streams.focal_plane
    radius = np.hypot(plane.x_rad - plane.x_rad.mean(), plane.y_rad - plane.y_rad.mean()).max()
    seconds = np.diff(streams.scan_bounds, axis=1) / sample_rate_hz
    # A layer that hardly moves against the scan can't be followed within it.
    return np.where(np.hypot(*found.T)[:, None] * radius < LONGEST_DELAY * seconds, found, 0.0)
