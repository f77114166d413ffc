"""An observation in blocks of whole scans, whose streams take no more memory than the scene allows.

Every stage goes over the blocks of an observation in order. A block draws its streams from random numbers of its own
(`surveysim.runtime.rng`), so where observations are cut is part of a scene, as its seed is.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Block:
    """Scans `first` to `end - 1` of an observation."""

    number: int
    first: int
    end: int

    @property
    def n_scans(self) -> int:
        """How many scans it holds."""
        return self.end - self.first


def scan_blocks(n_scans: int, scan_bytes: int, most_bytes: float) -> tuple[Block, ...]:
    """As few blocks as `most_bytes` allow, as equal as can be, of `n_scans` scans that each fit in."""
    n_blocks = -(-n_scans // int(most_bytes // scan_bytes))
    edges = [n_scans * number // n_blocks for number in range(n_blocks + 1)]
    return tuple(Block(number, *pair) for number, pair in enumerate(zip(edges, edges[1:], strict=False)))
