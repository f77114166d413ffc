"""White noise of the mean of all detectors: correlated pixels average less well than independent ones."""

import numpy as np

from mapmaker.chunks import row_chunks
from surveysim.telescope.focal_plane import Camera
from surveysim.telescope.lattice_noise import pair_sums
from surveysim.telescope.noise_levels import WhiteLevels
from surveysim.telescope.pixel_coherence import PixelCoherence, part_weights


def array_correlation(
    cam: Camera, coherence: PixelCoherence, *, aperture_weight: float, stop_weight: float = 0.0
) -> float:
    """Compute gamma^(2): the sum of the correlation of wave noise with all other detectors, averaged over detectors.

    Equation 67 of Hill and Kusaka (2024). The noise of the mean of N detectors is ``(shot + (1 + gamma^(2)) wave +
    internal) / N`` (equation 68). Exact: the sum runs over all pairs of the array, edges included.

    Parameters
    ----------
    coherence
        Correlation against separation, `surveysim.timestreams.shared_parts.photon_coherence` of a scene.
    aperture_weight, stop_weight
        Fractions of the load, or of the occupation number, of light through the aperture and of the stop, at the
        detector. The rest is independent between detectors.
    """
    seen = aperture_weight + stop_weight
    return seen**2 * common_with_others(cam, coherence, stop_weight / seen if seen else 0.0)


def common_with_others(cam: Camera, coherence: PixelCoherence, stop_share: float) -> float:
    """Sum of the correlation with all other detectors, averaged over detectors, for noise that is all shared."""
    place, n_det = cam.positions_f_lambda, len(cam.focal_plane.x_rad)
    angle = cam.polarization_angle_rad if coherence.kind == "hbt" else None
    if cam.lattice is not None and angle is None:
        sums = pair_sums(cam.lattice, cam.f_lambda_rad, coherence)
    else:
        sums = np.zeros(1)
        for rows in row_chunks(n_det, n_det):
            parts = coherence.parts(np.linalg.norm(place[rows, None] - place, axis=-1))
            if angle is not None:
                parts = parts * np.cos(angle[rows, None] - angle) ** 2
            sums = sums + parts.sum(axis=(1, 2))
        sums = sums - n_det
    return float(part_weights(stop_share, len(sums)) @ sums) / n_det


def correlated_noise(cam: Camera, coherence: PixelCoherence, levels: WhiteLevels) -> float:
    """Variance of the mean of all detectors over that of as many independent ones; 1 without noise.

    ``(shot + (1 + gamma^(2)) wave + internal) / (shot + wave + internal)``, for detectors with the noise of the scene.
    """
    alone = levels.photon_mk2_hz + levels.detector_mk2_hz
    shared = levels.photon_mk2_hz * levels.shared
    return 1 + shared * common_with_others(cam, coherence, levels.stop_share) / alone if shared else 1.0


def array_psd(cam: Camera, coherence: PixelCoherence, levels: WhiteLevels) -> float:
    """Compute the one-sided PSD [mK^2/Hz] of the mean of all detectors: equation 68 of Hill and Kusaka (2024)."""
    alone = (levels.photon_mk2_hz + levels.detector_mk2_hz) / len(cam.focal_plane.x_rad)
    return alone * correlated_noise(cam, coherence, levels)
