"""What a finished run says: the score table, gains, alternatives, and the summary of everything."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mapmaker.bandpower import BandPower, flat_band_power_fixed_weights
from surveysim.forecasting.forecast import DataSetForecast, Forecast
from surveysim.forecasting.validity import resolution_ell
from surveysim.reduction.cleaning_pipelines import ACTUAL, CleaningPipeline
from surveysim.reduction.data_set import DataSetKind
from surveysim.reduction.figure_of_merit import TARGETS, best_places
from surveysim.reduction.setup import Setup
from surveysim.results.agreement import Agreement, agreement, quoted_forecast, run_forecast
from surveysim.results.closure import truth
from surveysim.results.control_variate import quoted_scores
from surveysim.results.stages import absent_sections, left_out, stages_that_run
from surveysim.results.stopping import (
    FINE_ERROR,
    TOLD_ERRORS,
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
from surveysim.runtime.engine import SERIAL
from surveysim.runtime.errors import InsufficientDataError
from surveysim.runtime.provenance import made_by, now
from surveysim.scene.scene import scene_hash
from surveysim.survey.coadds import CoAdds, row_names
from surveysim.survey.discarded_scans import Discards, discards
from surveysim.survey.scores import DataSetScore, Gain, flux_removed, gain, rescore, sector_sigma
from surveysim.telescope.raster import samples_per_scan

PSD_AT_HZ = (0.01, 0.1, 1.0)
ALTERNATIVE_NINTHS = (2, 4, 6, 8, 9, 10, 11)  # of the scene's lowest scored multipole

# Which estimate of sigma(A) is quoted, in one sentence.
CONTROLLED = (
    "sigma(A) is controlled: the simulated value times the forecast for all weather over that for the weather drawn, "
    "which takes out the luck of the weather"
)
PLAIN = "sigma(A) is plain: of the weather drawn, since cleaning has no forecast that could take out its luck"
OPTIMAL_METHOD = (
    "The optimal set takes for each observation the pipeline whose own map has the least noise for its signal, which "
    "favours chance; what a pipeline leaves of the signal is that of two observations."
)
METHOD = (
    "Noise is measured by co-adds with random signs; of a sky in the streams 1 / n_eff of its power stays.",
    "Each data set's observations are weighted by their own measured noise in the scored multipoles. That lowers the "
    "co-added noise by chance; this bias is corrected.",
    "sigma(A)^-2 = sum over bins of n/2 (M/N)^2: every data set weights its bins by its own noise.",
    "M is a flat spectrum behind beam and pixels, convolved with the taper's power spectrum, times the window.",
    "The window is that of the actual data's cleaning, also for the simulated sets; the masked array has its own.",
    "The simulated sets take each detector's Hann-tapered PSD of the cleaned streams and are not cleaned again.",
    OPTIMAL_METHOD,
    "The masked array is cleaned with its own detectors alone; scaled means times its share of the detectors.",
)


def method(compared: bool, bandwidth: float | None, correlation: float) -> tuple[str, ...]:
    """Lines on how a scene is scored.

    `compared` says whether pipelines are compared, `bandwidth` is the instrument's, `correlation` that of neighbouring
    bins' noise, NaN for a single bin.
    """
    lines = [line for line in METHOD if compared or line != OPTIMAL_METHOD]
    band = "over the band" if bandwidth else "at the band's centre, as the scene gives no instrument.bandwidth"
    lines.append(f"Rayleigh-Jeans becomes CMB temperature {band}.")
    if not np.isnan(correlation):
        lines.append(
            f"The taper correlates the measured noise of neighbouring bins by {correlation:.2f}; n allows for it in "
            "sums over bins."
        )
    return tuple(lines)


@dataclass(frozen=True)
class Row:
    """A row of the score table: `sigma_ukcmb2` as quoted, with its error (NaN: unknown); forecast and reference or
    None; `plain_sigma_ukcmb2` without control variate. The forecast is for the weather that `sigma_ukcmb2` is for.
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
    """A finished run: setup, sums, scores, gains between data sets and the same data scored otherwise.

    They are empty without a score or where `unscored` says why there is none, and are those quoted
    (`surveysim.results.control_variate.quoted_scores`). `flux_removed` is the share of a faint point source's flux that
    each pipeline takes, known where pipelines are compared; `expected` the forecast of the data sets, None where
    cleaning has none. A run that `limits` ended early is scored for the whole survey. `wall_s` is the time since the
    run was started or, the last time, resumed.
    """

    setup: Setup
    coadds: CoAdds
    scores: dict[str, DataSetScore]
    gains: dict[str, Gain]
    alternatives: list[dict[str, float | str]]
    flux_removed: dict[str, float]
    expected: Forecast | None
    wall_s: float
    workers: int
    unscored: str
    limits: StoppingCriteria
    engine: str

    @property
    def discards(self) -> Discards:
        """Shares of discarded scans."""
        return discards(self.setup, self.coadds)

    @property
    def estimate(self) -> Estimate | None:
        """The best estimate of the actual data's sigma(A); None without a score."""
        return best_estimate(self.scores)

    @property
    def stopped(self) -> str:
        """What ended the run: "all" of its observations, or its "target" or "budget"."""
        return stop_reason(self.setup, self.limits, self.coadds.done, self.estimate)

    @property
    def parts(self) -> ErrorParts | None:
        """What the error of the estimate is made of; None without a score."""
        return error_parts(self.setup, self.coadds, self.scores) if ACTUAL in self.scores else None

    def cost(self, target: float) -> TimeToPrecision | None:
        """What an answer to a relative error would take; None without a score, or where none is as good."""
        parts = self.parts
        return None if parts is None else answer_cost(self.setup, self.coadds.done, self.workers, parts, target)

    @property
    def fine_cost(self) -> TimeToPrecision | None:
        """What an answer to 1 % would take, as `cost`."""
        return self.cost(FINE_ERROR)


