"""Figure of a run's error against simulation time, from the run's own errors and times."""

import numpy as np

from surveysim.report.figures.spec import Panel, PaperFigure, Series
from surveysim.results.results import SurveyResult
from surveysim.runtime.numbers import duration

SHORTEST, LONGEST = 1 / 30, 30  # of the times drawn, in those of the run
FEWEST = 2  # observations of the times drawn
TARGETS = np.geomspace(1 / 5, 10, 40)  # relative errors whose costs are drawn, in that of the run


def time_figure(result: SurveyResult) -> PaperFigure:
    """Relative error of the best estimate against seconds of simulation with the run's workers.

    The solid line has more observations only, the dashed one also more sign-flipped co-adds and skies where needed.
    """
    parts, done = result.parts, result.coadds.done
    own_s = done * parts.each_s / result.workers
    seconds = own_s * np.geomspace(max(SHORTEST, min(1, FEWEST / done)), LONGEST, 60)
    fixed = np.linalg.norm([parts.flips, parts.skies, parts.rest])
    alone = np.hypot(parts.observations * np.sqrt(own_s / seconds), fixed)
    error = result.estimate.relative_error
    costs = [cost for cost in map(result.cost, error * TARGETS) if cost and cost.observations > 2]
    # Observations come in pairs: of each number, the lowest error.
    lowest = {cost.observations: cost for cost in reversed(costs)}
    dashed = np.array([(cost.seconds, cost.relative_error) for cost in lowest.values()]).reshape(-1, 2).T
    this_run = f"this run: {duration(own_s)} of simulation, {duration(result.wall_s)} from start to score"
    series = (
        Series("more observations", "line", seconds, alone, "black"),
        Series("more sign-flipped co-adds and skies too", "line", dashed[0], dashed[1], "vermilion --"),
        Series(this_run, "points", np.array([own_s]), np.array([error]), "blue -."),
    )
    label = f"Time of simulation with {result.workers} worker{'s' * (result.workers > 1)} [s]"
    reach = (float(seconds[0]), float(seconds[-1]))
    panel = Panel("", label, r"Relative error of $\sigma(A)$", series, True, True, x_range=reach)
    title = f"{result.setup.scene.name}: error against run time ({done} observations)"
    return PaperFigure(0, title, "Extrapolated from this run's own errors and times.", (panel,))
