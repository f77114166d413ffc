"""PSDs of streams with flagged samples keep the level of white noise."""

from types import SimpleNamespace

import numpy as np
import pytest

from mapmaker.stream_psd import hann_power
from surveysim.reduction.stream_psds import sampled_scans

N_DET, N_SCAN, N = 40, 30, 100


@pytest.mark.parametrize("where", ["ends", "middle", "anywhere"])
def test_flagged_samples_count_as_in_the_periodogram(where):
    """White noise, zero where it is flagged; the mean of 1200 scans of 49 frequencies is known to 1 %."""
    rng = np.random.default_rng(3)
    lost = np.zeros((N_DET, N_SCAN, N), bool)
    if where == "ends":
        lost[..., :10] = lost[..., -10:] = True
    elif where == "middle":
        lost[..., 40:60] = True
    else:
        lost = rng.random(lost.shape) < 0.2
    data, flags = rng.standard_normal(lost.shape), lost.reshape(N_DET, -1)
    whole = hann_power(data.reshape(N_DET, -1), N_SCAN, np.ones(N_SCAN, bool)) / N_SCAN
    kept = rng.random(N_SCAN) < 0.8
    streams = SimpleNamespace(flags=flags, data_mk=flags)
    sampled = sampled_scans(streams, slice(None), kept)
    power = hann_power(np.where(lost, 0, data).reshape(N_DET, -1), N_SCAN, kept)
    assert (power[:, 1:].mean() / sampled.mean()) == pytest.approx(whole[:, 1:].mean(), rel=0.03)
    assert sampled.mean() / kept.sum() == pytest.approx(
        {"ends": 0.998, "middle": 0.5, "anywhere": 0.8}[where], abs=0.03
    )


def test_detectors_without_a_sample_count_nothing():
    flags = np.ones((2, N_SCAN * N), bool)
    flags[1, : N // 2 + 1] = False
    streams = SimpleNamespace(flags=flags, data_mk=flags)
    first, second = sampled_scans(streams, slice(None), np.ones(N_SCAN, bool))
    assert first == 0 < second
