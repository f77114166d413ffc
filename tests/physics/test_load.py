"""Photon noise by hand, by quadrature of Planck's law over the band, and against a published worked example."""

import math
from dataclasses import replace

import pytest
from scipy.integrate import quad

from surveysim.scene.passband import top_hat
from surveysim.scene.units import BOLTZMANN_J_K, PLANCK_J_S
from surveysim.telescope.photon_noise import PhotonNoise, photon_noise

BOLOCAM = {"load_k": 80.0, "frequency_hz": 143e9, "bandwidth": 0.15, "efficiency": 0.08, "polarizations": 2}


def power_per_k(bandwidth_hz, efficiency, polarizations):
    """Absorbed power per Rayleigh-Jeans temperature [W/K]."""
    return BOLTZMANN_J_K * bandwidth_hz * efficiency * polarizations


def power_w(temperature_rj_k, bandwidth_hz, efficiency, polarizations):
    """Absorbed power [W] of a load that fills the beam."""
    return temperature_rj_k * power_per_k(bandwidth_hz, efficiency, polarizations)


def shot_nep2(load_w, frequency_hz):
    """Shot noise [W^2/Hz] of an absorbed power."""
    return 2 * PLANCK_J_S * frequency_hz * load_w


def bose_nep2(load_w, bandwidth_hz, polarizations):
    """Bose noise [W^2/Hz] of an absorbed power."""
    return 2 * load_w**2 / (polarizations * bandwidth_hz)


@pytest.mark.parametrize("polarizations", [1, 2])
@pytest.mark.parametrize("frequency_hz, bandwidth", [(143e9, 0.15), (850e9, 0.01), (30e9, 0.6)])
def test_integrals_over_the_band_are_the_closed_forms(frequency_hz, bandwidth, polarizations):
    """Of a load in Rayleigh-Jeans temperature, to rounding."""
    noise = photon_noise(40.0, frequency_hz, bandwidth, 0.3, polarizations=polarizations, transmission=0.8)
    power = power_w(40.0, bandwidth * frequency_hz, 0.3, polarizations)
    per_k = 0.8 * power_per_k(bandwidth * frequency_hz, 0.3, polarizations)
    assert noise.power_w == pytest.approx(power, rel=1e-13)
    assert noise.w_per_k == pytest.approx(per_k, rel=1e-13)
    assert noise.shot_nep2 == pytest.approx(shot_nep2(power, frequency_hz), rel=1e-13)
    assert noise.bose_nep2 == pytest.approx(bose_nep2(power, bandwidth * frequency_hz, polarizations), rel=1e-13)


def test_by_hand():
    """80 K at 143 GHz, 15 %, 8 %, two polarizations, with k = 1.380649e-23 and h = 6.62607e-34.

    dnu = 0.15 * 143e9 = 21.45e9 Hz
    P/T = 1.380649e-23 * 21.45e9 * 0.08 * 2 = 4.73839e-14 W/K
    P = 80 * 4.73839e-14 = 3.79071e-12 W
    shot: 2 * 6.62607e-34 * 143e9 * 3.79071e-12 = 1.89506e-22 * 3.79071e-12 = 7.18361e-34 W^2/Hz
    Bose: 2 * (3.79071e-12)^2 / (2 * 21.45e9) = 1.436948e-23 / 21.45e9 = 6.69906e-34 W^2/Hz
    NEP = sqrt(13.88267e-34) = 3.72595e-17 W/sqrt(Hz)
    shot: 7.18361e-34 / (4.73839e-14)^2 = 7.18361e-34 / 2.245234e-27 = 3.19950e-7 K^2/Hz
    Bose: T^2 * 2 / (2 * 21.45e9) = 6400 / 21.45e9 = 2.98368e-7 K^2/Hz
    NET = sqrt(6.18318e-7) K = 0.786332 mK/sqrt(Hz), and times 1.65343 (over the band) 1.30014 mK_CMB/sqrt(Hz)
    """
    assert power_per_k(21.45e9, 0.08, 2) == pytest.approx(4.73839e-14, rel=2e-6)
    assert power_w(80, 21.45e9, 0.08, 2) == pytest.approx(3.79071e-12, rel=2e-6)
    assert shot_nep2(3.79071e-12, 143e9) == pytest.approx(7.18361e-34, rel=2e-6)
    assert bose_nep2(3.79071e-12, 21.45e9, 2) == pytest.approx(6.69906e-34, rel=2e-6)
    noise = photon_noise(**BOLOCAM)
    assert noise.power_w == pytest.approx(3.79071e-12, rel=2e-6)
    assert noise.nep_w_rthz == pytest.approx(3.72595e-17, rel=2e-6)
    assert noise.shot_psd_mk2_hz == pytest.approx(0.319950, rel=4e-6)
    assert noise.bose_psd_mk2_hz == pytest.approx(0.298368, rel=4e-6)
    assert noise.psd_mk2_hz == pytest.approx(0.618318, rel=4e-6)
    assert noise.net_mk_rthz == pytest.approx(0.786332, rel=4e-6)
    assert noise.net_mkcmb_rthz == pytest.approx(1.30014, rel=1e-5)


