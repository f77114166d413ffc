"""Sums over the finished observations of a run, in any order of arrival, with the same bits always.

The sums follow a fixed binary tree over the numbers of the observations. In a leaf, consecutive observations are added
one after the other; leaves, and groups of 2^k leaves, are added in pairs. A node can be made anywhere: by a worker for
a span of observations, or here from single ones. Nodes and single observations that wait for earlier ones stay apart.
"""

from collections.abc import Iterable

import numpy as np

from surveysim.reduction.resource_limits import LARGE_SUMS, LEAF
from surveysim.reduction.setup import Setup
from surveysim.survey.coadds import CoAdds, add_observations, add_sums, copied, empty_coadds, sums_bytes
from surveysim.survey.remote_node import Node, RemoteNode, here

_WAITING_BYTES = 64e6  # of single observations, which are added to the sums in one pass
_WAITING = 8


def leaf_size(setup: Setup) -> int:
    """Number of observations in a leaf; all of the survey where sums take much memory."""
    return 2**40 if node_bytes(setup) > LARGE_SUMS else LEAF


def node_bytes(setup: Setup) -> float:
    """Size of the maps of a node [bytes]."""
    return sums_bytes(setup.analysis)


def nodes_of_all(setup: Setup) -> int:
    """Number of nodes over all observations."""
    whole, rest = divmod(setup.scene.observations, leaf_size(setup))
    return whole.bit_count() + (rest > 0)


class CoAddTree:
    """Sums over the finished observations of a run.

    Parameters
    ----------
    setup
        The scene, prepared.
    nodes
        Sums over finished observations: single ones (`observation_sums`), the first of a leaf, and whole nodes.
    first
        Number of the first observation.

    Attributes
    ----------
    done
        Number of the observation up to which `so_far` counts; `advance` adds to it.
    finished
        Number of all finished observations.
    seconds
        Time [s] that they took on one worker each, without compilation.
    """

    def __init__(self, setup: Setup, nodes: Iterable[Node] = (), first: int = 0) -> None:
        self._setup, self._leaf = setup, leaf_size(setup)
        self._nodes: dict[int, Node] = {}  # by the first observation: leaves, whole or begun, and groups of leaves
        self._waiting: dict[int, CoAdds] = {}  # single observations by number
        self._first = self.done = first
        self.finished = 0
        self.seconds = 0.0
        for node in nodes:
            self.add(node)

    def add(self, item: Node) -> None:
        """Add a finished observation or the sums of a node."""
        self.finished += item.done
        self.seconds += item.total_s
        if isinstance(item, CoAdds) and is_single(item):
            self._waiting[item.first] = item
        else:
            self._nodes[item.first] = item
            self._join(item.first)

    def advance(self) -> bool:
        """Count the next observation, or the next node, if it is there."""
        start = self.done
        if start in self._waiting:
            self.done += 1
            if self._is_due(start):
                self._absorb(start)
        elif start < (end := self._covered(start)):
            self.done = end
        return self.done > start

    def so_far(self) -> CoAdds:
        """Sums over the observations up to `done`, to be read only."""
        self._absorb(self.done - 1)
        nodes, number = [], self._first
        while number < self.done:
            nodes.append(here(self._nodes[number]))
            number = nodes[-1].end
        if len(nodes) < 2:
            return nodes[0] if nodes else empty_coadds(self._setup.analysis)
        total = copied(nodes[0])
        for node in nodes[1:]:
            add_sums(total, node)
        return total

    def nodes(self) -> list[CoAdds]:
        """Sums over all finished observations, apart."""
        self._absorb(self.done - 1)
        found: dict[int, Node] = {**self._nodes, **self._waiting}
        return [here(found[first]) for first in sorted(found)]

    def bring_here(self) -> None:
        """Fetch the nodes that stay on a cluster."""
        self._nodes = {first: here(node) for first, node in self._nodes.items()}

    def forget_remote(self) -> None:
        """Drop the nodes that stay on a cluster, which is gone."""
        gone = [node for node in self._nodes.values() if isinstance(node, RemoteNode)]
        for node in gone:
            del self._nodes[node.first]
            self.finished -= node.done
            self.done = min(self.done, max(self._first, node.first))

    def missing(self) -> list[int]:
        """Numbers of the observations that are not finished."""
        there = np.zeros(self._setup.scene.observations, bool)
        for node in (*self._nodes.values(), *self._waiting.values()):
            there[node.first : node.end] = True
        return np.flatnonzero(~there).tolist()

    def forget_later(self) -> None:
        """Drop the observations from `done` on."""
        self._absorb(self.done - 1)
        self._waiting = {}
        self._nodes = {first: node for first, node in self._nodes.items() if node.end <= self.done}
        self.finished = self.done

    def _covered(self, number: int) -> int:
        """Find the end of the node that has an observation; the number itself where none has."""
        ends = (node.end for node in self._nodes.values() if node.first <= number < node.end)
        return next(ends, number)

    def _is_due(self, last: int) -> bool:
        """Return whether single observations that wait up to `last` are to be added to their leaf: many, or its end."""
        if (last + 1) % self._leaf == 0:
            return True
        most = max(1, min(_WAITING, int(_WAITING_BYTES / self._waiting[last].sums.nbytes)))
        return len([number for number in self._waiting if number <= last]) >= most

    def _absorb(self, last: int) -> None:
        """Add the single observations up to `last` that wait in its leaf."""
        first = max(0, last) - max(0, last) % self._leaf
        begun = self._nodes[first].end if first in self._nodes else first
        singles = []
        while begun <= last and begun in self._waiting:
            singles.append(self._waiting[begun])
            begun += 1
        if not singles:
            return
        sums = here(self._nodes[first]) if first in self._nodes else empty_coadds(self._setup.analysis)
        add_observations(self._setup.analysis, sums, singles)
        for item in singles:  # once they are in the sums
            del self._waiting[item.first]
        self._nodes[first] = sums
        self._join(first)

    def _join(self, first: int) -> None:
        """Add a whole node to its neighbour in the tree, as often as both are there."""
        node = self._nodes[first]
        while node.done % self._leaf == 0 and (other := self._nodes.get(first ^ node.done)) is not None:
            if other.done != node.done:
                return
            first = min(first, other.first)
            left, right = sorted((node, other), key=lambda item: item.first)
            if isinstance(left, RemoteNode) and isinstance(right, RemoteNode):
                node = left.joined(right)
            else:
                node = here(left)
                add_sums(node, here(right))
            del self._nodes[right.first]
            self._nodes[first] = node


def is_single(item: CoAdds) -> bool:
    """Return whether sums are over one observation alone, without sign-flipped co-adds."""
    return item.done == 1 and not len(item.flipped)


def is_node(setup: Setup, item: CoAdds) -> bool:
    """Return whether sums are a part of the tree: one observation, the first of a leaf, or a group of 2^k leaves."""
    leaf = leaf_size(setup)
    if is_single(item):
        return True
    if item.done < leaf:
        return item.first % leaf == 0
    n_leaf, rest = divmod(item.done, leaf)
    return rest == 0 and n_leaf & (n_leaf - 1) == 0 and item.first % item.done == 0
