"""A turbulent slab beside thin layers: `python docs/layers_study.py` writes the table of the page on layers.

The slab has the three-dimensional Kolmogorov spectrum Phi = kappa^(-11/3), kappa in cycles per metre, between two
heights. A detector integrates it along its line of sight, over the cylinder of the aperture; the wind carries all of
it. Its structure function is a quadrature over the transverse wavenumber k and both heights,

    D = 2 pi int k dk beam(k)^2 int int dz dz' F(k, z' - z) [J0(11) + J0(22) - J0(12) - J0(21)],

with F the transform of Phi along the line of sight (a Matern function) and J0(ij) that of 2 pi k times the distance
between beam i at z and beam j at z'. Thin layers are at the nodes of the Gauss-Legendre quadrature over height.
"""

from dataclasses import dataclass
from math import gamma, inf, pi, radians
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.special import j0, kv

from mapmaker.cleaning.templates import AVERAGE, PLANAR, QUADRATIC, template_basis
from mapmaker.timestreams import FocalPlane
from surveysim.atmosphere.layers import layer_sections
from surveysim.atmosphere.thin_screen import Screen, beam_transfer, structure_function
from surveysim.scene.scene import load_scene

HERE = Path(__file__).parent
SCENE, PAGE = HERE.parent / "scenarios" / "first_light.toml", HERE / "validation" / "layers.md"
BEGIN, END = "<!-- tables of docs/layers_study.py -->\n", "<!-- end of the tables -->\n"
INDEX, APERTURE_M = 11 / 3, 8.0
BOTTOM_M, MIDDLE_M, TOP_M = 750.0, 1000.0, 1250.0  # about the paper's height
OUTER_SCALE_M = 3 * (TOP_M - BOTTOM_M)  # calibrated (against the slab, by the first row of the table)
WIND_M_S = 9.0  # paper, section 3.1: 31 arcmin/s at 1000 m
ARCMIN = radians(1 / 60)
SCAN_RAD_S, FIELD_RAD = 4 * ARCMIN, 8 * ARCMIN  # of Bolocam
LAYERS = (1, 2, 3, 4)
MANY = 20  # layers that stand for the profile
ROWS = (
    "structure function, 0.67 to 8 arcmin",
    "variance over 8 arcmin, average removed",
    "variance, plane removed",
    "variance, quadratic removed",
    "detectors 8 arcmin apart, when the wind at 1000 m has moved by as much",
    "a detector against itself after 0.1 to 3 s, across the wind",
    "the same after 10 to 15 s",
)


@dataclass(frozen=True)
class Slab:
    """Turbulence between two heights [m], per unit of Phi."""

    bottom_m: float = BOTTOM_M
    top_m: float = TOP_M

    def structure(self, x_rad: float, y_rad: float, shift_m: float = 0.0) -> float:
        """Structure function of two beams apart by (x, y), the second after the wind has moved by `shift_m` in x."""
        k, of_k = _panels(np.geomspace(1e-6, 12 / APERTURE_M, 41), 5)
        apart, of_apart = _panels(np.append(0.0, np.geomspace(0.05, self.top_m - self.bottom_m, 25)), 4)
        node, weight = np.polynomial.legendre.leggauss(10)
        half = (self.top_m - self.bottom_m - apart) / 2
        middle = (self.bottom_m + self.top_m) / 2 + np.multiply.outer(node, half)
        across = np.hypot(x_rad, y_rad) * apart
        total = np.zeros(len(k))
        for z, share in zip(middle, weight, strict=True):
            heights = z + apart / 2, z - apart / 2
            cross = [np.hypot(x_rad * height - shift_m, y_rad * height) for height in heights]
            bracket = 1 + j0(2 * pi * np.outer(k, across)) - sum(j0(2 * pi * np.outer(k, item)) for item in cross)
            # Both orders of z and z'.
            total += 2 * (_along(k, apart) * bracket) @ (of_apart * share * half)
        return float(2 * pi * np.sum(of_k * k * beam_transfer(k * APERTURE_M) ** 2 * total))


def _along(k: np.ndarray, apart_m: np.ndarray) -> np.ndarray:
    """Transform of (k^2 + kz^2)^(-11/6) in kz, (n_k, n_apart)."""
    argument = 2 * pi * np.outer(k, apart_m)
    constant = 2 * pi ** (11 / 6) / gamma(11 / 6)
    return constant * (apart_m / k[:, None]) ** (4 / 3) * kv(4 / 3, np.minimum(argument, 600))


