"""Sections [[score.metrics]]: further scores of the co-added maps, one class for each kind."""

import re
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from surveysim.runtime.errors import InputError
from surveysim.scene.fields import PositiveAngle, PositiveBandPower, TableOrName, number, whole
from surveysim.scene.section import Section
from surveysim.scene.sky import check_profile
from surveysim.scene.spectrum_table import read_spectrum
from surveysim.scene.unions import union_of
from surveysim.scene.units import shown

SIGMA_KEY = "flat_band_power.sigma"  # key of the score that every scene has
SPECTRA = ("flat", "poisson", "clustered")
PIVOT_ELL = 3000.0  # multipole at which named spectra have their band power
_NAME = re.compile("[a-z][a-z0-9_]{0,39}")
_MOST_EDGES = 101


def _metric_name(value: object) -> object:
    if value and not (isinstance(value, str) and _NAME.fullmatch(value)):
        raise ValueError(f"found {shown(value)}; up to 40 small letters, digits and '_', first a letter, are expected")
    return value


class Metric(Section):
    """Base of the metrics: `quantity_names` lists its values, which results have as ``name.quantity``."""

    name: Annotated[str, BeforeValidator(_metric_name)] = Field(
        default="", json_schema_extra={"otherwise": "the value of `kind`"}
    )
    """Name in results: small letters, digits and `_`."""
    kind: str
    """Kind of the metric."""
    quantity_names: ClassVar[tuple[str, ...]] = ()

    @property
    def label(self) -> str:
        """Name in results."""
        return self.name or self.kind

    def check_bins(self, ell_bin: int, ell_max: int) -> None:
        """Raise ValueError for multipoles that the bins of the score do not have; most kinds have none of their own."""

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys of its quantities in results."""
        return tuple(f"{self.label}.{name}" for name in self.quantity_names)


class FlatBandPower(Metric):
    """Uncertainty of a flat CMB band power, which every score has."""

    kind: Literal["flat_band_power"] = "flat_band_power"
    """Kind of the metric."""
    quantity_names: ClassVar[tuple[str, ...]] = ("sigma",)


class BandPowers(Metric):
    """Uncertainty of the band powers of a fiducial spectrum in bins of multipole, with their covariance."""

    kind: Literal["band_powers"]
    """Kind of the metric."""
    edges: Annotated[tuple[Annotated[int, *whole(0, 10_000_000)], ...], Field(min_length=2, max_length=_MOST_EDGES)]
    """Edges of the bins in multipole: increasing multiples of `score.ell_bin` up to `score.ell_max`."""
    spectrum: TableOrName
    """Fiducial spectrum: "flat" has equal band powers, "poisson" equal C_ell, "clustered" C_ell as ell^-1.25; or an
    ECSV table with the columns `ell` and `cl`, C_ell in CMB temperature squared."""
    band_power_ukcmb2: PositiveBandPower | None = Field(alias="band_power", default=None)
    """Band power ell (ell + 1) C_ell / 2 pi of a named spectrum at ell = 3000; it is required there."""

    @property
    def bins(self) -> tuple[tuple[int, int], ...]:
        """Edges of each bin."""
        return tuple(pairwise(self.edges))

    @property
    def quantity_names(self) -> tuple[str, ...]:  # type: ignore[override]
        """Names of its quantities: two for each bin, and one for all."""
        of_bins = (f"{kind}_{low}_{high}" for kind in ("sigma", "total") for low, high in self.bins)
        return (*of_bins, "amplitude")

    def check_bins(self, ell_bin: int, ell_max: int) -> None:
        """Raise ValueError for edges that are none of the score's bins."""
        wrong = [edge for edge in self.edges if edge % ell_bin or edge > ell_max]
        if wrong:
            raise ValueError(
                f"metrics: found the edge {wrong[0]} in {self.label!r}; multiples of ell_bin = {ell_bin} up to"
                f" {ell_max // ell_bin * ell_bin} are expected"
            )

    @model_validator(mode="after")
    def _one_spectrum(self) -> Self:
        if any(high <= low for low, high in self.bins):
            raise ValueError(f"edges: found {shown(list(self.edges))}; increasing multipoles are expected")
        if not isinstance(self.spectrum, Path):
            if self.spectrum not in SPECTRA:
                names = ", ".join(map(repr, SPECTRA))
                raise ValueError(f"spectrum: found {shown(self.spectrum)}; {names} or the name of a file is expected")
            if self.band_power_ukcmb2 is None:
                raise ValueError(f"band_power: missing; spectrum {self.spectrum!r} needs it")
            return self
        if self.band_power_ukcmb2 is not None:
            raise ValueError("band_power: found together with a table, which sets it; one of the two is expected")
        ell, _ = spectrum_table(self.spectrum)
        if ell[0] > max(self.edges[0], 1) or ell[-1] < self.edges[-1]:
            raise ValueError(
                f"spectrum: {self.spectrum}: found ell from {ell[0]:g} to {ell[-1]:g}; a table that covers the bins,"
                f" {self.edges[0]} to {self.edges[-1]}, is expected"
            )
        return self