def survey_result(
    setup: Setup,
    coadds: CoAdds,
    wall_s: float,
    workers: int,
    limits: StoppingCriteria = UNLIMITED,
    engine: str = SERIAL.kind,
) -> SurveyResult:
    """Score what was summed; a survey that can't be scored keeps its maps and says why."""
    scores, ratios, others, removed, unscored = {}, {}, [], {}, ""
    if setup.scene.score is not None:
        try:
            scores = quoted_scores(setup, coadds)
            ratios, others = _gains(setup, scores), _alternatives(setup, coadds, scores)
            removed = flux_removed(setup, coadds)
        except InsufficientDataError as error:  # too few observations, or too few scans kept in them
            scores, ratios, others, removed, unscored = {}, {}, [], {}, str(error)
    expected = run_forecast(setup, coadds) if scores else None
    found = scores, ratios, others, removed, expected
    return SurveyResult(setup, coadds, *found, wall_s, workers, unscored, limits, engine)


def score_rows(result: SurveyResult) -> list[Row]:
    """The score table, masked sets also scaled by their share of the detectors (section 5.2)."""
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
            rows.append(replace(row, name=f"{row.name}_scaled", **scaled))
    reference = result.setup.scene.score.reference if rows else None
    values = dict(reference.values_ukcmb2) if reference else {}
    return [replace(row, reference_ukcmb2=values.get(row.name)) for row in rows]


def _row(item: DataSetScore, expected: DataSetForecast | None) -> Row:
    band, sigma = item.band, quoted_forecast(item, expected) if expected else None
    levels = band.sigma_ukcmb2, band.error_ukcmb2, item.plain_band.sigma_ukcmb2
    return Row(item.name, item.kind, item.n_det, *levels, band.ell_eff, band.fwhm_ell, sigma, None)


def forecast_agreement(result: SurveyResult) -> dict[str, Agreement]:
    """How far the forecast of each data set is from what was simulated; empty without a forecast."""
    expected = result.expected.scores if result.expected else {}
    return {name: agreement(result.setup, result.scores[name], item) for name, item in expected.items()}


def _gains(setup: Setup, scores: dict[str, DataSetScore]) -> dict[str, Gain]:
    """Ratios of uncertainties between data sets, with the error of each pair."""
    masked = next((name for name, item in scores.items() if item.kind is DataSetKind.MASKED), None)
    found = {}
    if {"actual", "uncorrelated"} <= scores.keys():
        found["actual / uncorrelated"] = gain(scores["actual"], scores["uncorrelated"])
    if {"uncorrelated", "white"} <= scores.keys():
        found["uncorrelated / white"] = gain(scores["uncorrelated"], scores["white"])
    if masked and "uncorrelated" in scores:
        share = scores[masked].n_det / setup.camera.n_det
        found[f"{masked}_scaled / uncorrelated"] = gain(scores[masked], scores["uncorrelated"], share)
    return found


