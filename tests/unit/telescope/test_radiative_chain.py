"""Radiative chains against closed forms: limits of Planck's law, single elements, isothermal chains."""

import math

import numpy as np
import pytest
from scipy.integrate import quad

from surveysim.scene.passband import Passband, top_hat
from surveysim.scene.units import BOLTZMANN_J_K, PLANCK_J_S
from surveysim.telescope.photon_noise import amplitude_weights, chain_noise, photon_noise
from surveysim.telescope.radiative_chain import (
    DETECTOR,
    SKY,
    STOP,
    RadiativeChain,
    Surface,
    black_body,
    coupling,
    emitter,
    stated,
)

BAND = top_hat(150e9, 0.25)
NU = BAND.nodes[0]
TRIANGLE = Passband((120e9, 150e9, 165e9), (0.0, 0.9, 0.0))


def occupation(nu, kelvin):
    return 1 / math.expm1(PLANCK_J_S * nu / (BOLTZMANN_J_K * kelvin))


def warm(kelvin, nodes=NU):
    """A source without anything before it."""
    return emitter("source", SKY, kelvin, nodes, transmission=0.0)


def losses(kelvin, nodes=NU):
    """Absorbing surfaces at one temperature, flat and sloped, with a stop."""
    slope = np.linspace(0.4, 0.9, len(nodes))
    return (
        emitter("mirror", SKY, kelvin, nodes, transmission=0.97),
        emitter("window", SKY, kelvin, nodes, transmission=slope),
        emitter("stop", STOP, kelvin, nodes, transmission=0.55),
        emitter("lens", DETECTOR, kelvin, nodes, emissivity=0.2, transmission=0.8),
    )


@pytest.mark.parametrize("kelvin", [0.3, 4.0, 280.0])
def test_isothermal_chain_is_a_black_body(kelvin):
    """Whatever the losses: each surface emits as much as it absorbs."""
    chain = RadiativeChain(BAND, 1, (warm(kelvin), *losses(kelvin)))
    np.testing.assert_allclose(chain.occupation.sum(axis=0), [occupation(nu, kelvin) for nu in NU], rtol=1e-13)


def test_reflection_emits_nothing():
    chain = RadiativeChain(BAND, 1, (warm(280.0), emitter("f", SKY, 280.0, NU, transmission=0.9, emissivity=0.04)))
    np.testing.assert_allclose(chain.occupation.sum(axis=0), 0.94 * black_body(NU, 280.0), rtol=1e-14)


def test_order_counts():
    """What comes later dims what comes before, and nothing else."""
    mirror, window, stop, lens = losses(100.0)
    chain = RadiativeChain(BAND, 1, (mirror, window, stop, lens, coupling(NU, 0.5)))
    np.testing.assert_allclose(chain.to_detector[0], window.transmission * 0.55 * 0.8 * 0.5, rtol=1e-14)
    np.testing.assert_allclose(chain.to_detector[3], 0.5, rtol=1e-14)
    np.testing.assert_allclose(chain.to_detector[4], 1.0)
    np.testing.assert_allclose(chain.transmission, 0.97 * window.transmission * 0.55 * 0.8 * 0.5, rtol=1e-14)
    np.testing.assert_allclose(chain.occupation[2], 0.45 * 0.8 * 0.5 * black_body(NU, 100.0), rtol=1e-14)


@pytest.mark.parametrize("polarizations", [1, 2])
@pytest.mark.parametrize("kelvin", [2.7255, 20.0, 300.0])
def test_single_black_body_by_quadrature(kelvin, polarizations):
    """P = n_pol int h nu n, shot noise 2 int h nu P_nu and wave noise 2 int P_nu^2 / n_pol over a top hat."""
    found = chain_noise(RadiativeChain(BAND, polarizations, (warm(kelvin), coupling(NU, 0.3))))

    def density(nu):
        return polarizations * PLANCK_J_S * nu * 0.3 * occupation(nu, kelvin)

    for value, of in (
        (found.power_w, density),
        (found.shot_nep2, lambda nu: 2 * PLANCK_J_S * nu * density(nu)),
        (found.bose_nep2, lambda nu: 2 * density(nu) ** 2 / polarizations),
    ):
        scale = of(150e9)
        expected = quad(lambda nu, of=of, scale=scale: of(nu) / scale, *BAND.edges_hz, epsabs=0, epsrel=1e-12)[0]
        assert value == pytest.approx(expected * scale, rel=1e-11)


