"""Sphinx builds the guide: `sphinx-build -W docs build/docs`. Nothing is fetched."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from generated import command_reference, config_reference, mapmaker_command_reference, scene_reference
from generated_python import api_reference, module_reference

from surveysim import __version__

project = "surveysim"
release = version = __version__
extensions = ["myst_parser"]
myst_heading_anchors = 3
html_theme = "furo"
html_title = f"surveysim {version}"
html_static_path = ["_static"]
html_css_files = ["blocks.css"]
html_show_sphinx = False
html_show_copyright = False
html_copy_source = False

# A line of a page and what takes its place when the guide is built.
GENERATED = {
    "<!-- all keys of a scene, made from the schema -->": scene_reference,
    "<!-- all commands, made from the program -->": command_reference,
    "<!-- all commands of mapmaker, made from the program -->": mapmaker_command_reference,
    "<!-- all keys of a configuration of mapmaker, made from the schema -->": config_reference,
    "<!-- all public names, made from the packages -->": api_reference,
    "<!-- all modules, made from the packages -->": module_reference,
}


def fill(app: object, page: str, source: list[str]) -> None:
    """Put what is made at build time where the page has its line."""
    for line, make in GENERATED.items():
        if line in source[0]:
            source[0] = source[0].replace(line, make())


def setup(app) -> None:
    """Let Sphinx call `fill` for each page."""
    app.connect("source-read", fill)
