"""Raster scans of the field.

Scans parallel to right ascension or declination are straight lines in the tangent plane of the field centre, along
its `xi` (east) or `eta` (north) axis. A line of constant declination deviates from it by xi^2 tan(dec) / 2: 26 arcsec
at 1 degree and 7 arcsec at 30 arcmin from the centre of a field at 40 degrees. Maps are binned where the telescope
points, so only the coverage differs.
"""

from dataclasses import dataclass, replace

import numpy as np

from surveysim.scene.scan_figures import LissajousFigure
from surveysim.scene.scan_patterns import RasterScan
from surveysim.telescope.directions import FieldCentre, Site
from surveysim.telescope.horizon_frame import HorizonFrame
from surveysim.telescope.patterns.figures import lissajous_curve
from surveysim.telescope.scans import ScanPath, Scans, mid_times, samples_per_scan, timing
from surveysim.telescope.turnarounds import (
    Turnaround,
    in_turnaround,
    mean_speed,
    simulated_turnaround,
    step_shares,
    sweep_offsets,
)


@dataclass(frozen=True, kw_only=True)
class Raster(Scans):
    """Raster of one observation (paper, "Instrument Description"), with the distance of neighbouring scans.

    Attributes
    ----------
    step_rad
    turning
        Turnaround that is simulated; None where they are left out.
    added
        Lissajous figure that is added, as by TolTEC's "rastajous"; None without one.
    """

    step_rad: float
    turning: Turnaround | None = None
    added: LissajousFigure | None = None

    @property
    def straight(self) -> bool:
        """True where no turnaround is simulated, and nothing is added."""
        return self.turning is None and self.added is None


def scene_raster(section: RasterScan, centre: FieldCentre, site: Site | None) -> Raster:
    """Make the raster of a section [scan]."""
    turning = simulated_turnaround(section)
    return Raster(**timing(section), step_rad=section.step_rad, turning=turning, added=section.lissajous)


def raster_extent(raster: Raster, lowest_rad: float) -> float:
    """Compute the largest offset from the centre of the pattern, along either axis [rad]."""
    half_s = mean_speed(raster.scan_s, raster.turning) * raster.scan_s / 2
    steps = raster.n_scans - (1 if raster.turning is None else 0)
    more = max(raster.added.amplitude_x_rad, raster.added.amplitude_y_rad) if raster.added else 0.0
    return max(raster.speed_rad_s * half_s, raster.step_rad * steps / 2) + more


def observation_raster(raster: Raster, observation: int, dither: np.ndarray, frame: HorizonFrame | None) -> ScanPath:
    """Compute the boresight path of the observation with a number: scans along RA and along Dec in turn."""
    path = raster_path(raster, ("ra", "dec")[observation % 2], dither)
    return path if raster.added is None else _with_figure(path, raster.added, raster.scan_s)


def _with_figure(path: ScanPath, figure: LissajousFigure, scan_s: float) -> ScanPath:
    """Add a Lissajous figure along right ascension and declination to a path."""
    x, y = lissajous_curve(figure, path.time_s)
    before, after = (lissajous_curve(figure, path.mid_time_s + side * scan_s / 2) for side in (-1, 1))
    velocity = path.velocity_rad_s + (after - before).T / scan_s
    return replace(path, xi_rad=path.xi_rad + x, eta_rad=path.eta_rad + y, velocity_rad_s=velocity)


def raster_path(raster: Raster, along: str, dither: np.ndarray) -> ScanPath:
    """Compute the boresight path of one observation.

    The first scan goes east (or north), the next one back, each `step_rad` further north (or east). The pattern is
    centred on the field plus the dither. Sample i of a scan is (i + 1/2) / rate after its start, so a scan is symmetric
    about its middle; a remainder of its duration is split between both ends. With simulated turnarounds, a scan has
    half of one at both ends.

    Parameters
    ----------
    along
        "ra" (xi) or "dec" (eta).
    dither : (2,)
        Offset of the pattern [rad].

    Raises
    ------
    ValueError
        For another direction, and for scans with too few samples (`samples_per_scan`).
    """
    if along not in ("ra", "dec"):
        raise ValueError(f'scans go along "ra" or "dec", not {along!r}')
    n = samples_per_scan(raster)
    k = np.arange(raster.n_scans)
    mid_s = mid_times(raster)
    from_mid_s = (np.arange(n) + 0.5 - n / 2) / raster.sample_rate_hz
    speed = raster.speed_rad_s * (1.0 - 2.0 * (k % 2))
    scan_s, turning = raster.scan_s, raster.turning
    along_rad = np.outer(speed, sweep_offsets(from_mid_s, scan_s, turning))
    across_rad = ((k - (raster.n_scans - 1) / 2)[:, None] + step_shares(from_mid_s, scan_s, turning)) * raster.step_rad
    axis = ("ra", "dec").index(along)
    offset = np.empty((2, raster.n_scans * n))
    offset[axis] = along_rad.ravel() + dither[axis]
    offset[1 - axis] = across_rad.ravel() + dither[1 - axis]
    velocity = np.zeros((raster.n_scans, 2))
    velocity[:, axis] = speed * mean_speed(scan_s, turning)
    velocity[:, 1 - axis] = 0.0 if turning is None else raster.step_rad / scan_s
    turned = in_turnaround(from_mid_s, scan_s, turning)
    return ScanPath(
        time_s=(mid_s[:, None] + from_mid_s).ravel(),
        xi_rad=offset[0],
        eta_rad=offset[1],
        scan=np.repeat(k.astype(np.int64), n),
        velocity_rad_s=velocity,
        mid_time_s=mid_s,
        straight=raster.straight,
        flagged=None if turned is None else np.tile(turned, raster.n_scans),
    )
