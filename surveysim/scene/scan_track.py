"""Section [scan] of a track that a table gives."""

import math
from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from surveysim.runtime.errors import InputError
from surveysim.scene.fields import Duration, DurationExtent, TableFile
from surveysim.scene.scan_section import MOST_SCANS, ScanSection
from surveysim.scene.track_table import TrackTable, read_track, track_speeds

_SLACK = 1e-3  # of a sample by which a track may begin late or end early


class TrackScan(ScanSection):
    """Track of a table, as schedulers write them, cut into scans of equal duration."""

    pattern: Literal["track"]
    """Pattern of the scans."""
    track_table: TableFile
    """Table of the boresight, ECSV or CSV: azimuth and elevation (`az`, `el`) or right ascension and declination (`ra`,
    `dec`) against `time` since the start of an observation or `mjd` (UTC). Dates of the table take the place of
    [schedule]'s."""
    interpolation: Literal["cubic", "linear"] = "cubic"
    """Interpolation between rows, in the tangent plane of the field: "cubic" takes four rows, "linear" two."""
    duration_s: Duration = Field(alias="chunk")
    """Duration of the chunks that cleaning treats as scans; 8 samples or more."""
    turnaround_s: DurationExtent = Field(alias="turnaround", default=0.0)
    """Part of the track between two chunks that is left out."""
    duration_key: ClassVar[str] = "scan.chunk"

    @property
    def table(self) -> TrackTable:
        """Content of the file."""
        return read_track(self.track_table)

    @property
    def needs_horizon(self) -> str:
        """Azimuths, and dates, need the place of the telescope."""
        return "track_table: found az and el" if self.table.on_horizon else ""

    @property
    def most_observations(self) -> int | None:
        """Observations of the table; a single one without a date can be repeated."""
        return self.table.n_obs if self.table.n_obs > 1 or self.table.start_mjd is not None else None

    @property
    def scans(self) -> int:
        """Number of chunks whose samples all observations of the table have."""
        left_s = self.table.last_s() + self._margin_s - self.duration_s
        return max(0, 1 + math.floor((left_s + _SLACK / self.sample_rate_hz) / (self.duration_s + self.turnaround_s)))

    @property
    def speed_rad_s(self) -> float:
        """Mean speed between rows."""
        return track_speeds(self.track_table)[0]

    @property
    def fastest_rad_s(self) -> float:
        """Largest speed between rows."""
        return track_speeds(self.track_table)[1]

    @property
    def _margin_s(self) -> float:
        """Time between the end of a chunk and its samples."""
        samples = math.floor(self.duration_s * self.sample_rate_hz + 1e-6)
        return (self.duration_s - (samples - 1) / self.sample_rate_hz) / 2

    @model_validator(mode="after")
    def _file_has_scans(self) -> Self:
        try:
            table = self.table
        except InputError as error:
            raise ValueError(str(error).removeprefix("scan.")) from None
        if table.first_s() > self._margin_s + _SLACK / self.sample_rate_hz:
            raise ValueError(
                f"track_table: found a track that begins {table.first_s():g} s after the start of an observation;"
                f" {self._margin_s:g} s or less, the time of the first sample, is expected"
            )
        if not 1 <= self.scans <= MOST_SCANS:
            raise ValueError(
                f"chunk: found {self.duration_s:g} s with a track of {table.last_s():g} s; a chunk that fits 1 to"
                f" {MOST_SCANS} times is expected"
            )
        if not self.fastest_rad_s:
            raise ValueError("track_table: found a track that does not move; another is expected")
        return self
