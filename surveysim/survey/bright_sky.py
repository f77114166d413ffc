"""Bright part of the map, which the passes of an iterative map-maker subtract from the streams before cleaning.

A template that is fitted to the detectors holds a little of every bright source, which cleaning removes. Each pass is
an ordinary run whose streams have the bright part of the last pass's map subtracted; at the end it is added to the map
of the residual (`mapmaker.iterative`).
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mapmaker.binning import BinnedMap
from mapmaker.files import atomic_write
from mapmaker.iterative import relative_change, significant
from surveysim.reduction.setup import Setup
from surveysim.scene.scene import scene_hash
from surveysim.survey.checkpoint import NAME, CheckpointError
from surveysim.survey.coadds import CoAdds, Convergence

FILE = "bright_sky.npz"
WHAT = "the bright part of the map"


@dataclass(frozen=True)
class BrightSky:
    """State of the passes before pass number `passes` + 1.

    Parameters
    ----------
    passes
        Number of finished passes.
    estimate_mk : (n_y, n_x)
        Bright part of their map, 0 elsewhere.
    bright : (n_y, n_x) bool
        Pixels that have been bright after a pass; they stay bright.
    change
        Relative change of the estimate in the last pass; infinite before the first.
    """

    passes: int
    estimate_mk: np.ndarray
    bright: np.ndarray
    change: float = np.inf


def no_bright_sky(setup: Setup) -> BrightSky:
    """State before the first pass."""
    shape = (setup.analysis.geometry.n_y, setup.analysis.geometry.n_x)
    return BrightSky(0, np.zeros(shape), np.zeros(shape, bool))


def with_estimate(setup: Setup, sky: BrightSky) -> Setup:
    """Let observations of a setup be cleaned without the bright part; the setup itself before the first pass."""
    return replace(setup, bright_sky_mk=sky.estimate_mk) if sky.passes else setup


def next_sky(setup: Setup, sky: BrightSky, coadds: CoAdds) -> BrightSky:
    """Find the bright part of the map of a pass."""
    section, geometry, weight = setup.scene.map.iteration, setup.analysis.geometry, coadds.weight[:1]
    item = BinnedMap(geometry, coadds.sums[:1] + sky.estimate_mk * weight, weight, coadds.hits[:1])
    fwhm_rad = float(setup.camera.beams.fwhm_rad.min())
    found = significant(item, fwhm_rad, section.threshold, section.loss ** (sky.passes + 1))[0]
    bright = sky.bright | found
    estimate = np.where(bright, item.signal_mk[0], 0.0)
    change = relative_change(estimate, sky.estimate_mk, weight[0])
    return BrightSky(sky.passes + 1, estimate, bright, change)


def restored(coadds: CoAdds, sky: BrightSky, after: BrightSky, tolerance: float) -> CoAdds:
    """Add the bright part that was subtracted before the last pass to the map of the actual data."""
    sums = coadds.sums.copy()
    sums[0] += sky.estimate_mk * coadds.weight[0]
    told = Convergence(WHAT, after.passes, after.change, after.change < tolerance)
    return replace(coadds, sums=sums, convergence=(told,))


def bright_sky_file(checkpoint: Path) -> Path:
    """File of the bright part beside a checkpoint."""
    return checkpoint.with_name(checkpoint.name.replace(NAME, FILE))


def save_bright_sky(path: Path, setup: Setup, sky: BrightSky) -> None:
    """Write the state of the passes atomically."""
    with atomic_write(path) as partial, open(partial, "wb") as file:
        np.savez(file, **vars(sky), scene=np.array(scene_hash(setup.scene)))


def load_bright_sky(path: Path, setup: Setup) -> BrightSky:
    """Read the state of the passes; that before the first where there is no file.

    Raises
    ------
    CheckpointError
        For a file of another scene, or of another number of observations, or that is none.
    """
    if not path.exists():
        return no_bright_sky(setup)
    empty = no_bright_sky(setup)
    try:
        with np.load(path, allow_pickle=False) as file:
            same = str(file["scene"]) == scene_hash(setup.scene)
            sky = BrightSky(int(file["passes"]), file["estimate_mk"], file["bright"], float(file["change"]))
        same &= sky.estimate_mk.shape == empty.estimate_mk.shape and bool(np.isfinite(sky.estimate_mk).all())
    except Exception:  # readers of archives raise many types of errors for other files
        same = False
    if not same:
        raise CheckpointError(
            f"{path}: not the bright sky of this scene with as many observations; start anew with --force, or write"
            " elsewhere with --out"
        )
    return sky
