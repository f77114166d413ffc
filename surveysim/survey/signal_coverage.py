"""Coverage of the scored patch by the observations that carry the signal simulations."""

import numpy as np

from surveysim.reduction.analysis import AnalysisSetup
from surveysim.survey.coadds import CoAdds

MOST_UNSEEN = 0.01  # of the patch; with 8 %, transfer functions were 40 % too low at the highest multipoles


def signal_coverage_warnings(analysis: AnalysisSetup, coadds: CoAdds) -> list[str]:
    """Warn of parts of the scored patch that the survey sees and the signal simulations do not.

    Holes in the maps of these mix multipoles, so that their transfer function is not that of the survey's map.
    """
    if not coadds.signal_weight.any():
        return []
    patch = analysis.region.patch
    unseen = (coadds.signal_weight[0] == 0) & (coadds.weight[0, patch, patch] > 0)
    share = float(np.sum(analysis.region.taper[unseen] ** 2) / np.sum(analysis.region.taper**2))
    if share <= MOST_UNSEEN:
        return []
    return [
        f"score.signal_sims.observations: the observations with simulated signal miss {100 * share:.0f} % of the scored"
        " patch, so that the transfer function and scores at high multipoles are off by more than their errors. Remedy:"
        " more of these observations."
    ]
