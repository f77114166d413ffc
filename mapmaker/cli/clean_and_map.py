"""Command `mapmaker clean-and-map`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mapmaker.printable import say

if TYPE_CHECKING:
    from mapmaker.pipeline.run import Result

EXIT_INCOMPLETE = 3  # maps are written, but files are missing in them
_MOST_LINES = 12  # reasons that are printed


def clean_and_map(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILES", help="Files of time-streams, in order of time.", show_default=False),
    ],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Directory for the results.", show_default=False)],
    config: Annotated[
        Path | None,
        typer.Option(
            "--config", metavar="FILE", help="Configuration, a TOML file; without it, defaults.", show_default=False
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace earlier results in the directory.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")] = False,
) -> None:
    """Clean time-streams and map them: maps, noise, tables of what was left out, and a report.

    The exit code is 3 if maps are written, but a file could not be used.
    """
    from mapmaker.cli.progress import progress_display
    from mapmaker.pipeline.config import Config, load_config
    from mapmaker.pipeline.outputs import check_directory, replaced, write_outputs
    from mapmaker.pipeline.run import clean_and_map as run

    settings = load_config(config) if config else Config()
    check_directory(out, force)
    done = [0]
    try:
        with replaced(out) as folder, progress_display(quiet) as show:

            def told(what: str, number: int, total: int) -> None:
                done[0] = number if what == "cleaning" else 0
                show(what, number, total)

            result = run(files, settings, told, folder)
            show("writing results", 0, 0)
            write_outputs(folder, result)
    except KeyboardInterrupt as error:
        error.add_note(f"{done[0]} of {len(files)} files were cleaned; nothing is kept of them, {out} is as before")
        raise
    if not quiet:
        say(_summary(result, out))
    if not all(item.used for item in result.files):
        raise typer.Exit(EXIT_INCOMPLETE)


def _summary(result: "Result", out: Path) -> str:
    """Lines about a result: files, data that were left out, and the place of the report."""
    from mapmaker.pipeline.totals import reason_totals

    files = [item for item in result.files if item.used]
    share = sum(item.samples_used for item in files) / max(1, sum(item.samples for item in files))
    lines = [f"{len(files)} of {len(result.files)} files mapped, {100 * share:.1f} % of their samples"]
    lines += [result.maps.solution] if result.maps.solution else []
    totals = reason_totals(result.dropped)
    lines += [f"  {item.text}" for item in totals[:_MOST_LINES]]
    lines += [f"  {item.file}: {item.detail}" for item in result.dropped if item.what == "file"][:_MOST_LINES]
    return "\n".join([*lines, f"results in {out}, report in {out / 'report.html'}"])
