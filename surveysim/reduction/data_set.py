"""Data sets that a survey makes maps of."""

from dataclasses import dataclass
from enum import StrEnum

from surveysim.reduction.cleaning_pipelines import ACTUAL, OPTIMAL, CleaningPipeline


class DataSetKind(StrEnum):
    """Kinds of data sets (section 5.2), and those that compare cleaning pipelines (section 4.3)."""

    ACTUAL = "actual"
    NOISE_ONLY = "noise-only"
    ALTERNATIVE = "alternative"
    OPTIMAL = "optimal"
    MASKED = "masked"


def scaled_name(name: str) -> str:
    """Name of the sigma(A) of a masked data set times its share of the detectors (section 5.2)."""
    return f"{name}_scaled"


@dataclass(frozen=True)
class DataSet:
    """A data set.

    Parameters
    ----------
    pipeline
        Its cleaning pipeline; None for the optimal set, which takes the best pipeline of each observation.
    n_det
        Number of its detectors.
    """

    name: str
    kind: DataSetKind
    pipeline: CleaningPipeline | None
    n_det: int

    @property
    def own_transfer_function(self) -> bool:
        """Return whether its pipeline or its detectors are not those of the actual data."""
        return self.kind is not DataSetKind.NOISE_ONLY


def data_sets(
    pipelines: tuple[CleaningPipeline, ...], noise_only: tuple[str, ...], scored: bool, n_det: int
) -> tuple[DataSet, ...]:
    """List the data sets in the order of their maps.

    Parameters
    ----------
    pipelines
        Cleaning pipelines, the scene's own first.
    noise_only
        Names of the noise-only sets.
    scored
        Whether maps are scored: several pipelines for all detectors then make an optimal set.
    n_det
        Number of detectors of the camera.
    """
    own, *others = (pipeline for pipeline in pipelines if pipeline.detectors is None)
    found = [DataSet(ACTUAL, DataSetKind.ACTUAL, own, n_det)]
    found += [DataSet(name, DataSetKind.NOISE_ONLY, own, n_det) for name in noise_only]
    found += [DataSet(other.data_set, DataSetKind.ALTERNATIVE, other, n_det) for other in others]
    if scored and others:
        found.append(DataSet(OPTIMAL, DataSetKind.OPTIMAL, None, n_det))
    masked = [pipeline for pipeline in pipelines if pipeline.detectors is not None]
    found += [DataSet(item.data_set, DataSetKind.MASKED, item, len(item.detectors)) for item in masked]
    return tuple(found)
