"""The table of a forecast's scores."""

from collections.abc import Mapping

from surveysim.forecasting.forecast import DataSetForecast
from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.reduction.data_set import scaled_name
from surveysim.runtime.numbers import count, number, short
from surveysim.runtime.table import SIGMA, Table, column


def forecast_table(
    scores: Mapping[str, DataSetForecast],
    all_weather: Mapping[str, float] | None = None,
    *,
    source: str = "",
    published: Mapping[str, float] | None = None,
) -> Table:
    """Return the forecast of sigma(A) of each data set, beside the reference.

    Parameters
    ----------
    scores : mapping of DataSetForecast
        Forecasts by data set, for the weather that the scene's seed draws.
    all_weather : mapping of float, optional
        sigma(A) [uK_CMB^2] by data set over all weather, of those that have it; all others are for the weather drawn.
    source : str
        Source of the reference values; empty without a reference.
    published : mapping of float, optional
        Reference values [uK_CMB^2] by data set.
    """
    published = published or {}
    drawn = _with_scaled(scores, {name: item.band.sigma_ukcmb2 for name, item in scores.items()})
    sigmas = drawn | _with_scaled(scores, all_weather or {})
    items = [*scores.values(), *_masked(scores).values()]
    columns = [
        column("name", list(sigmas), "data set"),
        column("n_det", [item.n_det for item in items], "detectors", count),
        column("sigma_ukcmb2", list(sigmas.values()), SIGMA, number, unit="uK2"),
    ]
    if all_weather is not None:
        columns.append(
            column("plain_sigma_ukcmb2", list(drawn.values()), "drawn weather [uK_CMB^2]", number, unit="uK2")
        )
    columns += [
        column("ell_eff", [item.band.ell_eff for item in items], "ell_eff", count),
        column("fwhm_ell", [item.band.fwhm_ell for item in items], "FWHM in ell", count),
    ]
    if source:
        ratios = [sigmas[name] / published[name] if name in published else None for name in sigmas]
        columns.append(column("reference_ukcmb2", [published.get(name) for name in sigmas], source, short, unit="uK2"))
        columns.append(column("ratio", ratios, "ratio", number))
    return Table("forecast", "Forecast of the uncertainty of a flat CMB band power", tuple(columns))


def _masked(scores: Mapping[str, DataSetForecast]) -> dict[str, DataSetForecast]:
    """Data sets of fewer detectors than the actual one."""
    return {name: item for name, item in scores.items() if ACTUAL in scores and item.n_det < scores[ACTUAL].n_det}


def _with_scaled(scores: Mapping[str, DataSetForecast], sigmas: Mapping[str, float]) -> dict[str, float]:
    """Add masked data sets times their share of the detectors."""
    masked = {name: item.n_det / scores[ACTUAL].n_det for name, item in _masked(scores).items() if name in sigmas}
    return {**sigmas, **{scaled_name(name): share * sigmas[name] for name, share in masked.items()}}