def _alternatives(setup: Setup, coadds: CoAdds, scores: dict[str, DataSetScore]) -> list[dict[str, float | str]]:
    """The same data scored otherwise: from other lowest multipoles, and with every set's bins weighted alike.

    `weights` is "own" (each data set weights its bins by its own noise), "actual" (all by the actual
    data's noise) or "own, 2-D" (modes also by their direction, which the scans set; the scene's range).
    Masked sets are scaled by their share of the detectors.
    """
    lowest = _lowest_multipoles(setup)
    rows = [_alternative(setup, scores, weights, ell) for weights in ("own", "actual") for ell in lowest]
    if setup.analysis.region.sectors is not None:
        sigma = {name: sector_sigma(setup, coadds, item) for name, item in scores.items()}
        ell_min = setup.scene.score.ell_min
        rows.append(_alternative_row(setup, scores, "own, 2-D", scores["actual"].band, ell_min, sigma))
    return rows


def _lowest_multipoles(setup: Setup) -> list[int]:
    """Edges of bins about the scene's own lowest multipole, none below what scans and taper resolve."""
    score = setup.scene.score
    ninths = np.array(ALTERNATIVE_NINTHS) * score.ell_min / 9
    edges = np.unique(np.round(ninths / score.ell_bin).astype(int) * score.ell_bin)
    used = (edges >= resolution_ell(setup)) & (edges + score.ell_bin <= score.ell_max)
    return edges[used].tolist()


def _alternative(setup: Setup, scores: dict[str, DataSetScore], weights: str, ell_min: int) -> dict[str, float | str]:
    reference = scores["actual"]
    band = rescore(setup, reference, ell_min).band
    used, modes = band.weight > 0, setup.analysis.region.rings.n_modes
    sigma = {}
    for name, item in scores.items():
        if weights == "own":
            sigma[name] = rescore(setup, item, ell_min).band.sigma_ukcmb2
        else:
            sigma[name] = flat_band_power_fixed_weights(
                item.quoted_psd, item.signal_psd, modes, used, weighting_noise_psd_ukcmb2=reference.quoted_psd
            )
    return _alternative_row(setup, scores, weights, band, ell_min, sigma)


def _alternative_row(
    setup: Setup,
    scores: dict[str, DataSetScore],
    weights: str,
    band: BandPower,
    ell_min: int,
    sigma_ukcmb2: dict[str, float],
) -> dict[str, float | str]:
    row = {"weights": weights, "ell_min": ell_min, "ell_eff": band.ell_eff, "fwhm_ell": band.fwhm_ell}
    for name, item in scores.items():
        share = item.n_det / setup.camera.n_det
        row[f"{name}_scaled" if share < 1 else name] = share * sigma_ukcmb2[name]
    return row


def summary(result: SurveyResult) -> dict[str, Any]:
    """The content of summary.json; its keys are stable (docs/reference/files.md)."""
    setup, coadds = result.setup, result.coadds
    columns = dict(zip(row_names(setup), np.array(coadds.rows).T, strict=True))
    samples = (
        coadds.done * setup.camera.n_det * setup.observing.raster.n_scans * samples_per_scan(setup.observing.raster)
    )
    content: dict[str, Any] = {
        "scene": setup.scene.name,
        "title": setup.scene.title,
        "seed": setup.scene.seed,
        "scene_sha256": scene_hash(setup.scene),
        **made_by(),
        "observations": coadds.done,
        "detectors": setup.camera.n_det,
        "detector_samples": samples,
        "stages_left_out": absent_sections(setup.scene),
        "stages": stages_that_run(setup),
        "left_out": left_out(setup),
        "scans": coadds.done * setup.observing.raster.n_scans,
        "scans_discarded": int(columns[f"discarded_{ACTUAL}"].sum()),
        "discarded": result.discards.shares,
        "discarded_by_weather": result.discards.by_weather,
        "warnings": result.discards.warnings,
        "mean_iterations": float(columns[f"iterations_{ACTUAL}"].mean()),
        "cleaning": {
            pipeline.data_set: _cleaning_entry(pipeline, result, columns) for pipeline in setup.analysis.pipelines
        },
        "stopped": _stopped_entry(result),
        "scores": {},
    }
    if result.unscored:
        content["unscored"] = result.unscored
    if result.scores:
        expected = result.expected.scores if result.expected else {}
        content["best"] = known(vars(result.estimate))
        content["scores"] = {row.name: _score_entry(row) for row in score_rows(result)}
        content["error_budget"] = {name: known(vars(item.budget)) for name, item in result.scores.items()}
        agreements = forecast_agreement(result)
        content["forecast_over_simulated"] = {name: known(vars(item)) for name, item in agreements.items()}
        content["forecast"] = {name: _forecast_entry(item) for name, item in expected.items()}
        content["gains"] = {name: known(vars(item)) for name, item in result.gains.items()}
        content["alternatives"] = result.alternatives
        if not np.isnan(setup.analysis.region.scored_correlation):
            content["bin_correlation"] = setup.analysis.region.scored_correlation
        if result.fine_cost:
            content["fine_answer"] = vars(result.fine_cost)
        content["answers"] = [vars(cost) for cost in map(result.cost, TOLD_ERRORS) if cost]
    content["truth"] = [vars(item) for item in truth(setup, coadds, result.scores, result.expected)]
    content["run"] = {
        "date": now(),
        "engine": result.engine,
        "workers": result.workers,
        "wall_s": result.wall_s,
        "stage_s": coadds.seconds,
        "stage_ns_per_detector_sample": {k: 1e9 * v / samples for k, v in coadds.seconds.items()},
    }
    return content


