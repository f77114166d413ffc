"""Beams of pixels over the plane of the stop, and the mutual coherence that light within and beyond the stop gives.

A beam that fills the stop and spills over its edge sees two sources: the sky and the telescope through the aperture,
and the stop's own emission around it. Two pixels s (f/#)lambda apart see the plane of the stop with a phase that turns
s times across the stop's diameter. By the van Cittert-Zernike theorem their mutual coherence is the Hankel transform of
the beam's intensity over the source (Hill and Kusaka 2024, arXiv 2309.01153, equations 53 to 56). With the radius rho
in units of the stop's radius, for a beam G of unit power,

    gamma_ap(s) = (1/eta) int_0^1 |G|^2 J0(pi s rho) 2 pi rho d rho,

and gamma_stop the same from 1 outwards over 1 - eta. Eta is the share of the beam's power within the stop. For uniform
G the first is ``2 J1(pi s) / (pi s)``. Light that fills the whole plane evenly has the coherence

    gamma_whole = eta gamma_ap + (1 - eta) gamma_stop,

the overlap of the beams of the two pixels in the focal plane. It is zero for apertures that do not overlap.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from surveysim.runtime.errors import OutOfRangeError

# Waist of the Gaussian beam of a corrugated horn, over the radius of its aperture (Goldsmith 1998).
_WAIST_PER_RADIUS = 0.6435
# Beyond this exponent (174 dB) truncation by the stop is below rounding.
_UNTRUNCATED = 40.0
_J0_ZERO = 2.404825557695773  # first zero of J0: the edge of the field in the aperture of a corrugated horn

Transform = Callable[[np.ndarray], np.ndarray]


class Illumination(ABC):
    """Intensity |G(rho)|^2 of a pixel's beam over the plane of the stop, round about its centre."""

    @property
    @abstractmethod
    def efficiency(self) -> float:
        """Share eta of the beam's power that passes the stop."""

    @abstractmethod
    def intensity(self, rho: np.ndarray) -> np.ndarray:
        """Intensity at radii `rho` in units of the stop's radius, relative to a fixed point of the beam."""

    @abstractmethod
    def aperture(self, separation_f_lambda: np.ndarray) -> np.ndarray:
        """Coherence gamma_ap of light through the stop, to 1e-11; 1 at no separation."""

    @abstractmethod
    def whole(self, separation_f_lambda: np.ndarray) -> np.ndarray:
        """Coherence of light from the whole plane of the stop: overlap of the beams in the focal plane."""

    @abstractmethod
    def at(self, frequency_ratio: float) -> "Illumination":
        """Illumination at `frequency_ratio` times the frequency of this one, by the same pixel."""

    def stop(self, separation_f_lambda: np.ndarray) -> np.ndarray:
        """Coherence gamma_stop of light from around the stop, to 1e-11 / (1 - eta); zero where nothing spills."""
        spill = 1 - self.efficiency
        if spill == 0:
            return np.zeros(np.shape(separation_f_lambda))
        inside = self.efficiency * self.aperture(separation_f_lambda)
        return (self.whole(separation_f_lambda) - inside) / spill


# ---------------------------------------------------------------- Gaussian beams


