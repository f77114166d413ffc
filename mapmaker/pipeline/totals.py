"""Data left out of a map, added up over files for the terminal and the report."""

from collections.abc import Sequence
from dataclasses import dataclass

from mapmaker.pipeline.dropped import DETECTOR, EXPLANATIONS, FILE, PART, SAMPLES, SCAN, Dropped

_NOUNS = {FILE: "file", DETECTOR: "detector", PART: "detector in a scan", SCAN: "scan", SAMPLES: "detector"}
_PLURALS = {PART: "detectors in a scan"}


@dataclass(frozen=True)
class ReasonTotal:
    """Sum over all files for one reason.

    Attributes
    ----------
    what, reason
        As in `Dropped`.
    count
        Number of rows: files, detectors in a file, scans, detectors in a scan.
    files
        Number of files.
    samples
    """

    what: str
    reason: str
    count: int
    files: int
    samples: int

    @property
    def text(self) -> str:
        """One line for people."""
        noun = _NOUNS[self.what] if self.count == 1 else _PLURALS.get(self.what, f"{_NOUNS[self.what]}s")
        lost = f"{self.samples} sample{'s' * (self.samples != 1)}"
        if self.what == SAMPLES:
            return f"{self.reason}: {lost}"
        return f"{self.reason}: {self.count} {noun}" + (f", {lost}" if self.samples else "")


def reason_totals(items: Sequence[Dropped]) -> list[ReasonTotal]:
    """Totals for each reason, in the order of `EXPLANATIONS`."""
    kinds = [FILE, SCAN, DETECTOR, PART, SAMPLES]
    order = {reason: k for k, reason in enumerate(EXPLANATIONS)}
    groups: dict[tuple[str, str], list[Dropped]] = {}
    for item in items:
        groups.setdefault((item.reason, item.what), []).append(item)
    return [
        ReasonTotal(what, reason, len(rows), len({row.file for row in rows}), sum(row.samples for row in rows))
        for (reason, what), rows in sorted(groups.items(), key=lambda at: (order[at[0][0]], kinds.index(at[0][1])))
    ]
