"""Values of a scene that its comments call assumed or calibrated."""

import re
from collections.abc import Mapping
from typing import Any

from surveysim.scene.sites import PLACE_KEYS, is_taken, sites_text

_OF_WIND = "beside other layers, only the height of the drawn wind"


def assumed_values(text: str) -> list[str]:
    """Return lines ``section.key = value: comment`` for comments that begin with "assumed" or "calibrated"."""
    section, found = "", []
    for line in text.splitlines():
        if match := re.match(r"\s*\[\[?([\w.\-]+)\]", line):
            section = match[1] + "."
        elif comment := re.search(r"#\s*((?:assumed|calibrated).*)$", line):
            key, equals, value = line[: comment.start()].partition("=")
            if equals and re.fullmatch(r"\w+", key.strip()):
                value = re.sub(r"\[$", "[...]", value.strip())  # the first line of a long list
                found.append(f"{section}{key.strip()} = {value}: {comment[1]}")
    return found


def assumed_of_site(section: Mapping[str, Any]) -> list[str]:
    """Return the assumed values that an [atmosphere] takes from its site, and those of the site's place."""
    lines = (line.partition(".")[::2] for line in assumed_values(sites_text()))
    ours = ((rest.split()[0], rest) for site, rest in lines if site == section.get("site"))
    found = [
        f"{'site' if key in PLACE_KEYS else 'atmosphere'}.{rest}"
        for key, rest in ours
        if key in PLACE_KEYS or is_taken(key, section)
    ]
    if section.get("layers") or section.get("profile"):
        # Layers have heights of their own.
        return [f"{line}; {_OF_WIND}" if line.startswith("atmosphere.layer_height ") else line for line in found]
    return found