@dataclass(frozen=True)
class GaussianIllumination(Illumination):
    """Gaussian beam with the intensity ``10^(-T/10 rho^2)``; an edge taper T of 0 dB is a uniformly lit stop, no spill.

    Raises OutOfRangeError unless `edge_taper_db` is finite and 0 or more.
    """

    edge_taper_db: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= self.edge_taper_db < math.inf:
            raise OutOfRangeError(
                f"edge_taper_db = {self.edge_taper_db:g} found; a finite taper of 0 dB or more is allowed"
            )

    @property
    def exponent(self) -> float:
        """Kappa of the intensity ``exp(-kappa rho^2)``."""
        return self.edge_taper_db * math.log(10) / 10

    @property
    def efficiency(self) -> float:
        """Share eta of the beam's power that passes the stop, ``1 - 10^(-T/10)``; 1 if uniform."""
        return -math.expm1(-self.exponent) if self.exponent else 1.0

    def intensity(self, rho: np.ndarray) -> np.ndarray:
        """Intensity at radii `rho` over the stop's, relative to the centre's."""
        lit = np.exp(-self.exponent * np.square(rho))
        return lit if self.exponent else np.where(np.asarray(rho) <= 1, lit, 0.0)

    def at(self, frequency_ratio: float) -> "GaussianIllumination":
        """Illumination at `frequency_ratio` times the frequency: the taper in dB grows with its square."""
        return GaussianIllumination(self.edge_taper_db * frequency_ratio**2)

    def aperture(self, separation_f_lambda: np.ndarray) -> np.ndarray:
        """Coherence gamma_ap of light through the stop, ``int I J0(pi s rho) rho d rho / int I rho d rho``.

        A uniformly illuminated stop gives ``2 J1(pi s) / (pi s)``: 0.506 at 0.7 (f/#)lambda, the paper's "50 % of the
        power received by adjacent bolometers is completely correlated" (section 5.1).
        """
        if self.exponent == 0:
            return self._zernike_sum(np.asarray(separation_f_lambda, dtype=float))
        return band_limited(self._zernike_sum, separation_f_lambda, 1.0)

    def _zernike_sum(self, separation: np.ndarray) -> np.ndarray:
        """Sum Zernike modes of the Gaussian: each transforms to a Bessel function (Nijboer); good to 1e-13."""
        from scipy.special import j1, jv

        x = np.pi * separation
        if self.exponent > _UNTRUNCATED:
            return np.exp(-(x**2) / (4 * self.exponent))
        safe = np.where(x == 0, 1.0, x)
        total = j1(safe)
        for order, weight in _zernike_weights(self.exponent / 2):
            total += weight * jv(order, safe)
        return np.where(x == 0, 1.0, 2 * total / safe)

    def whole(self, separation_f_lambda: np.ndarray) -> np.ndarray:
        """Overlap ``exp(-(pi s)^2 / 4 kappa)`` of two Gaussian beams in the focal plane; gamma_ap if uniform."""
        if self.exponent == 0:
            return self.aperture(separation_f_lambda)
        return np.exp(-np.square(np.pi * np.asarray(separation_f_lambda)) / (4 * self.exponent))


UNIFORM = GaussianIllumination()


def _zernike_weights(half_exponent: float) -> list[tuple[int, float]]:
    """Pairs (2m + 1, weight of J_(2m+1)) for m = 1, 2, ..., relative to a weight of 1 for J1, down to rounding.

    ``exp(-y t) = sum (2m + 1) (-1)^m i_m(y) P_m(t)``, t = 2 rho^2 - 1, and ``P_m(t)`` transforms to
    ``(-1)^m J_(2m+1)(x) / x``; i_m are modified spherical Bessel functions.
    """
    from scipy.special import ive

    if half_exponent == 0:
        return []
    m = np.arange(1, 60)
    weight = (2 * m + 1) * ive(m + 0.5, half_exponent) / ive(0.5, half_exponent)
    kept = weight > 1e-16
    return list(zip((2 * m[kept] + 1).tolist(), weight[kept].tolist(), strict=True))


def gaussian_horn(diameter_f_lambda: float) -> GaussianIllumination:
    """Illumination by a horn with an aperture of `diameter_f_lambda`: 8.9 dB at 2 (f/#)lambda, 1.1 dB at 0.7.

    The fundamental Gaussian beam of waist w0 spreads as ``exp(-2 (theta pi w0 / lambda)^2)``; the edge of the stop is
    at ``theta = 1 / (2 f/#)``. Valid for corrugated horns (Goldsmith, Quasioptical Systems, 1998), approximately for
    other horns with a symmetric beam, and for small angles. Raises OutOfRangeError unless the diameter is finite and
    above 0.
    """
    _check_diameter(diameter_f_lambda)
    waist = _WAIST_PER_RADIUS * diameter_f_lambda / 2
    return GaussianIllumination(10 / math.log(10) * 2 * (math.pi * waist / 2) ** 2)


