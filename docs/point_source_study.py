"""Fluxes of simulated sources through a cleaned survey: `python docs/point_source_study.py` writes the table of the page.

Surveys of first light's field, each with its own noise, weather and scans, and with sources at random places. A matched
filter measures each source, with a noise PSD and a transfer function from other surveys without sources.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import mapmaker as mm
from mapmaker.binning import weighted_mean
from mapmaker.geometry import plane_directions
from mapmaker.matched_filter import MatchedFilter
from mapmaker.spectrum import mode_ell
from surveysim.api import run
from surveysim.reduction.setup import Setup
from surveysim.runtime.engine import SERIAL
from surveysim.scene.noise_and_sky import Sky
from surveysim.scene.scene import Scene, load_scene
from surveysim.survey.coadds import CoAdds

HERE = Path(__file__).parent
SCENE, PAGE = HERE.parent / "scenarios" / "first_light.toml", HERE / "validation" / "calculators.md"
BEGIN, END = "<!-- table of docs/point_source_study.py -->\n", "<!-- end of the sources -->\n"
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
CALIBRATION, SKIES = 12, 200
SOURCES, PEAK_MK = 6, 10.0
REACH, APART = 13.0, 5.0  # arcmin from the centre along each axis, and between sources
CLEANINGS = ("average", "planar", "quadratic", "pca")
ARCMIN = np.radians(1 / 60)


@dataclass(frozen=True)
class Measurement:
    """Measured amplitudes of sources over the true one, and their stated scatter."""

    amplitude: np.ndarray
    scatter: np.ndarray

    @property
    def bias(self) -> tuple[float, float]:
        """Mean relative error, weighted by the stated scatter, and its own error."""
        weight = 1 / self.scatter**2
        return float(np.average(self.amplitude, weights=weight) - 1), float(weight.sum() ** -0.5)

    @property
    def chi2(self) -> float:
        """Mean square of the errors in units of the stated scatter."""
        return float(np.mean(((self.amplitude - 1) / self.scatter) ** 2))


def scene_of(cleaning: str, seed: int) -> Scene:
    """Scene of one survey without sources."""
    extra = {"cleaning.sigma_cut": 3.0} if cleaning == "pca" else {}
    return load_scene(SCENE, KEYS | extra | {"cleaning.algorithm": cleaning, "seed": seed})


def calibrated(cleaning: str, seeds: range) -> MatchedFilter:
    """Matched filter from sign-flipped co-adds and signal simulations of surveys without sources."""
    noise, cleaned, reference = [], [], []
    for seed in seeds:
        result = run(scene_of(cleaning, seed), engine=SERIAL)
        setup, coadds = result.setup, result.coadds
        region, root = setup.analysis.region, np.sqrt(relative_weight(setup, coadds))
        of_map = region.padded_taper, setup.analysis.geometry.pixel_rad, region.rings
        flips = weighted_mean(coadds.flipped[:, 0], patch_weight(setup, coadds))
        noise.append(mm.map_psd(region.pad(flips * root), *of_map).mean(axis=0))
        skies = weighted_mean(coadds.signal_maps[:, 0], coadds.signal_weight[0])
        reference += list(region.pad(skies[:, 0]))
        cleaned += list(region.pad(skies[:, 1]))
    transfer = mm.measure_amplitude_transfer(
        np.array(cleaned), np.array(reference), taper=of_map[0], pixel_rad=of_map[1], rings=of_map[2]
    )
    return mm.source_filter(
        profile(setup),
        np.mean(noise, axis=0),
        transfer=transfer.transmission,
        mask=region.selected,
        rings=region.rings,
        pixel_rad=of_map[1],
    )


def profile(setup: Setup) -> np.ndarray:
    """Transform of a source of 1 mK in beam and pixels, on the grid of the rings."""
    n, pixel = len(setup.analysis.region.padded_taper), setup.analysis.geometry.pixel_rad
    source = mm.gaussian_profile(mode_ell(n, n, pixel), setup.camera.focal_plane.fwhm_rad)
    return source * np.sqrt(mm.mode_pixel_window(n, n, pixel, pixel))


def patch_weight(setup: Setup, coadds: CoAdds) -> np.ndarray:
    """Weight of the first data set on the scored patch."""
    patch = setup.analysis.region.patch
    return coadds.weight[0][patch, patch]


def relative_weight(setup: Setup, coadds: CoAdds) -> np.ndarray:
    """The same over its mean under the squared taper."""
    weight, taper = patch_weight(setup, coadds), setup.analysis.region.taper
    return weight / np.average(weight, weights=taper**2)


def places(rng: np.random.Generator) -> np.ndarray:
    """Offsets (n_source, 2) [rad] east and north of sources apart from each other."""
    found: list[np.ndarray] = []
    while len(found) < SOURCES:
        place = rng.uniform(-REACH, REACH, 2)
        if all(np.hypot(*(place - other)) > APART for other in found):
            found.append(place)
    return np.array(found) * ARCMIN


def measured(cleaning: str, item: MatchedFilter, seeds: range) -> Measurement:
    """Measure sources of all surveys of some seeds."""
    parts = [_one(cleaning, item, seed) for seed in seeds]
    return Measurement(*(np.concatenate([getattr(part, name) for part in parts]) for name in ("amplitude", "scatter")))


def _one(cleaning: str, item: MatchedFilter, seed: int) -> Measurement:
    scene = scene_of(cleaning, seed)
    offsets = places(np.random.default_rng(seed))
    geometry = mm.MapGeometry(scene.field.ra_rad, scene.field.dec_rad, ARCMIN, 1, 1)
    directions = zip(*plane_directions(geometry, *offsets.T), strict=True)
    sources = [{"ra": f"{ra:.12f} rad", "dec": f"{dec:.12f} rad", "peak": f"{PEAK_MK} mK"} for ra, dec in directions]
    sky = Sky.model_validate({"cmb_band_power": "0 uK2", "point_sources": sources})
    result = run(scene.model_copy(update={"sky": sky}), engine=SERIAL)
    setup, coadds = result.setup, result.coadds
    patch, pixel = setup.analysis.region.patch, setup.analysis.geometry.pixel_rad
    image = weighted_mean(coadds.sums[0], coadds.weight[0])[patch, patch]
    centre = len(image) / 2 - 0.5
    found = mm.source_amplitudes(
        item,
        image,
        relative_weight(setup, coadds),
        row=centre + offsets[:, 1] / pixel,
        column=centre - offsets[:, 0] / pixel,
    )
    return Measurement(found.amplitude / PEAK_MK, found.scatter / PEAK_MK)


if __name__ == "__main__":
    import time
    for cleaning in sys.argv[2:] or CLEANINGS:
        t=time.process_time()
        item = calibrated(cleaning, range(1000, 1000 + CALIBRATION))
        m = measured(cleaning, item, range(int(sys.argv[1])))
        print(cleaning, item.sigma, m.bias, m.chi2, 1/np.mean(m.scatter), np.percentile(m.scatter,[0,50,100]), time.process_time()-t, flush=True)
