"""Names of several points of a sweep at once."""

from collections.abc import Sequence
from math import prod

from surveysim.studies.sweep.axes import Sweep


def name_of_points(sweep: Sweep, numbers: Sequence[int]) -> str:
    """Name points by the axes that tell them from the others.

    Parameters
    ----------
    sweep
        The sweep.
    numbers
        Numbers of one or more of its points, each once.

    Returns
    -------
    str
        ``all points``. Where they are all combinations of some values, ``axis = value or value, other axis = value``
        without the axes whose values are all there. The points one by one elsewhere.
    """
    places = [sweep.points[number].place for number in numbers]
    steps = [sorted(set(column)) for column in zip(*places, strict=True)]
    if prod(map(len, steps)) != len(places):
        return "; ".join(sweep.points[number].label for number in numbers)
    pairs = zip(sweep.axes, steps, strict=True)
    named = [axis.at(*own) for axis, own in pairs if len(own) < len(axis.values)]
    return ", ".join(named) or "all points"
