"""Fluxes of simulated sources through a cleaned survey: `python docs/point_source_study.py` writes the page's table.

Each of 200 surveys of first light's field has its own noise, scans and camera angles, and sources at random places.
A matched filter measures the sources. Its noise PSD and transfer functions come from other surveys.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import mapmaker as mm
from mapmaker.binning import weighted_mean
from mapmaker.geometry import plane_directions
from mapmaker.matched_filter import MatchedFilter
from surveysim.metrics.map_noise import noise_of_score
from surveysim.metrics.point_source import quantities
from surveysim.reduction.setup import Setup, prepare
from surveysim.scene.metrics import PointSourceDepth
from surveysim.scene.scene import Scene, load_scene
from surveysim.scene.sky import Sky
from surveysim.survey.coadds import CoAdds
from surveysim.survey.run import run_observations
from surveysim.survey.scores import score_survey

HERE = Path(__file__).parent
SCENE, PAGE = HERE.parent / "scenarios" / "first_light.toml", HERE / "validation" / "sources.md"
BEGIN, END = "<!-- table of docs/point_source_study.py -->\n", "<!-- end of the table -->\n"
KEYS: dict[str, Any] = {
    "observations": 4,
    "instrument.layout.rings": 3,
    "instrument.layout.dead": [5],
    "atmosphere.b2_probabilities": [0.5],
    "atmosphere.b2": "[280] mK2 rad(-5/3)",
    "score.size": "36 arcmin",
    "score.ell_min": 1000,
    "score.jackknives": 8,
    "score.noise_only_sets": [],
    "score.signal_sims.skies": 4,
    "score.signal_sims.observations": 4,
}
CLEANINGS = {
    "average": {},
    "planar": {},
    "quadratic": {},
    "pca": {"cleaning.sigma_cut": 2.5, "score.mask_separation_f_lambda": 0.8},
}
SKIES, CALIBRATION = range(200), range(1000, 1016)  # seeds
SOURCES, PEAK_MK = 6, 10.0
REACH, APART = 13.0, 5.0  # arcmin: from the centre along each axis, and between sources
ARCMIN = np.radians(1 / 60)


@dataclass(frozen=True)
class Measurement:
    """Measured amplitudes of sources over the true one, and their stated scatter, (n,) each."""

    amplitude: np.ndarray
    scatter: np.ndarray

    @property
    def bias(self) -> float:
        """Mean relative error, weighted by the stated scatter."""
        return float(np.average(self.amplitude, weights=1 / self.scatter**2)) - 1

    @property
    def bias_error(self) -> float:
        """Standard error of the bias."""
        return float(np.sum(1 / self.scatter**2) ** -0.5)

    @property
    def chi2(self) -> float:
        """Mean square of the errors in units of the stated scatter."""
        return float(np.mean(((self.amplitude - 1) / self.scatter) ** 2))


@dataclass(frozen=True)
class Survey:
    """Map of a survey on the scored patch, its relative weight, and the places of its sources."""

    setup: Setup
    coadds: CoAdds
    offsets: np.ndarray  # (n_source, 2) [rad] east and north

    @property
    def weight(self) -> np.ndarray:
        """Weight of each pixel over the mean under the squared taper."""
        region = self.setup.analysis.region
        weight = self.coadds.weight[0][region.patch, region.patch]
        return weight / np.average(weight, weights=region.taper**2)

    @property
    def image(self) -> np.ndarray:
        """Co-added map of the patch."""
        patch = self.setup.analysis.region.patch
        return weighted_mean(self.coadds.sums[0], self.coadds.weight[0])[patch, patch]

    @property
    def noise_psd(self) -> np.ndarray:
        """Mean PSD of the sign-flipped co-adds at weight 1."""
        region = self.setup.analysis.region
        weight = self.coadds.weight[0][region.patch, region.patch]
        return self.psd(weighted_mean(self.coadds.flipped[:, 0], weight) * np.sqrt(self.weight)).mean(axis=0)

    def psd(self, images: np.ndarray) -> np.ndarray:
        """PSDs of maps of the patch."""
        region = self.setup.analysis.region
        return mm.map_psd(region.pad(images), region.padded_taper, self.setup.analysis.geometry.pixel_rad, region.rings)

    @property
    def places(self) -> dict[str, np.ndarray]:
        """Rows and columns of the sources in the patch."""
        centre, pixel = len(self.weight) / 2 - 0.5, self.setup.analysis.geometry.pixel_rad
        return {"row": centre + self.offsets[:, 1] / pixel, "column": centre - self.offsets[:, 0] / pixel}


def survey(cleaning: str, seed: int, *, sources: bool = True) -> Survey:
    """Simulate the survey of a seed, with or without its sources."""
    keys = KEYS | CLEANINGS[cleaning] | {"cleaning.algorithm": cleaning, "seed": seed}
    scene, offsets = load_scene(SCENE, keys), draw_places(np.random.default_rng(seed))
    if sources:
        scene = scene.model_copy(update={"sky": sky_of(scene, offsets)})
    setup = prepare(scene)
    return Survey(setup, run_observations(setup, None), offsets)


def draw_places(rng: np.random.Generator) -> np.ndarray:
    """Draw places (n_source, 2) [rad] of sources apart from each other."""
    found: list[np.ndarray] = []
    while len(found) < SOURCES:
        place = rng.uniform(-REACH, REACH, 2)
        if all(np.hypot(*(place - other)) > APART for other in found):
            found.append(place)
    return np.array(found) * ARCMIN


def sky_of(scene: Scene, offsets: np.ndarray) -> Sky:
    """Sky of sources alone."""
    geometry = mm.MapGeometry(scene.field.ra_rad, scene.field.dec_rad, ARCMIN, 1, 1)
    sources = [
        {"ra": f"{ra:.12f} rad", "dec": f"{dec:.12f} rad", "peak": f"{PEAK_MK} mK"}
        for ra, dec in zip(*plane_directions(geometry, *offsets.T), strict=True)
    ]
    return Sky.model_validate({"cmb_band_power": "0 uK2", "point_sources": sources})


def profile(setup: Setup) -> np.ndarray:
    """Transform of a source of 1 mK in beam and pixels, on the grid of the rings."""
    n, pixel = len(setup.analysis.region.padded_taper), setup.analysis.geometry.pixel_rad
    source = mm.gaussian_profile(mm.mode_ell(n, n, pixel), setup.camera.focal_plane.fwhm_rad)
    return source * np.sqrt(mm.mode_pixel_window(n, n, pixel, pixel))


def uncleaned(item: Survey) -> np.ndarray:
    """Map (n, n) of the sources in beam and pixels, without scans and cleaning."""
    source, pixel = profile(item.setup), item.setup.analysis.geometry.pixel_rad
    n = len(source)
    up = np.exp(-2j * np.pi * np.outer(np.fft.fftfreq(n), item.places["row"]))
    along = np.exp(-2j * np.pi * np.outer(item.places["column"], np.fft.rfftfreq(n)))
    return np.fft.irfft2(source * (up @ along), (n, n)) * PEAK_MK / pixel**2


@dataclass(frozen=True)
class Calibration:
    """Matched filters of surveys, by what they know of the signal that cleaning leaves, and their blank maps.

    "all": nothing is lost. "power": the root of the transfer function of power, from CMB skies. "amplitude": the
    amplitude of simulated sources, from surveys with and without them.
    """

    filters: dict[str, MatchedFilter]
    blank: list[Survey]

    @property
    def metric(self) -> float:
        """Mean depth [mK] of the metric `point_source` of the blank surveys."""
        options, depths = PointSourceDepth(kind="point_source"), []
        for one in self.blank:
            _, noise = noise_of_score(one.setup, score_survey(one.setup, one.coadds)["actual"])
            depths.append(next(item.value for item in quantities(noise, options) if item.name == "depth_mk"))
        return float(np.mean(depths))

    @property
    def chi2(self) -> float:
        """Mean square of amplitudes over stated scatter in the blank maps, where sources are drawn."""
        found = [mm.filtered_map(self.filters["amplitude"], item.image, item.weight) for item in self.blank]
        reach = int(REACH * ARCMIN / self.blank[0].setup.analysis.geometry.pixel_rad)
        middle = slice(len(found[0].amplitude) // 2 - reach, len(found[0].amplitude) // 2 + reach)
        return float(np.mean([((one.amplitude / one.scatter)[middle, middle] ** 2).mean() for one in found]))


def calibration(cleaning: str, seeds: Iterable[int]) -> Calibration:
    """Make matched filters from simulated surveys."""
    blank, left, whole = [], [], []
    for seed in seeds:
        item, empty = survey(cleaning, seed), survey(cleaning, seed, sources=False)
        blank.append(empty)
        left.append(item.setup.analysis.region.pad(item.image - empty.image))
        whole.append(uncleaned(item))
    region, pixel = item.setup.analysis.region, item.setup.analysis.geometry.pixel_rad
    skies = [one.psd(weighted_mean(one.coadds.signal_maps[:, 0], one.coadds.signal_weight[0])) for one in blank]
    reference, cleaned = np.concatenate(skies).transpose(1, 0, 2)
    power = mm.measure_transfer_function(cleaned, reference, region.rings.ell)
    amplitude = mm.measure_amplitude_transfer(
        np.array(left), np.array(whole), taper=region.padded_taper, pixel_rad=pixel, rings=region.rings
    )
    transfers = {
        "all": np.ones(len(region.rings.ell)),
        "power": np.sqrt(power.transmission),
        "amplitude": amplitude.transmission,
    }
    given = {"mask": region.selected, "rings": region.rings, "pixel_rad": pixel}
    noise_psd = np.mean([one.noise_psd for one in blank], axis=0)
    filters = {
        name: mm.source_filter(profile(item.setup), noise_psd, transfer=transfer, **given)
        for name, transfer in transfers.items()
    }
    return Calibration(filters, blank)


def measured(cleaning: str, items: dict[str, MatchedFilter], seeds: Iterable[int]) -> dict[str, Measurement]:
    """Measure the sources of surveys of some seeds with each filter."""
    parts: dict[str, list[Measurement]] = {name: [] for name in items}
    for seed in seeds:
        found = survey(cleaning, seed)
        for name, item in items.items():
            one = mm.source_amplitudes(item, found.image, found.weight, **found.places)
            parts[name].append(Measurement(one.amplitude / PEAK_MK, one.scatter / PEAK_MK))
    return {
        name: Measurement(*(np.concatenate([vars(one)[key] for one in of]) for key in ("amplitude", "scatter")))
        for name, of in parts.items()
    }


def row(cleaning: str) -> str:
    """Row of the table for one cleaning."""
    known = calibration(cleaning, CALIBRATION)
    found = measured(cleaning, known.filters, SKIES)
    amplitude = found["amplitude"]
    cells = [
        f"`{cleaning}`",
        f"{1e3 * known.metric:.0f}",
        *(f"{1e3 * known.filters[name].sigma:.0f}" for name in ("power", "amplitude")),
        f"{100 * found['all'].bias:+.1f}",
        *(f"{100 * found[name].bias:+.2f}" for name in ("power", "amplitude")),
        f"{100 * amplitude.bias_error:.2f}",
        f"{amplitude.chi2:.3f}",
        f"{known.chi2:.3f}",
    ]
    return "| " + " | ".join(cells) + " |\n"


def table() -> str:
    """Markdown: depths, biases and chi^2 of each cleaning."""
    titles = "cleaning", "metric [uK]", "depth [uK], sqrt(T)", "depth [uK], a", "bias [%], without"
    titles += "bias [%], sqrt(T)", "bias [%], a", "error [%]", "chi^2", "chi^2, blank"
    head = f"| {' | '.join(titles)} |\n|---|{'---:|' * (len(titles) - 1)}\n"
    return head + "".join(map(row, CLEANINGS))


if __name__ == "__main__":
    today = table()
    before, rest = PAGE.read_text(encoding="utf-8").split(BEGIN)
    PAGE.write_text(f"{before}{BEGIN}\n{today}\n{END}{rest.split(END)[1]}", encoding="utf-8")