def _panels(edges: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
    node, weight = np.polynomial.legendre.leggauss(order)
    half = np.diff(edges) / 2
    return (edges[:-1, None] + half[:, None] * (1 + node)).ravel(), np.outer(half, weight).ravel()


@dataclass(frozen=True)
class ThinLayers:
    """Thin layers at some heights [m], with their B2."""

    height_m: tuple[float, ...]
    b2: tuple[float, ...]
    outer_scale_m: float = inf

    def structure(self, x_rad: float, y_rad: float, shift_m: float = 0.0) -> float:
        """As `Slab.structure`."""
        return sum(
            b2 * float(structure_function(self._screen(height), np.hypot(x_rad - shift_m / height, y_rad)))
            for height, b2 in zip(self.height_m, self.b2, strict=True)
        )

    def _screen(self, height_m: float) -> Screen:
        return Screen(INDEX, APERTURE_M / height_m, self.outer_scale_m / height_m)


def slab_layers(slab: Slab, number: int, outer_scale_m: float = inf) -> ThinLayers:
    """Place layers at the nodes of a quadrature over a slab: B2 is h^(b - 2) dh."""
    height, thickness = _panels(np.array([slab.bottom_m, slab.top_m]), number)
    return ThinLayers(tuple(height.tolist()), tuple((thickness * height ** (INDEX - 2)).tolist()), outer_scale_m)


def profile_layers(number: int) -> ThinLayers:
    """Layers of an exponential profile of the water vapour with a scale height of 2 km, as a scene makes them."""
    keys = {"profile": "exponential", "profile_layers": number, "water_scale_height": "2 km"}
    scene = load_scene(SCENE, {f"atmosphere.{key}": value for key, value in keys.items()})
    layers = layer_sections(scene.atmosphere)
    return ThinLayers(tuple(item.height_m for item in layers), tuple(item.share for item in layers))


# ---------------------------------------------------------------- measures


def measures(air: Slab | ThinLayers) -> tuple[np.ndarray, ...]:
    """Measures of the air, one for each of `ROWS`."""
    return (
        np.array([air.structure(apart, 0.0) for apart in FIELD_RAD * np.array([1 / 12, 0.25, 0.5, 1])]),
        *left_by_cleaning(air),
        np.array([air.structure(FIELD_RAD, 0.0, FIELD_RAD * MIDDLE_M)]),
        np.array([air.structure(0.0, SCAN_RAD_S * time, WIND_M_S * time) for time in (0.1, 0.3, 1, 3)]),
        np.array([air.structure(0.0, SCAN_RAD_S * time, WIND_M_S * time) for time in (10, 15)]),
    )


def left_by_cleaning(air: Slab | ThinLayers) -> list[np.ndarray]:
    """Variance that templates leave in a field of 8 arcmin at one time: average, plane and quadratic."""
    grid = np.linspace(-0.5, 0.5, 11) * FIELD_RAD
    x, y = (axis.ravel() for axis in np.meshgrid(grid, grid))
    inside = np.hypot(x, y) < 0.505 * FIELD_RAD
    plane = FocalPlane(x[inside], y[inside], ARCMIN)
    node = np.linspace(0, 1.02 * FIELD_RAD, 24)
    apart = np.hypot(*(np.subtract.outer(axis, axis) for axis in (plane.x_rad, plane.y_rad)))
    between = CubicSpline(node, [air.structure(item, 0.0) if item else 0.0 for item in node])(apart)
    left = []
    for terms in (AVERAGE, PLANAR, QUADRATIC):
        basis = template_basis(plane, terms)
        keep = np.eye(len(apart)) - basis.T @ basis
        left.append(-0.5 * np.trace(keep @ between @ keep) / len(apart))
    return [np.array([item]) for item in left]


def departures(air: ThinLayers, true: tuple[np.ndarray, ...]) -> list[float]:
    """Relative errors of measures, the largest of each row."""
    ratios = [found / exact - 1 for found, exact in zip(measures(air), true, strict=True)]
    return [float(row[np.argmax(np.abs(row))]) for row in ratios]


def tables() -> str:
    """Both tables of the page."""
    slab = Slab()
    columns = {f"{number}": slab_layers(slab, number) for number in LAYERS}
    columns |= {f"{number}, outer scale": slab_layers(slab, number, OUTER_SCALE_M) for number in (1, 2, 3)}
    profile = {f"{number}": profile_layers(number) for number in (1, 2, 3, 4, 6, 8)}
    return f"{_table(columns, measures(slab))}\n\n{_table(profile, measures(profile_layers(MANY)))}\n"


def _table(columns: dict[str, ThinLayers], true: tuple[np.ndarray, ...]) -> str:
    found = [departures(air, true) for air in columns.values()]
    lines = [f"| layers | {' | '.join(columns)} |", f"|---|{'---:|' * len(columns)}"]
    for name, row in zip(ROWS, zip(*found, strict=True), strict=True):
        lines.append(f"| {name} | {' | '.join(f'{100 * value:+.1f} %' for value in row)} |")
    return "\n".join(lines)


def with_tables(text: str) -> str:
    """Put the tables of today into the page."""
    before, rest = text.split(BEGIN)
    return f"{before}{BEGIN}\n{tables()}\n{END}{rest.split(END)[1]}"


if __name__ == "__main__":
    PAGE.write_text(with_tables(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
