"""Layers of the atmosphere: their screens, shares of B2 and winds, as a scene lists them or from a profile.

A layer of thickness dh at the height h, with the three-dimensional power spectrum c(h) kappa^(-b) of the emission per
unit length (kappa in cycles per metre), has in angles on the sky the two-dimensional spectrum

    P(alpha) = c(h) dh h^(b - 2) alpha^(-b),

since waves along the line of sight cancel where the layer is thick in their units, and kappa = alpha / h. So a profile
c(h) has B2 in proportion to c(h) h^(b - 2) dh. For the exponential profile the density of the vapour falls as
exp(-h / H); fluctuations are in proportion to the density, so c is in proportion to exp(-2 h / H). The layers of a
profile are at the nodes x of the Gauss-Laguerre quadrature in x = 2 h / H, with shares in proportion to its weights
times x^(b - 2).
"""

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from surveysim.runtime.errors import OutOfRangeError, SceneError
from surveysim.scene.atmosphere import Atmosphere
from surveysim.scene.layers import Layer as LayerSection

if TYPE_CHECKING:
    from surveysim.atmosphere.screen_simulation import SlantStrips
    from surveysim.atmosphere.thin_screen import Screen
    from surveysim.atmosphere.weather import Weather

_PROFILE_LAYERS = 4
_EXTREME = 5.0  # standard deviations of a drift that no scan of a survey exceeds, but for 1e-6 of the scans


@dataclass(frozen=True)
class Layer:
    """One turbulent layer above the telescope.

    Attributes
    ----------
    number
        From 0; random numbers of a layer go by it.
    section
        Its section, as `layer_sections` fills it.
    b2_factor
        The layer's B2 over that of the scene: its share, in the unit rad^(own index - index of the scene).
    wind_factor
        Angular speed over that of the drawn wind.
    strips
        Strips of its screen, none drawn yet.
    """

    number: int
    section: LayerSection
    b2_factor: float
    wind_factor: float
    strips: "SlantStrips"

    def wind(self, weather: "Weather") -> tuple[float, float]:
        """Angular speed [rad/s] and direction [rad] of the layer in azimuth-elevation axes, without its drift."""
        return weather.wind_speed_rad_s * self.wind_factor, weather.wind_angle_rad + self.section.wind_turn_rad

    @property
    def fastest_factor(self) -> float:
        """Angular speed over that of the drawn wind that its drift hardly ever exceeds."""
        return self.wind_factor * (
            math.exp(_EXTREME * self.section.wind_drift.speed_rms) if self.section.wind_drift else 1
        )

    @property
    def part(self) -> str:
        """Name by which its random numbers are keyed; those of the first layer have none."""
        return f"layer {self.number}" if self.number else ""


def layer_sections(air: Atmosphere) -> tuple[LayerSection, ...]:
    """List the layers of an atmosphere, with all keys that their sections leave to it.

    They are those of the scene, or of its profile, or the one at `layer_height`.
    """
    given = air.layers or (_profile(air) if air.profile else (_one(air.layer_height_m, 1.0),))
    shared = {
        "spectral_index": air.spectral_index,
        "outer_scale_m": air.outer_scale_m,
        "decorrelation_time_s": air.decorrelation_time_s,
        "wind_drift": air.wind_drift,
    }
    return tuple(
        item.model_copy(update={key: value for key, value in shared.items() if getattr(item, key) is None})
        for item in given
    )


def _one(height_m: float, share: float) -> LayerSection:
    return LayerSection.model_construct(name=f"{height_m:.4g} m", height_m=height_m, share=share)


def _profile(air: Atmosphere) -> tuple[LayerSection, ...]:
    """Layers of an exponential profile."""
    from scipy.special import roots_laguerre

    node, weight = roots_laguerre(air.profile_layers or _PROFILE_LAYERS)
    strength = weight * node ** (air.spectral_index - 2)
    heights, shares = node * air.water_scale_height_m / 2, strength / strength.sum()
    if heights[0] < air.illuminated_aperture_m:
        raise SceneError(
            f"atmosphere.profile_layers: found {len(heights)}, the lowest at {heights[0]:.3g} m, below the width of the"
            f" aperture, {air.illuminated_aperture_m:g} m; fewer are expected"
        )
    return tuple(_one(*pair) for pair in zip(heights.tolist(), shares.tolist(), strict=True))


def b2_factor(air: Atmosphere, layer: LayerSection) -> float:
    """B2 of a layer over that of the scene [rad^(own index - index of the scene)]."""
    if layer.pivot_rad is None:
        return layer.share
    return float(layer.share * layer.pivot_rad ** (air.spectral_index - layer.spectral_index))


def wind_factor(air: Atmosphere, layer: LayerSection) -> float:
    """Angular wind speed of a layer over the drawn one."""
    return layer.wind_factor * (air.layer_height_m / layer.height_m)


def layer_screen(air: Atmosphere, layer: LayerSection) -> "Screen":
    """Make the thin screen of a layer at the zenith; raises SceneError where it has no closed form."""
    from surveysim.atmosphere.thin_screen import Screen

    outer = math.inf if layer.outer_scale_m is None else layer.outer_scale_m / layer.height_m
    try:
        return Screen(layer.spectral_index, air.illuminated_aperture_m / layer.height_m, outer)
    except OutOfRangeError as error:
        raise SceneError(f"atmosphere: {error}") from None


def dominant_wind(air: Atmosphere, weather: "Weather") -> "Weather":
    """Weather with the wind of the layer with the largest share of B2, in place of the drawn one."""
    layer = dominant_layer(air)
    return replace(
        weather,
        wind_speed_rad_s=weather.wind_speed_rad_s * wind_factor(air, layer),
        wind_angle_rad=weather.wind_angle_rad + layer.wind_turn_rad,
    )


def dominant_layer(air: Atmosphere) -> LayerSection:
    """Find the layer with the largest share of B2, the first of equal ones."""
    return max(layer_sections(air), key=lambda layer: layer.share)