def _cleaning_entry(pipeline: CleaningPipeline, result: SurveyResult, columns: dict[str, np.ndarray]) -> dict[str, Any]:
    """What one pipeline costs: scans, iterations, templates, time, and of how many observations it is the best."""
    setup = result.setup
    entry: dict[str, Any] = {
        "steps": list(pipeline.steps),
        "scans_discarded": int(columns[f"discarded_{pipeline.data_set}"].sum()),
        "mean_iterations": float(columns[f"iterations_{pipeline.data_set}"].mean()),
        "mean_removed": float(columns[f"removed_{pipeline.data_set}"].mean()),
    }
    if pipeline.detectors is None:
        entry["psd_over_white"] = _psd_over_white(result, setup.analysis.whole_pipelines.index(pipeline))
    if pipeline.data_set in result.flux_removed:
        entry["point_source_flux_removed"] = result.flux_removed[pipeline.data_set]
    if setup.analysis.chooses and pipeline.detectors is None:
        place = setup.analysis.whole_pipelines.index(pipeline)
        for target in TARGETS:
            best = best_pipeline(setup, columns, target)
            entry[f"best_for_{target}"] = float(np.mean(best[best >= 0] == place)) if (best >= 0).any() else 0.0
    return entry


def _psd_over_white(result: SurveyResult, place: int) -> dict[str, float | None]:
    """Median PSD of the cleaned streams over its own level in the upper half of the band, at some frequencies.

    That level is the instrument's noise as the pipeline leaves it: templates of few detectors take some of it too. None
    where nothing is left of the streams, or no scan.
    """
    setup, coadds = result.setup, result.coadds
    psds = coadds.clean_psd if place == 0 else [psd[place - 1] for psd in coadds.compared_psd]
    median = np.median([psd for psd in psds if psd.any()] or [np.zeros(len(psds[0]))], axis=0)
    white = median[len(median) // 2 : -1].mean()
    step = setup.observing.raster.sample_rate_hz / samples_per_scan(setup.observing.raster)
    bins = {f"{hz:g} Hz": round(hz / step) for hz in PSD_AT_HZ}
    # The first bin holds what the scan's removed mean leaves, the last Nyquist's single mode.
    there = {name: k for name, k in bins.items() if 2 <= k < len(median) - 1}
    return {name: float(median[k] / white) if white > 0 else None for name, k in there.items()}


def best_pipeline(setup: Setup, columns: dict[str, np.ndarray], target: str) -> np.ndarray:
    """Place (n_obs,) among the pipelines for all detectors of the best one for a target, -1 without data."""
    return best_places(
        np.array([columns[f"merit_{target}_{pipeline.data_set}"] for pipeline in setup.analysis.whole_pipelines])
    )


def _stopped_entry(result: SurveyResult) -> dict[str, Any]:
    """What ended the run, of how many observations, and how good its answer is."""
    estimate, limits = result.estimate, {k: v for k, v in vars(result.limits).items() if v is not None}
    entry: dict[str, Any] = {
        "reason": result.stopped,
        "observations_simulated": result.coadds.done,
        "observations_of_survey": result.setup.scene.observations,
        **limits,
    }
    if estimate:
        entry |= known({"estimate": estimate.kind, "relative_error": estimate.relative_error})
    return entry


def known(entry: dict[str, Any]) -> dict[str, Any]:
    """The entry with None for what is unknown: JSON has no NaN."""
    return {key: None if value != value else value for key, value in entry.items()}


def _forecast_entry(item: DataSetForecast) -> dict[str, Any]:
    return {"discarded": item.kept.discarded, "effects": [vars(effect) for effect in item.effects]}


def _score_entry(row: Row) -> dict[str, float | str | None]:
    entry = known({key: value for key, value in vars(row).items() if key != "name" and value is not None})
    if row.reference_ukcmb2 is not None:
        entry["ratio_to_reference"] = row.sigma_ukcmb2 / row.reference_ukcmb2
    return entry
