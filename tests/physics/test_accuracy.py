"""Errors of numerical choices, against closed forms."""

import numpy as np
import pytest

from surveysim import load_scene
from surveysim.atmosphere import screen_kernels
from surveysim.atmosphere.screen_simulation import LOOK_UPS, strip_step
from surveysim.atmosphere.thin_screen import Screen, structure_function
from surveysim.studies.convergence.runs import Task, run_task
from tests.scenes import SMALL_SCENE, without_sections

N_LANE, N_X, N_POINT = 8, 12, 60
SCREENS = [Screen(11 / 3, 8 / 1000), Screen(11 / 3, 8 / 375), Screen(2.5, 8 / 1000)]


def look_up_matrix(kind, x, y):
    """Weights (n_point, n_node) that a look-up gives to the lattice points, from its answers to unit impulses."""
    columns = []
    for node in range(N_LANE * N_X):
        strip = np.zeros(N_LANE * N_X)
        strip[node] = 1.0
        data = np.zeros((len(x), 1))
        getattr(screen_kernels, LOOK_UPS[kind])(data, 0, 1, strip.reshape(N_LANE, N_X), x, y, 0.0, 1.0)
        columns.append(data[:, 0])
    return np.array(columns).T


def structure_error(screen, kind, step_rad):
    """RMS relative error of the structure function of look-ups at pairs of points, by closed forms: no draws.

    Differences of look-ups are sums over lattice points whose weights add to none, for which
    ``<(sum w f)^2> = -1/2 sum w_i w_j D_ij``.
    """
    rng = np.random.default_rng(7)
    x, y = rng.uniform(0, N_X - 1, 2 * N_POINT), rng.uniform(0, N_LANE - 1, 2 * N_POINT)
    lane, along = np.divmod(np.arange(N_LANE * N_X), N_X)
    apart = np.hypot(along[:, None] - along, lane[:, None] - lane)
    between = structure_function(screen, step_rad * apart)
    weights = look_up_matrix(kind, x, y)
    difference = weights[:N_POINT] - weights[N_POINT:]
    found = -0.5 * np.einsum("pi,ij,pj->p", difference, between, difference)
    distance = step_rad * np.hypot(x[:N_POINT] - x[N_POINT:], y[:N_POINT] - y[N_POINT:])
    return np.sqrt(np.mean((found / structure_function(screen, distance) - 1) ** 2))


@pytest.mark.parametrize("screen", SCREENS, ids=str)
@pytest.mark.parametrize("factor", [1.0, 4.0])
def test_the_structure_function_gets_better_with_the_order_of_the_look_up(screen, factor):
    step_rad = factor * strip_step(screen, 0.0)
    error = {kind: structure_error(screen, kind, step_rad) for kind in LOOK_UPS}
    assert error["linear"] < 0.5 * error["nearest"]
    assert error["cubic"] < 0.5 * error["linear"]


def test_finer_steps_make_better_look_ups():
    """For points as many steps apart: the beam leaves the less between lattice points the closer they are."""
    screen = Screen(11 / 3, 8 / 1000)
    coarse, fine = (structure_error(screen, "linear", factor * strip_step(screen, 0.0)) for factor in (2.0, 1.0))
    assert fine < 0.7 * coarse


def test_the_noise_part_of_the_error_falls_with_the_observations(tmp_path):
    """White noise and `none` for cleaning: K sign flips of N equal observations know sigma to
    ``s sqrt(1/K + (1 - 1/K) / N)``, s the scatter of one flip. K flips know s to 1 / sqrt(2 (K - 1)), and the
    N (N - 1) / 2 products of two observations that flips combine to 1 / sqrt(N (N - 1)): within 3 times both, over all
    surveys. Weights of the observations are nearly equal.
    """
    text = without_sections(SMALL_SCENE, "atmosphere", "excess", "photon", "sky", "score.reference")
    text = text.replace('algorithm = "average"', 'algorithm = "none"').replace('["uncorrelated", "white"]', "[]")
    path = tmp_path / "white.toml"
    path.write_text(text.replace("mask_separation_f_lambda = 1.3\n", ""))
    n_flip, counts, n_survey = 200, np.array([8, 16, 32]), 12
    relative = []
    for seed in range(n_survey):
        settings = {"seed": seed, "observations": 32, "score.jackknives": n_flip}
        run = run_task(Task(load_scene(path, settings), tuple(counts.tolist())))
        assert not run.note
        error = np.array([run.marks[count].score.budget.noise for count in counts])
        relative.append(error / np.sqrt(1 / n_flip + (1 - 1 / n_flip) / counts))
    mean = np.mean(relative, axis=0)
    spread = np.sqrt((1 / (2 * (n_flip - 1)) + 1 / (counts * (counts - 1))) / n_survey)
    assert (np.abs(mean / mean.mean() - 1) < 3 * spread).all()
    sigma = [run.marks[count].score.band.sigma_ukcmb2 for count in counts]
    # All are estimates of the whole survey's.
    np.testing.assert_allclose(np.array(sigma) / sigma[-1], 1, atol=3 * error.max())
