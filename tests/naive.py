"""Slow, obvious twins of the kernels: loops that can be read against the equations."""

from itertools import product

import numpy as np

from surveysim.runtime.rng import RandomPurpose, generator


def average_cleaning(scan_mk, tolerance, max_iterations):
    """Average subtraction of one scan in the paper's own two equations; returns (cleaned, c)."""
    data = scan_mk - scan_mk.mean(axis=1, keepdims=True)
    n_det, n_samp = data.shape
    c = np.ones(n_det)
    for _ in range(max_iterations):
        template = [sum(data[i, n] / c[i] for i in range(n_det)) / sum(1 / c) for n in range(n_samp)]
        square = sum(t * t for t in template)
        cross = [sum(template[n] * data[i, n] for n in range(n_samp)) for i in range(n_det)]
        updated = np.array(cross) / square
        change = np.mean(np.abs(updated / c - 1))
        c = updated
        if change < tolerance:
            template = [sum(data[i, n] / c[i] for i in range(n_det)) / sum(1 / c) for n in range(n_samp)]
            return data - np.outer(c, template), c
    raise ArithmeticError("not converged")


def remove_means(data):
    """Each row less its mean, or None where a value is not finite."""
    if any(not np.isfinite(value) for row in data for value in row):
        return None
    return np.array([[float(value) - sum(map(float, row)) / len(row) for value in row] for row in data])


def subtract_templates(block, shapes, templates):
    """Each sample of each detector less the sum over templates."""
    terms = range(len(templates))
    return [
        [block[i, n] - sum(shapes[k, i] * templates[k, n] for k in terms) for n in range(block.shape[1])]
        for i in range(len(block))
    ]


