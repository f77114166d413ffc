"""Former names of scene keys: a scene or an option that uses one is refused with the present name."""

from collections.abc import Mapping
from typing import Any

# Former keys, and their present names.
RENAMED = {
    "instrument.colours": "bands.NAME",
    "instrument.bands": "bands.NAME",
    "instrument.camera_rotation": "instrument.camera_rotation_range",
    "atmosphere.index": "atmosphere.spectral_index",
    "atmosphere.fluctuation": "atmosphere.water_fluctuation",
    "atmosphere.fluctuation_probabilities": "atmosphere.water_fluctuation_probabilities",
    "cleaning.reach": "cleaning.neighbour_radius",
    "score.white_above": "score.white_noise_above",
    "score.simulated": "score.noise_only_sets",
    "score.window": "score.signal_sims",
    "numerics.stream_memory": "numerics.max_block_memory",
}


def renamed_line(key: str) -> str:
    """Say how a dotted key is called now, if it or the section around it has another name; otherwise return ""."""
    old = ".".join(key.split(".")[:2])
    return f"{old} is now {RENAMED[old]}" if old in RENAMED else ""


def renamed_lines(content: Mapping[str, Any]) -> list[str]:
    """Return a line for each former key in the content of a scene file."""
    keys = (f"{section}.{key}" for section, table in content.items() if isinstance(table, Mapping) for key in table)
    return [line for line in map(renamed_line, keys) if line]
