"""The angular wind velocity of one observation from its time-streams alone (paper, "Calculating the Wind Velocity").

A frozen layer that moves with the velocity u against the boresight is seen by a detector a distance r away later by
``dt = r . s``, with the slowness ``s = u / |u|^2``; u is the wind less the velocity of the scan. The cross-PSD of the
two, ``D_i^* D_j``, then has the phase ``-2 pi f dt``, and ``2 pi dt / |r|`` is a sinusoid of the pair's angle.

Three things keep a plain fit of phases from the truth, and shape the fit here. A Hann taper on a red spectrum moves
the frequency that a bin stands for (a tenth at the third bin): with D and E the transforms of a stream under the taper
and under its derivative, that of the stream's own derivative is ``F = 2 pi i f D - E``, and a short delay makes
``D_j = D_i - dt F``, whatever the spectrum. Noisy phases pull a slope to zero: sums of cross-PSDs are fitted, not
phases. The layer's gradient across the wind turns the phases as a wind from another side would: it averages out over
scans, and each frequency is weighted by what scatters about its fit.

With pairs weighted by ``|r|^2`` the sums over all pairs factor into those over detectors: the fit needs the array's
mean and its plane alone. Neighbours, which share noise, have 0.2 % of the weight on 115 detectors; the pairs that show
how good the fit is are without them. The layer is brought to rest by the delays found so far before the plane is
fitted, so that delays may be long.
"""

from dataclasses import dataclass
from math import atan2, pi

import numpy as np

from mapmaker.errors import InsufficientDataError, OutOfRangeError
from mapmaker.timestreams import FocalPlane, Timestreams
from mapmaker.validation import bounds_of_scans, number, reals

N_PAIR_BINS = 24
# Centred on the angles of a hexagonal lattice's rows, which edges would split by rounding.
_CENTRES_RAD = np.arange(N_PAIR_BINS) * (2 * pi / N_PAIR_BINS) - pi
_LOWEST_BIN = 2  # the removed mean of a scan reaches the first bin of a Hann taper, and no other
_HANN = 1 + 2 * (4 / 9 + 1 / 36)  # what a Hann taper's correlation of neighbouring bins adds to the variance of a mean
_MIN_DETECTORS, _MIN_SCANS, _MIN_BINS = 7, 3, 2
HIGHEST_HZ, LEAST_CYCLES = 1.0, _LOWEST_BIN + _MIN_BINS  # of the band that is used, and in a scan
_NEIGHBOUR = 1.2  # pairs up to this many nearest separations apart are neighbours
_COHERENT = 0.2  # least mean relative cross-PSD: a quarter as much signal as noise
_START_COHERENT = 0.5  # the same before delays are known: keeps phases from wrapping
_ROUNDS = 5
_ROUNDING = 1e-14  # power of rounding in what a fit leaves, against the whole
_SHORTEST = 1e-3  # longest delay from the array's centre, in samples, that is none
_CERTAIN = 0.12  # largest relative error of a trusted wind
_AGREE = 12.5  # chi^2 a degree of freedom that two groups of 9 scans exceed once in a thousand times
# Largest reduced chi^2 of the pairs, where departures of a hundredth of the sinusoid count for nothing.
_GOOD_FIT, _GOOD_SHARE = 5.0, 0.01
# What one layer may leave along the wind, as a share of its signal or in standard deviations above the noise; and
# across it, as a Kolmogorov layer does without a beam, which lowers it.
_ALONG_SHARE, _ALONG_SIGMA, _ACROSS_SHARE = 0.1, 2.5, 1.5
_FAST = 2.5  # least ratio of wind to scan speed


