"""Tracks of tables, as schedulers write them, interpolated between rows in the tangent plane of the field."""

from dataclasses import dataclass, field

import numpy as np

from mapmaker.geometry import MapGeometry, plane_offsets
from surveysim.runtime.errors import SceneError
from surveysim.scene.scan_track import TrackScan
from surveysim.scene.track_table import TrackTable
from surveysim.telescope.directions import FieldCentre, Site
from surveysim.telescope.horizon_frame import HorizonFrame, from_horizon
from surveysim.telescope.scans import ScanPath, Scans, sample_times, timing


@dataclass(frozen=True, kw_only=True)
class Track(Scans):
    """Track of a table, with the field and the site that it is for, and whether its interpolation is cubic."""

    table: TrackTable = field(repr=False)
    centre: FieldCentre
    site: Site | None
    cubic: bool

    @property
    def known_step_s(self) -> float:
        """Typical time between rows."""
        return float(np.median(np.diff(self.table.time_s[self.table.rows(0)])))

    @property
    def starts_mjd(self) -> np.ndarray | None:
        """Starts of the observations in the table."""
        return self.table.start_mjd


def scene_track(section: TrackScan, centre: FieldCentre, site: Site | None) -> Track:
    """Make the track of a section [scan]."""
    return Track(
        **timing(section), table=section.table, centre=centre, site=site, cubic=section.interpolation == "cubic"
    )


def track_extent(track: Track, lowest_rad: float) -> float:
    """Compute the largest offset of a row from the centre, along either axis [rad]."""
    table, site = track.table, track.site
    frames: list[HorizonFrame | None] = [None] * table.n_obs
    if table.start_mjd is not None and site is not None:
        frames = [HorizonFrame(track.centre, site, float(start)) for start in table.start_mjd]
    return max(float(np.abs(_rows(track, number, frame)).max()) for number, frame in enumerate(frames))


def longest_gap(track: Track) -> tuple[int, float]:
    """Find the longest time between two rows in which samples lie: the second row, from 1, and the time [s]."""
    samples_s, found = sample_times(track)[0], (0, 0.0)
    for number in range(track.table.n_obs):
        rows = track.table.rows(number)
        known_s = track.table.time_s[rows]
        before = np.unique(np.clip(np.searchsorted(known_s, samples_s, side="right") - 1, 0, len(known_s) - 2))
        steps_s = known_s[before + 1] - known_s[before]
        longest = int(np.argmax(steps_s))
        found = max(found, (rows.start + int(before[longest]) + 2, float(steps_s[longest])), key=lambda item: item[1])
    return found


def track_path(track: Track, observation: int, dither: np.ndarray, frame: HorizonFrame | None) -> ScanPath:
    """Compute the boresight path of the observation with a number; a sample has the flag of the nearest row."""
    rows, (time_s, scan, mid_s) = track.table.rows(observation), sample_times(track)
    known_s, offsets = track.table.time_s[rows], _rows(track, observation, frame)
    xi, eta = (_interpolated(time_s, known_s, values, track.cubic) for values in offsets)
    n = len(time_s) // track.n_scans
    first, last = np.arange(track.n_scans) * n, np.arange(track.n_scans) * n + n - 1
    passed_s = time_s[last] - time_s[first]
    flagged = None
    if track.table.flagged is not None:
        middle = (known_s[1:] + known_s[:-1]) / 2
        flagged = track.table.flagged[rows][np.searchsorted(middle, time_s)]
    return ScanPath(
        time_s=time_s,
        xi_rad=xi + dither[0],
        eta_rad=eta + dither[1],
        scan=scan,
        velocity_rad_s=np.stack([(item[last] - item[first]) / passed_s for item in (xi, eta)], axis=-1),
        mid_time_s=mid_s,
        straight=False,
        flagged=flagged,
    )


def _rows(track: Track, observation: int, frame: HorizonFrame | None) -> np.ndarray:
    """Offsets (2, n_row) of an observation's rows in the tangent plane.

    Raises SceneError for directions from 90 degrees off the centre on.
    """
    table, rows = track.table, track.table.rows(observation)
    longitude, latitude = table.longitude_rad[rows], table.latitude_rad[rows]
    if table.on_horizon:
        assert frame is not None, "azimuths need a schedule"
        offsets = np.stack(from_horizon(frame, table.time_s[rows], longitude, latitude))
    else:
        plane = MapGeometry(track.centre.ra_rad, track.centre.dec_rad, 1.0, 1, 1)
        offsets = np.stack(plane_offsets(plane, longitude, latitude))
    wrong = np.flatnonzero(np.isnan(offsets[0]))
    if len(wrong):
        raise SceneError(
            f"scan.track_table: row {rows.start + wrong[0] + 1}: found a direction 90 deg or more from the centre of"
            " [field]; a track over the field is expected"
        )
    return offsets


def _interpolated(time_s: np.ndarray, known_s: np.ndarray, values: np.ndarray, cubic: bool) -> np.ndarray:
    """Interpolate linearly, or by the cubic through the two rows before and the two after each time."""
    if not cubic:
        return np.interp(time_s, known_s, values)
    first = np.clip(np.searchsorted(known_s, time_s, side="right") - 2, 0, len(known_s) - 4)
    found = np.zeros_like(time_s)
    for own in range(4):
        weight = np.ones_like(time_s)
        for other in range(4):
            if other != own:
                weight *= (time_s - known_s[first + other]) / (known_s[first + own] - known_s[first + other])
        found += weight * values[first + own]
    return found
