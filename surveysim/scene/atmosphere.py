"""Section [atmosphere]: the turbulent layer, its weather and the site."""

from fractions import Fraction
from functools import cached_property
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationInfo, model_validator

from surveysim.runtime.errors import InputError
from surveysim.scene.fields import (
    B2_MAX,
    B2_MIN,
    FLUCTUATION_MAX,
    FLUCTUATION_MIN,
    B2s,
    Duration,
    Fluctuations,
    Index,
    Length,
    Positive,
    Probabilities,
    SiteName,
    SpeedExtent,
    TableFile,
    Waters,
    file_path,
    number,
    whole,
)
from surveysim.scene.layers import Layer, WindDrift, check_layers
from surveysim.scene.section import Section, check_knots, check_quantiles
from surveysim.scene.sites import with_site
from surveysim.scene.units import shown, to_floats
from surveysim.scene.weather_table import OF_B2, WeatherTable, weather_table, with_table

KOLMOGOROV = Fraction(11, 3)  # the index that amplitudes of fluctuations in `sites.toml` belong to
_OF_SITE: Any = {"otherwise": "the site's"}


def _power(index: float | Fraction) -> str:
    """Unit of an amplitude of fluctuations at a spectral index."""
    return f"rad({2 - Fraction(str(index)).limit_denominator(1000)})"


