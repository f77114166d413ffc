"""The analysis of a scene: map, scored region, cleaning pipelines, simulated signals and data sets."""

from dataclasses import dataclass

import numpy as np

from mapmaker.cleaning.responsivity import Responsivities
from mapmaker.geometry import MapGeometry
from surveysim.reduction.cleaning_pipelines import CleaningPipeline
from surveysim.reduction.data_set import DataSet, data_sets
from surveysim.reduction.scored_region import ScoredRegion, scored_region
from surveysim.reduction.splits import SurveySplits
from surveysim.runtime.once import once
from surveysim.scene.scene import Scene
from surveysim.telescope.beams import Beams
from surveysim.timestreams.shared_parts import signal_skies
from surveysim.timestreams.simulation import SkySetup


@dataclass(frozen=True)
class AnalysisSetup:
    """The analysis of a scene.

    Parameters
    ----------
    geometry
        Grid of the maps.
    sky
        The scene's sky, on the grid of the simulated signals.
    pipelines
        Cleaning pipelines, the scene's own first and those of the masked array last.
    calibration
        Responsivities (n_band, n_det) that cleaning takes as known, its own band first; None where it fits them.
    masked
        Indices of the detectors of the masked array; None without one.
    n_det
        Number of detectors of the camera.
    weight
        Weight (n_det,) of the samples of each detector in the maps, with a mean of 1; None where all weigh alike.
    beams
        Beams of the detectors, with their weights in the maps.
    splits
        Splits of the data into parts with maps of their own; None without any.
    """

    scene: Scene
    geometry: MapGeometry
    sky: SkySetup
    pipelines: tuple[CleaningPipeline, ...]
    calibration: np.ndarray | None
    masked: np.ndarray | None
    n_det: int
    weight: np.ndarray | None
    beams: Beams
    splits: SurveySplits | None = None

    @once
    def region(self) -> ScoredRegion | None:
        """Scored patch and multipoles; None without a score."""
        return scored_region(self.scene, self.geometry, self.sky_geometry, self.beams)

    @property
    def sums_patch(self) -> slice:
        """Rows (and columns) of the map that jackknives and signal simulations are summed over.

        The scored patch; all of a map that is solved for; none without a score.
        """
        if self.region is None:
            return slice(0, 0)
        return slice(0, self.geometry.n_y) if self.scene.map.solved else self.region.patch

    @property
    def sky_geometry(self) -> MapGeometry:
        """Grid of the simulated signals."""
        return self.sky.geometry

    @once
    def signal_skies_mk(self) -> np.ndarray | None:
        """Skies (n_sky, n_beam, n_y, n_x) of the signal simulations, and after them the scene's own if it has one.

        A point source is last with several pipelines.
        """
        own = self.sky.map_mk if self.own_sky is not None else None
        return signal_skies(self.scene, self.sky_geometry, tuple(self.beams.fwhm_rad.tolist()), own_mk=own)

    @property
    def own_sky(self) -> int | None:
        """Place of the scene's own sky among the signal simulations; None without a sky or a score."""
        scene = self.scene
        return scene.score.signal_sims.skies if scene.score is not None and scene.sky is not None else None

    def weight_of(self, rows: np.ndarray | slice) -> np.ndarray | None:
        """Weights (n,) of some detectors in a map of their own, with a mean of 1; None where all weigh alike."""
        return None if self.weight is None else self.weight[rows] / self.weight[rows].mean()

    @property
    def n_signal_skies(self) -> int:
        """Number of these skies; 0 without a score."""
        score = self.scene.score
        return score.signal_sims.skies + bool(self.scene.sky) + bool(self.scene.cleaning.compare) if score else 0

    @property
    def responsivities(self) -> Responsivities:
        """Responsivities for template cleaning of all detectors: the method to fit them, or known ones (n_det,)."""
        return self.scene.cleaning.responsivities if self.calibration is None else self.calibration[0]

    @once
    def data_sets(self) -> tuple[DataSet, ...]:
        """Data sets, in the order of their maps."""
        score = self.scene.score
        return data_sets(self.pipelines, score.noise_only_sets if score else (), score is not None, self.n_det)

    @once
    def data_set_names(self) -> tuple[str, ...]:
        """Names of the data sets, in the order of their maps."""
        return tuple(item.name for item in self.data_sets)

    @property
    def pipeline_names(self) -> tuple[str, ...]:
        """Data sets of the pipelines."""
        return tuple(pipeline.data_set for pipeline in self.pipelines)

    @property
    def whole_pipelines(self) -> tuple[CleaningPipeline, ...]:
        """Pipelines for all detectors, the scene's own first."""
        return tuple(pipeline for pipeline in self.pipelines if pipeline.detectors is None)

    @property
    def chooses(self) -> bool:
        """Return whether the best pipeline of each observation makes a data set of its own."""
        return self.scene.score is not None and len(self.whole_pipelines) > 1

    @property
    def uses_wind(self) -> bool:
        """Return whether a pipeline needs the wind."""
        return any(pipeline.uses("wind") for pipeline in self.pipelines)

    @once
    def transfer_function_names(self) -> tuple[str, ...]:
        """Names of the data sets that have a transfer function of their own; the others share the first."""
        return tuple(item.name for item in self.data_sets if item.own_transfer_function)

    def transfer_function_index(self, data_set: str) -> int:
        """Place of the transfer function of a data set among `transfer_function_names`."""
        names = self.transfer_function_names
        return names.index(data_set) if data_set in names else 0
