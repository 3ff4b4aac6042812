"""Position: what a consumer has of a topic, as edges between what it has and what it has not."""

from typing import NamedTuple, Self

from agent.northbound.tuning import MOST_GAPS


class Position(NamedTuple):
    """Edges, ascending, an odd number: all up to the first acknowledged, then from each second to each third.

    The last is where live rows go on; what lies between is filled afterwards, the oldest first.
    """

    edges: tuple[int, ...]

    @property
    def live(self) -> int:
        """The number of the newest row that was acknowledged."""
        return self.edges[-1]

    @property
    def gap(self) -> tuple[int, int] | None:
        """Return the oldest stretch that is lacking: after which number, and up to which; None for none."""
        return (self.edges[0], self.edges[1]) if len(self.edges) > 1 else None

    def lag(self, head: int) -> int:
        """Return how many numbers up to `head` were not acknowledged."""
        gaps = zip(self.edges[:-1:2], self.edges[1::2], strict=True)
        return sum(until - after for after, until in gaps) + max(0, head - self.live)

    def left_behind(self, head: int) -> Self:
        """Return the position that goes on live after `head`; what is lacking up to there becomes a gap."""
        if head <= self.live:
            return self
        is_continued = len(self.edges) > 1 and self.edges[-2] == self.live
        edges = (*self.edges[:-2], head, head) if is_continued else (*self.edges, head, head)
        return type(self)(_bounded(edges))

    def advanced(self, live: int) -> Self:
        """Return the position after live rows up to a number were acknowledged."""
        return type(self)((*self.edges[:-1], live))

    def filled(self, reached: int) -> Self:
        """Return the position after rows of the oldest gap up to a number were acknowledged."""
        is_closed = reached >= self.edges[1]
        return type(self)(self.edges[2:] if is_closed else (reached, *self.edges[1:]))


def _bounded(edges: tuple[int, ...]) -> tuple[int, ...]:
    if len(edges) <= 2 * MOST_GAPS + 1:
        return edges
    between = range(1, len(edges) - 2, 2)
    shortest = min(between, key=lambda i: edges[i + 1] - edges[i])
    return edges[:shortest] + edges[shortest + 2 :]
