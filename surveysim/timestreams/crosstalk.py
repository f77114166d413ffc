"""Crosstalk between streams of detectors in readout: a matrix for all samples."""

from dataclasses import dataclass

import numpy as np

from mapmaker.chunks import row_chunks
from surveysim.scene.response import Crosstalk
from surveysim.timestreams.observed_block import ObservedBlock


@dataclass(frozen=True, eq=False)
class CrosstalkMatrix:
    """Symmetric matrix ``1 + e N + u (G - 1)`` of the crosstalk, applied in time proportional to the detectors.

    N is 1 for neighbours in readout, and G for detectors of one group; e and u are the fractions of the section.

    Attributes
    ----------
    groups
        Detectors of each readout group, in the order of readout.
    """

    section: Crosstalk
    groups: tuple[np.ndarray, ...]

    def __call__(self, data: np.ndarray) -> None:
        """Multiply streams (n_det, n_samp) by the matrix, in place."""
        for samples in row_chunks(data.shape[1], len(data)):
            data[:, samples] = self.times(data[:, samples].astype(float))

    def times(self, data: np.ndarray) -> np.ndarray:
        """Product of the matrix and an array (n_det, ...)."""
        leaked = np.zeros_like(data)
        for group in self.groups:
            before, after = group[:-1], group[1:]
            leaked[after] += self.section.neighbour_fraction * data[before]
            leaked[before] += self.section.neighbour_fraction * data[after]
            if self.section.group_fraction:
                leaked[group] += self.section.group_fraction * (data[group].sum(axis=0) - data[group])
        return data + leaked


def crosstalk(of: ObservedBlock, seen_mk: np.ndarray) -> CrosstalkMatrix:
    """Add fractions of the streams of other detectors to each stream."""
    return CrosstalkMatrix(of.setup.scene.crosstalk, of.setup.camera.readout_groups)
