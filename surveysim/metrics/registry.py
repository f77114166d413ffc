"""The list of metrics, and the functions of a scene's metrics."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from surveysim.metrics import (
    array_net,
    band_powers,
    cluster,
    flat_band_power,
    largest_scale,
    point_source,
    time_to,
)
from surveysim.metrics.map_noise import MapNoise, Quantity
from surveysim.runtime.table import Table
from surveysim.scene import metrics as sections
from surveysim.scene.analysis import Score
from surveysim.survey.scores import DataSetScore

MetricFunction = Callable[[MapNoise], tuple[Quantity, ...]]


@dataclass(frozen=True)
class Metric:
    """A kind of metric.

    Parameters
    ----------
    section
        Class of its options.
    quantities
        Function of the noise of a map and the options; with `of_another` also of the function of another quantity.
    of_another
        Whether the metric is about a quantity of another one, the option `of`.
    table
        Function that makes a table of its own from the options and, by data set, noise and score; None without one.
    """

    section: type[sections.Metric]
    quantities: Callable[..., tuple[Quantity, ...]]
    of_another: bool = False
    table: Callable[[Any, Mapping[str, tuple[MapNoise, DataSetScore]]], Table] | None = None


METRICS = {
    "flat_band_power": Metric(sections.FlatBandPower, flat_band_power.quantities),
    "band_powers": Metric(sections.BandPowers, band_powers.quantities, table=band_powers.table),
    "largest_scale": Metric(sections.LargestScale, largest_scale.quantities),
    "array_net": Metric(sections.ArrayNet, array_net.quantities),
    "time_to": Metric(sections.TimeTo, time_to.quantities, of_another=True),
    "point_source": Metric(sections.PointSourceDepth, point_source.quantities),
    "cluster": Metric(sections.ClusterDepth, cluster.quantities),
}


def metric_functions(score: Score) -> dict[str, MetricFunction]:
    """Return the metrics of a score by name, each a function of the noise of a map."""
    options: dict[str, Any] = {item.label: item for item in (sections.FlatBandPower(), *score.metrics)}
    rows = {name: METRICS[item.kind] for name, item in options.items()}
    found: dict[str, MetricFunction] = {
        name: partial(rows[name].quantities, options=item)
        for name, item in options.items()
        if not rows[name].of_another
    }
    for name, item in options.items():
        if rows[name].of_another:
            found[name] = partial(rows[name].quantities, options=item, target=_quantity(found, item.of))
    return {name: found[name] for name in options}


def _quantity(functions: Mapping[str, MetricFunction], key: str) -> Callable[[MapNoise], Quantity]:
    metric, _, name = key.partition(".")
    return lambda noise: next(item for item in functions[metric](noise) if item.name == name)


def metric_table_names(score: Score) -> dict[str, Any]:
    """Return the metrics that have a table of their own, by the name of its file: their kind, and name if given."""
    found = [item for item in score.metrics if METRICS[item.kind].table]
    return {f"{item.kind}_{item.name}" if item.name else item.kind: item for item in found}
