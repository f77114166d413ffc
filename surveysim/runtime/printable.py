"""Text for a terminal: what files and options hold can neither control it nor fill it."""

import sys

LONGEST = 400  # characters of a line of an error
MOST_LINES = 10  # of an error


def printable(text: object) -> str:
    """The text in one line; characters that control a terminal, break lines or turn the direction are escaped.

    Escaped is all that Unicode does not count as printable: ``\\x1b``, ``\\n``, ``\\u202e``, lone surrogates.
    """
    line = str(text)
    if line.isprintable():
        return line
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in line)


def shortened(line: str, longest: int = LONGEST) -> str:
    """The line less its middle, if it is longer than that: its beginning has the file, its end what is expected."""
    if len(line) <= longest:
        return line
    end = longest // 3
    return f"{line[: longest - end - 5]} ... {line[-end:]}"


def short_lines(text: object) -> str:
    """Printable lines of an error, each shortened, and how many there are more."""
    lines = [shortened(printable(line)) for line in str(text).split("\n")]
    more = len(lines) - MOST_LINES
    return "\n".join(lines if more <= 0 else [*lines[:MOST_LINES], f"and {more} more"])


def say(text: object) -> None:
    """Print a result to standard output, its lines printable."""
    print("\n".join(map(printable, str(text).split("\n"))), file=sys.stdout, flush=True)


def complain(text: object) -> None:
    """Print an error, or a notice, to standard error: printable, and no more than can be read."""
    print(short_lines(text), file=sys.stderr, flush=True)
