"""Maps of the parts of one observation: senses of its scans, halves of the array."""

from typing import Any

import numpy as np

from mapmaker.kernels.pixels import bin_samples
from surveysim.reduction.analysis import AnalysisSetup
from surveysim.reduction.cleaned_block import CleanedBlock
from surveysim.reduction.detector_weights import weighted


def empty_split_maps(analysis: AnalysisSetup) -> np.ndarray | None:
    """Make empty flat maps (n_part, 2, n_pixel) of sums and exposures; None without splits within observations."""
    if analysis.splits is None or not analysis.splits.within:
        return None
    n_part = sum(len(split.parts) for split in analysis.splits.within)
    return np.zeros((n_part, 2, analysis.geometry.n_y * analysis.geometry.n_x))


def add_split_maps(split_maps: np.ndarray, part: CleanedBlock) -> None:
    """Add the cleaned actual data of a block to the maps of each part, in place."""
    analysis, pipeline, cleaned = part.setup.analysis, part.pipelines[0], part.cleaned[0]
    rows = np.arange(analysis.n_det)[pipeline.rows]
    weight, bounds = analysis.weight_of(pipeline.rows), part.streams.scan_bounds
    places: dict[str, Any] = {"first_scan": part.block.first, "n_scans": part.block.n_scans, "rows": rows}
    selected = [item for split in analysis.splits.within for item in analysis.splits.parts_of(split, **places)]
    for maps, (some, scans) in zip(split_maps, selected, strict=True):
        data, index, kept = cleaned.data_mk[some], part.index[0][some], cleaned.kept & scans
        some_weight = None if weight is None else weight[some]
        for flat_map, values in zip(maps, (data, np.ones_like(data)), strict=True):
            bin_samples(weighted(values, some_weight), index, bounds, kept, flat_map, None)


def scored_split_maps(analysis: AnalysisSetup, dtype: np.dtype, split_maps: np.ndarray | None) -> dict[str, np.ndarray]:
    """Cut split maps to the scored patch, by the names of `ObservationResult`."""
    if split_maps is None:
        return {}
    patch = analysis.region.patch
    maps = split_maps.reshape(*split_maps.shape[:2], analysis.geometry.n_y, analysis.geometry.n_x)
    return {"split_sums": maps[:, 0, patch, patch].astype(dtype), "split_exposure": maps[:, 1, patch, patch].copy()}