@pytest.mark.parametrize(
    "frequency_hz, efficiency, loads",
    [(143e9, 0.08, [(10, 0.5), (80, 4.0)]), (268e9, 0.19, [(20, 5.0), (60, 15.0), (40, 10.0)])],
)
def test_loads_of_the_paper_are_of_two_polarizations(frequency_hz, efficiency, loads):
    """Section 1.1 gives five loads in K and in pW, to one digit; in one polarization they would be half."""
    for load_k, load_pw in loads:
        power_pw = power_w(load_k, 0.15 * frequency_hz, efficiency, 2) * 1e12
        assert power_pw == pytest.approx(load_pw, rel=0.2)


def test_shot_and_bose_are_about_equal_as_in_the_paper():
    """Section 1.1: "shot and Bose noise contribute in roughly equal amounts" at both frequencies."""
    for load_k, frequency_hz, efficiency in ((80, 143e9, 0.08), (60, 268e9, 0.19), (100, 268e9, 0.19)):
        noise = photon_noise(load_k, frequency_hz, 0.15, efficiency, polarizations=2)
        assert 0.6 < noise.bose_psd_mk2_hz / noise.shot_psd_mk2_hz < 1.5


def planck(load_k, frequency_hz, bandwidth, efficiency, polarizations):
    """Power [W], shot and Bose NEP^2 [W^2/Hz] of a black body of `load_k`, integrated over the band."""
    low, high = frequency_hz * (1 - bandwidth / 2), frequency_hz * (1 + bandwidth / 2)

    def integral(of):
        def density(nu):
            photons = efficiency / math.expm1(PLANCK_J_S * nu / (BOLTZMANN_J_K * load_k))
            return of(nu, polarizations * PLANCK_J_S * nu * photons)

        # In units of the scale of the integrand: quad's absolute tolerance knows no powers of 10^-30.
        scale = abs(density(frequency_hz))
        return quad(lambda nu: density(nu) / scale, low, high, epsabs=0, epsrel=1e-12)[0] * scale

    power = integral(lambda nu, p_nu: p_nu)
    shot = integral(lambda nu, p_nu: 2 * PLANCK_J_S * nu * p_nu)
    bose = integral(lambda nu, p_nu: 2 * p_nu**2 / polarizations)
    return power, shot, bose


@pytest.mark.parametrize("polarizations", [1, 2])
@pytest.mark.parametrize("load_k", [300.0, 80.0, 10.0, 4.0])
@pytest.mark.parametrize("frequency_hz, bandwidth", [(143e9, 0.15), (268e9, 0.15), (95e9, 0.3)])
def test_planck_load_over_the_band(frequency_hz, bandwidth, load_k, polarizations):
    """A load of the same power in Rayleigh-Jeans temperature has the noise of the black body, but for its slope.

    Over the band P_nu falls by a share s = y dnu / nu, y = -d ln P_nu / d ln nu = x / (1 - e^-x) - 1, linearly at
    first. The photons' mean frequency is lower by s / 12 dnu / nu, and the mean square of P_nu is larger than its
    square by s^2 / 12; both of these to the next order of s and of the bandwidth.
    """
    power, shot, bose = planck(load_k, frequency_hz, bandwidth, 0.3, polarizations)
    load_rj_k = power / power_per_k(bandwidth * frequency_hz, 0.3, polarizations)
    x = PLANCK_J_S * frequency_hz / (BOLTZMANN_J_K * load_k)
    # Rayleigh-Jeans temperature is lower by half of h nu / k, and by less when x is large.
    assert load_k - 0.5 * x * load_k < load_rj_k < load_k * (1 - 0.5 * x + x**2 / 12 * 1.05)
    noise = photon_noise(load_rj_k, frequency_hz, bandwidth, 0.3, polarizations=polarizations)
    mk2_per_w2 = 1e6 / power_per_k(bandwidth * frequency_hz, 0.3, polarizations) ** 2
    slope = (x / -math.expm1(-x) - 1) * bandwidth
    fewer, more = slope * bandwidth / 12, slope**2 / 12
    assert noise.power_w == pytest.approx(power, rel=1e-12)
    assert shot * mk2_per_w2 / noise.shot_psd_mk2_hz - 1 == pytest.approx(-fewer, rel=0.05)
    assert bose * mk2_per_w2 / noise.bose_psd_mk2_hz - 1 == pytest.approx(more, rel=0.05)
    # For 80 K at 143 GHz: less than 1e-4 of either.
    if (load_k, frequency_hz) == (80.0, 143e9):
        assert 0 < fewer < 1e-4 and 0 < more < 1e-5


