"""Text for a terminal: text from files and options can neither control the terminal nor fill it."""

import sys

LONGEST = 600  # characters of a line of an error
MOST_LINES = 10  # longest error message


def printable(text: object) -> str:
    """Escape all characters that are not printable, such as ``\\x1b``, ``\\n``, ``\\u202e`` and lone surrogates."""
    line = str(text)
    if line.isprintable():
        return line
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in line)


def shortened(line: str, longest: int = LONGEST) -> str:
    """Cut the middle of a long line: its beginning names the file, its end the values expected."""
    if len(line) <= longest:
        return line
    end = longest // 3
    return f"{line[: longest - end - 5]} ... {line[-end:]}"


def short_lines(text: object) -> str:
    """Printable lines of an error, each shortened, and the number of lines left out."""
    lines = [shortened(printable(line)) for line in str(text).split("\n")]
    more = len(lines) - MOST_LINES
    return "\n".join(lines if more <= 0 else [*lines[:MOST_LINES], f"and {more} more"])


def say(text: object) -> None:
    """Print a result to standard output in printable lines."""
    print("\n".join(map(printable, str(text).split("\n"))), file=sys.stdout, flush=True)


def complain(text: object) -> None:
    """Print an error or a notice to standard error in a few printable lines."""
    print(short_lines(text), file=sys.stderr, flush=True)
