"""Properties in which the detectors of a camera differ, from the table of detectors, and counts of detectors."""

from collections import Counter
from dataclasses import dataclass

import numpy as np

from surveysim.runtime.errors import SceneError
from surveysim.scene.detector_table import KEY, DetectorTable
from surveysim.scene.instrument import Instrument


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
    readout_group
        Name of the readout group.
    """

    noise: np.ndarray | None = None
    noise_is_power: bool = True
    efficiency: np.ndarray | None = None
    responsivity: np.ndarray | None = None
    beam_fwhm_rad: np.ndarray | None = None
    time_constant_s: np.ndarray | None = None
    readout_group: np.ndarray | None = None

    @property
    def white_differs(self) -> bool:
        """Return whether detectors differ in their white noise."""
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
        readout_group=found.get("readout_group"),
    )


def table_counts(table: DetectorTable, section: Instrument) -> DetectorCounts:
    """Count the detectors of a table: those of the band, and of all bands and readout groups."""
    rows = table.band_rows(section.table_band)
    counts = {
        name: tuple(Counter(table.columns[name][table.live & of].tolist()).items()) if name in table.columns else ()
        for name, of in (("band", np.ones(len(table), bool)), ("readout_group", rows))
    }
    dead = int(np.count_nonzero(rows & ~table.live))
    return DetectorCounts(int(np.count_nonzero(rows)), dead, counts["band"], counts["readout_group"])


def only_beams(section: Instrument, properties: DetectorProperties, most: int) -> None:
    """Raise SceneError for more than `most` different beams."""
    if properties.beam_fwhm_rad is None:
        return
    widths = np.unique(properties.beam_fwhm_rad)
    if len(widths) > most:
        least, largest = np.degrees(widths[[0, -1]]) * 3600
        raise SceneError(
            f"{KEY}: {section.positions}: column 'beam_fwhm': found {len(widths)} widths, {least:.4g} to {largest:.4g}"
            f" arcsec; {most} or fewer are expected, as each takes a sky of its own: round them"
        )
