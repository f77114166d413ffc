"""The guide's pages as their readers take them: blocks of code in order, and what is done with each kind."""

import os
import re
import shutil
import signal
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile

from markdown_it import MarkdownIt

from tests.entry import READERS_PATH

ROOT = Path(__file__).parent.parent.parent
README = ROOT / "README.md"
PAGES = sorted((ROOT / "docs").rglob("*.md"))
SHOWN = ("console", "text")  # for reading, as the guide says
PROGRAM = ("mapmaker", "surveysim", "tests", "pyproject.toml")


@dataclass(frozen=True)
class Block:
    """A fenced block of a page: the language that it names, its text, and the line of the page where it begins."""

    page: str
    line: int
    language: str
    text: str

    @property
    def file(self) -> str:
        """The file that its first line names, as in ``# streams.py``; empty if it names none."""
        match = re.match(r"# ([\w./-]+\.\w+)\n", self.text)
        return match[1] if match else ""


def blocks(path: Path) -> list[Block]:
    """All fenced blocks of a page, in order."""
    tokens = MarkdownIt().parse(path.read_text(encoding="utf-8"))
    fences = [token for token in tokens if token.type == "fence"]
    return [Block(path.name, token.map[0] + 1, token.info.strip(), token.content) for token in fences]


def follow(page: list[Block], folder: Path) -> None:
    """Do in an empty folder what a page says, with the installed program; AssertionError names the block that fails.

    The folder becomes a copy of what a reader has: the scenes, and the program where the page changes it. Text after
    commands is what they print, or lines of it.
    """
    # A reader who changes the program has installed it with -e, and runs the changed one.
    edited = any(block.language == "diff" for block in page)
    for name in ("scenarios", *PROGRAM) if edited else ("scenarios",):
        _copy(ROOT / name, folder / name)
    printed = None
    for block in page:
        said, printed = printed, None
        if block.language == "bash":
            printed = _run(block, ["bash", "-euo", "pipefail", "-c", block.text], folder, edited)
        elif block.language == "text" and said is not None:
            for line in filter(None, map(str.strip, block.text.splitlines())):
                assert line in said, f"{block.page}:{block.line}: not printed: {line}\n{said}"
        elif block.language == "diff":
            _run(block, ["git", "apply", "-"], folder, False, block.text)
        elif block.language == "python":
            assert block.file, f"{block.page}:{block.line}: a script without a name"
            (folder / block.file).write_text(block.text, encoding="utf-8")
        elif block.language == "toml":
            if block.file:
                scene = folder / block.file
                scene.write_text(with_sections(scene.read_text(encoding="utf-8"), block.text), encoding="utf-8")
        elif not block.language.startswith("{"):  # those are Sphinx's
            assert block.language in SHOWN, f"{block.page}:{block.line}: a block of kind {block.language!r}"


def _copy(source: Path, target: Path) -> None:
    """Copy a file or a folder with its compiled kernels, which hold as long as their source has its size and date."""
    if source.is_dir():
        shutil.copytree(source, target)
    else:
        shutil.copy(source, target)


def with_sections(scene: str, changes: str) -> str:
    """A scene with keys above all sections, and with sections, in place of its own of these names, others added.

    What lies below a section goes with it.
    """
    head, *sections = _split(scene)
    new_head, *new = _split(changes)
    for line in new_head.splitlines():
        if match := re.match(r"(\w+) = ", line):
            head = re.sub(rf"(?m)^{match[1]} = .*$", lambda _, line=line: line, head)
            assert line in head, f"no key {match[1]!r} above the sections"
    names = [_name(text) for text in new]
    kept = [text for text in sections if not any(f"{_name(text)}.".startswith(f"{name}.") for name in names)]
    return "\n".join([head, *kept, *new])


def _split(text: str) -> list[str]:
    """The text above all sections, then each section."""
    return re.split(r"(?m)^(?=\[)", text)


def _name(section: str) -> str:
    return section.partition("]")[0]


def _run(block: Block, command: list[str], folder: Path, edited: bool, given: str | None = None) -> str:
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    environment = os.environ | {"PATH": path, "PYTHONPATH": str(folder) if edited else READERS_PATH}
    with TemporaryFile("w+") as text, TemporaryFile("w+") as out, TemporaryFile("w+") as errors:
        text.write(given or "")
        text.seek(0)
        process = subprocess.Popen(
            command, cwd=folder, env=environment, stdin=text, stdout=out, stderr=errors, start_new_session=True
        )
        code = process.wait()
        with suppress(ProcessLookupError):  # a block that fails leaves its background jobs
            os.killpg(process.pid, signal.SIGTERM)
        said = "\n".join(file.read() for file in (out, errors) if file.seek(0) == 0)
    assert code == 0, f"{block.page}:{block.line} ends with {code}\n{block.text}\n{said}"
    return said