def hann_power(data, n_scans, kept):
    """Squares of the discrete Fourier transforms of kept scans, less their means and under Hann's taper."""
    n_det, n = len(data), data.shape[1] // n_scans
    power = np.zeros((n_det, n // 2 + 1))
    for i in range(n_det):
        for scan in np.flatnonzero(kept):
            samples = data[i, scan * n : (scan + 1) * n].astype(float)
            samples = (samples - np.mean(samples)) * [np.sin(np.pi * j / n) ** 2 for j in range(n)]
            for k in range(n // 2 + 1):
                power[i, k] += abs(sum(samples[j] * np.exp(-2j * np.pi * j * k / n) for j in range(n))) ** 2
    return power


def scale_mean_removed(data, n_scans, level):
    """Scans of each detector less their means, times its level."""
    scans = np.array(data, float).reshape(len(data), n_scans, -1)
    means = [[sum(scan) / len(scan) for scan in row] for row in scans]
    return ((scans - np.array(means)[..., None]) * level[:, None, None]).reshape(data.shape)


def template_cleaning(scan_mk, shapes, hold, tolerance, max_iterations):
    """Polynomial templates of one scan, sample by sample; returns (cleaned, c, steps).

    shapes: S, (n_det, n_par), first column constant. hold: take the fit of S to c, except for the constant,
    out of c after every step.
    """
    data = scan_mk - scan_mk.mean(axis=1, keepdims=True)
    n_det, n_samp = data.shape
    fit = np.linalg.inv(shapes.T @ shapes) @ shapes.T

    def templates(c):
        return np.array([shapes @ (fit @ (data[:, n] / c)) for n in range(n_samp)]).T

    c = np.ones(n_det)
    for step in range(1, max_iterations + 1):
        template = templates(c)
        updated = np.empty(n_det)
        for i in range(n_det):
            updated[i] = sum(template[i] * data[i]) / sum(template[i] ** 2)
        if hold:
            updated = updated - shapes @ (fit @ updated) + updated.mean()
            updated = updated / updated.mean()
        change = np.mean(np.abs(updated / c - 1))
        c = updated
        if change < tolerance:
            return data - c[:, None] * templates(c), c, step
    raise ArithmeticError("not converged")


def shifted_stream(stream, delay):
    """A periodic stream read `delay` samples later, as the appendix has it: interpolated, then divided by |S|."""
    n_samp = len(stream)
    whole = int(np.floor(delay))
    part = delay - whole
    drawn = [(1 - part) * stream[(n + whole) % n_samp] + part * stream[(n + whole + 1) % n_samp] for n in range(n_samp)]
    f_hz = np.fft.fftfreq(n_samp)
    s = 1 - part + part * np.exp(2j * np.pi * f_hz)
    return np.fft.ifft(np.fft.fft(drawn) / np.abs(s)).real


def wind_cleaning(scan_mk, delay, tolerance, max_iterations):
    """Average subtraction at rest with the layer, detector by detector; returns (cleaned, c)."""
    data = scan_mk - scan_mk.mean(axis=1, keepdims=True)
    n_det, n_samp = data.shape
    pad = int(np.ceil(max(abs(delay))))

    def mirrored(stream):
        return np.concatenate([stream, stream[::-1]])

    rest = np.empty((n_det, n_samp + 2 * pad))
    for i in range(n_det):
        longer = np.concatenate([data[i, :pad][::-1], data[i], data[i, n_samp - pad :][::-1]])
        rest[i] = shifted_stream(mirrored(longer), delay[i])[: len(longer)]
    has = np.array([[0 <= n - pad + delay[i] <= n_samp - 1 for n in range(n_samp + 2 * pad)] for i in range(n_det)])
    common = has.all(axis=0)
    _, c = average_cleaning(rest[:, common], tolerance, max_iterations)
    rest = rest - rest[:, common].mean(axis=1, keepdims=True)
    template = [np.mean((rest[:, n] / c)[has[:, n]]) if has[:, n].any() else np.nan for n in range(n_samp + 2 * pad)]
    known = np.flatnonzero(np.isfinite(template))
    template = np.array([template[min(max(n, known[0]), known[-1])] for n in range(n_samp + 2 * pad)])
    cleaned = np.empty_like(data)
    for i in range(n_det):
        cleaned[i] = data[i] - c[i] * shifted_back(mirrored(template), delay[i])[pad : pad + n_samp]
    return cleaned - cleaned.mean(axis=1, keepdims=True), c


def shifted_back(stream, delay):
    """The inverse of `shifted_stream`: the same in reversed time."""
    return shifted_stream(stream[::-1], delay)[::-1]


def pca_cleaning(scan_mk, sigma_cut):
    """Adaptive PCA in the paper's own steps; returns (cleaned, number of modes cut)."""
    data = scan_mk - scan_mk.mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(data @ data.T)
    amplitudes = vectors.T @ data
    left = [k for k in range(len(values)) if values[k] > 1e-12 * max(values)]
    cut = []
    while True:
        logarithm = {k: np.log(values[k]) for k in left}
        mean, sigma = np.mean(list(logarithm.values())), np.std(list(logarithm.values()))
        out = [k for k in left if logarithm[k] > mean + sigma_cut * sigma]
        if not out:
            break
        cut, left = cut + out, [k for k in left if k not in out]
    amplitudes[cut] = 0
    return vectors @ amplitudes, len(cut)


def local_cleaning(scan_mk, x_rad, y_rad, reach):
    """Each detector less the fitted mean of itself and its six or fewer nearest neighbours."""
    data = scan_mk - scan_mk.mean(axis=1, keepdims=True)
    n_det = len(data)
    apart = np.hypot(np.subtract.outer(x_rad, x_rad), np.subtract.outer(y_rad, y_rad))
    closest = min(apart[apart > 0])
    cleaned = data.copy()
    for i in range(n_det):
        others = sorted((apart[i, j], j) for j in range(n_det) if j != i and apart[i, j] < reach * closest)
        if others:
            template = np.mean([data[i], *(data[j] for _, j in others[:6])], axis=0)
            cleaned[i] -= template * sum(template * data[i]) / sum(template**2)
    return cleaned


def add_screen(data, start, stop, strip, x0, y0, dx, amplitude):
    """Bilinear look-up of every detector's track, from the four lattice points around each sample."""
    n_lane, n_x = strip.shape
    for d in range(data.shape[0]):
        for n in range(stop - start):
            x, y = x0[d] + n * dx, y0[d]
            i, j = min(int(x), n_x - 2), min(int(y), n_lane - 2)
            s, t = x - i, y - j
            along_near = (1 - s) * strip[j, i] + s * strip[j, i + 1]
            along_far = (1 - s) * strip[j + 1, i] + s * strip[j + 1, i + 1]
            data[d, start + n] += amplitude * ((1 - t) * along_near + t * along_far)


def add_weighted(data, start, values, weight):
    """As `surveysim.atmosphere.screen_kernels.add_weighted`."""
    for d in range(len(values)):
        for n in range(len(weight)):
            data[d, start + n] += weight[n] * values[d, n]


def add_screen_nearest(data, start, stop, strip, x0, y0, dx, amplitude):
    """Look-up of the lattice point that is nearest along each axis, the higher one halfway."""
    for d in range(data.shape[0]):
        for n in range(stop - start):
            i, j = (int(np.floor(p + 0.5)) for p in (x0[d] + n * dx, y0[d]))
            data[d, start + n] += amplitude * strip[j, i]


def add_screen_cubic(data, start, stop, strip, x0, y0, dx, amplitude):
    """Look-up in the polynomial of degree 3 along each axis through the 4 x 4 nearest points on the strip."""
    n_lane, n_x = strip.shape
    for d in range(data.shape[0]):
        for n in range(stop - start):
            along, across = (x0[d] + n * dx, n_x), (y0[d], n_lane)
            for i, u in cubic_weights(*along):
                for j, v in cubic_weights(*across):
                    data[d, start + n] += amplitude * u * v * strip[j, i]


def add_curved(look_up, data, start, stop, strip, x, y, cosine, sine, amplitude, u, v):
    """Look-up, by one of the functions above, of single samples: offsets turn as complex numbers, mirrored."""
    for n in range(stop - start):
        place = x[n] + 1j * y[n] + (cosine[n] - 1j * sine[n]) * (u - 1j * v)
        look_up(data, start + n, start + n + 1, strip, place.real, place.imag, 0.0, amplitude[n])


def cubic_weights(p, size):
    """Four points (number, weight) of Lagrange's polynomial at p among the points 0 to size - 1."""
    first = min(max(int(np.floor(p)) - 1, 0), size - 4)
    nodes = range(first, first + 4)
    return [(i, np.prod([(p - k) / (i - k) for k in nodes if k != i])) for i in nodes]


def combine_columns(columns, start, normals):
    """Modes (n_lane, n_freq): for each frequency its factors times complex normal amplitudes."""
    n_freq, n_lane = len(start) - 1, columns.shape[1]
    modes = np.zeros((n_lane, n_freq), complex)
    for k in range(n_freq):
        for r in range(start[k], start[k + 1]):
            modes[:, k] += columns[r] * complex(normals[2 * r], normals[2 * r + 1])
    return modes


def line_of_sight(dec0, xi, eta, plane_angle, x, y):
    """Place (xi, eta) of a detector in the plane, by vectors in the equatorial frame of a centre at RA 0."""
    east, north = np.array([0.0, 1.0, 0.0]), np.array([-np.sin(dec0), 0.0, np.cos(dec0)])
    centre = np.array([np.cos(dec0), 0.0, np.sin(dec0)])
    boresight = centre + xi * east + eta * north
    boresight = boresight / np.linalg.norm(boresight)
    # North and east of the sky at the boresight; the meridian's angle in the plane by a small step along it.
    pole = np.array([0.0, 0.0, 1.0])
    sky_east = np.cross(pole, boresight) / np.linalg.norm(np.cross(pole, boresight))
    sky_north = np.cross(boresight, sky_east)
    step = boresight + 1e-7 * sky_north
    step = step / (step @ centre)
    angle = plane_angle - np.arctan2(step @ east - xi, step @ north - eta)
    y_axis = np.cos(angle) * sky_north + np.sin(angle) * sky_east
    x_axis = np.sin(angle) * sky_north - np.cos(angle) * sky_east
    seen = boresight + x * x_axis + y * y_axis
    return seen @ east / (seen @ centre), seen @ north / (seen @ centre)


def detector_place(place, x, y):
    """Column and row of a detector in one sample: the homography as a matrix."""
    c0, cx, cy, r0, rx, ry, wx, wy = place
    column, row, depth = np.array([[cx, cy, c0], [rx, ry, r0], [wx, wy, 1.0]]) @ [x, y, 1.0]
    return (column / depth, row / depth) if depth > 0 else (-np.inf, -np.inf)


def plane_pixels(place, x_rad, y_rad, n_x, n_y):
    """The pixel that holds each sample, by rounding down; -1 off the map."""
    index = np.full((len(x_rad), place.shape[1]), -1)
    for d in range(len(x_rad)):
        for n in range(place.shape[1]):
            c, r = np.floor(detector_place(place[:, n], x_rad[d], y_rad[d]))
            if c in range(n_x) and r in range(n_y):
                index[d, n] = r * n_x + c
    return index


def bin_samples(data, index, bounds, kept, n_pixel):
    """Sums and hits of each pixel, pixel by pixel."""
    n_samp = data.shape[1]
    used = np.zeros(n_samp, bool)
    for (start, stop), keep in zip(bounds, kept, strict=True):
        for n in range(start, stop):
            used[n] = keep
    seen = [used & (index == pixel) for pixel in range(n_pixel)]
    return np.array([data[s].sum(dtype=float) for s in seen]), np.array([s.sum() for s in seen])


def add_sky(data, sky, place, x_rad, y_rad, gain):
    """Bilinear look-up of the sky by the area that each of four pixels has in common with a shifted one."""
    n_y, n_x = sky.shape
    for d in range(data.shape[0]):
        for n in range(data.shape[1]):
            c, r = detector_place(place[:, n], x_rad[d], y_rad[d])
            if not (0 <= c < n_x - 1 and 0 <= r < n_y - 1):
                continue
            for i in range(n_y):
                for j in range(n_x):
                    data[d, n] += gain[d] * sky[i, j] * max(0, 1 - abs(r - i)) * max(0, 1 - abs(c - j))


def add_signed(total, values, signs):
    """Signed copies, one by one."""
    for b in range(len(values)):
        for k in range(len(signs)):
            total[k] = total[k] + signs[k, b] * values[b]


def jackknife_signs(scene, observation):
    """Signs of one observation, from the generator itself."""
    rng = generator(scene.seed, RandomPurpose.JACKKNIFE, observation)
    return 2.0 * rng.integers(0, 2, scene.score.jackknives) - 1


def tree_sum(arrays, leaf=16):
    """Sum of arrays: leaves of some in order, pairs of whole leaves, pairs of these, and so on; then left to right."""
    nodes = []
    for first in range(0, len(arrays), leaf):
        total = np.zeros_like(arrays[0])
        for array in arrays[first : first + leaf]:
            total = total + array
        nodes.append((min(leaf, len(arrays) - first), total))
        while len(nodes) > 1 and nodes[-1][0] == nodes[-2][0] and nodes[-1][0] % leaf == 0:
            (size, left), (_, right) = nodes[-2:]
            nodes[-2:] = [(2 * size, left + right)]
    total = nodes[0][1]
    for _, node in nodes[1:]:
        total = total + node
    return total


def cosine_modes(n):
    """Orthonormal rows cos(pi k (j + 1/2) / n): the modes of a scan that goes on as its mirror image."""
    rows = np.array([[np.cos(np.pi * k * (j + 0.5) / n) for j in range(n)] for k in range(n)])
    return rows / np.sqrt(np.sum(rows**2, axis=1, keepdims=True))


def inverse_covariance(band_of_mode, covariances):
    """N^-1 (n_det n_samp, n_det n_samp) of one scan, detector by detector; mode 0 and modes of band -1 have none."""
    n_det, n = len(covariances[0]), len(band_of_mode)
    rows = cosine_modes(n)
    total = np.zeros((n_det, n, n_det, n))
    for k in range(1, n):
        if band_of_mode[k] >= 0:
            inverse = np.linalg.inv(covariances[band_of_mode[k]])
            total += np.einsum("de,i,j->diej", inverse, rows[k], rows[k])
    return total.reshape(n_det * n, n_det * n)


def gls_map(scans, n_pixel):
    """Maximum-likelihood map by a dense pseudo-inverse, from (data, index, N^-1) of each scan."""
    normal, right = np.zeros((n_pixel, n_pixel)), np.zeros(n_pixel)
    for data, index, inverse in scans:
        pointing = pointing_matrix(index, n_pixel)
        normal += pointing.T @ inverse @ pointing
        right += pointing.T @ inverse @ data.ravel()
    return np.linalg.pinv(normal, rcond=1e-10, hermitian=True) @ right


def pointing_matrix(index, n_pixel):
    """P (n_det n_samp, n_pixel); rows of samples off the map are 0."""
    pointing = np.zeros((index.size, n_pixel))
    for sample, pixel in enumerate(index.ravel()):
        if pixel >= 0:
            pointing[sample, pixel] = 1
    return pointing


def baseline_matrix(index, edges):
    """F (n_det n_samp, n_det n_baseline): 1 where a sample with data is in a baseline of its detector."""
    columns = []
    for d in range(len(index)):
        for first, end in edges:
            column = np.zeros(index.shape)
            for n in range(first, end):
                column[d, n] = index[d, n] >= 0
            columns.append(column.ravel())
    return np.array(columns).T


def baseline_inverse(index, edges, weight):
    """N^-1 (n_det n_samp, n_det n_samp) of white noise with baselines of infinite variance; 0 without data."""
    level = np.diag(np.where(index >= 0, weight[:, None], 0.0).ravel())
    loose = baseline_matrix(index, edges)
    fit = loose @ np.linalg.pinv(loose.T @ level @ loose) @ loose.T
    return level - level @ fit @ level


def apodized_sums(strength, power, frequency, at, transfer, per_step, mean, loose, share, own, lost, filtered):
    """Sum over the streams' frequencies of what an apodization lets through, with w looked up between its steps."""

    def w(frequency_hz):
        return np.interp(abs(frequency_hz) * per_step, range(len(transfer)), transfer, right=0.0)

    total = np.zeros((len(power), len(at)))
    for k in range(len(at)):
        row = strength[k] if len(strength) > 1 else strength[0]
        for a in range(len(frequency)):
            value = w(at[k] - frequency[a]) - mean[a] * w(at[k]) - (filtered[k, a] if filtered.size else 0.0)
            averaged = 2 * loose[a] * mean[a] * w(at[k] - frequency[a]) * w(at[k])
            total[:, k] += averaged * row[a] * power[:, a]
            total[:, k] += (1 - sum(share)) * value**2 * row[a] * power[:, a]
            for j in range(len(share)):
                total[:, k] += share[j] * (value - lost[j, a] * own[k, j]) ** 2 * row[a] * power[:, a]
    return total


def cleaning_matrix(x_rad, y_rad, responsivity, order):
    """1 - P (n_det, n_det) of polynomials up to an order (-1: none) times known responsivities."""
    powers = [(i, j) for i in range(order + 1) for j in range(order + 1 - i)]
    n_det = len(x_rad)
    if not powers:
        return np.eye(n_det)
    shapes = np.array([(x_rad / 1e-3) ** i * (y_rad / 1e-3) ** j for i, j in powers]).T
    fit = shapes @ np.linalg.inv(shapes.T @ shapes) @ shapes.T
    return np.eye(n_det) - np.diag(responsivity) @ fit @ np.diag(1 / responsivity)


def layer_gain(place, responsivity, left, wave, alpha):
    """Share of each wavevector's power (cycles/rad) that goes into each mode (n_mode, n_a), detector by detector.

    `left` is the matrix of the cleaning.
    """
    gain = np.zeros((len(wave), len(alpha)))
    for m, k in enumerate(wave):
        for a, q in enumerate(alpha):
            streams = [g * np.exp(2j * np.pi * (q * np.conj(r)).real) for g, r in zip(responsivity, place, strict=True)]
            cleaned = [sum(left[i, j] * streams[j] for j in range(len(place))) for i in range(len(place))]
            amplitude = sum(
                np.exp(-1j * (k * np.conj(r)).real) * value for r, value in zip(place, cleaned, strict=True)
            )
            gain[m, a] = abs(amplitude) ** 2 / len(place)
    return gain


def draw_trends(covariance, normals, group):
    """Trends (n_scan, n_trend) of scans, each group given the last, by dense conditional means and covariances.

    `covariance` (n_scan, n_scan, n_trend, n_trend).
    """
    n_scan, n_trend = normals.shape

    def block(rows, columns):
        return np.block([[covariance[a, b] for b in columns] for a in rows])

    trends = np.zeros((n_scan, n_trend))
    for start in range(0, n_scan, group):
        new, old = range(start, min(n_scan, start + group)), range(max(0, start - group), start)
        mean, left = 0.0, block(new, new)
        if old:
            regression = block(new, old) @ np.linalg.inv(block(old, old))
            mean = regression @ trends[old.start : old.stop].ravel()
            left = left - regression @ block(old, new)
        drawn = mean + np.linalg.cholesky(left) @ normals[new.start : new.stop].ravel()
        trends[new.start : new.stop] = drawn.reshape(len(new), n_trend)
    return trends


WORD = 2**32


def philox(counter, key, rounds=10):
    """Philox 4x32 of Python integers (or arrays of uint64): four words of a counter (4 words) and a key (2 words)."""
    (a, b, c, d), (k, j) = counter, key
    for _ in range(rounds):
        first, second = 0xD2511F53 * a, 0xCD9E8D57 * c
        a, b, c, d = (second >> 32) ^ b ^ k, second % WORD, (first >> 32) ^ d ^ j, first % WORD
        k, j = (k + 0x9E3779B9) % WORD, (j + 0xBB67AE85) % WORD
    return a, b, c, d


def deviate(words, position, rounds=10, radius_bits=40, refined=False):
    """A deviate of the stream `words` (4 words) by its position: 64 in a tile, 16 counters with two pairs each.

    The digits of float64 (`refined`) are those of a second counter.
    """
    tile, part, lane = position // 64, position % 64 // 16, position % 16
    counter = 16 * tile + lane

    def pair(second):
        four = philox((counter % WORD, counter // WORD + second, *words[2:]), words[:2], rounds)
        return [np.where(part < 2, four[k], four[k + 2]).astype(np.uint64) for k in (0, 1)]

    fractions = [(word + 0.5) / WORD for word in pair(2**31)] if refined else (0.5, 0.5)
    cosine, sine = box_muller(*pair(0), *fractions, radius_bits)
    return np.where(part % 2 == 0, cosine, sine)


def box_muller(word, other, fraction=0.5, fraction_of_angle=0.5, radius_bits=40):
    """Two normal deviates of two words: 40 bits for the radius, 24 for the angle, each with a fraction of the last.

    The number from 0 to 1 is mirrored in the upper half of its range.
    """
    upper = word >= WORD // 2
    number = np.where(upper, WORD - 1 - word, word) * 256 + other % 256
    coarse = 2 ** (40 - radius_bits)
    tail = (number // coarse + fraction) * coarse / 2.0**40
    radius = np.sqrt(-2 * np.where(upper, np.log1p(-tail), np.log(tail)))
    step = other // 256 % 2**22  # with a sign, in 22 bits
    angle = (np.where(step < 2**21, step, step - 2.0**22) + fraction_of_angle) / 2**21 * (np.pi / 4)
    radius = np.where(other >= WORD // 2, -radius, radius)
    swapped = other // 2**30 % 2 == 1
    cosine, sine = radius * np.cos(angle), radius * np.sin(angle)
    return np.where(swapped, sine, cosine), np.where(swapped, cosine, sine)


def beam_coherence(intensity, separation, inner, outer, n=4000):
    """Coherence of light between two radii of the stop's plane, by the midpoint rule in rho and angle."""
    rho = inner + (outer - inner) * (np.arange(n) + 0.5) / n
    weight = intensity(rho) * rho
    phase = 2 * np.pi * (np.arange(400) + 0.5) / 400
    ring = [np.mean(np.cos(np.pi * separation * r * np.cos(phase))) for r in rho]
    return float(np.sum(weight * ring) / np.sum(weight))


def wave_correlation(beam, separation, band, aperture_weight, stop_weight):
    """Correlation of wave noise by Hill and Kusaka's equations 59 and 60, frequency by frequency.

    Aperture and stop have one brightness each at all frequencies, so that their light goes as eta and 1 - eta.
    """
    weights = (aperture_weight, stop_weight) if stop_weight else (aperture_weight,)
    by_frequency = []
    for frequency, transmission in band:
        here, apart = beam.at(frequency), np.array([separation * frequency])
        gamma = here.aperture(apart)[0], here.stop(apart)[0] if stop_weight else 0.0
        by_frequency.append((transmission, (here.efficiency, 1 - here.efficiency), gamma))
    found = 0.0
    for first, one in enumerate(weights):
        for second, other in enumerate(weights):
            total = norm = 0.0
            for transmission, light, gamma in by_frequency:
                noise = transmission**2 * light[first] * light[second]
                total += noise * gamma[first] * gamma[second]
                norm += noise
            found += one * other * total / norm
    return found


def low_pass(data, per_scan, decay, taps):
    """One pole on each scan of each detector, which starts at rest and continues as it ends."""
    found = np.array(data, float)
    for d in range(len(data)):
        for start in range(0, data.shape[1], per_scan):
            x = [float(value) for value in data[d, start : start + per_scan]]
            x = [x[0], *x, x[-1]]  # the sample n is x[n + 1]
            for n in range(1, per_scan):
                cubic = sum(taps[d, j] * x[n - 1 + j] for j in range(4))
                found[d, start + n] = decay[d] * found[d, start + n - 1] + cubic
    return found


def add_derivative(data, per_scan, lead):
    """Each scan plus a multiple of its derivative from five samples; the ends continue."""
    found = np.array(data, float)
    for d in range(len(data)):
        for start in range(0, data.shape[1], per_scan):
            x = np.pad(np.array(data[d, start : start + per_scan], float), 2, mode="edge")
            for n in range(per_scan):
                slope = np.dot([1, -8, 0, 8, -1], x[n : n + 5]) / 12
                found[d, start + n] = x[n + 2] + lead[d] * slope
    return found


def crosstalk_matrix(n_det, groups, neighbour, group):
    """Matrix of the crosstalk of readout groups, lists of detectors in the order of readout."""
    matrix = np.zeros((n_det, n_det))
    for i in range(n_det):
        matrix[i, i] = 1.0
        for members in groups:
            for j in members:
                if i in members and j != i:
                    near = abs(members.index(i) - members.index(j)) == 1
                    matrix[i, j] = group + (neighbour if near else 0.0)
    return matrix


def fill_flagged(data, scan_bounds, flagged):
    """Gaps of each scan: the common signal, from mean changes, and a line through the means on both sides."""
    filled = np.array(data, float)
    for start, stop in scan_bounds:
        scan, lost = np.array(data[:, start:stop], float), flagged[:, start:stop]
        times, rows = range(stop - start), range(len(scan))
        seen = [n for n in times if not lost[:, n].all()]
        if not seen:
            filled[:, start:stop] = np.nan
            continue
        at = [0.0]
        for before, n in zip(seen, seen[1:], strict=False):
            changes = [scan[d, n] - scan[d, before] for d in rows if not (lost[d, n] or lost[d, before])]
            at.append(at[-1] + np.mean(changes or [0.0]))
        common = np.interp(times, seen, at)
        for d in rows:
            for gap in runs(lost[d]):
                sides = [side for side in neighbours(lost[d], gap) if side]
                means = [np.mean([scan[d, n] - common[n] for n in side]) for side in sides] or [0.0]
                places = [np.mean(side) for side in sides]
                slope = (means[1] - means[0]) / (places[1] - places[0]) if len(sides) == 2 else 0.0
                for n in gap:
                    line = means[0] + (slope * (n - places[0]) if sides else 0.0)
                    filled[d, start + n] = common[n] + line
    return filled


def runs(lost):
    """Runs of lost samples, each as the list of its samples."""
    found = []
    for n in np.flatnonzero(lost):
        if found and found[-1][-1] == n - 1:
            found[-1].append(n)
        else:
            found.append([n])
    return found


def neighbours(lost, gap):
    """Samples before and after a gap: as many as it has, up to the next gap or the end."""
    sides = []
    for step, n in ((-1, gap[0] - 1), (1, gap[-1] + 1)):
        side = []
        while 0 <= n < len(lost) and not lost[n] and len(side) < len(gap):
            side.append(n)
            n += step
        sides.append(side)
    return sides


def add_pulses(data, per_scan, detector, scan, start, amplitude, decay):
    """Pulses that decay by a factor a sample, each within its scan."""
    total = np.array(data, float)
    for d, s, first, size in zip(detector, scan, start, amplitude, strict=True):
        for n in range(max(0, first), per_scan):
            total[d, s * per_scan + n] += size * decay ** (n - first)
    return total


def mode_response(taper, pixel, edges, sky_shape, cells=1):
    """Mean PSD of the map's modes in each bin per power of each mode of the sky, (n_bin, N_y, N_x): wave by wave."""
    n_y, n_x = taper.shape
    k_map = [2 * np.pi * np.fft.fftfreq(n, pixel) for n in taper.shape]
    k_sky = [2 * np.pi * np.fft.fftfreq(n, pixel / cells) for n in sky_shape]
    area = np.prod(sky_shape) * (pixel / cells) ** 2
    response, count = np.zeros((len(edges) - 1, *sky_shape)), np.zeros(len(edges) - 1)
    for k_y in k_map[0]:
        for k_x in k_map[1]:
            inside = [b for b in range(len(count)) if edges[b] <= np.hypot(k_y, k_x) < edges[b + 1]]
            if not inside:
                continue
            wave_y = np.exp(-1j * np.subtract.outer(k_y - k_sky[0], np.zeros(n_y)) * np.arange(n_y) * pixel)
            wave_x = np.exp(-1j * np.subtract.outer(k_x - k_sky[1], np.zeros(n_x)) * np.arange(n_x) * pixel)
            response[inside[0]] += np.abs(wave_y @ taper @ wave_x.T) ** 2 * pixel**2 / (area * np.sum(taper**2))
            count[inside[0]] += 1
    return response / count[:, None, None]


def coupling_matrix(taper, pixel, edges, window, sky_shape):
    """Mean PSD of the map in each bin per unit band power in each bin; the outer ones have all other multipoles."""
    k_y, k_x = (2 * np.pi * np.fft.fftfreq(n, pixel) for n in sky_shape)
    ell, n_bin = np.hypot(k_y[:, None], k_x), len(edges) - 1
    power = window(k_y[:, None], k_x) * np.where(ell > 0, 2 * np.pi / np.maximum(ell * (ell + 1), 1e-9), 0)
    place = np.array([[min(max(sum(edge <= at for edge in edges) - 1, 0), n_bin - 1) for at in row] for row in ell])
    response = mode_response(taper, pixel, edges, sky_shape)
    return np.array([[np.sum((row * power)[place == b]) for b in range(n_bin)] for row in response])


def cross_pseudo_power(maps, taper, pixel, edges):
    """Mean cross-power of the pairs of tapered maps, in bins."""
    modes = [np.fft.fft2(item * taper) for item in maps]
    pairs = [(a * b.conj()).real for i, a in enumerate(modes) for b in modes[:i]]
    cross = np.mean(pairs, axis=0) * pixel**2 / np.sum(taper**2)
    k_y, k_x = (2 * np.pi * np.fft.fftfreq(n, pixel) for n in taper.shape)
    ell = np.hypot(k_y[:, None], k_x)
    return np.array(
        [cross[(ell >= low) & (ell < high)].mean() for low, high in zip(edges[:-1], edges[1:], strict=True)]
    )


def coupling_on_sphere(spectrum, top):
    """Sum over 3-j symbols (top, top): coupling matrix of a taper of this power spectrum, without its 2 l' + 1."""
    from ducc0.misc import wigner3j_int

    matrix = np.zeros((top, top))
    for l1 in range(top):
        for l2 in range(top):
            first, symbols = wigner3j_int(l1, l2, 0, 0)
            for l3, symbol in enumerate(symbols, first):
                if l3 < len(spectrum):
                    matrix[l1, l2] += (2 * l3 + 1) / (4 * np.pi) * spectrum[l3] * symbol**2
    return matrix


def step_statistic(data, lost, bounds, window, fewest):
    """Loop over samples; see `mapmaker.kernels.cleaned_tests.step_statistic`."""
    found = np.zeros(data.shape)
    for d, (start, stop) in product(range(len(data)), bounds):
        for n in range(start, stop):
            sides = range(max(start, n - window), n), range(n, min(stop, n + window))
            before, after = ([data[d, k] for k in side if not lost[d, k]] for side in sides)
            if min(len(before), len(after)) >= fewest:
                scale = np.sqrt(1 / len(before) + 1 / len(after))
                found[d, n] = (np.mean(after) - np.mean(before)) / scale
    return found


def add_weighted_samples(data, index, bounds, weight, n_pixel):
    """Sums, weights and hits of each pixel; see `mapmaker.kernels.weighted_sums.add_weighted`."""
    total, exposure, hits = np.zeros(n_pixel), np.zeros(n_pixel), np.zeros(n_pixel, int)
    for d, (s, (start, stop)) in product(range(len(data)), enumerate(bounds)):
        for n in range(start, stop):
            if index[d, n] >= 0 and weight[d, s] != 0:
                total[index[d, n]] += weight[d, s] * data[d, n]
                exposure[index[d, n]] += weight[d, s]
                hits[index[d, n]] += 1
    return total, exposure, hits