def test_published_example():
    """J. Ruhl's notebook BoloNoise_Simple (2021, with jbolo): 10 K, 150 GHz, 25 %, 50 %, one polarization.

    Printed, with h = 6.6e-34 and k = 1.38e-23: a black body's P = 1.770e-12 W, NEP 2.274e-17 W/sqrt(Hz) with the
    Bose term and 1.870e-17 without, NET 6.213e-5 K sqrt(s). In Rayleigh-Jeans temperature: P = 2.588e-12 W, and
    a power scatter of 1.601e-17 W sqrt(s) from photon counting, both times 1/sqrt(2) of a spectrum's.
    """
    # Constants that are 0.4 % and 0.05 % low, each to the power at which it enters.
    noise = photon_noise(1.770e-12 / power_per_k(37.5e9, 0.5, 1), 150e9, 0.25, 0.5, polarizations=1)
    assert noise.nep_w_rthz == pytest.approx(2.274e-17, rel=4e-3)
    assert math.sqrt(shot_nep2(1.770e-12, 150e9)) == pytest.approx(1.870e-17, rel=4e-3)
    assert noise.net_mk_rthz / math.sqrt(2) == pytest.approx(6.213e-2, rel=4e-3)
    assert power_w(10, 37.5e9, 0.5, 1) == pytest.approx(2.588e-12, rel=1e-3)
    assert math.sqrt(shot_nep2(2.588e-12, 150e9) / 2) == pytest.approx(1.601e-17, rel=4e-3)


def test_scaling():
    """Shot noise goes as T / (eta n_pol dnu), Bose noise as T^2 / (n_pol dnu) whatever the efficiency."""
    noise = photon_noise(**BOLOCAM)
    hot = photon_noise(**BOLOCAM | {"load_k": 160.0})
    clear = photon_noise(**BOLOCAM | {"efficiency": 0.32})
    polarized = photon_noise(**BOLOCAM | {"polarizations": 1})
    for other, shot, bose in ((hot, 2, 4), (clear, 0.25, 1), (polarized, 2, 2)):
        assert other.shot_psd_mk2_hz == pytest.approx(shot * noise.shot_psd_mk2_hz, rel=1e-12)
        assert other.bose_psd_mk2_hz == pytest.approx(bose * noise.bose_psd_mk2_hz, rel=1e-12)
    assert photon_noise(**BOLOCAM | {"load_k": 0.0}).psd_mk2_hz == 0


def test_ideal_single_mode_is_dickes_radiometer():
    """Without shot noise NET^2 = 2 T^2 / dnu one-sided, so that a time t leaves T / sqrt(dnu t) (Dicke 1946)."""
    noise = photon_noise(100.0, 1e9, 0.1, 1.0, polarizations=1)
    left_k = 1e-3 * math.sqrt(noise.bose_psd_mk2_hz / (2 * 60.0))
    assert left_k == pytest.approx(100.0 / math.sqrt(0.1e9 * 60.0), rel=1e-12)
    # h nu / k T = 4.8e-4 is the share of shot noise.
    assert noise.shot_psd_mk2_hz / noise.bose_psd_mk2_hz == pytest.approx(4.799e-4, rel=1e-3)


def test_atmosphere_dims_the_sky_alone():
    """A transmission of 0.8 leaves power and NEP as they are and makes each PSD 1 / 0.64 as large."""
    noise, dimmed = photon_noise(**BOLOCAM), photon_noise(**BOLOCAM, transmission=0.8)
    expected = replace(noise, w_per_k=0.8 * noise.w_per_k, w_per_k_cmb=0.8 * noise.w_per_k_cmb)
    assert vars(dimmed) == pytest.approx(vars(expected), rel=1e-12)
    assert dimmed.psd_mk2_hz == pytest.approx(noise.psd_mk2_hz / 0.64, rel=1e-12)
    assert dimmed.net_mkcmb_rthz == pytest.approx(noise.net_mk_rthz / 0.8 * top_hat(143e9, 0.15).cmb_per_rj, rel=1e-12)


def test_record_adds_squares():
    noise = PhotonNoise(1e-12, shot_nep2=9.0, bose_nep2=16.0, w_per_k=1e3, w_per_k_cmb=500.0)
    assert (noise.nep_w_rthz, noise.psd_mk2_hz, noise.net_mk_rthz, noise.net_mkcmb_rthz) == (5, 25, 5, 10)


@pytest.mark.parametrize(
    "name, values, allowed",
    [
        ("load_k", [-1.0, math.inf, math.nan], "a finite temperature of 0 K or more is allowed"),
        ("frequency_hz", [0.0, -1.0, math.inf, math.nan], "a positive finite frequency is allowed"),
        ("bandwidth", [0.0, 2.0, math.nan], "between 0 and 2 is allowed"),
        ("efficiency", [0.0, 1.01, math.nan], "above 0 and up to 1 is allowed"),
        ("transmission", [0.0, -0.5, 1.01], "above 0 and up to 1 is allowed"),
        ("polarizations", [0, 3, 1.5], "1 or 2 is allowed"),
    ],
)
def test_out_of_range(name, values, allowed):
    for value in values:
        with pytest.raises(ValueError, match=f"{name} = {value:g} found; .*{allowed}"):
            photon_noise(**BOLOCAM | {name: value})
