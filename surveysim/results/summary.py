"""The content of summary.json of a run."""

from typing import TYPE_CHECKING, Any

import numpy as np

from surveysim.reduction.cleaning_pipelines import ACTUAL, CleaningPipeline
from surveysim.reduction.design_warnings import design_warnings
from surveysim.reduction.figure_of_merit import TARGETS, best_places
from surveysim.reduction.setup import Setup
from surveysim.results.closure import closure_tests
from surveysim.results.metric_tables import metric_entries
from surveysim.results.results import SurveyResult, score_entries
from surveysim.results.sensitivity import saturation_warnings, sensitivities, sensitivity_entries
from surveysim.results.sky_tables import sky_entry
from surveysim.results.spectra import spectra_entry
from surveysim.results.stages import absent_sections, left_out, stages_that_run
from surveysim.results.stopping import TOLD_ERRORS
from surveysim.runtime.provenance import made_by, now
from surveysim.runtime.strict_json import known
from surveysim.scene.scene import scene_hash
from surveysim.survey.convergence import map_maker_entry
from surveysim.survey.rows import row_names
from surveysim.survey.scores import DataSetScore
from surveysim.telescope.scans import samples_per_scan

if TYPE_CHECKING:
    from surveysim.forecasting.forecast import DataSetForecast

PSD_AT_HZ = (0.01, 0.1, 1.0)


def summary(result: SurveyResult) -> dict[str, Any]:
    """Return the content of summary.json; its keys are stable (docs/reference/files.md)."""
    setup, coadds = result.setup, result.coadds
    sensed = sensitivities(setup)
    columns = dict(zip(row_names(setup.analysis), np.array(coadds.rows).T, strict=True))
    scans = setup.observing.scans
    samples = coadds.done * setup.camera.n_det * scans.n_scans * samples_per_scan(scans)
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
        "scans": coadds.done * setup.observing.scans.n_scans,
        "scans_discarded": int(columns[f"discarded_{ACTUAL}"].sum()),
        "discarded": result.discards.shares,
        "discarded_by_weather": result.discards.by_weather,
        "warnings": [*design_warnings(setup), *result.warnings, *saturation_warnings(sensed)],
        "mean_iterations": float(columns[f"iterations_{ACTUAL}"].mean()),
        "cleaning": {item.data_set: _cleaning_entry(item, result, columns) for item in setup.analysis.pipelines},
        "stopped": _stopped_entry(result),
        "scores": {},
    }
    if setup.scene.map.maker != "binned":
        content["map_maker"] = map_maker_entry(setup.scene, coadds)
    if setup.scene.losses:
        content["samples_lost"] = float(columns["flagged"].mean())
    if sensed:
        content["sensitivity"] = sensitivity_entries(setup, sensed)
    if result.unscored:
        content["unscored"] = result.unscored
    if result.scores:
        content |= _scored_entries(result)
    if result.sky:
        content["own_sky"] = sky_entry(result.sky)
    if result.spectra:
        content["split_spectra"] = spectra_entry(setup, result.spectra, coadds.done)
    content["closure"] = [vars(item) for item in closure_tests(setup, coadds, result.scores, result.expected)]
    content["run"] = {
        "date": now(),
        "engine": result.engine,
        "workers": result.workers,
        "wall_s": result.wall_s,
        "stage_s": coadds.seconds,
        "stage_ns_per_detector_sample": {k: 1e9 * v / samples for k, v in coadds.seconds.items()},
    }
    return content


def _scored_entries(result: SurveyResult) -> dict[str, Any]:
    """Entries of a run with a score."""
    from surveysim.results.agreement import forecast_agreement

    expected = result.expected.scores if result.expected else {}
    region, entries = result.setup.analysis.region, dict[str, Any]()
    entries["estimate"] = known(vars(result.estimate))
    entries["scores"] = score_entries(result)
    entries["metrics"] = metric_entries(result.metrics)
    entries["error_budget"] = {name: known(_budget_entry(item)) for name, item in result.scores.items()}
    agreements = forecast_agreement(result)
    entries["forecast_over_simulated"] = {name: known(vars(item)) for name, item in agreements.items()}
    entries["forecast"] = {name: _forecast_entry(item) for name, item in expected.items()}
    entries["gains"] = {name: known(vars(item)) for name, item in result.gains.items()}
    entries["alternatives"] = result.alternatives
    if not np.isnan(region.scored_correlation):
        entries["bin_correlation"] = region.scored_correlation
    entries["time_to_precision"] = [vars(cost) for cost in map(result.cost, TOLD_ERRORS) if cost]
    return entries


def _cleaning_entry(pipeline: CleaningPipeline, result: SurveyResult, columns: dict[str, np.ndarray]) -> dict[str, Any]:
    """Scans, iterations and templates of one pipeline, and the share of observations in which it is the best."""
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
    """Median PSD of the cleaned streams over its level in the upper half of the band, at some frequencies.

    That level is the instrument noise after this pipeline: templates of few detectors remove a part of it too. None
    without a kept scan, or if cleaning removes the streams completely.
    """
    setup, coadds = result.setup, result.coadds
    psds = coadds.clean_psd if place == 0 else [psd[place - 1] for psd in coadds.compared_psd]
    median = np.median([psd for psd in psds if psd.any()] or [np.zeros(len(psds[0]))], axis=0)
    white = median[len(median) // 2 : -1].mean()
    step = setup.observing.scans.sample_rate_hz / samples_per_scan(setup.observing.scans)
    bins = {f"{hz:g} Hz": round(hz / step) for hz in PSD_AT_HZ}
    # Without the first bin (removed mean of the scan) and the last (single mode at the Nyquist frequency).
    there = {name: k for name, k in bins.items() if 2 <= k < len(median) - 1}
    return {name: float(median[k] / white) if white > 0 else None for name, k in there.items()}


def _budget_entry(item: DataSetScore) -> dict[str, float]:
    """Relative errors of one data set's sigma(A), by their origin."""
    budget = item.budget
    return {
        "noise": budget.noise,
        "weather": budget.weather,
        "transfer_function": budget.transfer_function,
        "population": budget.population,
    }


def _stopped_entry(result: SurveyResult) -> dict[str, Any]:
    """Reason for the end of the run, its observations, and its relative error."""
    estimate, limits = result.estimate, {}
    for name in ("target_error", "time_budget_s"):
        if (value := getattr(result.limits, name)) is not None:
            limits[name] = value
    entry: dict[str, Any] = {
        "reason": result.stopped,
        "observations_simulated": result.coadds.done,
        "observations_of_survey": result.setup.scene.observations,
        **limits,
    }
    if estimate:
        told = {"metric": result.limits.metric, "relative_error": result.relative_error}
        entry |= known({"estimate": estimate.kind} | told)
    return entry


def _forecast_entry(item: "DataSetForecast") -> dict[str, Any]:
    return {"discarded": item.kept.discarded, "effects": [vars(effect) for effect in item.effects]}


def best_pipeline(setup: Setup, columns: dict[str, np.ndarray], target: str) -> np.ndarray:
    """Place (n_obs,) among the pipelines for all detectors of the best one for a target, -1 without data."""
    merits = [columns[f"merit_{target}_{pipeline.data_set}"] for pipeline in setup.analysis.whole_pipelines]
    return best_places(np.array(merits))
