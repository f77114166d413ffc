"""The parts of the guide that are made when it is built: all keys of a scene, all commands."""

import subprocess
import sys

from surveysim.scene.keys import key_rows, scene_sections


def scene_reference() -> str:
    """Markdown: for each section of a scene a heading, what it is, and a table of its keys."""
    parts = []
    for section in scene_sections():
        parts += [f"## {section.heading}", *section.introduction]
        rows = [
            f"| `{row.key.rpartition('.')[2]}` | {row.meaning} | {row.kind} | {row.allowed} | {row.default} |"
            for row in key_rows(section)
        ]
        head = "| key | what it is | type and unit | allowed | default |\n|---|---|---|---|---|"
        parts.append("\n".join([head, *rows]))
    return "\n\n".join(parts)


def command_reference() -> str:
    """Markdown: for each command what it does, its arguments and options, as typer documents them."""
    command = [sys.executable, "-m", "typer", "surveysim.cli.app", "utils", "docs", "--name", "surveysim"]
    text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    return text[text.index("## `surveysim ") :].replace("```console\n$ ", "```text\n")
