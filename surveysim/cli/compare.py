"""The command compare: finished runs beside each other."""

from pathlib import Path
from typing import Annotated

import typer

from surveysim.cli.options import Force, NoFigures, Quiet


def compare(
    directories: Annotated[
        list[Path],
        typer.Argument(metavar="DIR", help="Two or more runs, or points of a sweep."),
    ],
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Directory for table, figures and report; by default none.")
    ] = None,
    no_figures: NoFigures = False,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Compare finished runs.

    Settings that differ, scores with paired errors and spectra are read from their directories. Ratios are to the first
    run.
    """
    from surveysim.api.comparisons import compare as compare_runs
    from surveysim.report.terminal.compare import print_comparison

    result = compare_runs(directories, out, figures=not no_figures, force=force)
    if not quiet:
        print_comparison(result, out)
