"""The section of the atmosphere."""

from fractions import Fraction
from typing import Any, Self

from pydantic import Field, model_validator

from surveysim.quantities import Index, Length, SiteName, SpeedExtent, Waters
from surveysim.sections.base import Section, check_knots, check_quantiles
from surveysim.sites import with_site
from surveysim.units import to_floats


class Atmosphere(Section):
    """The Kolmogorov-Taylor thin screen and the distributions that each observation draws from.

    A `site` gives the keys that the scene leaves out: layer height, wind, the precipitable water (`pwv`) and its
    fractional fluctuations (`fluctuation`, (delta C / C)^2 as an amplitude like B2), from which B2 follows. With
    `b2` beside a site the B2 that follows keeps its rank and takes these quantiles; without a site there is no water.
    """

    index: Index
    illuminated_aperture_m: Length = Field(alias="illuminated_aperture")
    outer_scale_m: Length | None = Field(alias="outer_scale", default=None)
    site: SiteName = None
    layer_height_m: Length = Field(alias="layer_height")
    b2_probabilities: tuple[float, ...] = ()
    b2: tuple[float, ...] = ()
    pwv_probabilities: tuple[float, ...] = ()
    pwv_mm: Waters = Field(alias="pwv", default=())
    fluctuation_probabilities: tuple[float, ...] = ()
    fluctuation: tuple[float, ...] = ()
    wind_median_rad_s: SpeedExtent = Field(alias="wind_median")
    wind_log_scatter: float = Field(ge=0, le=2)
    wind_b2_exponent: float = Field(ge=-2, le=2, default=0.0)

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
