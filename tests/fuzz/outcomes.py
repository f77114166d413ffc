"""Outcomes of mangled inputs, and their detection."""

import contextlib
import io
import os
import re
import sys
import traceback
import unicodedata
from dataclasses import dataclass
from pathlib import Path

from tests import entry

GOOD = ("refused", "right")
BAD = ("silent", "message", "traceback", "hang", "memory")
LONGEST_LINE, MOST_LINES = 500, 40
_LIBRARY = re.compile(r"^WARNING: .*|\b[A-Z]\w+Warning: .*", re.MULTILINE)
BUG = ("Traceback (most recent call last)", "surveysim can't go on")
_DETAILS = re.compile(r"details in (\S+\.txt)")


@dataclass(frozen=True)
class Outcome:
    """One of `GOOD` or `BAD`; `text` says why, or quotes the refusal.

    "silent": accepted, and the result is wrong. "message": refused, with a text that is long, of several lines, or
    carries control characters; or with the wrong exit code.
    """

    kind: str
    text: str = ""


class Silent(Exception):
    """Something wrong was accepted; the text says what."""


def check(condition: object, text: str) -> None:
    """Raise Silent with a text unless a condition holds."""
    if not condition:
        raise Silent(text)


@dataclass(frozen=True)
class Ended:
    """End of a command: exit code, or the traceback that escaped it, and its output."""

    code: int
    out: str
    error: str
    escaped: str = ""


def call(*arguments: str) -> Ended:
    """Run the command line in this process; its streams are files, as in a batch job."""
    kept = [os.dup(number) for number in (1, 2)]
    files = [Path(name).absolute() for name in (".stdout", ".stderr")]
    sys.argv = ["surveysim", *arguments]
    escaped, code = "", 0
    try:
        for number, path in enumerate(files, 1):
            target = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(target, number)
            os.close(target)
        sys.stdout, sys.stderr = (io.TextIOWrapper(os.fdopen(os.dup(n), "wb"), "utf-8", "replace") for n in (1, 2))
        entry.main()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
    except BaseException:  # whatever gets through is what is looked for
        escaped, code = traceback.format_exc(), 1
    finally:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(ValueError, OSError):
                stream.close()
        sys.stdout, sys.stderr = sys.__stdout__, sys.__stderr__
        for number, old in enumerate(kept, 1):
            os.dup2(old, number)
            os.close(old)
    texts = [path.read_text("utf-8", "replace") for path in files]
    for path in files:
        path.unlink()
    return Ended(code, *texts, escaped)


def last_frame(text: str) -> str:
    """Place and reason of a traceback."""
    lines = [line.strip() for line in text.strip().splitlines()]
    frames = [line for line in lines if line.startswith("File ") and "/tests/fuzz/" not in line]
    where = frames[-1].replace("File ", "", 1) if frames else "?"
    ours = [line for line in frames if "/surveysim/" in line or "/mapmaker/" in line]
    if ours and ours[-1] != frames[-1]:
        where = f"{ours[-1].replace('File ', '', 1)} -> {where}"
    return f"{lines[-1][:200] if lines else ''} at {where}"


def fault_of_text(text: str) -> str:
    """Fault of a message for a user, empty if there is none."""
    controls = {f"U+{ord(c):04X}" for c in text if c != "\n" and _unprintable(c)}
    if controls:
        return f"control characters {', '.join(sorted(controls))}"
    if found := _LIBRARY.search(text):
        return f"a library's warning {found[0]!r}"
    lines = text.strip().splitlines()
    if lines and lines[0].startswith("Usage:"):  # the frame that typer draws around its one line
        lines = [text.strip()[-LONGEST_LINE:]] if len(text) < 4 * LONGEST_LINE else lines
    if not lines:
        return "no message"
    if len(lines) > MOST_LINES:
        return f"{len(lines)} lines"
    longest = max(map(len, lines))
    return f"a line of {longest} characters" if longest > LONGEST_LINE else ""


def _unprintable(character: str) -> bool:
    return unicodedata.category(character) in ("Cc", "Cs", "Zl", "Zp") or "\u202a" <= character <= "\u202e"


def outcome_of_end(ended: Ended, refusals: tuple[int, ...] = (2,)) -> Outcome | None:
    """The outcome of a command that did not accept its input, or None where it did."""
    said = ended.escaped or ended.error
    if ended.escaped or any(words in said for words in BUG):
        return Outcome("traceback", last_frame(ended.escaped) if ended.escaped else _details(ended.error))
    if "not enough memory" in said or "MemoryError" in said:
        return Outcome("memory", said[-300:])
    if ended.code == 0:
        warned = _LIBRARY.search(ended.error)
        return Outcome("message", f"a library's warning: {ended.error[-300:]}") if warned else None
    if ended.code not in refusals:
        return Outcome("message", f"exit code {ended.code}: {ended.error[:300]}")
    fault = fault_of_text(ended.error)
    if fault:
        return Outcome("message", f"{fault}: {ended.error[:300]}")
    return Outcome("refused", ended.error[:300])


def _details(error: str) -> str:
    """Place of a bug that the entry point caught, from its file with the details, which is removed."""
    match = _DETAILS.search(error)
    if match is None or not Path(match[1]).is_file():
        return error[-300:]
    text = Path(match[1]).read_text(encoding="utf-8", errors="replace")
    Path(match[1]).unlink()
    return last_frame(text)


def outcome_of_error(error: Exception, allowed: tuple[type, ...]) -> Outcome:
    """The outcome of an error that a function raised."""
    if isinstance(error, MemoryError):
        return Outcome("memory", str(error))
    if not isinstance(error, allowed):
        return Outcome("traceback", last_frame("".join(traceback.format_exception(error))))
    fault = fault_of_text(str(error)) or ("two lines" if len(str(error).splitlines()) > 1 else "")
    return Outcome("message", f"{fault}: {str(error)[:300]}") if fault else Outcome("refused", str(error)[:300])
