"""Weather of named sites: water, B2 that follows from it, and what the paper's Table 1 has."""

import math

import numpy as np
import pytest
from scipy.special import ndtri
from scipy.stats import kstest, spearmanr

from surveysim.atmosphere.water import pwv_quantile
from surveysim.atmosphere.weather import b2_quantile, draw_weather, site_water
from surveysim.scene.atmosphere import Atmosphere
from surveysim.scene.passband import top_hat
from surveysim.scene.place import shipped_place

N_DRAWS = 8000
QUARTILES = ndtri([0.25, 0.5, 0.75])
PAPER_MEDIAN_PWV = {"mauna_kea": 1.68, "south_pole": 0.25, "alma": 1.00, "ccat": 0.83}
OWN_B2 = {"b2_probabilities": [0.25, 0.5, 0.75], "b2": "[100, 280, 980] mK2 rad(-5/3)"}


def atmosphere(site, **keys):
    return Atmosphere.model_validate({"spectral_index": "11/3", "illuminated_aperture": "8 m", "site": site} | keys)


def draws(air, water, seed=1):
    rng = np.random.default_rng(seed)
    return [draw_weather(air, water, rng) for _ in range(N_DRAWS)]


@pytest.mark.parametrize("site", PAPER_MEDIAN_PWV)
def test_median_water_is_the_paper_s(site):
    assert pwv_quantile(atmosphere(site), 0.5) == pytest.approx(PAPER_MEDIAN_PWV[site], rel=1e-9)


def test_quartiles_of_the_water_above_mauna_kea():
    """A quarter of n draws lies below the first quartile, to sqrt(p (1 - p) / n)."""
    air = atmosphere("mauna_kea")
    pwv = np.array([item.pwv_mm for item in draws(air, site_water(air, shipped_place(air.site), top_hat(143e9, 0.15)))])
    for share, quartile in zip((0.25, 0.5, 0.75), (1.00, 1.68, 2.92), strict=True):
        assert np.mean(pwv < quartile) == pytest.approx(share, abs=5 * math.sqrt(share * (1 - share) / N_DRAWS))
    assert pwv.min() >= 0.5 and pwv.max() <= 3.5


def test_drawn_water_between_its_quantiles():
    """Of three quantiles, ln PWV is uniform between each two: the largest departure of n draws (Kolmogorov-Smirnov)."""
    air = atmosphere("mauna_kea", pwv="[1, 2, 3] mm", pwv_probabilities=[0, 0.4, 1])
    pwv = [item.pwv_mm for item in draws(air, site_water(air, shipped_place(air.site), top_hat(143e9, 0.15)))]
    assert kstest(np.interp(np.log(pwv), np.log([1, 2, 3]), [0, 0.4, 1]), "uniform").pvalue > 1e-3
    assert len(set(pwv)) == N_DRAWS  # with quantiles that ended at 0.25, a quarter of all had the lowest


@pytest.mark.parametrize("frequency, quartiles", [(143e9, (100, 280, 980)), (268e9, (1100, 4000, 14000))])
def test_one_distribution_of_fluctuations_serves_both_bands_of_table_1(frequency, quartiles):
    """One distribution for two bands leaves up to 13 %: two calibrations of 12 % each are good to 17 % together."""
    air = atmosphere("mauna_kea")
    b2 = b2_quantile(air, site_water(air, shipped_place(air.site), top_hat(frequency, 0.15)), QUARTILES)
    np.testing.assert_allclose(np.log(b2), np.log(quartiles), atol=0.14)


@pytest.mark.parametrize("frequency, width, median", [(150e9, 0.2, 10), (219e9, 0.137, 38), (274e9, 0.175, 74)])
def test_medians_above_the_south_pole(frequency, width, median):
    """Predicted, not calibrated: half of Mauna Kea's fluctuations on the Pole's water. 7.5 / 35.5 / 82 mK^2.

    Medians and band centres of ACBAR by its authors (Bussmann et al. 2005, abstract); the paper has 151 and 282 GHz.
    """
    air = atmosphere("south_pole")
    b2 = b2_quantile(air, site_water(air, shipped_place(air.site), top_hat(frequency, width)), 0.0)
    # Two calibrations of 12 % (the paper's; ACBAR's taken alike), 3 GHz at 150 GHz, "half" for 1 / 2.1 and 1 / 2.4.
    assert math.log(b2 / median) == pytest.approx(0, abs=np.linalg.norm([0.12, 0.12, 0.17, 0.18]))


