"""The section of the atmosphere."""

from fractions import Fraction
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from surveysim.runtime.errors import InputError
from surveysim.scene.fields import (
    B2_MAX,
    B2_MIN,
    FLUCTUATION_MAX,
    FLUCTUATION_MIN,
    B2s,
    Fluctuations,
    Index,
    Length,
    Probabilities,
    SiteName,
    SpeedExtent,
    Waters,
    number,
)
from surveysim.scene.section import Section, check_knots, check_quantiles
from surveysim.scene.sites import with_site
from surveysim.scene.units import shown, to_floats

KOLMOGOROV = Fraction(11, 3)  # the index that amplitudes of fluctuations in `sites.toml` belong to
_OF_SITE: Any = {"otherwise": "the site's"}


class Atmosphere(Section):
    """The Kolmogorov-Taylor thin screen and the distributions that each observation draws from.

    A `site` gives the keys that the scene leaves out: layer height, wind, water and its fluctuations, from which B2
    follows. With `b2` beside a site the B2 that follows keeps its rank and takes these quantiles; without a site there
    is no water.
    """

    spectral_index: Index
    """b of the power spectrum B2 sin(el)^(1 - b) alpha^-b of the layer; 11/3 is Kolmogorov's."""
    illuminated_aperture_m: Length = Field(alias="illuminated_aperture")
    """Diameter of the aperture that is lit: a pixel sees the layer through a top hat of it."""
    outer_scale_m: Length | None = Field(alias="outer_scale", default=None)
    """Scale beyond which fluctuations no longer grow (von Karman), no less than the aperture. Needed for an index of 4
    or more."""
    site: SiteName = None
    """Where the weather is from: its water and opacity, and the keys that are left out below."""
    layer_height_m: Length = Field(alias="layer_height", json_schema_extra=_OF_SITE)
    """Height of the layer above the telescope, at the zenith."""
    b2_probabilities: Probabilities = ()
    """Probabilities, between 0 and 1, of the quantiles `b2`."""
    b2: B2s = Field(default=(), json_schema_extra={"otherwise": "follows from the site"})
    """Quantiles of B2, the amplitude of the layer's power spectrum at the zenith, over the survey."""
    pwv_probabilities: Probabilities = Field(default=(), json_schema_extra=_OF_SITE)
    """Probabilities of the quantiles `pwv`: the first is 0 and the last 1, or there is one value alone."""
    pwv_mm: Waters = Field(alias="pwv", default=(), json_schema_extra=_OF_SITE)
    """Quantiles of the precipitable water over the site at the zenith, from the driest to the wettest; ln PWV is linear
    in the probability between them. One value: the same water in all observations."""
    water_fluctuation_probabilities: Probabilities = Field(default=(), json_schema_extra=_OF_SITE)
    """Probabilities, between 0 and 1, of the quantiles `water_fluctuation`."""
    water_fluctuation: Fluctuations = Field(default=(), json_schema_extra=_OF_SITE)
    """Quantiles of (delta C / C)^2, the water's fractional fluctuations as an amplitude like B2. A site's are those of
    an index of 11/3: with another index this key is needed, or `b2`, beside which its ranks alone count."""
    wind_median_rad_s: SpeedExtent = Field(alias="wind_median", json_schema_extra=_OF_SITE)
    """Median angular speed of the layer, which blows from anywhere."""
    wind_log_scatter: Annotated[float, *number(0, 2)] = Field(json_schema_extra=_OF_SITE)
    """Scatter of the logarithm of that speed."""
    wind_b2_exponent: Annotated[float, *number(-2, 2)] = 0.0
    """The median wind goes as this power of B2 over its median."""

    @model_validator(mode="before")
    @classmethod
    def _site_and_units_of_the_index(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        data, own = with_site(data), data
        if "spectral_index" not in data:
            return data
        try:
            index = Fraction(str(data["spectral_index"])).limit_denominator(1000)
            power = f"rad({2 - index})"
        except (ValueError, ZeroDivisionError, OverflowError):
            index = power = None  # one error is enough: the index is refused by its own check
        of_water = power
        if (
            power
            and index > 0
            and index != KOLMOGOROV
            and "water_fluctuation" in data
            and "water_fluctuation" not in own
        ):
            if "b2" not in own:
                raise ValueError(
                    f"water_fluctuation: missing; those of site {data['site']!r} are amplitudes at an index of"
                    f" {KOLMOGOROV}: with {index}, 'water_fluctuation' in {power} or 'b2' in mK2 {power} is expected"
                )
            # B2 has quantiles of its own, of which each draw takes that of its rank: an amplitude's unit drops out.
            of_water = f"rad({2 - KOLMOGOROV})"
        found: dict[str, Any] = {}
        for name, unit in (("b2", f"mK2 {power}"), ("water_fluctuation", of_water)):
            try:
                found |= {name: to_floats(data[name], unit) if power else ()} if name in data else {}
            except InputError as error:
                raise ValueError(f"{name}: {error}") from None
        return data | found

    @model_validator(mode="after")
    def _distributions_are_whole(self) -> Self:
        if self.site is None and self.pwv_mm:
            raise ValueError("site: missing; 'pwv' needs the opacity of a site")
        if self.b2 or self.b2_probabilities:
            check_quantiles("b2", self.b2_probabilities, self.b2)
            if not all(value == 0 or B2_MIN <= value <= B2_MAX for value in self.b2):
                raise ValueError(f"b2: found {shown(self.b2)}; 0 or values from {B2_MIN:g} to {B2_MAX:g} are expected")
        elif self.site is None:
            raise ValueError("b2: missing; a distribution of B2, or a site that it follows from, is expected")
        if self.site is not None:
            check_quantiles("water_fluctuation", self.water_fluctuation_probabilities, self.water_fluctuation)
            check_knots("pwv_probabilities", self.pwv_probabilities, "pwv", self.pwv_mm)
            if len(self.pwv_mm) > 1 and (self.pwv_probabilities[0], self.pwv_probabilities[-1]) != (0, 1):
                raise ValueError(
                    f"pwv_probabilities: found {shown(self.pwv_probabilities)}; 0 first and 1 last are expected, the"
                    " driest and the wettest water, or one value alone"
                )
            for key, values in (("pwv", self.pwv_mm), ("water_fluctuation", self.water_fluctuation)):
                if not min(values) > 0:
                    raise ValueError(f"{key}: found {shown(values)}; values above 0 are expected")
            if not FLUCTUATION_MIN <= min(self.water_fluctuation) <= max(self.water_fluctuation) <= FLUCTUATION_MAX:
                raise ValueError(
                    f"water_fluctuation: found {shown(self.water_fluctuation)}; values from {FLUCTUATION_MIN:g} to"
                    f" {FLUCTUATION_MAX:g} are expected"
                )
        if self.layer_height_m < self.illuminated_aperture_m:
            raise ValueError(
                f"layer_height: found {self.layer_height_m:g} m with an aperture of {self.illuminated_aperture_m:g} m; "
                "no less than the aperture is expected, as the layer is seen through D / h radian"
            )
        if self.outer_scale_m is not None and self.outer_scale_m < self.illuminated_aperture_m:
            raise ValueError(
                f"outer_scale: found {self.outer_scale_m:g} m with an aperture of {self.illuminated_aperture_m:g} m; "
                "no less than the aperture is expected"
            )
        if self.spectral_index >= 4 and self.outer_scale_m is None:
            raise ValueError(
                f"outer_scale: missing; an index of {self.spectral_index:g} (4 or more) needs an outer scale"
            )
        return self
