"""Load and sensitivity of a scene's detectors at the quartiles of the site's water, and their tables."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from surveysim.atmosphere.weather import survey_pwv_quantile
from surveysim.reduction.setup import Setup
from surveysim.runtime.numbers import number, short
from surveysim.runtime.table import Column, Table, column, file_column, share_text
from surveysim.telescope.array_noise import correlated_noise
from surveysim.telescope.noise_levels import WhiteLevels, white_levels
from surveysim.telescope.sensitivity import Sensitivity, sensitivity
from surveysim.timestreams.simulation import camera_white

Content = Mapping[str, Any]  # an entry of `sensitivity` in summary.json

_QUARTILES = {"first quartile": 0.25, "median": 0.5, "third quartile": 0.75}
STATED = "stated sky"


def has_load(setup: Setup) -> bool:
    """Return whether the photon noise of a scene follows from a load."""
    photon = setup.scene.photon
    return photon is not None and photon.psd_mk2_hz is None


def sensitivities(setup: Setup) -> dict[str, Sensitivity]:
    """Compute the sensitivity at the mean elevation of the survey, for quartiles of the site's water or a stated sky.

    Empty where photon noise does not follow from a load.
    """
    if not has_load(setup):
        return {}
    scene, elevation_rad = setup.scene, float(setup.observing.angles.elevation_rad.mean())
    sky = scene.photon.load or scene.optics
    if sky.sky_k is not None:
        return {STATED: sensitivity(scene, None, math.nan, elevation_rad)}
    opacity, air, dated = setup.air.water.opacity, scene.atmosphere, setup.air.dated
    return {
        name: sensitivity(scene, opacity, float(survey_pwv_quantile(air, dated, share)), elevation_rad)
        for name, share in _QUARTILES.items()
    }


def saturation_warnings(found: Mapping[str, Sensitivity]) -> list[str]:
    """Warn of bolometers that their load saturates, in the first sky that does."""
    for name, item in found.items():
        if item.saturates:
            return [
                f"detector.bolometer: {1e12 * item.load_w:.3g} pW of load ({name}) saturate it; its link carries "
                f"{1e12 * item.saturation_w:.3g} pW."
            ]
    return []


def sensitivity_entries(setup: Setup, found: Mapping[str, Sensitivity]) -> list[dict[str, Any]]:
    """Return the entry `sensitivity` of summary.json: one item for each sky."""
    return [_sky_entry(setup, name, item) for name, item in found.items()]


def _sky_entry(setup: Setup, name: str, item: Sensitivity) -> dict[str, Any]:
    opacity = setup.air.water.opacity if setup.air.water else None
    levels = white_levels(setup.scene, opacity, item.pwv_mm, item.elevation_rad)
    shared = correlated_noise(setup.camera, setup.camera.photon_coherence, levels)
    return _entry(name, item, math.sqrt(_nominal_detectors(setup, levels) / shared)) | {"array_noise_ratio": shared}


def _nominal_detectors(setup: Setup, levels: WhiteLevels) -> float:
    """Number of detectors with the noise of the scene that are worth as much as those of the camera."""
    white = camera_white(setup.camera, levels)
    variance = white.shared + white.alone + white.detector
    return float(np.sum((levels.photon_mk2_hz + levels.detector_mk2_hz) / variance))


def _entry(name: str, item: Sensitivity, root: float) -> dict[str, Any]:
    total = sum(item.nep2.values())
    return {
        "sky": name,
        "pwv_mm": None if np.isnan(item.pwv_mm) else item.pwv_mm,
        "elevation_rad": item.elevation_rad,
        "load_w": item.load_w,
        "saturation_w": item.saturation_w,
        "nep_w_rthz": {origin: math.sqrt(nep2) for origin, nep2 in item.nep2.items()},
        "total_nep_w_rthz": item.nep_w_rthz,
        "net_mk_rts": item.net_mk_rts,
        "net_mkcmb_rts": item.net_mkcmb_rts,
        "nefd_mjy_rts": item.nefd_mjy_rts,
        "array_net_mkcmb_rts": item.net_mkcmb_rts / root,
        "array_nefd_mjy_rts": item.nefd_mjy_rts / root,
        "elements": [
            {
                "name": element.name,
                "side": element.side,
                "temperature_k": element.temperature_k,
                "load_w": element.load_w,
                "occupation": element.occupation,
                "transmission": element.transmission,
                "nep2_share": element.nep2 / total,
            }
            for element in item.elements
        ],
    }


# ---------------------------------------------------------------- tables


def middle_sky(entries: Sequence[Content]) -> Content:
    """Return the item that stands for all: the median water, or the only one."""
    return entries[len(entries) // 2]


def sky_text(entry: Content) -> str:
    """Name the sky of an item: water and elevation."""
    sky, pwv_mm = entry["sky"], entry["pwv_mm"]
    water = sky if pwv_mm is None else f"{sky} water, {number(pwv_mm)} mm"
    return f"{water}, at {_elevation(entry)}"


def sensitivity_tables(entries: Sequence[Content]) -> tuple[Table, ...]:
    """Return all tables, from the entry `sensitivity` of summary.json."""
    return load_table(entries), nep_table(entries), sensitivity_table(entries)


def load_table(entries: Sequence[Content]) -> Table:
    """Return the load of a detector by element, from the sky to the detector, at the median water."""
    entry = middle_sky(entries)
    rows = entry["elements"]
    columns = (
        column("element", _values(rows, "name"), "element"),
        column("side", _values(rows, "side"), "side"),
        column("temperature", _values(rows, "temperature_k"), "T [K]", short, unit="K"),
        column("load", [1e12 * row["load_w"] for row in rows], "load [pW]", number, unit="pW"),
        column("occupation", _values(rows, "occupation"), "occupation number", number),
        column("transmission", _values(rows, "transmission"), "transmission", share_text),
        column("nep2_share", _values(rows, "nep2_share"), "share of NEP^2", share_text),
    )
    meta = {"sky": entry["sky"], "pwv_mm": entry["pwv_mm"], "elevation_deg": math.degrees(entry["elevation_rad"])}
    return Table("load", f"Load of a detector: {sky_text(entry)}", columns, meta=meta)


def nep_table(entries: Sequence[Content]) -> Table:
    """Return the load of a detector and its NEPs by origin, for each sky."""
    columns = [
        *_skies(entries),
        column("load", [1e12 * entry["load_w"] for entry in entries], "load [pW]", number, unit="pW"),
    ]
    for origin in entries[0]["nep_w_rthz"]:
        values = [1e18 * entry["nep_w_rthz"][origin] for entry in entries]
        columns.append(column(f"nep_{origin}", values, origin, number, unit="aW / Hz(1/2)"))
    totals = [1e18 * entry["total_nep_w_rthz"] for entry in entries]
    columns.append(column("nep", totals, "total", number, unit="aW / Hz(1/2)"))
    return Table("nep", f"NEP of a detector [aW/√Hz] at {_elevation(entries[0])}", tuple(columns))


def sensitivity_table(entries: Sequence[Content]) -> Table:
    """Return NETs and NEFDs of a detector and of the array for each sky."""
    columns = (
        *_skies(entries),
        _column(entries, "net_mk_rts", "NET [mK_RJ √s]", "mK s(1/2)"),
        _column(entries, "net_mkcmb_rts", "NET [mK_CMB √s]", "mK s(1/2)"),
        _column(entries, "nefd_mjy_rts", "NEFD [mJy √s]", "mJy s(1/2)"),
        _column(entries, "array_net_mkcmb_rts", "array [mK_CMB √s]", "mK s(1/2)"),
        _column(entries, "array_nefd_mjy_rts", "array [mJy √s]", "mJy s(1/2)"),
        file_column("array_noise_ratio", _values(entries, "array_noise_ratio")),
    )
    meta = {"comment": "array: mean of all detectors with the correlation of their photon noise"}
    return Table("sensitivity", f"Sensitivity of a detector at {_elevation(entries[0])}", columns, meta=meta)


def _skies(entries: Sequence[Content]) -> tuple[Column, ...]:
    return (
        column("sky", _values(entries, "sky"), "sky"),
        column("pwv", _values(entries, "pwv_mm"), "water [mm]", number, unit="mm"),
        file_column("elevation", [math.degrees(entry["elevation_rad"]) for entry in entries], "deg"),
    )


def _elevation(entry: Content) -> str:
    return f"an elevation of {math.degrees(entry['elevation_rad']):.1f} deg"


def _column(entries: Sequence[Content], key: str, heading: str, unit: str) -> Column:
    return column(key.removesuffix("_rts"), _values(entries, key), heading, number, unit=unit)


def _values(rows: Sequence[Content], key: str) -> list[Any]:
    return [row[key] for row in rows]