def test_quartiles_above_the_south_pole():
    """Both bands of Table 1 at 151 and 282 GHz together: 2.4 / 8.0 / 24 and 30 / 99 / 299 mK^2.

    Each band lies a quarter off the mean of the two, low at 151 and high at 282 GHz: the ratio of the bands, which
    fluctuations leave alone, is 12.4 in the model and 7 in the data. With the centres of ACBAR's authors it is 11.
    """
    air = atmosphere("south_pole")
    bands = [(151e9, 0.2), (282e9, 0.18)]
    b2 = np.array(
        [b2_quantile(air, site_water(air, shipped_place(air.site), top_hat(*band)), QUARTILES) for band in bands]
    )
    off = np.log(b2 / [(3.7, 10, 37), (28, 74, 230)]).mean(axis=0)
    # The paper finds 25 / 12 = 2.1 and 50 / 21 = 2.4 for its "factor of 2", with a calibration of 12 %.
    np.testing.assert_allclose(off, 0, atol=math.hypot(0.18, 0.12))
    np.testing.assert_allclose(b2[1] / b2[0], 12.4, rtol=0.01)


def test_drawn_b2_has_the_quantiles_that_follow():
    air = atmosphere("mauna_kea")
    water = site_water(air, shipped_place(air.site), top_hat(143e9, 0.15))
    b2 = np.array([item.b2 for item in draws(air, water)])
    for share in (0.1, 0.25, 0.5, 0.75, 0.9):
        below = np.mean(b2 < b2_quantile(air, water, ndtri(share)))
        assert below == pytest.approx(share, abs=5 * math.sqrt(share * (1 - share) / N_DRAWS))


def test_b2_is_the_fluctuation_of_the_water_times_what_the_band_makes_of_it():
    """Over pairs of draws with the same generator, B2 in two bands differs by the ratio of the responses alone."""
    air = atmosphere("mauna_kea")
    low, high = (site_water(air, shipped_place(air.site), top_hat(frequency, 0.15)) for frequency in (143e9, 268e9))
    for one, other in list(zip(draws(air, low), draws(air, high), strict=True))[:50]:
        assert one.pwv_mm == other.pwv_mm
        expected = high.response(one.pwv_mm) / low.response(one.pwv_mm)
        # Quantiles of B2 are tabulated in steps of rank: a part in a thousand.
        assert other.b2 / one.b2 == pytest.approx(expected, rel=0.01)


def test_own_quantiles_keep_the_rank():
    free, own = atmosphere("mauna_kea"), atmosphere("mauna_kea", **OWN_B2)
    water = site_water(free, shipped_place(free.site), top_hat(143e9, 0.15))
    ours, theirs = ([item.b2 for item in draws(air, water)] for air in (free, own))
    assert spearmanr(ours, theirs).statistic == pytest.approx(1, abs=1e-9)
    for share, quartile in zip((0.25, 0.5, 0.75), (100, 280, 980), strict=True):
        assert np.mean(np.array(theirs) < quartile) == pytest.approx(share, abs=5 * math.sqrt(0.25 / N_DRAWS))


def test_wind_falls_with_b2_if_asked():
    """Slope of ln w on ln B2: the residual scatter 0.4 over that of ln B2, sqrt(n), is its error."""
    air = atmosphere("mauna_kea", wind_b2_exponent=-0.25)
    weather = draws(air, site_water(air, shipped_place(air.site), top_hat(143e9, 0.15)))
    x, y = (np.log([getattr(item, name) for item in weather]) for name in ("b2", "wind_speed_rad_s"))
    error = 0.4 / (x.std() * math.sqrt(N_DRAWS))
    assert np.polyfit(x, y, 1)[0] == pytest.approx(-0.25, abs=5 * error)
    assert np.median(np.degrees(np.exp(y)) * 60) == pytest.approx(31, rel=5 * 1.25 * 0.6 / math.sqrt(N_DRAWS))