def test_rayleigh_jeans_limit():
    """A hot black body is a load of its temperature less h nu / 2 k, to (h nu / k T)^2 / 12."""
    kelvin = 9000.0
    x = PLANCK_J_S * 150e9 / (BOLTZMANN_J_K * kelvin)
    hot = chain_noise(RadiativeChain(BAND, 2, (warm(kelvin), coupling(NU, 0.3))))
    load = photon_noise(kelvin * (1 - x / 2), 150e9, 0.25, 0.3, polarizations=2)
    assert hot.power_w == pytest.approx(load.power_w, rel=x**2)
    assert hot.shot_nep2 == pytest.approx(load.shot_nep2, rel=x**2)
    assert hot.bose_nep2 == pytest.approx(load.bose_nep2, rel=x**2)
    assert x < 1e-3


def test_wien_limit():
    """Of a cold load photons come one by one: wave over shot noise is the occupation number, e^-x."""
    narrow = top_hat(150e9, 1e-4)
    nodes = narrow.nodes[0]
    kelvin = 0.3
    x = PLANCK_J_S * 150e9 / (BOLTZMANN_J_K * kelvin)
    found = chain_noise(RadiativeChain(narrow, 1, (warm(kelvin, nodes),)))
    assert x > 20
    assert found.power_w == pytest.approx(PLANCK_J_S * 150e9 * math.exp(-x) * 15e6, rel=1e-5)
    assert found.bose_nep2 / found.shot_nep2 == pytest.approx(math.exp(-x), rel=1e-5)


def test_transmission_of_the_band_enters_wave_noise_twice():
    """A triangle of peak 1 and base B has int t = B / 2, for shot noise, and int t^2 = B / 3, for wave noise."""
    nodes = TRIANGLE.nodes[0]
    found = chain_noise(RadiativeChain(TRIANGLE, 1, (stated("load", SKY, 10.0, nodes), coupling(nodes, 0.5))))
    power_per_hz = BOLTZMANN_J_K * 10.0 * 0.5
    assert found.power_w == pytest.approx(power_per_hz * 45e9 / 2, rel=1e-12)
    assert found.bose_nep2 == pytest.approx(2 * power_per_hz**2 * 45e9 / 3, rel=1e-12)
    assert found.shot_nep2 == pytest.approx(2 * PLANCK_J_S * TRIANGLE.centre_hz * found.power_w, rel=1e-12)
    assert found.w_per_k == pytest.approx(BOLTZMANN_J_K * 0.5 * 45e9 / 2, rel=1e-12)


def test_temperatures_above_the_atmosphere():
    """dP/dT of the CMB is the slope of a black body's power at 2.7255 K."""
    chain = RadiativeChain(BAND, 1, (*losses(250.0), coupling(NU, 0.4)))

    def power(kelvin):
        return float(chain.power_w(black_body(NU, kelvin) * chain.transmission))

    step = 1e-4
    slope = (power(2.7255 + step) - power(2.7255 - step)) / (2 * step)
    assert chain.w_per_k_cmb == pytest.approx(slope, rel=1e-7)
    hot = 1e6
    assert chain.w_per_k == pytest.approx((power(hot + 1) - power(hot - 1)) / 2, rel=1e-6)


def test_weights_are_parts_of_the_occupation_number():
    """Of one temperature before and at the stop: eta, 1 - eta, less what the lens behind it adds."""
    flat = warm(100.0), emitter("stop", STOP, 100.0, NU, transmission=0.6)
    aperture, stop = amplitude_weights(RadiativeChain(BAND, 1, (*flat, coupling(NU, 0.3))))
    assert (aperture, stop) == (pytest.approx(0.6, rel=1e-13), pytest.approx(0.4, rel=1e-13))
    lens = emitter("lens", DETECTOR, 100.0, NU, transmission=0.75)
    aperture, stop = amplitude_weights(RadiativeChain(BAND, 1, (*flat, lens)))
    assert (aperture, stop) == (pytest.approx(0.45, rel=1e-13), pytest.approx(0.3, rel=1e-13))


def test_weights_are_averages_over_the_wave_noise():
    """Half of a band is sky, half stop: the louder half counts by its square."""
    low = NU < 150e9
    sky, stop = np.where(low, 3.0, 0.0), np.where(low, 0.0, 1.0)
    ones = np.ones(len(NU))
    surfaces = Surface("sky", SKY, None, sky / NU, ones), Surface("stop", STOP, None, stop / NU, ones)
    aperture, stopped = amplitude_weights(RadiativeChain(BAND, 1, surfaces))
    assert (aperture, stopped) == (pytest.approx(0.9, rel=1e-12), pytest.approx(0.1, rel=1e-12))


def test_nothing_that_emits_has_no_weights():
    chain = RadiativeChain(BAND, 1, (coupling(NU, 0.3),))
    assert amplitude_weights(chain) == (0.0, 0.0)
    assert chain_noise(chain).psd_mk2_hz == 0