def spectrum_table(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Read a table of a spectrum: multipoles and band powers [uK_CMB^2]; raises ValueError, as fields do."""
    try:
        return read_spectrum("spectrum", path)
    except InputError as error:
        raise ValueError(str(error)) from None


class LargestScale(Metric):
    """Multipole at which scans and cleaning leave half of the signal's power."""

    kind: Literal["largest_scale"]
    """Kind of the metric."""
    quantity_names: ClassVar[tuple[str, ...]] = ("ell",)


class ArrayNet(Metric):
    """Noise-equivalent temperature of detector and array after cleaning, as the scored multipoles see it."""

    kind: Literal["array_net"]
    """Kind of the metric."""
    quantity_names: ClassVar[tuple[str, ...]] = ("array_rj", "array_cmb", "detector_rj", "detector_cmb")


class TimeTo(Metric):
    """Observing time after which another metric reaches a value."""

    kind: Literal["time_to"]
    """Kind of the metric."""
    of: str
    """Key of the quantity of another metric, such as "flat_band_power.sigma"."""
    value: Annotated[float, *number(1e-30, 1e30)]
    """Value to reach, in the unit that results have for that quantity."""
    quantity_names: ClassVar[tuple[str, ...]] = ("hours",)


class _SourceDepth(Metric):
    """Base of the metrics of a matched filter."""

    ell_min: Annotated[int, *whole(0, 10_000_000)] | None = Field(
        default=None, json_schema_extra={"otherwise": "`score.ell_min`"}
    )
    """Lowest multipole that the matched filter uses, in whole bins of the score; the highest is `score.ell_max`."""

    def check_bins(self, ell_bin: int, ell_max: int) -> None:
        """Raise ValueError for a lowest multipole that leaves no bin."""
        most = ell_max // ell_bin * ell_bin - ell_bin
        if self.ell_min is not None and self.ell_min > most:
            raise ValueError(
                f"metrics: found ell_min = {self.ell_min} in {self.label!r}; {most} or less is expected, which leaves a"
                f" bin of {ell_bin} below {ell_max}"
            )


class PointSourceDepth(_SourceDepth):
    """Depth and mapping speed for point sources, by a matched filter of the map; without confusion by other sources."""

    kind: Literal["point_source"]
    """Kind of the metric."""
    quantity_names: ClassVar[tuple[str, ...]] = ("depth_mjy", "depth_mk", "mapping_speed")


class ClusterDepth(_SourceDepth):
    """Depth for clusters of galaxies in the central Compton parameter y0, by a matched filter of the map; without
    confusion by the CMB or galaxies."""

    kind: Literal["cluster"]
    """Kind of the metric."""
    profile: Literal["arnaud", "beta"]
    """Profile: "arnaud" is the universal pressure profile of Arnaud et al. (2010), "beta" an isothermal cluster."""
    theta_500_rad: PositiveAngle | None = Field(alias="theta_500", default=None)
    """Required by "arnaud": angle of R500."""
    core_radius_rad: PositiveAngle | None = Field(alias="core_radius", default=None)
    """Required by "beta": angle of the core radius theta_c in y0 (1 + theta^2 / theta_c^2)^((1 - 3 beta) / 2)."""
    beta: Annotated[float, *number(0.4, 5)] | None = None
    """Required by "beta": its exponent."""
    quantity_names: ClassVar[tuple[str, ...]] = ("depth_y0",)

    @model_validator(mode="after")
    def _keys_of_profile(self) -> Self:
        check_profile(
            self.profile, {"theta_500": self.theta_500_rad, "core_radius": self.core_radius_rad, "beta": self.beta}
        )
        return self


METRIC_SECTIONS: tuple[type[Metric], ...] = (
    BandPowers,
    LargestScale,
    ArrayNet,
    TimeTo,
    PointSourceDepth,
    ClusterDepth,
)
if TYPE_CHECKING:
    AnyMetric = Metric
else:
    AnyMetric = union_of(METRIC_SECTIONS, "kind")


def check_metrics(metrics: tuple[Metric, ...], ell_bin: int, ell_max: int) -> None:
    """Raise ValueError for equal names, an unknown target of a `TimeTo`, and bins that the score's do not make up."""
    names = [FlatBandPower().label, *(item.label for item in metrics)]
    if repeated := [name for name in names if names.count(name) > 1]:
        raise ValueError(f"metrics: found the name {repeated[0]!r} more than once; give one of them another 'name'")
    known = metric_keys(tuple(item for item in metrics if not isinstance(item, TimeTo)))
    for item in metrics:
        if isinstance(item, TimeTo) and item.of not in known:
            raise ValueError(
                f"metrics: found {shown(item.of)} as 'of' of {item.label!r}; one of {', '.join(known)} is expected"
            )
        item.check_bins(ell_bin, ell_max)


def metric_keys(metrics: tuple[Metric, ...]) -> tuple[str, ...]:
    """Return the keys of all quantities of a score with these metrics."""
    return tuple(key for item in (FlatBandPower(), *metrics) for key in item.keys)
