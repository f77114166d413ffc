"""Tables of a run, from the content of its summary.json: each is built here once."""

from collections.abc import Mapping, Sequence
from typing import Any

from surveysim.runtime.numbers import as_known, count, number, quoted_share, short
from surveysim.runtime.table import SIGMA, Column, Table, column, file_column, quoted_columns, share_text

Content = Mapping[str, Any]  # content of summary.json

_SHARES = {
    "point_source_flux_removed": "flux removed",
    "best_for_cmb": "best for CMB",
    "best_for_point_source": "best for source",
}
_ALTERNATIVES = {"weights": "weights of bins", "ell_min": "from ell", "ell_eff": "ell_eff", "fwhm_ell": "FWHM in ell"}


def score_table(scores: Content, source: str = "", meta: Content | None = None) -> Table:
    """Return the score table: sigma(A) of each data set with its forecast and the reference.

    Parameters
    ----------
    scores : mapping
        Entry `scores` of the summary.
    source : str
        Source of the reference values; empty without a reference.
    meta : mapping, optional
        Header of the file.
    """
    rows = list(scores.values())
    sigma, error, forecast = (_values(rows, key) for key in ("sigma_ukcmb2", "error_ukcmb2", "forecast_ukcmb2"))
    columns = [
        column("name", list(scores), "data set"),
        column("n_det", _values(rows, "n_det"), "detectors", count),
        *quoted_columns(("sigma_ukcmb2", "error_ukcmb2"), sigma, error, SIGMA, unit="uK2"),
        file_column("plain_sigma_ukcmb2", _values(rows, "plain_sigma_ukcmb2"), "uK2"),
        column("ell_eff", _values(rows, "ell_eff"), "ell_eff", count),
        column("fwhm_ell", _values(rows, "fwhm_ell"), "FWHM in ell", count),
        rounded_column("forecast_ukcmb2", forecast, error, "forecast"),
        *_reference_columns(rows, source),
    ]
    return Table("score", "Uncertainty of a flat CMB band power", tuple(columns), meta=meta or {})


def rounded_column(
    name: str,
    values: Sequence[float | None],
    errors: Sequence[float | None],
    heading: str,
    *,
    flags: Sequence[str] = (),
) -> Column:
    """Return a column [uK_CMB^2] that is rounded as another with these errors is; unseen where it has no value."""
    pairs = zip(values, errors, flags or [""] * len(values), strict=True)
    cells = tuple("" if value is None else f"{as_known(value, error)}{flag}" for value, error, flag in pairs)
    return Column(name, values, "uK2", heading, cells if any(cells) else None)


def _reference_columns(rows: list[Content], source: str) -> list[Column]:
    published = _values(rows, "reference_ukcmb2")
    if not source:
        return [file_column("reference_ukcmb2", published, "uK2")]
    pairs = [over_reference(row) for row in rows]
    ratios, errors = [ratio for ratio, _ in pairs], [error for _, error in pairs]
    return [
        column("reference_ukcmb2", published, source, short, unit="uK2"),
        *quoted_columns(("ratio", "ratio_error"), ratios, errors, "ratio", in_files=False),
    ]


def over_reference(row: Content) -> tuple[float | None, float | None]:
    """Ratio of an entry's sigma(A) to the reference, with its error; None where there is none."""
    if "reference_ukcmb2" not in row:
        return None, None
    error = row["error_ukcmb2"]
    return row["ratio_to_reference"], None if error is None else error / row["reference_ukcmb2"]


def gain_table(gains: Content, published: Mapping[str, float]) -> Table:
    """Return ratios of sigma(A) between data sets, with `published` ratios by name."""
    rows = list(gains.values())
    columns = [
        column("gain", list(gains), "gain"),
        *quoted_columns(("ratio", "ratio_error"), _values(rows, "ratio"), _values(rows, "error"), "ratio"),
    ]
    if published:
        columns.append(column("published", [published.get(name) for name in gains], "published", short))
    return Table("gain", "Gains", tuple(columns))


