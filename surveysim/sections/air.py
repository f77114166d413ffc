"""The section of the atmosphere."""

from fractions import Fraction
from typing import Any, Self

from pydantic import Field, model_validator

from surveysim.quantities import B2s, Fluctuations, Index, Length, SiteName, SpeedExtent, Waters
from surveysim.sections.base import Section, check_knots, check_quantiles
from surveysim.sites import with_site
from surveysim.units import to_floats

_OF_SITE = {"otherwise": "the site's"}


class Atmosphere(Section):
    """The Kolmogorov-Taylor thin screen and the distributions that each observation draws from.

    A `site` gives the keys that the scene leaves out: layer height, wind, water and its fluctuations, from which B2
    follows. With `b2` beside a site the B2 that follows keeps its rank and takes these quantiles; without a site there
    is no water.
    """

    index: Index
    """b of the power spectrum B2 sin(el)^(1 - b) alpha^-b of the layer; 11/3 is Kolmogorov's."""
    illuminated_aperture_m: Length = Field(alias="illuminated_aperture")
    """Diameter of the aperture that is lit: a pixel sees the layer through a top hat of it."""
    outer_scale_m: Length | None = Field(alias="outer_scale", default=None)
    """Scale beyond which fluctuations no longer grow (von Karman). Needed for an index of 4 or more."""
    site: SiteName = None
    """Where the weather is from: its water and opacity, and the keys that are left out below."""
    layer_height_m: Length = Field(alias="layer_height", json_schema_extra=_OF_SITE)
    """Height of the layer above the telescope, at the zenith."""
    b2_probabilities: tuple[float, ...] = ()
    """Probabilities, between 0 and 1, of the quantiles `b2`."""
    b2: B2s = Field(default=(), json_schema_extra={"otherwise": "follows from the site"})
    """Quantiles of B2, the amplitude of the layer's power spectrum at the zenith, over the survey."""
    pwv_probabilities: tuple[float, ...] = Field(default=(), json_schema_extra=_OF_SITE)
    """Probabilities, from 0 to 1, of the quantiles `pwv`."""
    pwv_mm: Waters = Field(alias="pwv", default=(), json_schema_extra=_OF_SITE)
    """Quantiles of the precipitable water over the site at the zenith."""
    fluctuation_probabilities: tuple[float, ...] = Field(default=(), json_schema_extra=_OF_SITE)
    """Probabilities, between 0 and 1, of the quantiles `fluctuation`."""
    fluctuation: Fluctuations = Field(default=(), json_schema_extra=_OF_SITE)
    """Quantiles of (delta C / C)^2, the water's fractional fluctuations as an amplitude like B2."""
    wind_median_rad_s: SpeedExtent = Field(alias="wind_median", json_schema_extra=_OF_SITE)
    """Median angular speed of the layer, which blows from anywhere."""
    wind_log_scatter: float = Field(ge=0, le=2, json_schema_extra=_OF_SITE)
    """Scatter of the logarithm of that speed."""
    wind_b2_exponent: float = Field(ge=-2, le=2, default=0.0)
    """The median wind goes as this power of B2 over its median."""

    @model_validator(mode="before")
    @classmethod
    def _site_and_units_of_the_index(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        data = with_site(data)
        if "index" not in data:
            return data
        try:
            power = f"rad({2 - Fraction(str(data['index'])).limit_denominator(1000)})"
        except (ValueError, ZeroDivisionError):
            power = None  # one error is enough: the index is refused by its own check
        found = {}
        for name, unit in (("b2", f"mK2 {power}"), ("fluctuation", power)):
            try:
                found |= {name: to_floats(data[name], unit) if power else ()} if name in data else {}
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from None
        return data | found

    @model_validator(mode="after")
    def _distributions_are_whole(self) -> Self:
        if self.site is None and self.pwv_mm:
            raise ValueError("site: missing; 'pwv' needs the opacity of a site")
        if self.b2 or self.b2_probabilities:
            check_quantiles("b2", self.b2_probabilities, self.b2)
        elif self.site is None:
            raise ValueError("b2: missing; a distribution of B2, or a site that it follows from, is expected")
        if self.site is not None:
            check_quantiles("fluctuation", self.fluctuation_probabilities, self.fluctuation)
            check_knots("pwv_probabilities", self.pwv_probabilities, "pwv", self.pwv_mm)
            if min(self.pwv_probabilities) < 0 or max(self.pwv_probabilities) > 1:
                raise ValueError(f"pwv_probabilities: found {self.pwv_probabilities}; values from 0 to 1 are expected")
            if not min(self.pwv_mm + self.fluctuation) > 0:
                raise ValueError(f"pwv: found {self.pwv_mm} and {self.fluctuation}; values above 0 are expected")
        if self.index >= 4 and self.outer_scale_m is None:
            raise ValueError(f"outer_scale: missing; an index of {self.index:g} (4 or more) needs an outer scale")
        return self
