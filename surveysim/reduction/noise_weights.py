"""Noise weights of solved maps: measured on the cleaned streams of each block, kept in one file an observation.

The second stage of a run (`surveysim.survey.solution`) points each observation again and reads its weights. A file has
the kept scans, the detectors, the lost samples and the arrays of N^-1 of each block, for the whole and a masked array.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mapmaker.destriping import BaselineWeight
from mapmaker.files import atomic_write
from mapmaker.geometry import boresight_pixels
from mapmaker.gls import GlsOptions, NoiseModel, ScanNoise, measure_scan_noise
from mapmaker.normal_equations import NoiseWeight, NormalBlock
from surveysim.reduction.cleaning_pipelines import ACTUAL, CleaningPipeline
from surveysim.reduction.setup import Setup
from surveysim.scene.map_section import MapSection
from surveysim.scene.scene import survey_hash
from surveysim.timestreams.scan_blocks import Block
from surveysim.timestreams.simulation import observation_path


@dataclass(frozen=True)
class BlockWeights:
    """Noise weights of a data set in one block of an observation.

    Attributes
    ----------
    data_set
        That of a cleaning pipeline.
    block
        Number of the block.
    rows : (n,)
        Its detectors.
    bounds : (n_kept, 2)
        Kept scans [start, stop), from the start of the block.
    lost : (n, n_samp) bool
        Lost samples; None without any.
    noise
    """

    data_set: str
    block: int
    rows: np.ndarray
    bounds: np.ndarray
    lost: np.ndarray | None
    noise: NoiseWeight


def measured_weight(setup: Setup, rows: np.ndarray | slice, data_mk: np.ndarray, bounds: np.ndarray) -> NoiseWeight:
    """Noise weight of the cleaned streams (n, n_samp) of the detectors `rows` in their kept scans (n_kept, 2)."""
    section, rate = setup.scene.map, setup.observing.scans.sample_rate_hz
    if section.maker == "destriped":
        weight = setup.analysis.weight_of(rows)
        return BaselineWeight(np.ones(len(data_mk)) if weight is None else weight, baseline_samples(setup))
    plane = setup.camera.focal_plane.subset(rows)
    return measure_scan_noise(data_mk, bounds, plane, rate, noise_options(section))


def baseline_samples(setup: Setup) -> int:
    """Samples of a baseline of a destriped map."""
    return max(2, round(setup.scene.map.destriped.baseline_s * setup.observing.scans.sample_rate_hz))


def block_weights(
    block: Block, pipeline: CleaningPipeline, normal: NormalBlock, flags: np.ndarray | None
) -> BlockWeights:
    """Weights of a block in the map of a pipeline, with the flags (n_det, n_samp) of all detectors."""
    rows = pipeline.rows
    lost = None if flags is None else flags[rows]
    numbers = np.arange(len(normal.index)) if isinstance(rows, slice) else rows
    return BlockWeights(pipeline.data_set, block.number, numbers, normal.scan_bounds, lost, normal.noise)


def noise_options(section: MapSection) -> GlsOptions:
    """Options of the noise model of a scene."""
    of = section.likelihood
    return GlsOptions((0.0, *of.band_edges_hz, np.inf), of.max_modes, of.eigenvalue_cut)


def weights_file(directory: Path, observation: int) -> Path:
    """Return the path of the file of an observation."""
    return directory / f"{observation:04d}.npz"


def save_weights(path: Path, setup: Setup, observation: int, blocks: Sequence[BlockWeights]) -> None:
    """Write the weights of an observation atomically."""
    content: dict[str, Any] = {
        "survey": np.array(survey_hash(setup.scene)),
        "observation": np.array(observation),
    }
    for item in blocks:
        arrays = {"rows": item.rows, "bounds": item.bounds, **_arrays(item.noise)}
        if item.lost is not None:
            arrays["lost"] = np.packbits(item.lost, axis=1)
        content |= {f"{item.data_set}/{item.block}/{name}": array for name, array in arrays.items()}
    with atomic_write(path) as partial, open(partial, "wb") as file:
        np.savez(file, **content)


def is_weights_file(path: Path, setup: Setup, observation: int) -> bool:
    """Return whether a file has the weights of an observation of this survey."""
    if not path.is_file():  # a pipe never ends
        return False
    try:
        with np.load(path, allow_pickle=False) as file:
            return file["survey"] == survey_hash(setup.scene) and file["observation"] == observation
    except Exception:  # readers of archives raise many types of errors for other files
        return False


def normal_blocks(setup: Setup, observation: int, path: Path, data_set: str = ACTUAL) -> Iterator[NormalBlock]:
    """Point an observation again, and yield its blocks with the weights of a data set in a file."""
    _, whole = observation_path(setup.observing, observation)
    plane, geometry = setup.camera.focal_plane, setup.analysis.geometry
    with np.load(path, allow_pickle=False) as file:
        for block in setup.observing.blocks:
            prefix = f"{data_set}/{block.number}/"
            arrays = {name.removeprefix(prefix): file[name] for name in file.files if name.startswith(prefix)}
            if not arrays:
                continue
            of, some = whole.scans(block.first, block.end), plane.subset(arrays["rows"])
            index = boresight_pixels(geometry, of.xi_rad, of.eta_rad, of.array_angle_rad, plane=some)
            if "lost" in arrays:
                index[np.unpackbits(arrays["lost"], axis=1, count=index.shape[1]).astype(bool)] = -1
            yield NormalBlock(index, arrays["bounds"], _noise(setup, arrays))


def _arrays(noise: Any) -> dict[str, np.ndarray]:
    """Arrays of N^-1, in single precision."""
    if isinstance(noise, BaselineWeight):
        return {"weight": noise.weight.astype(np.float32), "length": np.array(noise.length)}
    arrays = {}
    for k, model in enumerate(noise.models):
        arrays[f"white_{k}"] = model.white_mk2.astype(np.float32)
        arrays |= {f"modes_{k}_{b}": item.astype(np.float32) for b, item in enumerate(model.modes_mk)}
    return arrays


def _noise(setup: Setup, arrays: Mapping[str, np.ndarray]) -> NoiseWeight:
    if "length" in arrays:
        return BaselineWeight(arrays["weight"], int(arrays["length"]))
    n_model = sum(name.startswith("white_") for name in arrays)
    return ScanNoise(tuple(_noise_model(setup, arrays, k) for k in range(n_model)))


def _noise_model(setup: Setup, arrays: Mapping[str, np.ndarray], number: int) -> NoiseModel:
    white = arrays[f"white_{number}"].astype(float)
    modes = tuple(arrays[f"modes_{number}_{b}"].astype(float) for b in range(len(white)))
    edges, rate = noise_options(setup.scene.map).band_edges_hz, setup.observing.scans.sample_rate_hz
    return NoiseModel(edges, white, modes, rate)
