"""The result of a run: its scores, gains, alternatives, forecast and error."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.reduction.data_set import DataSetKind, scaled_name
from surveysim.reduction.setup import Setup
from surveysim.results.sky_recovery import SkyRecovery, sky_recoveries
from surveysim.results.spectra import spectra_warnings
from surveysim.results.stopping import (
    FINE_ERROR,
    UNLIMITED,
    ErrorParts,
    Estimate,
    StoppingCriteria,
    TimeToPrecision,
    answer_cost,
    best_estimate,
    error_parts,
    stop_reason,
)
from surveysim.results.tables import score_table
from surveysim.runtime.engine import SERIAL
from surveysim.runtime.errors import InsufficientDataError
from surveysim.runtime.strict_json import known
from surveysim.runtime.table import Table
from surveysim.survey.coadds import CoAdds
from surveysim.survey.convergence import convergence_warnings
from surveysim.survey.discarded_scans import Discards, discards
from surveysim.survey.error_modes import Gain
from surveysim.survey.scores import DataSetScore
from surveysim.survey.signal_coverage import signal_coverage_warnings
from surveysim.survey.split_spectra import SurveySpectra, survey_spectra

if TYPE_CHECKING:
    from astropy.table import QTable
    from matplotlib.figure import Figure

    from surveysim.forecasting.forecast import DataSetForecast, Forecast
    from surveysim.results.metrics import MetricResults
    from surveysim.results.scored import Scored

GOOD_SIGMA, GOOD_PSD = 0.1, 0.15  # relative accuracy of a forecast
KNOWN = GOOD_PSD / 2  # largest standard error of a ratio that can be called good


@dataclass(frozen=True)
class Row:
    """A row of the score table.

    Parameters
    ----------
    name, n_det : str, int
        Data set and its number of detectors.
    sigma_ukcmb2, error_ukcmb2 : float
        sigma(A) [uK_CMB^2] as quoted, and its Monte Carlo error; NaN for an unknown error.
    plain_sigma_ukcmb2 : float
        sigma(A) [uK_CMB^2] without control variate.
    ell_eff, fwhm_ell : float
        Effective multipole and width of the weights.
    forecast_ukcmb2 : float, optional
        Forecast for the weather of `sigma_ukcmb2`.
    reference_ukcmb2 : float, optional
        Published value.
    """

    name: str
    kind: DataSetKind
    n_det: int
    sigma_ukcmb2: float
    error_ukcmb2: float
    plain_sigma_ukcmb2: float
    ell_eff: float
    fwhm_ell: float
    forecast_ukcmb2: float | None
    reference_ukcmb2: float | None


@dataclass(frozen=True)
class SurveyResult:
    """A finished run.

    Parameters
    ----------
    setup : Setup
        Setup of the scene.
    coadds : CoAdds
        Sums over the observations.
    scores : dict of DataSetScore
        Quoted scores by data set (`surveysim.results.control_variate.quoted_scores`); empty without a score.
    gains : dict of Gain
        Ratios of sigma(A) between data sets.
    alternatives : list of dict
        The same data scored otherwise, a row each.
    flux_removed : dict of float
        Share of a faint point source's flux that each pipeline removes; empty unless pipelines are compared.
    expected : Forecast, optional
        Forecast of the data sets; None for a cleaning without one.
    metrics : dict of dict of MetricResult
        Quantities of all metrics by data set and key, such as "flat_band_power.sigma"; empty without a score.
    wall_s : float
        Time [s] since the start or the last resumption.
    workers : int
        Number of workers.
    unscored : str
        Reason for a missing score; else empty.
    limits : StoppingCriteria
        Limits of the run; one that they ended early is scored for the whole survey.
    engine : str
        Kind of the engine.
    spectra : SurveySpectra, optional
        Band powers and null tests of the splits; None without splits.
    no_spectra : str
        Reason for missing spectra; else empty.
    """

    setup: Setup
    coadds: CoAdds
    scores: dict[str, DataSetScore]
    gains: dict[str, Gain]
    alternatives: list[dict[str, float | str]]
    flux_removed: dict[str, float]
    expected: "Forecast | None"
    metrics: "MetricResults"
    wall_s: float
    workers: int
    unscored: str
    limits: StoppingCriteria
    engine: str
    spectra: SurveySpectra | None = None
    no_spectra: str = ""

    @cached_property
    def sky(self) -> dict[str, SkyRecovery]:
        """The scene's own sky beside what comes back of it, by data set; empty without a sky or a score."""
        return sky_recoveries(self.setup, self.coadds)

    @property
    def discards(self) -> Discards:
        """Shares of discarded scans."""
        return discards(self.setup, self.coadds)

    @property
    def warnings(self) -> list[str]:
        """Lines on discarded scans, the coverage of the signal simulations, unconverged maps and split maps."""
        lines = [*self.discards.warnings, *signal_coverage_warnings(self.setup.analysis, self.coadds)]
        lines += convergence_warnings(self.setup.scene, self.coadds)
        lines += spectra_warnings(self.spectra) if self.spectra else []
        return [*lines, f"spectra: not measured: {self.no_spectra}."] if self.no_spectra else lines

    @property
    def estimate(self) -> Estimate | None:
        """The best estimate of the actual data's sigma(A); None without a score."""
        return best_estimate(self.scores)

    @property
    def stopped(self) -> str:
        """Reason for the end of the run: "all" of its observations, or its "target" or "budget"."""
        return stop_reason(self.setup, self.limits, self.coadds.done, self.relative_error)

    @property
    def relative_error(self) -> float | None:
        """Relative error of the metric of the limits, by default of sigma(A); None without a score."""
        if ACTUAL not in self.metrics:
            return None
        return self.metrics[ACTUAL][self.limits.metric].quoted.response.budget.total

    @property
    def parts(self) -> ErrorParts | None:
        """Parts of the error of the estimate; None without a score."""
        return error_parts(self.setup, self.coadds, self.scores) if ACTUAL in self.scores else None

    def table(self) -> "QTable":
        """Return the score table with units, as tables/scores.ecsv has it; without rows where there is no score."""
        return self._score_table().quantities()

    def plot(self, figure: str = "map_psd") -> "Figure":
        """Draw a figure of the run.

        Parameters
        ----------
        figure : str
            Name of the figure, as its file in figures/ has it: "map_psd", "map", "timestream_psd" and so on.

        Raises
        ------
        ValueError
            For a figure that the run has no results for.
        """
        from surveysim.report.figures.survey import survey_figures

        found = survey_figures(self)
        if figure not in found:
            raise ValueError(f"figure: found {figure!r}; one of {', '.join(found) or 'none'} is expected")
        return found[figure]()

    def _score_table(self) -> Table:
        scene = self.setup.scene
        source = scene.score.reference.source if scene.score and scene.score.reference else ""
        return score_table(score_entries(self), source)

    def __repr__(self) -> str:
        """A line on the run above its score table."""
        scene = self.setup.scene
        done = f"{self.coadds.done} of {scene.observations} observations, {self.setup.camera.n_det} detectors"
        told = self._score_table().text() if self.scores else f"not scored: {self.unscored or 'no section [score]'}"
        return f"SurveyResult of {scene.name}: {done}\n{told}"

    def _repr_html_(self) -> str:
        """The score table."""
        return self._score_table().html()

    def cost(self, target: float) -> TimeToPrecision | None:
        """Return the cost of sigma(A) to a relative error; None without a score, or if out of reach."""
        parts = self.parts
        return None if parts is None else answer_cost(self.setup, self.coadds.done, self.workers, parts, target)

    @property
    def fine_cost(self) -> TimeToPrecision | None:
        """Cost of sigma(A) to 1 %, as `cost`."""
        return self.cost(FINE_ERROR)


