"""The guide against the program `mapmaker`: keys of configurations, commands, files, and reasons."""

import re

import pytest
import typer.main

from docs.generated import config_reference, config_sections, mapmaker_command_reference
from mapmaker.cli.app import app
from mapmaker.cli.clean_and_map import EXIT_INCOMPLETE
from mapmaker.cli.main import EXIT_FAILED, EXIT_INTERRUPTED, EXIT_WRONG_INPUT
from mapmaker.pipeline.dropped import EXPLANATIONS
from tests.docs.pages import ROOT

pytestmark = pytest.mark.docs
PAGE = (ROOT / "docs" / "guide" / "real_data.md").read_text()


def test_every_key_of_a_configuration_is_in_the_reference():
    text = config_reference()
    for heading, section in config_sections():
        part = text.split(f"### {heading}\n")[1].partition("\n### ")[0]
        names = [name for name in section.model_fields if name != "algorithm"]
        assert re.findall(r"^\| `(\w+)` \|", part, re.MULTILINE) == names
        assert all(field.description for name, field in section.model_fields.items() if name != "algorithm"), heading
    rows = {line.split("|")[1].strip(): line for line in text.splitlines() if line.startswith("| `")}
    assert rows["`jump_window`"].endswith('| time, as `"1 s"` | `"1 s"` |')
    assert rows["`healpix_nside`"].endswith("| integer from 1 to 1048576 |  |")
    assert rows["`widths`"].endswith("| **required** |")


def test_every_command_and_option_is_in_the_reference():
    text = mapmaker_command_reference()
    for name, command in typer.main.get_command(app).commands.items():
        part = text.split(f"## `mapmaker {name}`\n")[1].partition("\n## ")[0]
        for parameter in command.params:
            assert parameter.opts[-1] in part or parameter.opts[-1].upper() in part


def test_reasons_and_exit_codes():
    rows = dict(re.findall(r"^\| ([^|`]+) \| ([^|]+) \|$", PAGE, re.MULTILINE))
    assert {reason: rows[reason] for reason in EXPLANATIONS} == EXPLANATIONS
    codes = list(map(int, re.findall(r"^\| (\d+) \|", PAGE, re.MULTILINE)))
    assert codes == [0, EXIT_FAILED, EXIT_WRONG_INPUT, EXIT_INCOMPLETE, EXIT_INTERRUPTED]
