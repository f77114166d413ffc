"""Passbands: transmission of a frequency band, as a top hat, a table or by name, and averages over it."""

import tomllib
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from surveysim.runtime.errors import InputError
from surveysim.scene.frequency_table import read_frequency_table
from surveysim.scene.similar_names import did_you_mean
from surveysim.scene.units import BOLTZMANN_J_K, CMB_TEMPERATURE_K, PLANCK_J_S, shown

KEY = "instrument.passband"
_MOST_NODES = 64  # of a segment: exact to rounding for a smooth integrand over any top hat
_FEWEST_NODES = 3
_X_PER_HZ = PLANCK_J_S / (BOLTZMANN_J_K * CMB_TEMPERATURE_K)


@dataclass(frozen=True)
class Passband:
    """Relative transmission of a band: linear between its knots, zero outside them.

    One knot is a band without width, two knots of equal transmission are a top hat.

    Parameters
    ----------
    frequency_hz
        Increasing frequencies of the knots.
    transmission
        Transmission at each knot, 0 or more; its scale does not matter.
    """

    frequency_hz: tuple[float, ...]
    transmission: tuple[float, ...]

    @property
    def edges_hz(self) -> tuple[float, float]:
        """Lowest and highest frequency."""
        return self.frequency_hz[0], self.frequency_hz[-1]

    @property
    def centre_hz(self) -> float:
        """Mean frequency, weighted by the transmission."""
        frequency, weight = self.nodes
        return float(weight @ frequency)

    @property
    def width_hz(self) -> float:
        """Width of the top hat of equal area and equal largest transmission; 0 for a single frequency."""
        return float(self._cumulative[-1] / max(self.transmission))

    @cached_property
    def nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies (n,) [Hz] and weights (n,) of averages over the band; the weights sum to 1.

        Gauss-Legendre in each segment: exact to rounding for a top hat, and for functions that are smooth over a
        segment of a table.
        """
        if len(self.frequency_hz) == 1:
            return np.array(self.frequency_hz), np.ones(1)
        knots, width = np.array(self.frequency_hz), np.diff(self.frequency_hz)
        node, weight = np.polynomial.legendre.leggauss(max(_FEWEST_NODES, _MOST_NODES // len(width)))
        frequency = (knots[:-1, None] + width[:, None] * (1 + node) / 2).ravel()
        weights = (width[:, None] * weight).ravel() * np.interp(frequency, knots, self.transmission)
        return frequency, weights / weights.sum()

    def at(self, frequency_hz: np.ndarray) -> np.ndarray:
        """Transmission at frequencies within the band, over its largest value."""
        return np.interp(frequency_hz, self.frequency_hz, self.transmission) / max(self.transmission)

    @property
    def cmb_per_rj(self) -> float:
        """Thermodynamic CMB temperature per Rayleigh-Jeans temperature: 1.65 at 143 GHz.

        A Rayleigh-Jeans source puts equal power into equal frequencies: one spatial mode, whose solid angle times
        aperture is the squared wavelength, and a beam that the source fills. So this is one over the band's mean of
        ``x^2 e^x / (e^x - 1)^2`` with ``x = h nu / k T_CMB``. (The ratio of the BLIP figures that section 1.1 of the
        paper quotes in both temperatures is 1.53.)
        """
        return float(1 / self._rj_per_cmb.sum())

    @property
    def sz_k_cmb(self) -> float:
        """CMB temperature [K] of the thermal Sunyaev-Zeldovich effect per Compton parameter y: -2.84 at 143 GHz.

        The mean over the band of ``T_CMB (x coth(x / 2) - 4)``, weighted by Rayleigh-Jeans temperature per CMB
        temperature (Carlstrom et al. 2002, ARA&A 40, 643, section 2). It is not relativistic: the electrons of
        massive clusters change it by some per cent.
        """
        frequency, _ = self.nodes
        x = _X_PER_HZ * frequency
        return float(CMB_TEMPERATURE_K * self.cmb_per_rj * np.sum(self._rj_per_cmb * (x / np.tanh(x / 2) - 4)))

    def power_law(self, frequency_hz: float, index: float) -> float:
        """Mean over the band of ``(nu / frequency_hz)^index``."""
        frequency, weight = self.nodes
        return float(weight @ (frequency / frequency_hz) ** index)

    @property
    def _rj_per_cmb(self) -> np.ndarray:
        """Rayleigh-Jeans temperature per CMB temperature at the nodes, times their weights."""
        frequency, weight = self.nodes
        x = _X_PER_HZ * frequency
        return weight * np.exp(x) * (x / np.expm1(x)) ** 2

    def cell_shares(self, edge_hz: np.ndarray) -> np.ndarray:
        """Compute the shares (m,) of the band in cells between increasing edges (m + 1,) [Hz].

        They sum to 1 where the cells cover the band. A band without width is all in the cell that holds it.
        """
        edge_hz = np.asarray(edge_hz, dtype=float)
        if len(self.frequency_hz) == 1:
            shares = np.zeros(len(edge_hz) - 1)
            shares[np.clip(np.searchsorted(edge_hz, self.frequency_hz[0], "right") - 1, 0, len(shares) - 1)] = 1
            return shares
        return np.diff(self._integral(edge_hz)) / self._cumulative[-1]

    @cached_property
    def _cumulative(self) -> np.ndarray:
        """Integral (n,) of the transmission up to each knot."""
        value = np.array(self.transmission)
        return np.concatenate([[0.0], np.cumsum(np.diff(self.frequency_hz) * (value[1:] + value[:-1]) / 2)])

    def _integral(self, frequency_hz: np.ndarray) -> np.ndarray:
        """Integral of the transmission up to any frequencies; quadratic within a segment."""
        knots, value = np.array(self.frequency_hz), np.array(self.transmission)
        inside = np.clip(frequency_hz, *self.edges_hz)
        segment = np.clip(np.searchsorted(knots, inside, "right") - 1, 0, len(knots) - 2)
        rest = inside - knots[segment]
        return self._cumulative[segment] + rest * (value[segment] + np.interp(inside, knots, value)) / 2


def top_hat(frequency_hz: float, bandwidth: float) -> Passband:
    """Make a band with straight sides; `bandwidth` is its width over its centre, 0 for the centre alone."""
    if not bandwidth:
        return Passband((frequency_hz,), (1.0,))
    return Passband(tuple(frequency_hz * (1 + side * bandwidth / 2) for side in (-1, 1)), (1.0, 1.0))


def read_passband(source: Path | str) -> Passband:
    """Read a passband: an ECSV table with columns `frequency` and `transmission`, or a text, one of `named_passbands`.

    Raises
    ------
    InputError
        For an unknown name; for other columns, fewer than two rows, frequencies that do not increase, and a
        transmission that is negative or nowhere above 0. One line with the file and the row.
    """
    if isinstance(source, str):
        return _named(source)
    frequency_hz, value = read_frequency_table(KEY, source, "transmission")
    if not max(value) > 0:
        raise InputError(f"{KEY}: {source}: column 'transmission': found 0 in all rows; one above 0 is expected")
    return Passband(frequency_hz, value)


@cache
def named_passbands() -> dict[str, dict[str, Any]]:
    """Return the named passbands: edges in GHz and their source."""
    return tomllib.loads(files("surveysim.scene").joinpath("passbands.toml").read_text(encoding="utf-8"))


def _named(name: str) -> Passband:
    if name not in named_passbands():
        raise InputError(
            f"{KEY}: found {shown(name)}{did_you_mean(name, named_passbands())}; the name of an ECSV file, or one of "
            f"{', '.join(named_passbands())} is expected"
        )
    low, high = named_passbands()[name]["edges_ghz"]
    return Passband((low * 1e9, high * 1e9), (1.0, 1.0))
