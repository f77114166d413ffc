"""Maps of a run, whatever their map-maker."""

from dataclasses import dataclass

from mapmaker.binning import BinnedMap
from mapmaker.pipeline.healpix_sums import HealpixSums
from mapmaker.pipeline.splits import Split


@dataclass(frozen=True)
class Maps:
    """Map of all data, and noise maps.

    Attributes
    ----------
    map
    splits
    noise
        Noise map of each division; without weight where its halves have no pixel in common.
    healpix
        Sums on HEALPix pixels; None without.
    solution
        Sentence on the convergence of the map; empty for a binned one.
    converged
    """

    map: BinnedMap
    splits: tuple[Split, ...]
    noise: tuple[BinnedMap, ...]
    healpix: HealpixSums | None = None
    solution: str = ""
    converged: bool = True