def _check_diameter(diameter_f_lambda: float) -> None:
    if not 0 < diameter_f_lambda < math.inf:
        raise OutOfRangeError(f"diameter_f_lambda = {diameter_f_lambda:g} found; a finite diameter above 0 is allowed")


# ---------------------------------------------------------------- corrugated horns


@dataclass(frozen=True)
class He11Illumination(Illumination):
    """Beam of the HE11 mode of a corrugated horn, with the field ``J0(2.405 r / a)`` across its aperture of radius a.

    The far field is ``J0(v) / (1 - (v / 2.405)^2)`` at ``v = (pi / 2) d rho``, d the diameter in (f/#)lambda
    (Clarricoats and Olver, Corrugated Horns for Microwave Antennas, 1984). Valid for small angles and no phase error.
    Raises OutOfRangeError unless the diameter is finite and above 0.
    """

    diameter_f_lambda: float

    def __post_init__(self) -> None:
        _check_diameter(self.diameter_f_lambda)

    @property
    def efficiency(self) -> float:
        """Share eta of the beam's power that passes the stop. The power of the beam is ``2.405^2 / 2`` in v dv."""
        rho, weight = self._nodes(0.0)
        return float(weight.sum()) * (np.pi / 2 * self.diameter_f_lambda) ** 2 / (_J0_ZERO**2 / 2)

    def intensity(self, rho: np.ndarray) -> np.ndarray:
        """Intensity at radii `rho` over the stop's, relative to the centre's."""
        from scipy.special import j0, j1

        v = np.pi / 2 * self.diameter_f_lambda * np.asarray(rho, dtype=float)
        rest = 1 - (v / _J0_ZERO) ** 2
        near = np.abs(rest) < 1e-8  # the zero of numerator and denominator
        field = np.where(near, _J0_ZERO * j1(_J0_ZERO) / 2, j0(v) / np.where(near, 1.0, rest))
        return field**2

    def at(self, frequency_ratio: float) -> "He11Illumination":
        """Illumination at `frequency_ratio` times the frequency: the horn is that many times wider in (f/#)lambda."""
        return He11Illumination(self.diameter_f_lambda * frequency_ratio)

    def aperture(self, separation_f_lambda: np.ndarray) -> np.ndarray:
        """Coherence gamma_ap of light through the stop."""

        def transform(separation: np.ndarray) -> np.ndarray:
            return _hankel(separation, *self._nodes(np.max(separation, initial=0.0)))

        return band_limited(transform, separation_f_lambda, 1.0)

    def whole(self, separation_f_lambda: np.ndarray) -> np.ndarray:
        """Overlap of the fields in two apertures: 0 for horns that do not overlap, from one diameter on."""
        apart = np.abs(np.asarray(separation_f_lambda, dtype=float)) / self.diameter_f_lambda
        found, lens = np.zeros(apart.shape), apart < 1
        found[lens] = _he11_overlap(apart[lens])
        return found

    def _nodes(self, largest_f_lambda: float) -> tuple[np.ndarray, np.ndarray]:
        """Quadrature nodes over the stop's radius, and weights times the intensity, up to a separation."""
        phase = np.pi * (self.diameter_f_lambda + largest_f_lambda)
        node, weight = np.polynomial.legendre.leggauss(30 + math.ceil(phase / 2))
        rho = (node + 1) / 2
        return rho, weight / 2 * rho * self.intensity(rho)


def _he11_overlap(apart: np.ndarray) -> np.ndarray:
    """Overlap (n,) of two HE11 fields less than one diameter `apart` (n,), over the power of one.

    A quarter of the lens that both apertures cover is integrated in polar coordinates about its middle.
    """
    from scipy.special import j0, j1

    node, weight = np.polynomial.legendre.leggauss(60)
    angle, share = np.pi / 4 * (node + 1), np.pi / 4 * weight
    half, cosine, sine = apart[:, None, None], np.cos(angle)[:, None], np.sin(angle)[:, None]
    reach = np.sqrt(1 - (half * sine) ** 2) - half * cosine
    r = reach * (node + 1) / 2
    pair = [j0(_J0_ZERO * np.sqrt(r**2 + half**2 + 2 * sign * r * half * cosine)) for sign in (1, -1)]
    lens = np.sum(pair[0] * pair[1] * r * (reach / 2) * weight * share[:, None], axis=(-2, -1))
    return 4 * lens / (np.pi * j1(_J0_ZERO) ** 2)


