"""Blocks of whole scans of an observation, within the memory that the scene allows or of one scan each.

Every stage goes over the blocks of an observation in order. A block has random numbers of its own
(`surveysim.runtime.rng`), so the results of a scene depend on its blocks, as they do on its seed.
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
        """Number of scans."""
        return self.end - self.first


def scan_blocks(n_scans: int, scan_bytes: int, most_bytes: float) -> tuple[Block, ...]:
    """Divide an observation into the fewest equal blocks within a memory limit.

    Parameters
    ----------
    scan_bytes
        Memory of one scan.
    most_bytes
        Memory limit of a block of several scans; a block holds at least one.
    """
    n_blocks = -(-n_scans // max(1, int(most_bytes // scan_bytes)))
    edges = [n_scans * number // n_blocks for number in range(n_blocks + 1)]
    return tuple(Block(number, *pair) for number, pair in enumerate(zip(edges, edges[1:], strict=False)))
