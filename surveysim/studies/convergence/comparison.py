"""Comparison of settings: errors, biases, slopes, and recommendations."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from mapmaker.uncertainty import ErrorBudget
from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.reduction.setup import Setup
from surveysim.runtime.errors import InputError
from surveysim.runtime.memory import peak_bytes
from surveysim.studies.convergence.records import MUCH_FASTER, MUCH_WORSE, Measured, Recommendation, Setting, Slope
from surveysim.studies.convergence.runs import Mark, Run, Tasks, clocks, first_line
from surveysim.survey.error_modes import error_modes
from surveysim.survey.scores import DataSetScore


def survey_rows(settings: Iterable[Setting], pooled: Sequence[Run]) -> list[Measured]:
    """Make the rows of the number of observations: means over seeds, relative to the mean of the whole surveys.

    The error of a bias is the paired error of a part and its whole, divided by the root of the number of seeds.
    """
    rows = []
    for setting in (item for item in settings if item.kind == "survey"):
        count = int(setting.label)
        marks = [run.marks.get(count, Mark(None, np.nan, np.nan, "refused: no observation")) for run in pooled]
        if any(mark.score is None for mark in marks):
            reason = next(mark.note for mark in marks if mark.score is None)
            rows.append(Measured(setting, count, note=reason))
            continue
        rows.append(_survey_row(setting, count, marks, pooled))
    return rows


def _survey_row(setting: Setting, count: int, marks: Sequence[Mark], pooled: Sequence[Run]) -> Measured:
    whole = [run.marks[max(run.marks)].score for run in pooled]
    (sigma, errors), (reference, _) = sigmas(mark.score for mark in marks), sigmas(whole)
    paired = [_bias(mark.score, one, True)[1] for mark, one in zip(marks, whole, strict=True)]
    parts = {key: rms([vars(mark.score.budget)[key] for mark in marks]) for key in vars(marks[0].score.budget)}
    seen = f"scatter of {len(marks)} seeds: {100 * scatter(sigma):.1f} %"
    return Measured(
        setting,
        count,
        sigma_ukcmb2=float(sigma.mean()),
        error_ukcmb2=float(sigma.mean() * rms(errors)),
        bias=float(sigma.mean() / reference.mean() - 1),
        bias_error=rms(paired) / float(np.sqrt(len(marks))),
        wall_s=float(np.mean([mark.wall_s for mark in marks])),
        cpu_s=float(np.mean([mark.cpu_s for mark in marks])),
        start_s=float(np.mean([run.start_s for run in pooled])),
        peak_mb=max(run.peak_mb for run in pooled),
        raised_mb=max(run.raised_mb for run in pooled),
        budget=ErrorBudget(**parts),
        note=seen if len(marks) > 1 else "",
    )


def ladder_rows(settings: Sequence[Setting], asked: Tasks, runs: Mapping[str, Run]) -> list[Measured]:
    """Make the rows of the other ladders, each relative to the finest of its settings that could be run."""
    found: dict[int, tuple[Run, Mark]] = {}
    refused = dict(asked.refused)
    for place, key in asked.hashes.items():
        run, (n_obs,) = runs[key], asked.tasks[key].counts
        mark = run.marks.get(n_obs, Mark(None, np.nan, np.nan, run.note))
        if mark.score is None:
            refused[place] = mark.note
        else:
            found[place] = run, mark
    rows = []
    for place, setting in enumerate(settings):
        if setting.kind not in ("sampling", "numerical"):
            continue
        finest = max((other for other in found if settings[other].parameter == setting.parameter), default=place)
        same_skies = setting.parameter not in ("signal simulations", "observations with simulations")
        n_obs = max(task.counts[0] for task in asked.tasks.values())
        if place in refused:
            rows.append(Measured(setting, n_obs, note=refused[place]))
        else:
            run, mark = found[place]
            best = found[finest][1].score
            rows.append(_ladder_row(setting, n_obs, run, mark, finest=best, same_skies=same_skies))
    return rows


def _ladder_row(
    setting: Setting, n_obs: int, run: Run, mark: Mark, *, finest: DataSetScore, same_skies: bool
) -> Measured:
    band, (bias, bias_error) = mark.score.band, _bias(mark.score, finest, same_skies or mark.score is finest)
    spent = mark.wall_s, mark.cpu_s, run.start_s, run.peak_mb, run.raised_mb
    return Measured(setting, n_obs, band.sigma_ukcmb2, band.error_ukcmb2, bias, bias_error, *spent, mark.score.budget)


def forecast_row(setup: Setup, setting: Setting, reference_ukcmb2: float, reference_error: float) -> Measured:
    """Make a row from the forecast instead of a run, over all weather like the reference."""
    from surveysim.forecasting.forecast import forecast
    from surveysim.results.control_variate import in_all_weather

    scene = setup.scene
    try:
        before = clocks()
        forecast(setup)
        between = clocks()
        sigma = in_all_weather(setup, forecast(setup))[ACTUAL]
    except InputError as error:  # a scene without a forecast
        return Measured(setting, scene.observations, note=f"refused: {first_line(error)}")
    wall, cpu = clocks() - between
    ratio = sigma / reference_ukcmb2
    start_s = max(0.0, float((between - before)[0] - wall))
    spent = float(wall), float(cpu), start_s, peak_bytes() / 1e6, np.nan
    return Measured(setting, scene.observations, sigma, 0.0, ratio - 1, ratio * reference_error, *spent)


def _bias(item: DataSetScore, reference: DataSetScore, same_skies: bool) -> tuple[float, float]:
    """Ratio of sigma(A) minus 1, and its paired error for runs with the same seed."""
    ratio = item.band.sigma_ukcmb2 / reference.band.sigma_ukcmb2
    one, other = error_modes((item, reference), (0, 0 if same_skies else 1))
    return float(ratio - 1), float(ratio * np.linalg.norm(one - other))


def sigmas(scores: Iterable[DataSetScore]) -> tuple[np.ndarray, np.ndarray]:
    """Return sigma(A) (n,) and its relative errors (n,)."""
    found = [(item.band.sigma_ukcmb2, item.budget.total) for item in scores]
    sigma, errors = np.transpose(found)
    return sigma, errors


def scatter(sigma: np.ndarray) -> float:
    """Relative standard deviation, NaN for a single value."""
    return float(np.std(sigma, ddof=1) / sigma.mean()) if len(sigma) > 1 else np.nan


def rms(values: Sequence[float] | np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def slopes(rows: Iterable[Measured]) -> list[Slope]:
    """Fit slopes of the Monte Carlo errors against observations, time and noise realizations.

    -1/2 is expected against observations and time, which excludes the start. All sign flips of a survey share its
    noise, so the error stops falling once they are as many as its observations.

    Parameters
    ----------
    rows
        Measured settings; those without an error budget are left out.

    Returns
    -------
    Slopes; those with fewer than two different positive abscissas are left out.
    """
    done = [row for row in rows if row.budget is not None]
    whole = [row for row in done if row.setting.kind == "survey"]
    flips = [row for row in done if row.setting.parameter == "noise realizations"]
    counts = [row.observations for row in whole]
    total = [row.budget.total for row in whole]
    flipped = [row.budget.noise for row in flips]
    found = [
        _slope("error against observations", counts, total),
        _slope("error against time", [row.wall_s for row in whole], total),
        _slope("error against CPU time", [row.cpu_s for row in whole], total),
        _slope("noise part against observations", counts, [row.budget.noise for row in whole]),
        _slope("weather part against observations", counts, [row.budget.weather for row in whole]),
        _slope("noise part against noise realizations", [float(row.setting.label) for row in flips], flipped),
    ]
    return [item for item in found if item is not None]


def _slope(name: str, x_values: Sequence[float], y_values: Sequence[float]) -> Slope | None:
    x, y = np.array(x_values, float), np.array(y_values, float)
    used = (x > 0) & (y > 0)
    if np.unique(x[used]).size < 2:
        return None
    x, y = np.log(x[used]), np.log(y[used])
    from_mean = x - x.mean()
    slope = float(from_mean @ y / (from_mean @ from_mean))
    left = y - y.mean() - slope * from_mean
    error = np.sqrt(left @ left / (len(x) - 2) / (from_mean @ from_mean)) if len(x) > 2 else np.nan
    return Slope(name, slope, float(error))


def recommendations(rows: Iterable[Measured], tolerated: float) -> list[Recommendation]:
    """Return the fastest setting, in CPU time, of each parameter that is good enough.

    A numerical setting is good enough if its bias is below `tolerated` or below the error of the bias. A Monte Carlo
    setting is good enough if its error of sigma(A) hardly exceeds the error of the scene's own setting.
    """
    ladder: dict[str, list[Measured]] = {}
    for row in rows:
        if row.setting.kind in ("sampling", "numerical") and np.isfinite(row.bias):
            ladder.setdefault(row.setting.parameter, []).append(row)
    found = []
    for parameter, steps in ladder.items():
        own = next((row for row in steps if row.setting.own), steps[-1])
        samples = own.setting.kind == "sampling"
        if samples:
            good = [row for row in steps if not row.relative_error > MUCH_WORSE * own.relative_error]  # or unknown
        else:
            good = [row for row in steps if abs(row.bias) <= max(tolerated, row.bias_error)]
        best = min(good, key=lambda row: row.cpu_s)
        if own in good and own.cpu_s <= MUCH_FASTER * best.cpu_s:
            best = own
        resolved = samples or best.bias_error <= tolerated
        found.append(Recommendation(parameter, best.setting.label, best.setting.own, resolved))
    return found
