"""Each kind of metric on maps whose answer is known, and the responses that errors are made of."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mapmaker.bandpower import bin_weights, flat_band_power, flat_spectrum_psd
from surveysim.metrics import array_net, band_powers, largest_scale, time_to
from surveysim.metrics import flat_band_power as flat
from surveysim.metrics.errors import quantity_responses
from surveysim.metrics.map_noise import MapNoise, Quantity, ScoredMap
from surveysim.runtime.errors import SceneError
from surveysim.scene.metrics import ArrayNet, BandPowers, FlatBandPower, LargestScale, TimeTo
from surveysim.scene.scene import load_scene
from tests.scenes import SMALL_SCENE, write_scene

EDGES = np.arange(0.0, 12_500, 500)
ELL = (EDGES[1:] + EDGES[:-1]) / 2
N_MODES = 0.2 * ELL
EXPOSURE = 4e8  # detector-seconds per sr
N_DET = 25


def scored_map(correlation=0.0) -> ScoredMap:
    """A map without beam, whose taper does not couple multipoles but for `correlation`."""
    return ScoredMap(
        ell=ELL,
        edges_ell=EDGES,
        n_modes=N_MODES,
        selected=ELL > 4000,
        correlation=np.full(len(ELL) - 1, correlation),
        flat_psd=flat_spectrum_psd(ELL),
        hours=10.0,
        scan_hours=9.0,
        ukcmb_per_mk=1650.0,
        psd_of=lambda spectrum: spectrum(ELL),
        power_of=lambda profile: profile(ELL) ** 2,
        beam_sr=1e-7,
        mjy_per_mk=30.0,
        sz_ukcmb=-2.7e6,
    )


def map_noise(noise=1e-2, transmission=1.0, **changes) -> MapNoise:
    ones = np.ones(len(ELL))
    return MapNoise(scored_map(**changes), "actual", N_DET, noise * ones, transmission * ones, lambda: EXPOSURE)


def options(kind, **keys):
    return kind.model_validate({"kind": kind.model_fields["kind"].annotation.__args__[0], **keys})


def found(metric, noise, chosen, **others) -> dict[str, Quantity]:
    quantities = metric.quantities(noise, chosen, **others)
    assert tuple(item.name for item in quantities) == chosen.quantity_names
    return {item.name: item for item in quantities}


# ---------------------------------------------------------------- responses


def test_finite_differences_are_the_closed_form():
    noise = map_noise(1e-2 * (1 + 2000 / ELL), ELL / (ELL + 1500))
    weight = bin_weights(noise.noise_psd, noise.signal_psd, N_MODES, noise.map.selected)

    def without_closed_form(noise):
        return tuple(replace(item, response=None) for item in flat.quantities(noise, FlatBandPower()))

    _, of_noise, of_transmission = quantity_responses(without_closed_form, noise)["sigma"]
    np.testing.assert_allclose(of_noise, weight, atol=1e-8)
    np.testing.assert_allclose(of_transmission, -weight, atol=1e-8)


@pytest.mark.parametrize("metric, chosen", [(flat, FlatBandPower()), (array_net, options(ArrayNet))])
def test_closed_forms_of_responses(metric, chosen):
    noise = map_noise(1e-2 * (1 + 2000 / ELL), ELL / (ELL + 1500))
    for name, item in found(metric, noise, chosen).items():
        for place in (3, 10, 20):
            factor = np.where(np.arange(len(ELL)) == place, 1.001, 1.0)
            for key, sign in (("noise", 1), ("transmission", -1)):
                up, down = (found(metric, noise.scaled(**{key: x}), chosen)[name].value for x in (factor, 1 / factor))
                slope = np.log(up / down) / (2 * np.log(1.001))
                assert slope == pytest.approx(sign * item.response[place], abs=1e-6)


# ---------------------------------------------------------------- band powers


def test_one_ring_has_the_error_of_knox():
    """``sqrt(2 / n) (C + N)`` in units of band power, for rings that the taper does not couple."""
    chosen = options(BandPowers, edges=[5000, 5500, 6000], spectrum="poisson", band_power="100 uK2")
    values = found(band_powers, map_noise(), chosen)
    for place, (low, high) in ((10, chosen.bins[0]), (11, chosen.bins[1])):
        power = 100 * ELL[place] * (ELL[place] + 1) / (3000 * 3001)
        noise = 1e-2 / flat_spectrum_psd(ELL[place])
        assert values[f"sigma_{low}_{high}"].value == pytest.approx(math.sqrt(2 / N_MODES[place]) * noise)
        assert values[f"total_{low}_{high}"].value == pytest.approx(math.sqrt(2 / N_MODES[place]) * (noise + power))


def test_flat_spectrum_in_all_bins_is_the_flat_band_power():
    """A faint one, whose own variance does not matter."""
    chosen = options(BandPowers, edges=[4000, 7000, 12_000], spectrum="flat", band_power="0.001 uK2")
    noise = map_noise(1e-2 * (1 + 2000 / ELL), ELL / (ELL + 1500))
    sigma = found(flat, noise, FlatBandPower())["sigma"].value
    values = found(band_powers, noise, chosen)
    assert 1e-3 * values["amplitude"].value == pytest.approx(sigma, rel=1e-6)
    bins = [values[f"sigma_{low}_{high}"].value for low, high in chosen.bins]
    assert np.sum(np.power(bins, -2)) ** -0.5 == pytest.approx(sigma, rel=1e-6)


def test_coupling_moves_variance_to_the_neighbour():
    """A sum over all rings keeps its variance, up to the ends of the range."""
    edges = list(range(4000, 12_000, 500))
    chosen = options(BandPowers, edges=edges, spectrum="flat", band_power="1000 uK2")
    for own_variance in (False, True):
        alone, coupled = (
            band_powers.covariance(map_noise(correlation=r), chosen, own_variance=own_variance) for r in (0.0, 0.1)
        )
        np.testing.assert_allclose(np.diag(coupled), np.diag(alone) / 1.2, rtol=1e-12)
        np.testing.assert_allclose(np.diag(coupled, 1) ** 2, 0.01 * np.diag(coupled)[1:] * np.diag(coupled)[:-1])
        rings = len(edges) - 1
        flat_sum = 1 / np.sqrt(np.diag(alone))
        expected = 1 - 2 * 0.1 / 1.2 / rings
        assert flat_sum @ coupled @ flat_sum / rings == pytest.approx(expected, rel=1e-12)


def test_spectra_have_their_band_power_at_the_pivot():
    for name, index in (("flat", 0), ("poisson", 2), ("clustered", 0.75)):
        chosen = options(BandPowers, edges=[2500, 3000, 3500], spectrum=name, band_power="50 uK2")
        expected = [50 * (ell / 3000) ** index for ell in (2750, 3250)]
        np.testing.assert_allclose(band_powers.fiducial_powers(scored_map(), chosen), expected, rtol=1e-4)


TABLE = """# %ECSV 1.0
# ---
# datatype:
# - {name: ell, datatype: float64}
# - {name: cl, unit: UNIT, datatype: float64}
# schema: astropy-2.0
ell cl
"""


def band_scene(folder: Path, rows: str, unit: str = "uK2") -> Path:
    (folder / "cl.ecsv").write_text(TABLE.replace("UNIT", unit) + rows)
    entry = '\n[[score.metrics]]\nkind = "band_powers"\nedges = [2000, 12000]\nspectrum = "cl.ecsv"\n'
    return write_scene(folder, SMALL_SCENE + entry)


def test_a_table_is_a_spectrum(tmp_path):
    """Linear in band power between rows, in any unit of temperature."""
    rows = "".join(f"{ell} {50e-12 * 2 * math.pi / ell / (ell + 1)}\n" for ell in (1, 900, 20_000))
    (item,) = load_scene(band_scene(tmp_path, rows, "K2")).score.metrics
    np.testing.assert_allclose(band_powers.fiducial_powers(scored_map(), item), 50)


@pytest.mark.parametrize(
    "rows, unit, message",
    [
        ("100 1\n20000 1\n", "mJy", "column 'cl': found the unit 'mJy'"),
        ("100 1\n20000 -1\n", "uK2", "row 2, column 'cl': found -1 uK2, and 0 or more is allowed"),
        ("100 1\n90 1\n", "uK2", "row 2, column 'ell': found 90, and more than 0 and than in the row before is"),
        ("100 1\n", "uK2", "found 1 rows, and two or more are needed"),
        ("100 1\n9000 1\n", "uK2", "found ell from 100 to 9000; a table that covers the bins, 2000 to 12000, is"),
    ],
)
def test_wrong_tables_name_row_and_column(tmp_path, rows, unit, message):
    with pytest.raises(SceneError) as error:
        load_scene(band_scene(tmp_path, rows, unit))
    assert message in str(error.value) and "score.metrics.0.spectrum: " in str(error.value)


# ---------------------------------------------------------------- the others


@pytest.mark.parametrize("half", [2200.0, 3333.0, 9000.0])
def test_largest_scale_is_where_half_is_left(half):
    noise = map_noise(transmission=1 / (1 + (half / ELL) ** 4))
    assert found(largest_scale, noise, options(LargestScale))["ell"].value == pytest.approx(half, rel=0.003)


@pytest.mark.parametrize("transmission, side", [(0.6, "below the lowest bin, ell = 250"), (0.4, "above the highest")])
def test_largest_scale_outside_the_bins_is_told(transmission, side):
    item = found(largest_scale, map_noise(transmission=transmission), options(LargestScale))["ell"]
    assert math.isnan(item.value) and item.note.startswith(side)


def test_array_net_of_white_noise_is_the_detectors():
    """N = NET^2 / exposure, whatever the multipoles; half of the signal's power costs half of the noise's."""
    net_mk = 1.5
    noise = map_noise((net_mk * 1650) ** 2 / EXPOSURE)
    values = {name: item.value for name, item in found(array_net, noise, options(ArrayNet)).items()}
    assert values == pytest.approx(
        {"array_rj": 0.3, "array_cmb": 0.495, "detector_rj": 1.5, "detector_cmb": 1.5 * 1.65}, rel=1e-12
    )
    lossy = found(array_net, noise.scaled(transmission=0.5), options(ArrayNet))
    assert lossy["detector_rj"].value == pytest.approx(1.5 * math.sqrt(2), rel=1e-12)


def _sigma(noise):
    return flat.quantities(noise, FlatBandPower())[0]


def _hours(target, value, noise):
    chosen = options(TimeTo, of="flat_band_power.sigma", value=value)
    return found(time_to, noise, chosen, target=target)["hours"]


def test_time_goes_as_one_over_an_error_of_noise():
    sigma = _sigma(map_noise()).value
    for factor in (1e-3, 0.5, 1.0, 7.0):
        assert _hours(_sigma, factor * sigma, map_noise()).value == pytest.approx(10 / factor, rel=1e-9)


def test_time_with_the_signals_own_variance():
    """One ring: ``a = sqrt(2/n) (1 + N / S)`` is reached at ``t = (N / S) / (a sqrt(n/2) - 1)``, if ever."""
    chosen = options(BandPowers, edges=[5000, 5500], spectrum="flat", band_power="1000 uK2")
    noise, least = map_noise(), math.sqrt(2 / N_MODES[10])

    def target(noise):
        return band_powers.quantities(noise, chosen)[-1]

    share = 1e-2 / (1000 * flat_spectrum_psd(ELL[10]))
    for factor in (1.01, 2.0, 100.0):
        assert _hours(target, factor * least, noise).value == pytest.approx(10 * share / (factor - 1), rel=1e-6)
    never = _hours(target, 0.99 * least, noise)
    assert never.value == math.inf and never.note.startswith("never: ")


def test_time_of_what_does_not_depend_on_it():
    def scale(noise):
        return largest_scale.quantities(noise, options(LargestScale))[0]

    noise = map_noise(transmission=1 / (1 + (3000 / ELL) ** 4))
    assert _hours(scale, 4000, noise).value == 0 and _hours(scale, 2000, noise).value == math.inf
    nothing = _hours(scale, 2000, map_noise())
    assert math.isnan(nothing.value) and "has no value: below the lowest bin" in nothing.note


def test_time_of_a_quantity_that_should_grow():
    def speed(noise):
        return Quantity("speed", 1 / _sigma(noise).value, "", lower_is_better=False)

    now = speed(map_noise()).value
    assert _hours(speed, 3 * now, map_noise()).value == pytest.approx(30, rel=1e-9)


def test_sigma_is_that_of_the_mapmaker():
    noise = map_noise(1e-2 * (1 + 2000 / ELL), ELL / (ELL + 1500))
    scored = noise.noise_psd, noise.signal_psd, N_MODES, noise.map.selected
    assert _sigma(noise).value == pytest.approx(flat_band_power(*scored), rel=1e-14)
