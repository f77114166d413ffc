"""HTML of a report page."""

import re
from functools import cache
from typing import TYPE_CHECKING

from mapmaker.printable import printable
from mapmaker.report.components import Page

if TYPE_CHECKING:
    from jinja2 import Environment
    from markupsafe import Markup

# Units and symbols as the results write them, once they are escaped for HTML.
_WRITTEN = [
    (re.compile(pattern), written)
    for pattern, written in (
        (r"\b([uµm])K_CMB\^?2\b", r"\1K²<sub>CMB</sub>"),
        (r"\b([uµ]K²|[uµm]K)_(CMB|RJ)\b", r"\1<sub>\2</sub>"),
        (r"\b([uµm])K\^?2\b", r"\1K²"),
        (r"\buK", "µK"),
        (r"\b(rad|Hz)\((-?[\d/]+)\)", r"\1<sup>\2</sup>"),
        (r"\^\(([^()]*)\)", r"<sup>\1</sup>"),
        (r"\^(-?\d+)", r"<sup>\1</sup>"),
        (r"<sup>-", "<sup>−"),
        (r"\bB2\b", "B<sup>2</sup>"),
        (r"\bell_eff\b", "ℓ<sub>eff</sub>"),
        (r"\bell\b", "ℓ"),
        (r"\(f/#\)lambda\b", "(f/#)λ"),
        (r"\bsigma\(A\)", "σ(A)"),
        (r" / (s|Hz)\b", r"/\1"),
        (r"\+-", "±"),
        (r"(?<=[a-z0-9])([._])(?=[a-z])", r"\1<wbr>"),  # where a key of a scene may go on in the next line
    )
]


# Characters that no page may have, or that turn the direction of its text.
_CONTROLS = re.compile("[\0-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")


def page_bytes(page: Page, footer: str) -> bytes:
    """Make the HTML of a page, with a footer in which code stands in backticks."""
    text = _environment().get_template("page.html.j2").render(page=page, footer=footer.split("`"))
    return _CONTROLS.sub(lambda found: printable(found[0]), text).encode("utf-8")


@cache
def _environment() -> "Environment":
    """Templates, which are compiled once for all pages of a process."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("mapmaker.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["units"] = units
    return environment


def units(text: str) -> "Markup":
    """Escape text for HTML, and format units and symbols: ``uK_CMB^2``, ``mK2 rad(-5/3)``, ``ell_eff``."""
    from markupsafe import Markup, escape

    written = str(escape(text))
    for pattern, replacement in _WRITTEN:
        written = pattern.sub(replacement, written)
    return Markup(written)