def cleaning_table(cleaning: Content) -> Table:
    """Return costs and residuals of each cleaning pipeline of all detectors, from the entry `cleaning`."""
    rows = [entry for entry in cleaning.values() if "psd_over_white" in entry]
    columns = [
        column("cleaning", ["+".join(row["steps"]) for row in rows], "cleaning"),
        column("scans_discarded", _values(rows, "scans_discarded"), "scans discarded", count),
        column("mean_iterations", _values(rows, "mean_iterations"), "iterations", number),
        column("mean_removed", _values(rows, "mean_removed"), "templates", number),
    ]
    for hz in rows[0]["psd_over_white"]:
        ratios = [row["psd_over_white"][hz] for row in rows]
        columns.append(column(f"psd_over_white_{hz}", ratios, f"PSD at {hz} over white", number))
    there = [name for name in _SHARES if name in rows[0]]
    columns += [column(name, _values(rows, name), _SHARES[name], share_text) for name in there]
    return Table("cleaning", "Cleaning pipelines: cost and residual", tuple(columns))


def alternative_table(rows: Sequence[Content]) -> Table:
    """Return sigma(A) [uK_CMB^2] of the same data with other scoring, from the entry `alternatives`."""
    columns = []
    for name in rows[0]:
        unit = "" if name in _ALTERNATIVES else "uK2"
        heading = _ALTERNATIVES.get(name, name)
        columns.append(column(name, _values(rows, name), heading, str if name == "weights" else count, unit=unit))
    meta = {"comment": "sigma(A) in uK_CMB^2 of the same data, scored otherwise"}
    return Table("alternative", "The same data scored otherwise: sigma(A) [uK_CMB^2]", tuple(columns), meta=meta)


def agreement_table(agreements: Content) -> Table:
    """Return forecast over simulation, minus 1, of each data set, from the entry `forecast_over_simulated`."""
    rows = list(agreements.values())
    columns = [
        column("name", list(agreements), "data set"),
        _share_column("sigma", rows, "sigma(A)"),
        _share_column("psd", rows, "noise PSD"),
        column("worst_ell", _values(rows, "worst_ell"), "at ell", count),
        column("within", _values(rows, "within"), "good bins", count),
        column("unknown", _values(rows, "unknown"), "uncertain bins", count),
        column("bins", _values(rows, "bins"), "bins", count),
    ]
    return Table("forecast", "Forecast over simulation, less 1", tuple(columns))


def _share_column(name: str, rows: list[Content], heading: str) -> Column:
    pairs = [(row[name], row[f"{name}_error"]) for row in rows]
    cells = tuple("" if value is None else quoted_share(value, error) for value, error in pairs)
    return Column(name, [value for value, _ in pairs], "", heading, cells)


def effect_table(forecasts: Content) -> Table:
    """Return the effects that forecasts neglect, from the entry `forecast`, each once."""
    seen: dict[str, tuple[str, Content]] = {}
    for name, item in forecasts.items():
        for effect in item["effects"]:
            seen.setdefault(effect["sentence"], (name, effect))
    names, effects = zip(*seen.values(), strict=True) if seen else ((), ())
    columns = (
        column("name", names, "data set"),
        column("effect", [item["name"] for item in effects], "effect"),
        column("size", [item["size"] for item in effects], "size", share_text),
        column("sentence", [item["sentence"] for item in effects], "in this scene"),
        column("flagged", ["yes" if item["flagged"] else "" for item in effects], "flagged"),
    )
    return Table("effect", "Effects on the forecast", columns)


def closure_table(items: Sequence[Content], kind: str) -> Table:
    """Return closure tests of one kind, "measured" or "drawn", from the entry `closure`."""
    rows = [item for item in items if item["kind"] == kind]
    title = {"measured": "Measured from streams and maps", "drawn": "Weather drawn"}[kind]
    found, errors = _values(rows, "found"), _values(rows, "error")
    scales = [1 / row["expected"] if row["expected"] else None for row in rows]
    ratios = [None if scale is None else row["found"] * scale for row, scale in zip(rows, scales, strict=True)]
    pairs = list(zip(errors, scales, strict=True))
    ratio_errors = [None if None in pair else pair[0] * pair[1] for pair in pairs]
    columns = (
        column("quantity", _values(rows, "quantity"), "quantity"),
        column("unit", _values(rows, "unit"), "unit"),
        column("expected", _values(rows, "expected"), "expected", number),
        *quoted_columns(("found", "error"), found, errors, "found", digits=3),
        *quoted_columns(("ratio", "ratio_error"), ratios, ratio_errors, "ratio", digits=3),
    )
    return Table({"measured": "closure", "drawn": "weather"}[kind], title, columns)


def _values(rows: Sequence[Content], key: str) -> list[Any]:
    return [row.get(key) for row in rows]
