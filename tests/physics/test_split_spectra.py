"""Band powers from split maps of simulated surveys against their input, and null tests with and without a fault."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, kstest

from surveysim import load_scene
from surveysim.reduction.setup import prepare
from surveysim.results.spectra import spectra_warnings
from surveysim.survey.run import run_observations
from surveysim.survey.split_spectra import survey_spectra
from tests.scenes import SMALL_SCENE, SPECTRA, WIDE_PATCH, without_sections, write_scene

pytestmark = pytest.mark.slow
SKY = '\n[sky]\ncmb_band_power = "100000 uK2"\n'
# Without a layer, in seconds: the layer changes the noise, not the estimator.
QUIET = without_sections(SMALL_SCENE, "atmosphere", "excess", "photon", "sky").replace(
    'algorithm = "average"', 'algorithm = "none"'
)
KEYS = {name: value for name, value in WIDE_PATCH.items() if not name.startswith("atmosphere")} | {
    "observations": 24,
    "map.pixel": "30 arcsec",
    "score.noise_only_sets": [],
    "score.mask_separation_f_lambda": None,
    "score.ell_min": 2000,
    "score.ell_max": 8000,
    "score.jackknives": 2,
    "score.signal_sims.skies": 4,
    "score.signal_sims.observations": 8,
    "spectra.ell_bin": 1000,
    "spectra.realizations": 40,
}
N_SEED, N_BIN, N_REALIZATION = 8, 6, 40
N_STEEP = 6


def measured(tmp_path, text, keys):
    setup = prepare(load_scene(write_scene(tmp_path, text + SPECTRA), KEYS | keys))
    return survey_spectra(setup, run_observations(setup, None))


@pytest.fixture(scope="module")
def surveys(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scenes")
    return [measured(folder, QUIET + SKY, {"seed": seed}) for seed in range(N_SEED)]


def test_band_powers_are_those_of_the_sky(surveys):
    """No bias in any bin within three errors of the mean, and chi-squared as its distribution says."""
    assert len(surveys[0].input_uk2) == N_BIN
    np.testing.assert_allclose(surveys[0].input_uk2, 1e5, rtol=1e-9)
    pulls = [(item.reported.powers.power_uk2 - 1e5) / item.reported.monte_carlo.error_uk2 for item in surveys]
    assert np.abs(np.mean(pulls, axis=0)).max() * np.sqrt(N_SEED) < 3
    total = sum(item.reported.fit.value for item in surveys)
    # Hotelling's statistic scatters more than chi-squared.
    spread = 1 + (N_BIN + 1) / (N_REALIZATION - N_BIN - 4)
    low, high = chi2.ppf([0.001, 0.999], N_SEED * N_BIN)
    assert abs(total - N_SEED * N_BIN) < spread * (high - low) / 2
    assert kstest([item.reported.fit.pte for item in surveys], "uniform").pvalue > 1e-3
    for item in surveys:
        ratio = item.reported.powers.covariance.error_uk2 / item.reported.monte_carlo.error_uk2
        assert np.abs(np.log(ratio)).mean() < 0.25  # 40 realizations know an error to 11 %, the noise is not even


def test_splits_of_clean_surveys_pass(surveys):
    for name in ("night", "direction", "array"):
        ptes = [item.splits[name].null.chi_squared.pte for item in surveys]
        assert kstest(ptes, "uniform").pvalue > 1e-3 and min(ptes) > 1e-4


def test_noise_of_nights_is_not_correlated(surveys):
    """The cross-power of the noise of parts is zero, on average over seeds and bins."""
    pulls = np.array([item.splits["night"].bias_uk2 / item.splits["night"].bias_error_uk2 for item in surveys])
    assert abs(pulls.mean()) < 4 / np.sqrt(N_SEED)


def test_the_noise_bias_of_half_arrays_is_removed(tmp_path):
    """Cleaned halves of the array share noise, of one to two errors of the band powers in each bin."""
    text = without_sections(SMALL_SCENE, "sky") + SKY.replace("100000", "20000")
    layer = {name: value for name, value in WIDE_PATCH.items() if name.startswith("atmosphere")}
    surveys = [measured(tmp_path, text, layer | {"seed": 300 + seed}) for seed in range(4)]
    items = [(item.splits["array"], item.input_uk2) for item in surveys]
    pulls = [(item.powers.power_uk2 - expected) / item.monte_carlo.error_uk2 for item, expected in items]
    assert np.mean([item.bias_uk2 / item.monte_carlo.error_uk2 for item, _ in items]) > 1
    assert abs(np.mean(pulls)) < 4 / np.sqrt(np.size(pulls))


def test_time_constants_fail_the_split_by_direction_alone(tmp_path):
    """Streams that lag shift the sky along the scan, there and back in turn: the maps differ."""
    bright = QUIET + SKY.replace("100000", "3000000")
    found = measured(tmp_path, bright, {"time_constants": {"value": "0.2 s"}})
    assert found.splits["direction"].null.chi_squared.pte < 1e-6
    assert found.splits["night"].null.chi_squared.pte > 1e-3


def test_a_wrong_calibration_fails_the_split_by_array(tmp_path):
    """A gain of one half that is off by 20 %, put into its sums."""
    setup = prepare(load_scene(write_scene(tmp_path, QUIET + SKY.replace("100000", "3000000") + SPECTRA), KEYS))
    coadds = run_observations(setup, None)
    good = survey_spectra(setup, coadds)
    assert good.splits["array"].null.chi_squared.pte > 1e-3
    # The band powers of this very sky, without its sample variance of up to 22 %. The transfer function of four skies
    # is known to 4 %, and each sky leaks otherwise through the taper.
    np.testing.assert_allclose(good.reported.powers.power_uk2, good.sky_uk2, rtol=0.12)
    place = setup.analysis.splits.of("array").first
    coadds.split_sums[place] *= 1.2
    coadds.split_flipped[place, :, 0] *= 1.2
    assert survey_spectra(setup, coadds).splits["array"].null.chi_squared.pte < 1e-6


def test_steep_spectra_with_a_transfer_function_of_their_own(tmp_path):
    """Band powers as 1 / l^2, cleaned: by flat simulated skies the lowest bin would have half of its power."""
    ell = np.arange(2, 30_000, 20)
    lines = [f"{at} {1e5 * (max(at, 200) / 4000) ** -2:.6e}" for at in ell]
    (tmp_path / "steep.dat").write_text("\n".join(lines))
    text = without_sections(SMALL_SCENE, "sky", "excess") + '\n[sky]\nspectrum = "steep.dat"\n'
    own = WIDE_PATCH | {"score.signal_sims.spectrum": "sky", "score.signal_sims.skies": 8}
    surveys = [measured(tmp_path, text, own | {"seed": 1000 + seed}) for seed in range(N_STEEP)]
    ratio = [item.reported.powers.power_uk2[0] / item.input_uk2[0] for item in surveys]
    error = np.std(ratio, ddof=1) / np.sqrt(N_STEEP)
    assert error < 0.15 and abs(np.mean(ratio) - 1) < 3 * error
    assert not any("flat ones" in line for item in surveys for line in spectra_warnings(item))
    assert any("flat ones" in line for line in spectra_warnings(replace(surveys[0], own_transfer=False)))
