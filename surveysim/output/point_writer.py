"""Writing the results of the points of a sweep, each as those of a run."""

from dataclasses import dataclass
from pathlib import Path

from surveysim.output.directory import begin, claimed, replacing
from surveysim.output.expected_files import of_point
from surveysim.output.expected_study_files import point_directory
from surveysim.output.writer import write_outputs
from surveysim.results.results import SurveyResult
from surveysim.studies.sweep.axes import Point, Sweep


@dataclass(frozen=True)
class PointWriter:
    """Writes the results of a point below the `directory` of its sweep, in the process where it runs.

    Tables, spectra, summary and report always; maps and figures with `keep_all`.
    """

    directory: Path
    keep_all: bool
    force: bool

    def __call__(self, point: Point, result: SurveyResult) -> None:
        """Write the results of a run; errors as `claimed`."""
        results = of_point(result.setup, self.keep_all)
        with claimed(self.directory / point_directory(point.number), results, self.force) as place:
            begin(place, removed=lambda name: False)
            with replacing(place) as new:
                write_outputs(new, result, self.keep_all, maps=self.keep_all, point=point.label)


def check_points(writer: PointWriter, sweep: Sweep) -> None:
    """Raise the error of the first directory of a point that can't be written, before any work."""
    from surveysim.reduction.setup import prepare

    for point in sweep.points:
        directory = writer.directory / point_directory(point.number)
        if directory.exists():
            with claimed(directory, of_point(prepare(point.scene), writer.keep_all), writer.force):
                pass
