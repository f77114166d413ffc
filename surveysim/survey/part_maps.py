"""Maps of the parts of a split, with realizations of their noise from random signs of the observations."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mapmaker.binning import weighted_mean
from surveysim.reduction.analysis import AnalysisSetup
from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.reduction.splits import Split
from surveysim.runtime.errors import InsufficientDataError
from surveysim.scene.spectra import NIGHT
from surveysim.survey.coadds import CoAdds, noise_weights

FEWEST_INDEPENDENT = 2.0  # observations whose signs are independent, once the sky is removed
_LEAST_NOISE = 0.1  # of a part that remains once the sky is removed from maps with random signs


@dataclass(frozen=True)
class PartMaps:
    """Maps of the parts of a split on the scored patch.

    Attributes
    ----------
    maps_uk : (n_part, n, n)
        [uK_CMB], 0 where unobserved.
    noise_uk : (K, n_part, n, n)
        Realizations of their noise, without the sky.
    independent
        Observations of equal weight that have as many independent signs.
    unseen : (n_part,)
        Share of the tapered patch that a part does not see.
    """

    maps_uk: np.ndarray
    noise_uk: np.ndarray
    independent: float
    unseen: np.ndarray

    @property
    def common(self) -> float:
        """Correlation between the noise powers of two realizations: both have the noise of the same observations."""
        return 1 / self.independent


def part_maps(analysis: AnalysisSetup, coadds: CoAdds, split: Split, groups: Sequence[slice]) -> PartMaps:
    """Divide the sums of the parts of a split, those of each group together.

    In a map with random signs the sky has the amplitude a, the sum of the signed weights over that of the weights, if
    all observations filter it alike. The rest has the share 1 - <a^2> of the noise.

    Parameters
    ----------
    groups
        Parts that are added up for each map.

    Raises
    ------
    InsufficientDataError
        For parts with too few observations.
    """
    own = np.arange(len(coadds.split_sums))[split.maps]
    members = [own[group] for group in groups]
    total, weight = (np.stack([array[some].sum(axis=0) for some in members]) for array in _sums(coadds))
    flipped = np.stack([coadds.split_flipped[some].sum(axis=0) for some in members], axis=1)
    amplitude = weighted_mean(flipped[:, :, 1], weight)
    noise = weighted_mean(flipped[:, :, 0] - amplitude * total, weight)
    to_ukcmb = 1e3 * analysis.scene.instrument.cmb_per_rj
    scale = _noise_scale(analysis, weight, np.mean(amplitude**2, axis=0))
    return PartMaps(
        weighted_mean(total, weight) * to_ukcmb,
        noise * (to_ukcmb * scale[:, None, None]),
        _independent(analysis, coadds, split, groups),
        _unseen(analysis, weight),
    )


def _sums(coadds: CoAdds) -> tuple[np.ndarray, np.ndarray]:
    return coadds.split_sums, coadds.split_weight


def _noise_scale(analysis: AnalysisSetup, weight: np.ndarray, removed: np.ndarray) -> np.ndarray:
    """Factor (n_part,) that makes up for the noise that is removed with the sky, a share (n_part, n, n)."""
    variance = np.divide(analysis.region.taper**2, weight, out=np.zeros_like(weight), where=weight > 0)
    whole, left = variance.sum(axis=(1, 2)), (variance * (1 - removed)).sum(axis=(1, 2))
    if not (left > _LEAST_NOISE * whole).all():
        raise InsufficientDataError("a part of a split has data of too few observations; two or more are expected")
    return np.sqrt(whole / left)


def _independent(analysis: AnalysisSetup, coadds: CoAdds, split: Split, groups: Sequence[slice]) -> float:
    """Count the independent signs in the difference of parts, less one for each sky that is removed."""
    weights = noise_weights(coadds.noise_mk2()[:, analysis.data_set_names.index(ACTUAL)])
    if split.name != NIGHT:
        return _checked(np.sum(weights) ** 2 / np.sum(weights**2) - 1)
    part = analysis.splits.night_parts[coadds.first : coadds.end]
    members = [np.isin(part, np.arange(len(split.parts))[group]) for group in groups]
    totals = np.array([weights[some].sum() for some in members])
    if not totals.all():
        raise InsufficientDataError("a part of a split has no data yet")
    shares = np.concatenate([weights[some] / total**2 for some, total in zip(members, totals, strict=True)])
    return _checked((1 / totals).sum() ** 2 / np.sum(shares**2) - len(groups))


def _checked(independent: float) -> float:
    if independent < FEWEST_INDEPENDENT:
        raise InsufficientDataError(
            f"random signs of {max(independent, 0):.1f} independent observations do not measure the noise of a split;"
            f" {FEWEST_INDEPENDENT:g} or more are expected"
        )
    return independent


def _unseen(analysis: AnalysisSetup, weight: np.ndarray) -> np.ndarray:
    squares = analysis.region.taper**2
    return np.array([np.sum(squares[part == 0]) for part in weight]) / squares.sum()
