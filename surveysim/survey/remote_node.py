"""Nodes of the tree of sums that stay on the workers of a cluster."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from surveysim.runtime.items import Held, LargeResults
from surveysim.survey.coadds import CoAdds, add_sums, copied
from surveysim.survey.spans import Span


@dataclass(frozen=True)
class NodeOutline:
    """Observations of a node and the seconds that they took."""

    first: int
    done: int
    seconds: float

    def __add__(self, later: "NodeOutline") -> "NodeOutline":
        """Outline of the sums over both."""
        return NodeOutline(self.first, self.done + later.done, self.seconds + later.seconds)


@dataclass(frozen=True)
class RemoteNode:
    """Sums on the cluster."""

    held: Held

    @property
    def first(self) -> int:
        """Number of the first observation."""
        return self.held.outline.first

    @property
    def done(self) -> int:
        """Number of observations."""
        return self.held.outline.done

    @property
    def end(self) -> int:
        """Number of the observation that comes next."""
        return self.first + self.done

    @property
    def total_s(self) -> float:
        """Seconds that the observations took."""
        return self.held.outline.seconds

    @cached_property
    def here(self) -> CoAdds:
        """The sums, fetched from the cluster."""
        return self.held.fetch()

    def joined(self, later: "RemoteNode") -> "RemoteNode":
        """Add sums over the observations that follow, on the cluster."""
        return RemoteNode(self.held.joined(later.held))


Node = CoAdds | RemoteNode


def node_of(result: Any) -> Node:
    """Make a node of the answer of a worker: sums, or sums that stay with it."""
    return result if isinstance(result, CoAdds) else RemoteNode(result)


def here(node: Node) -> CoAdds:
    """Get the sums of a node."""
    return node if isinstance(node, CoAdds) else node.here


def _is_large(span: Span) -> bool:
    return span.end - span.first > 1


def _outline(sums: CoAdds) -> NodeOutline:
    return NodeOutline(sums.first, sums.done, sums.total_s)


def _join(left: CoAdds, right: CoAdds) -> CoAdds:
    total = copied(left)
    add_sums(total, right)
    return total


SUMS_OF_SPANS = LargeResults(_is_large, _outline, _join)