# ---------------------------------------------------------------- measured beams


@dataclass(frozen=True)
class TableIllumination(Illumination):
    """Beam by its values at radii `rho` (n,) over the stop's, linear in between and zero beyond the last.

    `power` is 1 if `values` (n,) are intensities, 2 if they are amplitudes. The radii increase from 0; the last is 1 or
    more. The table holds at all frequencies.
    """

    rho: tuple[float, ...]
    values: tuple[float, ...]
    power: int = 1

    @property
    def efficiency(self) -> float:
        """Share eta of the beam's power that passes the stop."""
        within, all_of = (self._nodes(0.0, edge)[1].sum() for edge in (1.0, self.rho[-1]))
        return float(within / all_of)

    def intensity(self, rho: np.ndarray) -> np.ndarray:
        """Intensity at radii `rho` over the stop's, in the unit of the table."""
        return np.interp(rho, self.rho, self.values, right=0.0) ** self.power

    def at(self, frequency_ratio: float) -> "TableIllumination":
        """Illumination at another frequency: the same."""
        return self

    def aperture(self, separation_f_lambda: np.ndarray) -> np.ndarray:
        """Coherence gamma_ap of light through the stop."""
        return self._coherence(separation_f_lambda, 1.0)

    def whole(self, separation_f_lambda: np.ndarray) -> np.ndarray:
        """Coherence of light from the whole plane of the stop."""
        return self._coherence(separation_f_lambda, self.rho[-1])

    def _coherence(self, separation_f_lambda: np.ndarray, edge: float) -> np.ndarray:
        def transform(separation: np.ndarray) -> np.ndarray:
            return _hankel(separation, *self._nodes(np.max(separation, initial=0.0), edge))

        return band_limited(transform, separation_f_lambda, edge)

    def _nodes(self, largest_f_lambda: float, edge: float) -> tuple[np.ndarray, np.ndarray]:
        """Quadrature nodes of each piece of the table up to `edge`, and weights times the intensity."""
        knots = np.unique(np.append(self.rho, edge))
        knots = knots[knots <= edge]
        width = np.diff(knots)[:, None]
        # A piece of unlike width takes as many nodes as the widest.
        node, weight = np.polynomial.legendre.leggauss(12 + math.ceil(np.pi * largest_f_lambda * width.max() / 2))
        rho = knots[:-1, None] + width * (node + 1) / 2
        return rho.ravel(), (weight / 2 * width * rho * self.intensity(rho)).ravel()


# ---------------------------------------------------------------- transforms


def _hankel(separation: np.ndarray, rho: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Hankel transform at separations, normalised to 1 at none."""
    from scipy.special import j0

    return j0(np.pi * np.multiply.outer(separation, rho)) @ weight / weight.sum()


def band_limited(transform: Transform, separation_f_lambda: np.ndarray, edge: float) -> np.ndarray:
    """Compute the transform of a beam within `edge` stop radii at many separations, to 1e-11, from few.

    It has no power beyond `edge` cycles per 2 (f/#)lambda. Like a cosine's, its Chebyshev coefficients over separations
    up to S vanish soon beyond the order pi edge S / 2.
    """
    separation = np.abs(np.asarray(separation_f_lambda, dtype=float))
    largest = separation.max(initial=0.0)
    order = math.pi / 2 * edge * largest
    degree = math.ceil(order + 12 * order ** (1 / 3) + 20)
    if separation.size <= degree:
        return transform(separation)
    return np.polynomial.Chebyshev.interpolate(transform, degree, [0.0, largest])(separation)
