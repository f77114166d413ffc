"""Angular wind velocity of one observation from its time-streams alone (paper, "Calculating the Wind Velocity").

A frozen layer that moves with the velocity u against the boresight reaches a detector at the distance r after
``dt = r . s``, with the slowness ``s = u / |u|^2``; u is the wind less the velocity of the scan. The cross-PSD of the
two detectors, ``D_i^* D_j``, has the phase ``-2 pi f dt``, and ``2 pi dt / |r|`` is a sinusoid of the pair's angle.

A plain fit of phases is biased by three effects, which the fit here avoids. A Hann taper on a red spectrum shifts the
effective frequency of a bin, by a tenth for the third bin: with the transforms D and E of a stream under the taper and
under its derivative, the transform of the stream's derivative is ``F = 2 pi i f D - E``, and for a short delay
``D_j = D_i - dt F``, whatever the spectrum. Noisy phases bias a slope to zero: sums of cross-PSDs are fitted, not
phases. The layer's gradient across the wind turns the phases as another wind direction would: it averages out over
scans, and each frequency is weighted by the scatter about its fit.

For pairs weighted by ``|r|^2``, sums over all pairs factor into sums over detectors: the fit needs only the array's
mean and gradient. Neighbours, which share noise, have 0.2 % of the weight for 115 detectors; the pairs that measure the
goodness of fit exclude them. The delays found so far are removed before the gradient is fitted, so that delays may be
long.

`fit_wind` measures an observation that does not fit in memory, from the transforms of its blocks (`wind_transforms`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import atan2, pi

import numpy as np

from mapmaker.errors import InsufficientDataError, OutOfRangeError
from mapmaker.timestreams import FocalPlane, Timestreams
from mapmaker.validation import bounds_of_scans, number, reals
from mapmaker.wind_checks import (
    CENTRES_RAD,
    N_PAIR_BINS,
    group_disagreement,
    has_several_layers,
    jackknife_error,
    pair_slopes,
    quadratic_shapes,
)
from mapmaker.wind_delays import (
    LOWEST_BIN,
    MIN_BINS,
    ROUNDS,
    Delays,
    ScanSpectra,
    measure_slowness,
    scan_spectra,
    scan_transforms,
)

_MIN_DETECTORS = 7
MIN_SCANS = 3
HIGHEST_HZ, LEAST_CYCLES = 1.0, LOWEST_BIN + MIN_BINS  # upper end of the band [Hz]; cycles of its lower end in a scan
_SHORTEST = 1e-3  # delay from the array's centre, in samples, below which there is none
_CERTAIN = 0.12  # largest relative error of a trusted wind
_AGREE = 12.5  # chi^2 a degree of freedom that two groups of 9 scans exceed once in a thousand times
_GOOD_FIT = 5.0  # largest reduced chi^2 of the pairs
_CURVED = 0.1  # largest departure from a constant velocity, over the length of the scan
_FAST = 2.5  # least ratio of wind to scan speed


@dataclass(frozen=True)
class WindFit:
    """Wind of one observation in the array frame; NaN where it could not be measured.

    Attributes
    ----------
    velocity_rad_s : (2,)
    speed_rad_s, angle_rad
        Speed, and angle from the x axis.
    speed_error_rad_s, angle_error_rad
        Standard errors, from a jackknife over scans.
    pair_angle_rad : (n_bin,)
        Angle of the pairs, centres of bins.
    slope, slope_error : (n_bin,)
        ``2 pi dt / |r|`` [s/rad]; NaN for bins without pairs.
    sinusoid : (2,)
        Fit ``sinusoid[0] cos + sinusoid[1] sin`` to the slopes.
    goodness
        Reduced chi^2 of the slopes about their own best sinusoid.
    highest_hz
        Upper end of the coherent band.
    flag
        Reason why the wind is not reliable; "" if it is.
    """

    velocity_rad_s: np.ndarray
    speed_rad_s: float
    angle_rad: float
    speed_error_rad_s: float
    angle_error_rad: float
    pair_angle_rad: np.ndarray
    slope: np.ndarray
    slope_error: np.ndarray
    sinusoid: np.ndarray
    goodness: float
    highest_hz: float
    flag: str


@dataclass(frozen=True)
class WindTransforms:
    """Transforms of some scans of an observation, without their time-streams.

    Attributes
    ----------
    scans : (n_scan, n_det, 4 n_freq)
        `mapmaker.wind_delays.scan_transforms`.
    live : (n_det,)
        Detectors that are constant in none of the scans.
    n_samp
        Samples of a scan.
    sample_rate_hz
    """

    scans: np.ndarray
    live: np.ndarray
    n_samp: int
    sample_rate_hz: float


def scan_velocities(streams: Timestreams) -> np.ndarray:
    """Velocity of the boresight in each scan along the array's x and y, (n_scan, 2) [rad/s].

    Raises
    ------
    ValueError
        For a scan of one sample, and for scans that are not straight: the boresight departs from a constant velocity by
        more than a tenth of the scan's length and half of a beam.
    """
    from mapmaker.geometry import MapGeometry, mean_direction, north_angle, plane_offsets

    tangent = MapGeometry(*mean_direction(streams.ra_rad, streams.dec_rad), 1.0, 1, 1)
    sky = np.stack(plane_offsets(tangent, streams.ra_rad, streams.dec_rad))
    angles = streams.array_angle_rad + north_angle(tangent, *sky)
    velocity = []
    for start, stop in streams.scan_bounds:
        if stop - start < 2:
            raise InsufficientDataError(
                f"scan: found a scan of one sample, {start}; 2 or more are expected for a velocity"
            )
        t = streams.time_s[start:stop] - streams.time_s[start:stop].mean()
        xi, eta = sky[:, start:stop] @ t / (t @ t)
        _check_straight(sky[:, start:stop], t, np.array([xi, eta]), streams.focal_plane.fwhm_rad, start)
        angle = angles[(start + stop) // 2]
        cos, sin = np.cos(angle), np.sin(angle)
        velocity.append((-xi * cos + eta * sin, xi * sin + eta * cos))
    return np.array(velocity).reshape(-1, 2)


def _check_straight(
    sky_rad: np.ndarray, t: np.ndarray, velocity_rad_s: np.ndarray, fwhm_rad: float, start: int
) -> None:
    """Raise OutOfRangeError for a scan (2, n) that begins with the sample `start` and is far from straight."""
    departure = sky_rad - velocity_rad_s[:, None] * t
    departure = np.hypot(*(departure - departure.mean(axis=1, keepdims=True))).max()
    length = np.hypot(*velocity_rad_s) * (t[-1] - t[0])
    if departure > _CURVED * length + fwhm_rad / 2:
        raise OutOfRangeError(
            f"scan: found a scan, {start}, whose boresight departs by {np.degrees(departure) * 60:.3g} arcmin from a"
            f" constant velocity; {np.degrees(_CURVED * length + fwhm_rad / 2) * 60:.3g} arcmin or less are expected"
        )


def measure_wind(
    data_mk: np.ndarray,
    scan_bounds: np.ndarray,
    focal_plane: FocalPlane,
    *,
    sample_rate_hz: float,
    scan_velocity_rad_s: np.ndarray,
    highest_hz: float = HIGHEST_HZ,
) -> WindFit:
    """Measure the angular wind velocity in the array frame, from the delays between detectors.

    Scans with a component along the first one, and those against it, are two groups, whose slownesses are measured
    separately. Detectors that are constant in a scan are excluded. The band starts at two cycles a scan and ends where
    noise dominates, or at `highest_hz`. Source: Sayers et al. (2010), "Calculating the Wind Velocity".

    Parameters
    ----------
    data_mk : (n_det, n_samp)
        Streams that are not cleaned.
    scan_bounds : (n_scan, 2)
        Scans [start, stop) of equal length.
    focal_plane
    sample_rate_hz
    scan_velocity_rad_s : (n_scan, 2)
        Velocity of the boresight in the array frame, `scan_velocities`.
    highest_hz

    Returns
    -------
    WindFit
        With a `flag` where a frozen layer does not explain the data.

    Raises
    ------
    ValueError
        For values that are not finite, and for shapes, scans or a band that do not match.
    """
    data_mk, scan_bounds = _checked_streams(data_mk, scan_bounds, focal_plane)
    velocity = _checked_velocity(scan_velocity_rad_s, len(scan_bounds))
    _check_band(scan_bounds, sample_rate_hz, highest_hz)
    return _fit([_transforms(data_mk, scan_bounds, sample_rate_hz, highest_hz)], focal_plane, velocity)


def wind_transforms(
    data_mk: np.ndarray,
    scan_bounds: np.ndarray,
    focal_plane: FocalPlane,
    *,
    sample_rate_hz: float,
    highest_hz: float = HIGHEST_HZ,
) -> WindTransforms:
    """Transform some scans of an observation for `fit_wind`; arguments and errors as for `measure_wind`."""
    data_mk, scan_bounds = _checked_streams(data_mk, scan_bounds, focal_plane)
    _check_band(scan_bounds, sample_rate_hz, highest_hz)
    return _transforms(data_mk, scan_bounds, sample_rate_hz, highest_hz)


def fit_wind(blocks: Sequence[WindTransforms], focal_plane: FocalPlane, *, scan_velocity_rad_s: np.ndarray) -> WindFit:
    """Measure the wind of an observation from the transforms of its blocks, as `measure_wind` from its streams.

    Parameters
    ----------
    blocks
        Transforms of all scans in order.
    focal_plane
    scan_velocity_rad_s : (n_scan, 2)
        Velocity of the boresight in the array frame, in all scans.

    Returns
    -------
    WindFit

    Raises
    ------
    ValueError
        For no block, blocks that do not match, too few scans, and another number of velocities.
    """
    if len({(block.n_samp, block.sample_rate_hz, block.scans.shape[1:]) for block in blocks}) != 1:
        raise ValueError(
            f"{len(blocks)} blocks found; one or more with equal detectors, rates and scan lengths are allowed"
        )
    n_scan = sum(len(block.scans) for block in blocks)
    return _fit(blocks, focal_plane, _checked_velocity(scan_velocity_rad_s, n_scan))


def _fit(blocks: Sequence[WindTransforms], focal_plane: FocalPlane, velocity: np.ndarray) -> WindFit:
    live, rate = np.all([block.live for block in blocks], axis=0), blocks[0].sample_rate_hz
    x, y = focal_plane.x_rad[live], focal_plane.y_rad[live]
    if live.sum() < _MIN_DETECTORS or np.linalg.matrix_rank(quadratic_shapes(x, y)) < 6:
        return _nothing("too few live detectors")
    scans = np.concatenate([block.scans for block in blocks]).compress(live, axis=1)
    spectra = scan_spectra(scans, places_rad=np.stack([x, y]), bin_hz=rate / blocks[0].n_samp)
    groups = _groups(velocity)
    found = measure_slowness(spectra, groups)
    if found is None or np.abs(found.slowness @ spectra.r_rad).max() * rate < _SHORTEST:
        return _nothing("no coherent delay")
    return _wind_fit(spectra, found, groups, velocity)


def _transforms(data_mk: np.ndarray, bounds: np.ndarray, rate: float, highest_hz: float) -> WindTransforms:
    live = np.all([np.ptp(data_mk[:, start:stop], axis=1) > 0 for start, stop in bounds], axis=0)
    scans = scan_transforms(data_mk, bounds, rate=rate, highest_hz=highest_hz)
    return WindTransforms(scans, live, int(bounds[0, 1] - bounds[0, 0]), rate)


def _checked_streams(
    data_mk: np.ndarray, scan_bounds: np.ndarray, focal_plane: FocalPlane
) -> tuple[np.ndarray, np.ndarray]:
    data_mk = reals("data_mk", data_mk, (len(focal_plane.x_rad), "n_samp"))
    return data_mk, bounds_of_scans(scan_bounds, data_mk.shape[1])


def _check_band(bounds: np.ndarray, rate: float, highest_hz: float) -> None:
    if not len(bounds):
        raise InsufficientDataError("no scan found; one or more are needed")
    length = np.diff(bounds, axis=1)
    if np.ptp(length):
        raise ValueError("scans of different lengths found; scans of one length are allowed")
    lowest = LEAST_CYCLES * number("sample_rate_hz", rate, above=0) / length[0, 0]
    if not lowest <= number("highest_hz", highest_hz) < rate / 2:
        raise OutOfRangeError(
            f"highest_hz = {highest_hz} found; {lowest:.3g} to less than {rate / 2:.3g} Hz is allowed"
        )


def _checked_velocity(velocity: np.ndarray, n_scan: int) -> np.ndarray:
    if n_scan < MIN_SCANS:
        raise InsufficientDataError(f"{n_scan} scans found; at least {MIN_SCANS} are needed")
    return reals("scan_velocity_rad_s", velocity, (n_scan, 2)).astype(np.float64, copy=False)


def _groups(velocity: np.ndarray) -> list[np.ndarray]:
    """Group the scans (by index) by direction: along the first one and against it; one group if either has less than
    three.
    """
    along = velocity @ velocity[0] >= 0
    split = [np.flatnonzero(along), np.flatnonzero(~along)]
    return split if min(map(len, split)) >= MIN_SCANS else [np.arange(len(velocity))]


@np.errstate(divide="ignore", invalid="ignore", over="ignore")  # without delays the wind is infinite
def _wind_fit(spectra: ScanSpectra, found: Delays, groups: list[np.ndarray], velocity: np.ndarray) -> WindFit:
    scan = np.array([np.mean(velocity[scans], axis=0) for scans in groups]) @ [1, 1j]
    whole = found.slowness[[scans[0] for scans in groups]] @ [1, 1j]
    wind = complex(_wind(whole, scan))
    errors = np.zeros(2)
    for g, scans in enumerate(groups):
        trial = np.tile(whole, (len(scans), 1))
        trial[:, g] = found.left_out[scans] @ [1, 1j]
        less = _wind(trial, scan) / wind
        errors = np.hypot(errors, jackknife_error(np.column_stack([less.real, less.imag])))
    along, across = errors.tolist()
    slope, error, goodness = pair_slopes(spectra, found)
    reasons = {
        "delays too uncertain": not (along <= _CERTAIN and across <= _CERTAIN),
        "more than one layer": has_several_layers(spectra, found),
        "forward and backward scans disagree": group_disagreement(found, groups, scan) > _AGREE,
        "poor fit": goodness > _GOOD_FIT,
        "wind not far above the scan speed": abs(wind) < _FAST * np.hypot(*velocity.T).max(),
    }
    return WindFit(
        velocity_rad_s=np.array([wind.real, wind.imag]),
        speed_rad_s=abs(wind),
        angle_rad=atan2(wind.imag, wind.real),
        speed_error_rad_s=abs(wind) * along,
        angle_error_rad=across,
        pair_angle_rad=CENTRES_RAD.copy(),
        slope=slope,
        slope_error=error,
        sinusoid=2 * pi * np.mean(found.slowness, axis=0),
        goodness=goodness,
        highest_hz=float(spectra.f_hz[found.n_freq - 1]),
        flag=next((reason for reason, failed in reasons.items() if failed), ""),
    )


def _wind(slowness: np.ndarray, scan_velocity: np.ndarray) -> np.ndarray:
    """Fit the wind (...) to slownesses (..., n_group), all as x + i y: ``conj(s) = 1 / (w - v)``."""
    wind = 1 / slowness.conj().mean(axis=-1) + scan_velocity.mean()
    for _ in range(ROUNDS):
        model = 1 / (wind[..., None] - scan_velocity)
        step = -(model.conj() ** 2) * (slowness.conj() - model)
        wind = wind + step.sum(axis=-1) / np.sum(np.abs(model) ** 4, axis=-1)
    return wind


def _nothing(flag: str) -> WindFit:
    nan = float("nan")
    none, slopes, errors = np.full(2, nan), np.full(N_PAIR_BINS, nan), np.full(N_PAIR_BINS, nan)
    return WindFit(none, nan, nan, nan, nan, CENTRES_RAD.copy(), slopes, errors, none.copy(), nan, nan, flag)
