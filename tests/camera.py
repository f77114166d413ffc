"""Parts of a scene whose noise follows from a chain of optical elements."""

from tests.scenes import SMALL_SCENE, without_sections

QUIET = without_sections(SMALL_SCENE, "atmosphere", "excess", "photon", "detector", "sky", "score").replace(
    '"average"', '"none"'
)
BAND = {"instrument.bandwidth": 0.15, "instrument.efficiency": 0.4, "instrument.polarizations": 1}
HORNS = {"instrument.horn_f_lambda": 1.0, "instrument.layout.pitch_f_lambda": 1.2}
PHOTON = '[photon]\ncoherence = "field"\n'
SITE = """
[atmosphere]
site = "mauna_kea"
spectral_index = "11/3"
layer_height = "1000 m"
illuminated_aperture = "8 m"
wind_median = "31 arcmin / s"
wind_log_scatter = 0.4
"""
CAMERA = """
[optics]
aperture = "10 m"
[optics.stop]
temperature = "4 K"
[[optics.elements]]
name = "mirrors"
side = "sky"
temperature = "270 K"
emissivity = 0.05
[[optics.elements]]
name = "filter"
side = "sky"
temperature = "50 K"
transmission = 0.9
emissivity = 0.02
[[optics.elements]]
name = "lens"
side = "detector"
temperature = "1 K"
transmission = 0.95
"""
STATED_SKY = CAMERA.replace('aperture = "10 m"', 'sky = "20 K"')
BOLOMETER = """
[detector.bolometer]
conductance = "100 pW / K"
critical_temperature = "165 mK"
bath_temperature = "100 mK"
exponent = 3
amplifier_nep = "5e-18 W / Hz(1/2)"
"""
