"""The command line: the program's options, and the list of its commands."""

from typing import Annotated, Any

import typer
from typer.core import TyperArgument, TyperCommand

from mapmaker.printable import say
from surveysim import __version__
from surveysim.cli import budgets, compare, optimise, runs, scenes, studies, tracks

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
    scenes.check,
    scenes.optics,
    tracks.track,
    scenes.keys,
    scenes.new,
    scenes.cameras,
)


class PlainCommand(TyperCommand):
    """Command whose help shows arguments as SCENE, without types and braces."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        for param in self.params:
            if isinstance(param, TyperArgument):
                param.display_type_rich = lambda ctx: None  # type: ignore[method-assign]

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Return the words of the usage line."""
        return [piece.replace("{", "").replace("}", "") for piece in super().collect_usage_pieces(ctx)]


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
