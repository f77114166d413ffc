"""Load and sensitivity of a detector at the points of a sweep, side by side."""

import math
from typing import Any

from surveysim.reduction.setup import prepare
from surveysim.results.sensitivity import middle_sky, sensitivities, sensitivity_entries, sky_text
from surveysim.runtime.numbers import number
from surveysim.runtime.table import Table, column
from surveysim.studies.sweep.axes import Point, Sweep

SKY = {"water": "water [mm]", "elevation": "elevation [deg]"}
HEADINGS = {
    "load": "load [pW]",
    "shot": "shot",
    "wave": "wave",
    "nep": "NEP [aW/√Hz]",
    "net": "NET [mK_CMB √s]",
    "nefd": "NEFD [mJy √s]",
    "array_net": "array [mK_CMB √s]",
    "array_nefd": "array [mJy √s]",
    "beam": "beam [arcsec]",
}


def sensitivity_of_points(sweep: Sweep) -> Table | None:
    """Return a row for each point: its values, load, NEPs, NET, NEFD, and those of the array.

    The sky is that of the median water where the scene has a site, at the mean elevation of the survey; the title has
    it, or columns where it differs. Cells of points whose photon noise follows from no load are empty. None if this
    holds for all.
    """
    rows = [_row(point) for point in sweep.points]
    if not any(rows):
        return None
    axes = [
        column(axis.name, [axis.labels[point.place[place]] for point in sweep.points], axis.name)
        for place, axis in enumerate(sweep.axes)
    ]
    detectors = column("n_det", [point.n_det for point in sweep.points], "detectors")
    skies = {row["sky"]: row["water"] for row in rows if row}
    headings = HEADINGS if len(skies) == 1 else SKY | HEADINGS
    values = {key: [row.get(key) for row in rows] for key in headings}
    known = (column(key, values[key], heading, number) for key, heading in headings.items() if any(values[key]))
    sky = f": {next(iter(skies))}" if len(skies) == 1 else " at the median water" * any(skies.values())
    return Table("sensitivity", f"Load and sensitivity of a detector{sky}", (*axes, detectors, *known))


def _row(point: Point) -> dict[str, Any]:
    """Return the values of a point in the units of the table; empty without a load."""
    setup = prepare(point.scene)
    found = sensitivities(setup)
    if not found:
        return {}
    entry = middle_sky(sensitivity_entries(setup, found))
    return {
        "sky": sky_text(entry),
        "water": entry["pwv_mm"],
        "elevation": math.degrees(entry["elevation_rad"]),
        "load": 1e12 * entry["load_w"],
        "shot": 1e18 * entry["nep_w_rthz"]["shot"],
        "wave": 1e18 * entry["nep_w_rthz"]["wave"],
        "nep": 1e18 * entry["total_nep_w_rthz"],
        "net": entry["net_mkcmb_rts"],
        "nefd": entry["nefd_mjy_rts"],
        "array_net": entry["array_net_mkcmb_rts"],
        "array_nefd": entry["array_nefd_mjy_rts"],
        "beam": math.degrees(setup.camera.focal_plane.fwhm_rad) * 3600,
    }
