"""The Python interface of comparisons of finished runs."""

from collections.abc import Sequence
from pathlib import Path

from threadpoolctl import threadpool_limits

from surveysim.output.directory import claimed, replacing
from surveysim.output.expected_study_files import of_comparison
from surveysim.output.study_writer import write_comparison
from surveysim.studies.compare.comparison import RunComparison, compare_finished
from surveysim.studies.compare.finished_run import read_runs


def compare(
    directories: Sequence[str | Path], out: str | Path | None = None, *, figures: bool = True, force: bool = False
) -> RunComparison:
    """Compare finished runs with the first of them.

    Parameters
    ----------
    directories
        Two or more output directories of runs, of bands of a camera, or of points of a sweep (SWEEP/points/3).
    out
        Directory for the results.
    figures
        Draw the figures of the report.
    force
        Replace other results in `out`, and the user's files of the same names.

    Returns
    -------
    Settings that differ; scores, metrics and their ratios. Errors of ratios are paired where seed and version are the
    same and the directories have scores.npz, else they are those of independent runs.

    Raises
    ------
    SceneError
        A directory is none of a finished run with a score.
    OutputError
        As for `run`.
    """
    with threadpool_limits(1):  # the same bits on any machine
        result = compare_finished(read_runs(directories))
    if out is not None:
        with claimed(Path(out), of_comparison(result, figures), force) as place, replacing(place) as new:
            write_comparison(new, result, figures)
    return result
