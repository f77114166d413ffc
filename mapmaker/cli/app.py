"""The command line of mapmaker: the program's options, and the list of its commands."""

from collections.abc import Callable
from importlib.metadata import version as installed_version
from typing import Annotated

import typer

from mapmaker.cli.clean_and_map import clean_and_map
from mapmaker.cli.convert import convert
from mapmaker.cli.plain import PlainCommand
from mapmaker.printable import say

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # plain help: quick to load
    context_settings={"help_option_names": ["-h", "--help"]},
)
# The modules of commands import what they need when they run: the help loads neither numpy nor astropy.
COMMANDS: tuple[Callable[..., None], ...] = (clean_and_map, convert)

for command in COMMANDS:
    app.command(cls=PlainCommand)(command)


def _print_version(asked: bool) -> None:
    if asked:
        say(f"mapmaker {installed_version('mmcam-surveysim')}")
        raise typer.Exit


@app.callback()
def program(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Cleaning and map-making of time-streams of bolometer arrays."""