@dataclass(frozen=True)
class WindFit:
    """The wind of one observation in the array frame; NaN where nothing could be measured.

    `velocity_rad_s` (2,), `speed_rad_s` and `angle_rad` (of the velocity, from the x axis) with their standard errors,
    from leaving out one scan at a time. Against the pair's angle `pair_angle_rad` (n_bin,), the centres of bins:
    `slope` and `slope_error` (n_bin,) of ``2 pi dt / |r|`` [s/rad], NaN for a bin without pairs, and the fit
    ``sinusoid[0] cos + sinusoid[1] sin``. `goodness`: reduced chi^2 of the slopes about their own best sinusoid.
    `highest_hz`: end of the band that was coherent enough. `flag`: "" for a wind to be trusted, else why not.
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
class _Spectra:
    """Relative transforms of tapered scans: `d` and `e` (n_freq, n_scan, n_det) under Hann taper and derivative.

    Each detector has the mean power 1 over the scans at every frequency `f_hz` (n_freq,). `r_rad` (2, n_det) from
    the detectors' centre.
    """

    d: np.ndarray
    e: np.ndarray
    f_hz: np.ndarray
    r_rad: np.ndarray


@dataclass(frozen=True)
class _Aligned:
    """Spectra with the delays of `slowness` (n_scan, 2) taken out.

    `d` (n_freq, n_scan, n_det); its mean over the array `mean` and that of the stream's derivative `rate`
    (n_freq, n_scan); `f_hz` (n_freq,) effective frequencies, and `turn_hz` those that the delays were taken out
    with; `coherence` (n_freq,) mean relative cross-PSD.
    """

    d: np.ndarray
    mean: np.ndarray
    rate: np.ndarray
    f_hz: np.ndarray
    turn_hz: np.ndarray
    coherence: np.ndarray


@dataclass(frozen=True)
class _Delays:
    """Spectra at rest, the number of frequencies used, and the slowness (n_scan, 2) of each scan's group.

    `left_out` (n_scan, 2): that of the scan's group without the scan.
    """

    aligned: _Aligned
    n_freq: int
    slowness: np.ndarray
    left_out: np.ndarray


def scan_velocities(streams: Timestreams) -> np.ndarray:
    """Velocity of the boresight in each scan, of 2 samples or more, along the array's x and y, (n_scan, 2) [rad/s]."""
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
        angle = angles[(start + stop) // 2]
        cos, sin = np.cos(angle), np.sin(angle)
        velocity.append((-xi * cos + eta * sin, xi * sin + eta * cos))
    return np.array(velocity).reshape(-1, 2)


def measure_wind(
    data_mk: np.ndarray,
    scan_bounds: np.ndarray,
    focal_plane: FocalPlane,
    *,
    sample_rate_hz: float,
    scan_velocity_rad_s: np.ndarray,
    highest_hz: float = HIGHEST_HZ,
) -> WindFit:
    """Angular wind velocity in the array frame, from the delays between the detectors of one observation.

    data_mk: (n_det, n_samp) [mK], not cleaned. scan_bounds: (n_scan, 2) [start, stop), scans of one length.
    scan_velocity_rad_s: (n_scan, 2) of the boresight in the array frame, `scan_velocities`. Scans with a component
    along and against the first one are two groups, whose slownesses are measured apart. Detectors that are
    constant in a scan are left out. The band goes from two cycles a scan to where noise takes over, or `highest_hz`.
    Raises ValueError for values that are not finite, and for shapes, scans or a band that do not fit. A fit that the
    frozen layer does not explain has a `flag`. Sayers et al. (2010), "Calculating the Wind Velocity".
    """
    data_mk = reals("data_mk", data_mk, (len(focal_plane.x_rad), "n_samp"))
    scan_bounds = bounds_of_scans(scan_bounds, data_mk.shape[1])
    velocity = _checked_velocity(scan_bounds, scan_velocity_rad_s, sample_rate_hz, highest_hz)
    live = np.all([np.ptp(data_mk[:, start:stop], axis=1) > 0 for start, stop in scan_bounds], axis=0)
    x, y = focal_plane.x_rad[live], focal_plane.y_rad[live]
    if live.sum() < _MIN_DETECTORS or np.linalg.matrix_rank(_quadratic(x, y)) < 6:
        return _nothing("too few live detectors")
    spectra = _spectra(
        data_mk[live], scan_bounds, places_rad=np.stack([x, y]), rate=sample_rate_hz, highest_hz=highest_hz
    )
    groups = _groups(velocity)
    found = _slowness(spectra, groups)
    if found is None or np.abs(found.slowness @ spectra.r_rad).max() * sample_rate_hz < _SHORTEST:
        return _nothing("no coherent delay")
    return _wind_fit(spectra, found, groups, velocity)


def _checked_velocity(bounds, velocity, rate, highest_hz) -> np.ndarray:
    if len(bounds) < _MIN_SCANS:
        raise InsufficientDataError(f"{len(bounds)} scans found; at least {_MIN_SCANS} are needed")
    length = np.diff(bounds, axis=1)
    if np.ptp(length):
        raise ValueError("scans of different lengths found; scans of one length are allowed")
    lowest = LEAST_CYCLES * number("sample_rate_hz", rate, above=0) / length[0, 0]
    if not lowest <= number("highest_hz", highest_hz) < rate / 2:
        raise OutOfRangeError(
            f"highest_hz = {highest_hz} found; {lowest:.3g} to less than {rate / 2:.3g} Hz is allowed"
        )
    return reals("scan_velocity_rad_s", velocity, (len(bounds), 2)).astype(np.float64, copy=False)


def _spectra(data, bounds, *, places_rad, rate, highest_hz) -> _Spectra:
    n = int(bounds[0, 1] - bounds[0, 0])
    scans = np.stack([data[:, start:stop] for start, stop in bounds]).astype(np.float64)
    scans -= scans.mean(axis=2, keepdims=True)
    cycles = np.arange(_LOWEST_BIN, int(highest_hz * n / rate * (1 + 1e-9)) + 1)
    turn = 2 * pi * (np.arange(n) + 0.5) / n
    wave = np.exp(-1j * turn[:, None] * cycles)
    taper, slope = 0.5 * (1 - np.cos(turn)), (pi * rate / n) * np.sin(turn)
    # A few bins only, so a product is faster than whole transforms.
    basis = np.hstack([taper[:, None] * wave, slope[:, None] * wave])
    parts = scans @ np.hstack([basis.real, basis.imag])
    both = (parts[..., : 2 * len(cycles)] + 1j * parts[..., 2 * len(cycles) :]).transpose(2, 0, 1)
    d, e = both.reshape(2, len(cycles), *both.shape[1:])
    scale = 1 / np.sqrt(np.mean(np.abs(d) ** 2, axis=1, keepdims=True))
    r = places_rad - places_rad.mean(axis=1, keepdims=True)
    return _Spectra(d * scale, e * scale, cycles * (rate / n), r)


def _groups(velocity: np.ndarray) -> list[np.ndarray]:
    """Scans (by index) along the first one and those against it; one group if either has fewer than three."""
    along = velocity @ velocity[0] >= 0
    split = [np.flatnonzero(along), np.flatnonzero(~along)]
    return split if min(map(len, split)) >= _MIN_SCANS else [np.arange(len(velocity))]


def _align(spectra: _Spectra, slowness: np.ndarray, f_hz: np.ndarray) -> _Aligned:
    """Take the delays of `slowness` (n_scan, 2) out, with the phases that they have at `f_hz` (n_freq,)."""
    n_det = spectra.d.shape[2]
    turn = np.exp(2j * pi * f_hz[:, None, None] * (slowness @ spectra.r_rad))
    d = spectra.d * turn
    mean = d.mean(axis=2)
    rate = 2j * pi * spectra.f_hz[:, None] * mean - np.einsum("ksi,ksi->ks", spectra.e, turn) / n_det
    power = np.sum(np.abs(mean) ** 2, axis=1)
    effective = np.sum((mean.conj() * rate).imag, axis=1) / (2 * pi * power)
    coherence = (n_det * power / d.shape[1] - 1) / (n_det - 1)
    return _Aligned(d, mean, rate, effective, f_hz, coherence)


def _band(aligned: _Aligned, least: float) -> int:
    """How many frequencies, from the first on, are coherent over the array."""
    return int(np.argmin(np.append(aligned.coherence >= least, False)))


def _slowness(spectra: _Spectra, groups: list[np.ndarray]) -> _Delays | None:
    """The delays of all groups, or None where too few frequencies are coherent."""
    slowness = np.zeros((spectra.d.shape[1], 2))
    aligned = _align(spectra, slowness, spectra.f_hz)
    for least in (_START_COHERENT, *[_COHERENT] * (_ROUNDS - 1)):
        if _band(aligned, _COHERENT) < _MIN_BINS:
            return None
        n_freq = max(_band(aligned, least), _MIN_BINS)
        slowness, left_out = _regress(spectra.r_rad, aligned, slowness=slowness, groups=groups, n_freq=n_freq)
        aligned = _align(spectra, slowness, aligned.f_hz)
    return _Delays(aligned, n_freq, slowness, left_out)


def _regress(r_rad, aligned: _Aligned, *, slowness, groups, n_freq) -> tuple[np.ndarray, np.ndarray]:
    """Slowness of each scan's group, and the same without that scan, (n_scan, 2), from gradient against rate.

    The array's gradient is ``-s F`` and what does not follow the wind; the 2 x 2 covariances of the latter,
    one a frequency, are the weights of a generalised least-squares fit.
    """
    mean, rate = aligned.mean[:n_freq], aligned.rate[:n_freq]
    gradient = np.moveaxis(aligned.d[:n_freq] @ np.linalg.pinv(r_rad), 2, 0)
    gradient -= 2j * pi * aligned.turn_hz[:n_freq, None] * mean * slowness.T[:, None, :]
    product, power = -(rate.conj() * gradient).real, np.abs(rate) ** 2
    least = _ROUNDING * np.sum(np.abs(mean) ** 2, axis=1) / np.max(np.abs(r_rad)) ** 2
    weight = np.eye(2) / np.sum(power, axis=1)[:, None, None]
    fitted, left_out = np.empty((2, *slowness.shape))
    for _ in range(3):
        normal = np.einsum("kab,ks->sab", weight, power)
        right = np.einsum("kab,bks->sa", weight, product)
        for scans in groups:
            a, b = normal[scans].sum(axis=0), right[scans].sum(axis=0)
            fitted[scans] = np.linalg.solve(a, b)
            left_out[scans] = np.linalg.solve(a - normal[scans], (b - right[scans])[..., None])[..., 0]
        rest = gradient + rate * fitted.T[:, None, :]
        covariance = np.einsum("aks,bks->kab", rest.conj(), rest).real
        weight = np.linalg.inv(covariance + least[:, None, None] * np.eye(2))
    return fitted, left_out


@np.errstate(divide="ignore", invalid="ignore", over="ignore")  # without any delay the wind is infinite
def _wind_fit(spectra, found: _Delays, groups, velocity) -> WindFit:
    scan = np.array([np.mean(velocity[scans], axis=0) for scans in groups]) @ [1, 1j]
    whole = found.slowness[[scans[0] for scans in groups]] @ [1, 1j]
    wind = complex(_wind(whole, scan))
    errors = np.zeros(2)
    for g, scans in enumerate(groups):
        trial = np.tile(whole, (len(scans), 1))
        trial[:, g] = found.left_out[scans] @ [1, 1j]
        less = _wind(trial, scan) / wind
        errors = np.hypot(errors, _jackknife_error(np.column_stack([less.real, less.imag])))
    along, across = errors.tolist()
    slope, error, goodness = _pair_slopes(spectra, found)
    reasons = {
        "delays too uncertain": not (along <= _CERTAIN and across <= _CERTAIN),
        "more than one layer": _several_layers(spectra, found),
        "forward and backward scans disagree": _disagreement(found, groups, scan) > _AGREE,
        "poor fit": goodness > _GOOD_FIT,
        "wind not far above the scan speed": abs(wind) < _FAST * np.hypot(*velocity.T).max(),
    }
    return WindFit(
        velocity_rad_s=np.array([wind.real, wind.imag]),
        speed_rad_s=abs(wind),
        angle_rad=atan2(wind.imag, wind.real),
        speed_error_rad_s=abs(wind) * along,
        angle_error_rad=across,
        pair_angle_rad=_CENTRES_RAD.copy(),
        slope=slope,
        slope_error=error,
        sinusoid=2 * pi * np.mean(found.slowness, axis=0),
        goodness=goodness,
        highest_hz=float(spectra.f_hz[found.n_freq - 1]),
        flag=next((reason for reason, failed in reasons.items() if failed), ""),
    )


def _wind(slowness: np.ndarray, scan_velocity: np.ndarray) -> np.ndarray:
    """Least-squares wind (...) of slownesses (..., n_group), all as x + i y: ``conj(s) = 1 / (w - v)``."""
    wind = 1 / slowness.conj().mean(axis=-1) + scan_velocity.mean()
    for _ in range(_ROUNDS):
        model = 1 / (wind[..., None] - scan_velocity)
        step = -(model.conj() ** 2) * (slowness.conj() - model)
        wind = wind + step.sum(axis=-1) / np.sum(np.abs(model) ** 4, axis=-1)
    return wind


def _quadratic(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Constant, slopes and curvatures over the array, (n_det, 6), for coordinates of any scale."""
    x, y = x / np.abs(x).max(), y / np.abs(y).max()
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)


def _several_layers(spectra: _Spectra, found: _Delays) -> bool:
    """Whether the array's gradient holds more than one frozen layer can show.

    Along the wind nothing is left of a layer at rest but noise, neither a slope nor a curvature: the curvature
    measures the noise, whatever detectors share of it. Across the wind a layer has gradients of its own.
    """
    k, at_rest, s = slice(found.n_freq), found.aligned, found.slowness @ [1, 1j]
    unit = s.mean() / abs(s.mean())
    turned = (spectra.r_rad.T @ [1, 1j]) * unit.conjugate()
    shapes = np.linalg.pinv(_quadratic(turned.real, turned.imag))[1:4]
    parts = np.moveaxis(at_rest.d[k] @ shapes.T, 2, 0)
    rate, s = at_rest.rate[k], s * unit.conjugate()
    follows = rate - 2j * pi * at_rest.turn_hz[k, None] * at_rest.mean[k]
    size = np.abs(turned.real).max(), np.abs(turned.imag).max()
    parts[:2] += [follows * s.real * size[0], follows * s.imag * size[1]]
    # Relative to the noise, and what the signal along the wind has on either axis.
    along, across, noise = np.sum(np.abs(parts) ** 2, axis=(1, 2)) / np.sum(shapes**2, axis=1)
    signal_x, signal_y = (np.sum(np.abs(rate * s.real * size[a]) ** 2) / np.sum(shapes[a] ** 2) for a in (0, 1))
    sigma = np.sqrt(2 * _HANN / rate.size)  # of the logarithm of a ratio of two powers
    not_noise = along > noise * np.exp(_ALONG_SIGMA * sigma)
    return bool((not_noise and along - noise > _ALONG_SHARE * signal_x) or across - noise > _ACROSS_SHARE * signal_y)


def _disagreement(found: _Delays, groups, scan_velocity) -> float:
    """Chi^2 a degree of freedom of the difference between the winds of two groups; 0 for one group."""
    if len(groups) == 1:
        return 0.0
    winds = [1 / (found.slowness[scans[0]] @ [1, -1j]) for scans in groups] + scan_velocity
    less = [1 / (found.left_out[scans] @ [1, -1j]) for scans in groups]
    covariance = sum(np.cov([part.real, part.imag], bias=True) * (len(part) - 1) for part in less)
    apart = np.array([(winds[0] - winds[1]).real, (winds[0] - winds[1]).imag])
    return float(apart @ np.linalg.pinv(covariance) @ apart) / 2


def _pair_slopes(spectra: _Spectra, found: _Delays) -> tuple[np.ndarray, np.ndarray, float]:
    """Slopes (n_bin,) of all pairs but neighbours, their errors, and the reduced chi^2 about their sinusoid."""
    rest, norm = _pair_sums(spectra, found)
    used = norm.sum(axis=0) > 0
    circle = np.stack([np.cos(_CENTRES_RAD), np.sin(_CENTRES_RAD)])
    model = 2 * pi * np.mean(found.slowness, axis=0) @ circle
    slope, error = np.full((2, N_PAIR_BINS), np.nan)
    rest, norm = rest[:, used], norm[:, used]
    total = norm.sum(axis=0)
    whole = rest.sum(axis=0) / total
    less = (rest.sum(axis=0) - rest) / (total - norm)
    slope[used], error[used] = model[used] + whole, _jackknife_error(less)
    # A change of the sinusoid is common to all bins: only what is left of it can tell a bad fit.
    root = np.sqrt(total)
    shape = root[:, None] * circle.T[used]
    project = np.eye(len(total)) - shape @ np.linalg.pinv(shape)
    left, scatter = project @ (root * whole), _jackknife_error((root * less) @ project)
    floor = _GOOD_SHARE * np.abs(model).max() * root
    # Pairs are counted in both directions: half of the bins are the other half again.
    return slope, error, float(np.sum(left**2 / (scatter**2 + floor**2)) / max(len(total) - 4, 1))


def _jackknife_error(less: np.ndarray) -> np.ndarray:
    """Standard error (n,) from values with one of n_scan left out, (n_scan, n)."""
    return less.std(axis=0) * np.sqrt(len(less) - 1)


def _pair_sums(spectra: _Spectra, found: _Delays) -> tuple[np.ndarray, np.ndarray]:
    """Sums over pairs and frequencies, (n_scan, n_bin): phase that delays leave, and what it is divided by [s/rad]."""
    d = found.aligned.d[: found.n_freq]
    first, second = np.nonzero(~np.eye(d.shape[2], dtype=bool))
    x, y = spectra.r_rad[:, second] - spectra.r_rad[:, first]
    apart = np.hypot(x, y)
    far = apart > _NEIGHBOUR * apart[apart > 0].min()
    first, second, apart = first[far], second[far], apart[far]
    bins = np.rint((np.arctan2(y[far], x[far]) + pi) * (N_PAIR_BINS / (2 * pi))).astype(np.int64) % N_PAIR_BINS
    turn = 2 * pi * found.aligned.turn_hz[: found.n_freq, None]
    rest, norm = np.empty((2, d.shape[1], N_PAIR_BINS))
    for scan in range(d.shape[1]):
        now = d[:, scan]
        phase, power = -((turn * now).conj().T @ now).imag, ((turn**2 * now).conj().T @ now).real
        rest[scan] = np.bincount(bins, phase[first, second] * apart, N_PAIR_BINS)
        norm[scan] = np.bincount(bins, power[first, second] * apart**2, N_PAIR_BINS)
    return 2 * pi * rest, norm


def _nothing(flag: str) -> WindFit:
    nan, per_bin = float("nan"), np.full((2, N_PAIR_BINS), np.nan)
    return WindFit(per_bin[0, :2], nan, nan, nan, nan, _CENTRES_RAD.copy(), *per_bin, per_bin[1, :2], nan, nan, flag)
