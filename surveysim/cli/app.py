"""The command line: the program's options, and the list of its commands."""

from typing import Annotated

import typer

from mapmaker.cli.plain import PlainCommand
from mapmaker.printable import say
from surveysim import __version__
from surveysim.cli import budgets, checks, compare, optimise, runs, scenes, studies, tracks

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # plain help: quick to load, and without types of flags
    context_settings={"help_option_names": ["-h", "--help"]},
)
COMMANDS = (
    runs.run,
    runs.forecast,
    budgets.budget,
    optimise.optimise,
    studies.accuracy,
    compare.compare,
    runs.plan,
    studies.paper,
    scenes.report,
    checks.check,
    checks.optics,
    tracks.track,
    scenes.keys,
    scenes.new,
    scenes.cameras,
)


for command in COMMANDS:
    app.command(cls=PlainCommand)(command)


def _print_version(asked: bool) -> None:
    if asked:
        say(f"surveysim {__version__}")
        raise typer.Exit


@app.callback()
def program(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Monte Carlo surveys of millimetre-wave cameras through a turbulent atmosphere."""
