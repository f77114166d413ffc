"""The scene's own sky and what comes back of it: entry of summary.json, tables and a sentence."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from surveysim.results.sky_fluxes import SourceFlux
from surveysim.results.sky_recovery import SkyRecovery
from surveysim.runtime.numbers import number, quoted, with_error
from surveysim.runtime.strict_json import known
from surveysim.runtime.table import Column, Table, column, file_column

Content = Mapping[str, Any]  # entry `own_sky` of summary.json
MOST_SHOWN = 12  # sources of a page
_FLUXES = ("catalogue_mjy", "input_mjy", "output_mjy", "transfer", "ratio", "measured_mjy", "error_mjy")


def sky_entry(recoveries: Mapping[str, SkyRecovery]) -> dict[str, Any]:
    """Return the entry `own_sky` of summary.json: what comes back of each data set, and sources of the first."""
    first = next(iter(recoveries.values()))
    entry: dict[str, Any] = {
        "recovered": {
            name: known({"ratio": item.total, "error": item.total_error}) for name, item in recoveries.items()
        }
    }
    if first.fluxes:
        entry["sources"] = [known(flux_row(item)) for item in first.fluxes[:MOST_SHOWN]]
    return entry


def flux_row(item: SourceFlux) -> dict[str, Any]:
    """Return the values of a source by name, angles in degrees and arcminutes."""
    place: dict[str, Any] = {"source": item.source, "kind": item.kind}
    place |= {"ra_deg": math.degrees(item.ra_rad), "dec_deg": math.degrees(item.dec_rad)}
    place["aperture_arcmin"] = 60 * math.degrees(item.aperture_rad)
    return place | {name: getattr(item, name) for name in _FLUXES}


def recovery_sentences(entry: Content) -> list[str]:
    """Say how much of the sky comes back, for each data set."""
    return [
        f"{name}: {quoted(item['ratio'], item['error'])} of what went in, over the transfer function."
        for name, item in entry["recovered"].items()
    ]


def source_table(entry: Content) -> Table:
    """Return the fluxes of the brightest sources, for people, from the entry of summary.json."""
    rows = entry["sources"]
    columns = (
        column("source", [row["source"] for row in rows], "source"),
        column("catalogue_mjy", [row["catalogue_mjy"] for row in rows], "flux [mJy]", number),
        column("input_mjy", [row["input_mjy"] for row in rows], "aperture, in [mJy]", number),
        column("output_mjy", [row["output_mjy"] for row in rows], "out [mJy]", number),
        column("transfer", [row["transfer"] for row in rows], "transfer", number),
        column("ratio", [row["ratio"] for row in rows], "out / transfer / in", number),
        Column(
            "measured_mjy",
            [row["measured_mjy"] for row in rows],
            "",
            "in the map [mJy]",
            tuple(with_error(row["measured_mjy"], row["error_mjy"]) for row in rows),
        ),
    )
    return Table("sky", "Sources and clusters that come back, in the map of the actual data", columns)


def flux_table(recoveries: Mapping[str, SkyRecovery], meta: Content) -> Table:
    """Return the fluxes of all sources in the maps of all data sets, for files."""
    rows = [{"data_set": name} | flux_row(item) for name, found in recoveries.items() for item in found.fluxes]
    units = {"ra_deg": "deg", "dec_deg": "deg", "aperture_arcmin": "arcmin"}
    units |= {name: "mJy" for name in _FLUXES if name.endswith("mjy")}
    columns = [file_column(_file_name(name), [row[name] for row in rows], units.get(name, "")) for name in rows[0]]
    return Table("sky_fluxes", "Fluxes of sources and clusters", tuple(columns), meta=meta)


def _file_name(name: str) -> str:
    return name.removesuffix("_mjy").removesuffix("_deg").removesuffix("_arcmin")


def sky_transfer_table(recoveries: Mapping[str, SkyRecovery], scored: Sequence[bool], meta: Content) -> Table:
    """Return transfer functions by bin of multipoles, of the simulated skies and of the scene's own, for files."""
    first = next(iter(recoveries.values()))
    columns = [file_column("ell", first.ell), file_column("scored", scored)]
    names = ("transfer", "transfer_error", "own_transfer", "recovered", "recovered_error", "correlation")
    for name, item in recoveries.items():
        columns += [file_column(f"{quantity}_{name}", getattr(item, quantity)) for quantity in names]
    return Table("sky_transfer", "Amplitude transfer functions", tuple(columns), meta=meta)