class Atmosphere(Section):
    """Kolmogorov-Taylor thin screen, and the distributions from which the weather of each observation is drawn.

    A `site`, or else a section [site], supplies the keys that the scene leaves out: layer height, wind, water vapour
    and its fluctuations, which determine B2. The water of a section [site] is the scene's own. If `b2` is given as
    well, B2 follows these quantiles, at the rank of the drawn water. Without a site there is no water vapour.
    """

    turbulence: Literal["layer", "none"] = "layer"
    """"none" leaves the turbulent layer out of the time-streams. The weather, the opacity and the optical load stay as
    they are, and so does excess noise that depends on B2."""
    spectral_index: Index
    """Spectral index b of the layer's power spectrum B2 sin(el)^(1 - b) alpha^-b; Kolmogorov turbulence has 11/3."""
    illuminated_aperture_m: Length = Field(alias="illuminated_aperture")
    """Diameter of the illuminated aperture, the width of a pixel's top-hat beam at the layer."""
    outer_scale_m: Length | None = Field(alias="outer_scale", default=None)
    """Outer scale of the turbulence (von Karman), no smaller than the illuminated aperture. Required for a spectral
    index of 4 or more."""
    site: SiteName = None
    """Site that supplies place, water vapour, opacity and the keys that are left out. Not with a section [site]."""
    layer_height_m: Length = Field(alias="layer_height", json_schema_extra=_OF_SITE)
    """Height of the layer above the telescope. With several layers, the height that the drawn wind belongs to: the
    angular speed times this height is the wind in m/s."""
    layers: tuple[Layer, ...] = ()
    """Turbulent layers. Without them there is one, at `layer_height`. Not with a `profile`."""
    profile: Literal["exponential"] | None = None
    """Makes layers from a profile of the water vapour. "exponential": the power of fluctuations at a height is
    proportional to the square of the water's density, which falls exponentially."""
    profile_layers: Annotated[int, *whole(1, 20)] | None = Field(default=None, json_schema_extra={"otherwise": "4"})
    """Number of layers of the `profile`."""
    water_scale_height_m: Length | None = Field(alias="water_scale_height", default=None, json_schema_extra=_OF_SITE)
    """Scale height of the density of water vapour, for a `profile`."""
    decorrelation_time_s: Duration | None = Field(alias="decorrelation_time", default=None)
    """Time T in which the pattern of each layer evolves, beside its motion: the correlation at a lag t < 2 T is
    (1 - t / 2 T) cos(pi t / 2 T) + sin(pi t / 2 T) / pi, 0.76 at T / 2 and 0.32 at T, and none beyond 2 T. Without
    it the layers are frozen."""
    b2_probabilities: Probabilities = ()
    """Probabilities of the quantiles `b2`, between 0 and 1."""
    b2: B2s = Field(default=(), json_schema_extra={"otherwise": "follows from the site"})
    """Quantiles of B2, the amplitude of the layer's power spectrum at the zenith."""
    pwv_probabilities: Probabilities = Field(default=(), json_schema_extra=_OF_SITE)
    """Probabilities of the quantiles `pwv`, from 0 to 1; a single value for constant water vapour."""
    pwv_mm: Waters = Field(alias="pwv", default=(), json_schema_extra=_OF_SITE)
    """Quantiles of precipitable water vapour (PWV) at the zenith; ln PWV is interpolated linearly in probability. A
    single value holds for all observations."""
    pwv_by_month: tuple[Waters, ...] = Field(default=(), json_schema_extra=_OF_SITE)
    """In place of `pwv`: its quantiles in each of the 12 months. A [schedule] gives each observation its month, in
    local mean solar time; without one all months are equally likely."""
    pwv_by_hour: tuple[Positive, ...] = Field(default=(), json_schema_extra=_OF_SITE)
    """With `pwv_by_month`: factors of the water in each of the 24 hours of local mean solar time."""
    water_fluctuation_probabilities: Probabilities = Field(default=(), json_schema_extra=_OF_SITE)
    """Probabilities of the quantiles `water_fluctuation`, between 0 and 1."""
    water_fluctuation: Fluctuations = Field(default=(), json_schema_extra=_OF_SITE)
    """Quantiles of (delta C / C)^2, the amplitude of the power spectrum of fractional water fluctuations. The values of
    a site hold for a spectral index of 11/3; another index requires this key or `b2`."""
    wind_median_rad_s: SpeedExtent = Field(alias="wind_median", json_schema_extra=_OF_SITE)
    """Median angular speed of the wind in the layer; its direction is uniformly distributed."""
    wind_log_scatter: Annotated[float, *number(0, 2)] = Field(json_schema_extra=_OF_SITE)
    """Standard deviation of the natural logarithm of the wind speed."""
    wind_b2_exponent: Annotated[float, *number(-2, 2)] = 0.0
    """Exponent of the median wind speed as a power of B2 over its median."""
    wind_drift: WindDrift | None = None
    """Slow changes of the wind within an observation, for all layers without a section of their own. Without it the
    wind is constant."""
    correlation_time_s: Duration | None = Field(alias="correlation_time", default=None)
    """Time in which the weather of the observations drifts: water, B2 (or the water fluctuation) and wind of two
    observations correlate by exp(-lag / time). Their distributions stay the same. It needs a [schedule]. Without it
    observations have independent weather."""
    weather_table: TableFile = None
    """ECSV table of the weather of real nights, in place of distributions: a column `time` (UTC; MJD, or ISO 8601) and
    some of `pwv`, `b2` or `water_fluctuation`, `wind_speed` (in the layer, as a length or an angle over time) and
    `wind_direction` (that it comes from, from north through east). Rows are interpolated to the middle of each
    observation; quantities without a column are drawn. It needs a [schedule], and replaces keys of distributions, which
    may be left out."""

    @cached_property
    def table(self) -> WeatherTable | None:
        """Weather of real nights; None without a table."""
        return None if self.weather_table is None else weather_table(self.weather_table, _power(self.spectral_index))

    @property
    def dated_key(self) -> str:
        """Key that needs the dates of the observations; empty without one."""
        if self.weather_table is not None:
            return "weather_table"
        return "" if self.correlation_time_s is None else "correlation_time"

    @model_validator(mode="before")
    @classmethod
    def _site_and_units_of_the_index(cls, data: Any, info: ValidationInfo) -> Any:
        if not isinstance(data, dict):
            return data
        data, own = with_site(data), data
        if "spectral_index" not in data:
            return data
        try:
            index = Fraction(str(data["spectral_index"])).limit_denominator(1000)
            power = _power(index)
        except (ValueError, ZeroDivisionError, OverflowError):
            index = power = None  # one error is enough: the index is refused by its own check
        if power and (name := data.get("weather_table")) is not None:
            data = with_table(data, file_path(name, info), power)
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
            # Each draw takes the quantile of B2 with its rank, so the unit of the fluctuation drops out.
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
        water = {"pwv": self.pwv_mm, "pwv_by_month": self.pwv_by_month, "pwv_by_hour": self.pwv_by_hour}
        if self.site is None and any(water.values()):
            key = next(key for key, values in water.items() if values)
            raise ValueError(f"site: missing; {key!r} needs the opacity of a site")
        if self.b2 or self.b2_probabilities:
            check_quantiles("b2", self.b2_probabilities, self.b2)
            if not all(value == 0 or B2_MIN <= value <= B2_MAX for value in self.b2):
                raise ValueError(f"b2: found {shown(self.b2)}; 0 or values from {B2_MIN:g} to {B2_MAX:g} are expected")
        elif self.site is None:
            raise ValueError("b2: missing; a distribution of B2, or a site that it follows from, is expected")
        if self.site is not None:
            check_quantiles("water_fluctuation", self.water_fluctuation_probabilities, self.water_fluctuation)
            self._water_is_whole()
            if not min(self.water_fluctuation) > 0:
                raise ValueError(
                    f"water_fluctuation: found {shown(self.water_fluctuation)}; values above 0 are expected"
                )
            if not FLUCTUATION_MIN <= min(self.water_fluctuation) <= max(self.water_fluctuation) <= FLUCTUATION_MAX:
                raise ValueError(
                    f"water_fluctuation: found {shown(self.water_fluctuation)}; values from {FLUCTUATION_MIN:g} to"
                    f" {FLUCTUATION_MAX:g} are expected"
                )
        if self.table is not None:
            self._table_fits(self.table)
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
        self._layers_are_whole()
        return self

    def _layers_are_whole(self) -> None:
        """Raise ValueError for layers that can't be drawn, and for keys of a profile that is none."""
        if self.layers:
            check_layers(self.layers, self.spectral_index, self.outer_scale_m, self.illuminated_aperture_m)
        if self.layers and self.profile:
            raise ValueError("profile: found with 'layers'; one of them is expected")
        if self.profile and self.water_scale_height_m is None:
            raise ValueError("water_scale_height: missing; a 'profile' needs it")
        for name in ("profile_layers", "water_scale_height_m"):
            if self.profile is None and getattr(self, name) is not None:
                raise ValueError(f"{name.removesuffix('_m')}: found without 'profile', which it belongs to")

    def _table_fits(self, table: WeatherTable) -> None:
        """Raise ValueError for a table of weather with columns that the other keys have no use for."""
        for name in ("pwv", "water_fluctuation"):
            if name in table.columns and self.site is None:
                raise ValueError(f"site: missing; the column {name!r} of 'weather_table' needs the opacity of a site")
        if self.wind_b2_exponent and "wind_speed" not in table.columns and set(OF_B2) & set(table.columns):
            raise ValueError(
                f"wind_b2_exponent: found {self.wind_b2_exponent:g} with the B2 of 'weather_table'; 0, or a column"
                " 'wind_speed', is expected"
            )

    def _water_is_whole(self) -> None:
        """Raise ValueError for water of a site that is no distribution."""
        if bool(self.pwv_mm) == bool(self.pwv_by_month):
            found = "found with 'pwv_by_month'" if self.pwv_mm else "missing"
            raise ValueError(f"pwv: {found}; either 'pwv' or 'pwv_by_month' is expected")
        if self.pwv_by_hour and not self.pwv_by_month:
            raise ValueError("pwv_by_hour: found without 'pwv_by_month'; months are expected with it")
        for key, count, unit in (("pwv_by_month", 12, "month"), ("pwv_by_hour", 24, "hour")):
            if len(getattr(self, key)) not in (0, count):
                raise ValueError(
                    f"{key}: found {len(getattr(self, key))} values; one for each {unit}, {count}, is expected"
                )
        key = "pwv_by_month" if self.pwv_by_month else "pwv"
        for quantiles in self.pwv_by_month or (self.pwv_mm,):
            check_knots("pwv_probabilities", self.pwv_probabilities, key, quantiles)
            if not min(quantiles) > 0:
                raise ValueError(f"{key}: found {shown(quantiles)}; values above 0 are expected")
        ends = self.pwv_probabilities[0], self.pwv_probabilities[-1]
        if len(self.pwv_probabilities) > 1 and ends != (0, 1):
            raise ValueError(
                f"pwv_probabilities: found {shown(self.pwv_probabilities)}; 0 first and 1 last are expected, the"
                " driest and the wettest water, or one value alone"
            )