def survey_result(
    setup: Setup,
    coadds: CoAdds,
    *,
    wall_s: float,
    workers: int,
    limits: StoppingCriteria = UNLIMITED,
    engine: str = SERIAL.kind,
) -> SurveyResult:
    """Score the sums of a run; a survey that can't be scored keeps its maps and the reason."""
    found: Scored = {}, {}, [], {}, None, {}
    unscored = ""
    if setup.scene.score is not None:
        from surveysim.results.scored import scored_parts

        try:
            found = scored_parts(setup, coadds)
        except InsufficientDataError as error:  # too few observations, or too few scans kept in them
            unscored = str(error)
    spectra, no_spectra = _spectra(setup, coadds)
    return SurveyResult(setup, coadds, *found, wall_s, workers, unscored, limits, engine, spectra, no_spectra)


def _spectra(setup: Setup, coadds: CoAdds) -> tuple[SurveySpectra | None, str]:
    """Measure the spectra of the splits; None with the reason where too little is simulated."""
    if setup.analysis.splits is None:
        return None, ""
    try:
        return survey_spectra(setup, coadds), ""
    except InsufficientDataError as error:
        return None, str(error)


def score_rows(result: SurveyResult) -> list[Row]:
    """Return the score table, masked sets also scaled by their share of the detectors (section 5.2)."""
    expected = result.expected.scores if result.expected else {}
    rows = [_row(item, expected.get(name)) for name, item in result.scores.items()]
    for row in list(rows):
        if row.kind is DataSetKind.MASKED:
            share = row.n_det / result.setup.camera.n_det
            scaled = {
                name: None if value is None else share * value
                for name, value in vars(row).items()
                if name in ("sigma_ukcmb2", "error_ukcmb2", "plain_sigma_ukcmb2", "forecast_ukcmb2")
            }
            rows.append(replace(row, name=scaled_name(row.name), **scaled))
    reference = result.setup.scene.score.reference if rows else None
    values = dict(reference.values_ukcmb2) if reference else {}
    return [replace(row, reference_ukcmb2=values.get(row.name)) for row in rows]


def _row(item: DataSetScore, expected: "DataSetForecast | None") -> Row:
    band, sigma = item.band, quoted_forecast(item, expected) if expected else None
    sigmas = band.sigma_ukcmb2, band.error_ukcmb2, item.plain_band.sigma_ukcmb2
    return Row(item.name, item.kind, item.n_det, *sigmas, band.ell_eff, band.fwhm_ell, sigma, None)


def quoted_forecast(simulated: DataSetScore, expected: "DataSetForecast") -> float:
    """Return the forecast of sigma(A) [uK_CMB^2] for the weather of the quoted score.

    Its ratio to the quoted score is that of the plain ones. A score with the forecast as control variate is for all
    weather, hence this forecast too.
    """
    return expected.band.sigma_ukcmb2 * simulated.band.sigma_ukcmb2 / simulated.plain_band.sigma_ukcmb2


def score_entries(result: SurveyResult) -> dict[str, dict[str, float | str | None]]:
    """Return rows of the score table by name, as summary.json has them: without absent values, None if unknown."""
    return {row.name: _score_entry(row) for row in score_rows(result)}


def _score_entry(row: Row) -> dict[str, float | str | None]:
    entry = known({key: value for key, value in vars(row).items() if key != "name" and value is not None})
    if row.reference_ukcmb2 is not None:
        entry["ratio_to_reference"] = row.sigma_ukcmb2 / row.reference_ukcmb2
    return entry
