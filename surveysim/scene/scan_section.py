"""Bases of the sections [scan]."""

from typing import TYPE_CHECKING, ClassVar, Self

from pydantic import Field, model_validator

from surveysim.scene.fields import AngleExtent, Duration, Frequency
from surveysim.scene.section import Section

MIN_SAMPLES = 8  # scans with fewer samples would vanish with their mean and a few templates
MOST_SCANS = 100_000


class ScanSection(Section):
    """Base of the patterns, with the numbers that every pattern has as keys or properties.

    Attributes
    ----------
    speed_rad_s
        Mean speed of the boresight on the sky during a scan.
    fastest_rad_s
        Largest speed of the boresight on the sky.
    scans
        Number of scans in one observation.
    duration_s, turnaround_s
        Duration of one scan without turnarounds, and of the turnaround between two.
    scan_s, gap_s
        Duration of one scan as it is simulated, and of the time between two.
    duration_key
        Key that sets the duration of a scan.
    there_and_back
        Whether scans go there and back in turn.
    """

    pattern: str
    """Pattern of the scans."""
    dither_rad: AngleExtent = Field(alias="dither")
    """Full range of the pattern's offset, drawn uniformly for each observation in both directions."""
    sample_rate_hz: Frequency = Field(alias="sample_rate")
    """Sampling rate of the time-streams."""
    duration_key: ClassVar[str] = "scan.duration"
    there_and_back: ClassVar[bool] = False

    @property
    def needs_horizon(self) -> str:
        """Key and value that need the horizon of a schedule; empty without any."""
        return ""

    @property
    def most_observations(self) -> int | None:
        """Number of observations that the pattern has; None for any."""
        return None

    @property
    def scan_s(self) -> float:
        """Duration of a scan."""
        return self.duration_s

    @property
    def gap_s(self) -> float:
        """Time between two scans."""
        return self.turnaround_s

    def check_observations(self, number: int, scheduled: bool) -> None:
        """Raise ValueError for short scans, more observations than the pattern has, and a horizon without dates."""
        if not scheduled and self.needs_horizon:
            raise ValueError(
                f"scan.{self.needs_horizon} with [fixed_pointing]; a section [schedule] is expected in its place"
            )
        most = self.most_observations
        if most is not None and number > most:
            raise ValueError(f"observations: found {number}; {most} or fewer are expected, as in scan.track_table")
        if (samples := self.duration_s * self.sample_rate_hz) < MIN_SAMPLES:
            raise ValueError(
                f"{self.duration_key}: found {samples:.3g} samples a scan; {MIN_SAMPLES} or more are expected"
            )

    if TYPE_CHECKING:

        @property
        def speed_rad_s(self) -> float: ...  # noqa: D102
        @property
        def fastest_rad_s(self) -> float: ...  # noqa: D102
        @property
        def scans(self) -> int: ...  # noqa: D102
        @property
        def duration_s(self) -> float: ...  # noqa: D102
        @property
        def turnaround_s(self) -> float: ...  # noqa: D102


class ChunkedScan(ScanSection):
    """Base of the patterns without natural scans, which are cut into chunks of equal duration.

    `total_s` is the duration of an observation; a remainder shorter than a chunk is left out.
    """

    duration_s: Duration = Field(alias="chunk")
    """Duration of the chunks that cleaning treats as scans; 8 samples or more."""
    duration_key: ClassVar[str] = "scan.chunk"

    if TYPE_CHECKING:

        @property
        def total_s(self) -> float: ...  # noqa: D102

    @property
    def scans(self) -> int:
        """Number of chunks in one observation."""
        return int(self.total_s / self.duration_s * (1 + 1e-12))

    @property
    def turnaround_s(self) -> float:
        """Time between two chunks: none."""
        return 0.0

    @model_validator(mode="after")
    def _has_chunks(self) -> Self:
        if not 1 <= self.scans <= MOST_SCANS:
            raise ValueError(
                f"chunk: found {self.duration_s:g} s in a duration of {self.total_s:g} s; a chunk that fits 1 to"
                f" {MOST_SCANS} times is expected"
            )
        return self
