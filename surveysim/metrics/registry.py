"""The list of metrics, and the functions of a scene's metrics."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from surveysim.metrics import array_net, band_powers, cluster, flat_band_power, largest_scale, point_source, time_to
from surveysim.metrics.map_noise import MapNoise, Quantity
from surveysim.scene import metrics as sections
from surveysim.scene.analysis import Score

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
    title
        Name for tables.
    of_another
        Whether the metric is about a quantity of another one, the option `of`.
    """

    section: type[sections.Metric]
    quantities: Callable[..., tuple[Quantity, ...]]
    title: str
    of_another: bool = False


METRICS = {
    "flat_band_power": Metric(sections.FlatBandPower, flat_band_power.quantities, "flat CMB band power"),
    "band_powers": Metric(sections.BandPowers, band_powers.quantities, "band powers of a spectrum"),
    "largest_scale": Metric(sections.LargestScale, largest_scale.quantities, "largest scale that is left"),
    "array_net": Metric(sections.ArrayNet, array_net.quantities, "NET after cleaning"),
    "time_to": Metric(sections.TimeTo, time_to.quantities, "time to reach a value", of_another=True),
    "point_source": Metric(sections.PointSourceDepth, point_source.quantities, "depth for point sources"),
    "cluster": Metric(sections.ClusterDepth, cluster.quantities, "depth for clusters"),
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
