"""Properties in which the detectors of a camera differ, from the table of detectors, and counts of detectors."""

from collections import Counter
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from surveysim.runtime.errors import SceneError
from surveysim.scene.detector_table import KEY, DetectorTable, read_detectors
from surveysim.scene.instrument import Instrument
from surveysim.scene.units import shown


@dataclass(frozen=True, eq=False, kw_only=True)
class DetectorProperties:
    """Properties (n_det,) of the live detectors of a camera; None where all are alike.

    Attributes
    ----------
    noise
        Relative PSD of the detector noise, in the temperature that a detector of the nominal efficiency would have.
        Its mean is 1.
    noise_is_power
        Whether `noise` follows from NEPs: a detector of higher efficiency then has less noise in temperature.
    efficiency
        Optical efficiency over the nominal one.
    responsivity
        Relative responsivity; its mean is 1.
    beam_fwhm_rad
    time_constant_s
    """

    noise: np.ndarray | None = None
    noise_is_power: bool = True
    efficiency: np.ndarray | None = None
    responsivity: np.ndarray | None = None
    beam_fwhm_rad: np.ndarray | None = None
    time_constant_s: np.ndarray | None = None

    @property
    def white_differs(self) -> bool:
        """Whether detectors differ in their white noise."""
        return self.noise is not None or self.efficiency is not None


@dataclass(frozen=True)
class DetectorCounts:
    """Numbers of detectors of a camera.

    Attributes
    ----------
    positions, dead
        Positions of the band, and those among them without a working detector.
    bands, readout_groups
        Working detectors of each band and readout group of the table, by name.
    wafers
        Working detectors and positions of each wafer.
    """

    positions: int
    dead: int
    bands: tuple[tuple[str, int], ...] = ()
    readout_groups: tuple[tuple[str, int], ...] = ()
    wafers: tuple[tuple[int, int], ...] = ()


def band_rows(table: DetectorTable, section: Instrument) -> np.ndarray:
    """Flag the rows (n_row,) of the band of an instrument, dead ones included.

    Raises
    ------
    SceneError
        For a band that the table lacks, or has no live detector of, and for several bands without a choice.
    """
    names = table.columns.get("band")
    if names is None:
        if section.table_band is not None:
            raise SceneError(
                f"instrument.band: found {section.table_band!r}, and {section.positions} without a column 'band'; "
                "that column, or no key 'band', is expected"
            )
        return np.ones(len(table), bool)
    there = ", ".join(map(repr, dict.fromkeys(names[table.live].tolist())))
    if section.table_band is None:
        if len(set(names[table.live].tolist())) > 1:
            raise SceneError(
                f"instrument.band: missing; the table of detectors has several: one of {there} is expected"
            )
        return np.ones(len(table), bool)
    rows = names == section.table_band
    if not (rows & table.live).any():
        raise SceneError(f"instrument.band: found {section.table_band!r}; one of {there} is expected")
    return rows


def table_properties(table: DetectorTable, rows: np.ndarray) -> DetectorProperties:
    """Collect the properties of some live detectors of a table."""
    found = {name: values[rows] for name, values in table.columns.items()}
    noise = found.get("psd")
    if "nep" in found:
        noise = found["nep"] ** 2
    responsivity = found.get("responsivity")
    return DetectorProperties(
        noise=None if noise is None else noise / noise.mean(),
        noise_is_power="psd" not in found,
        efficiency=found.get("efficiency"),
        responsivity=None if responsivity is None else responsivity / responsivity.mean(),
        beam_fwhm_rad=found.get("beam_fwhm"),
        time_constant_s=found.get("time_constant"),
    )


def table_counts(table: DetectorTable, section: Instrument) -> DetectorCounts:
    """Count the detectors of a table: those of the band, and of all bands and readout groups."""
    rows = band_rows(table, section)
    counts = {
        name: tuple(Counter(table.columns[name][table.live & of].tolist()).items()) if name in table.columns else ()
        for name, of in (("band", np.ones(len(table), bool)), ("readout_group", rows))
    }
    dead = int(np.count_nonzero(rows & ~table.live))
    return DetectorCounts(int(np.count_nonzero(rows)), dead, counts["band"], counts["readout_group"])


@lru_cache(maxsize=8)  # the bands of a camera, and the levels of each observation, have a table in common
def detector_table(path: Path) -> DetectorTable:
    """Read a table of detectors once."""
    return read_detectors(path)


def table_noise(section: Instrument) -> tuple[str, float] | None:
    """Noise level of the detectors that a table states: the key, "nep" or "psd", and the root mean square or mean.

    None without a table, or without such a column.
    """
    if section.positions is None:
        return None
    table = detector_table(section.positions)
    rows = band_rows(table, section) & table.live
    if "nep" in table.columns:
        return "nep", float(np.sqrt(np.mean(table.columns["nep"][rows] ** 2)))
    return ("psd", float(np.mean(table.columns["psd"][rows]))) if "psd" in table.columns else None


def only_beams(section: Instrument, properties: DetectorProperties, most: int) -> None:
    """Raise SceneError for more than `most` different beams."""
    if properties.beam_fwhm_rad is None:
        return
    widths = np.unique(properties.beam_fwhm_rad)
    if len(widths) > most:
        raise SceneError(
            f"{KEY}: {section.positions}: column 'beam_fwhm': found {len(widths)} widths, {shown(widths[0])} rad first;"
            f" {most} or fewer are expected, as each takes a sky of its own: round them"
        )
