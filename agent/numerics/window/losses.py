"""The lost readings of a stream, on their way from the samples to the windows that hold them."""

from collections.abc import Callable, Sequence

from agent.numerics.window.eliminated import Solving
from agent.numerics.window.filtering.summary import Summary
from agent.numerics.window.lost import Events, Lost, LostColumns, Taps
from agent.numerics.window.operators import Operators
from agent.types import FloatArray

Over = Callable[[int, int], FloatArray]
"""[e ψ] (1+c, samples p) of a hop's samples up to some number."""


class Losses:
    """Lost readings, and their columns as far as the bank has come.

    Args:
        taps: where a lost reading of each channel enters.
    """

    def __init__(self, taps: Taps) -> None:
        self._taps = taps
        self._reach = max(abs(offset) for channel in taps for offset, *_ in channel)
        self._lost = Lost.none()

    def begin(self, operators: Operators) -> None:
        """Start anew at the bank's next hop."""
        self._plan = operators.plan
        self._columns = LostColumns(operators, self._taps)

    def append(self, lost: Lost) -> None:
        """Take lost readings of later samples."""
        self._lost = self._lost.followed(lost)

    def forget(self, oldest: int, stop: int) -> None:
        """Let go of what touches no sample of [oldest, stop)."""
        self._lost = self._lost.between(oldest - self._reach, stop) if stop > oldest else Lost.none()

    def eliminate(
        self, hop: int, newest: tuple[Summary | None, Summary], solving: Sequence[Solving | None], over: Over
    ) -> None:
        """Eliminate what was lost from the windows that end in hop `hop` and after it.

        newest: the hops before these (None where the bank begins) and the heads of these.
        """
        if not len(self._lost) and self._columns.is_idle(hop):
            return
        completed, heads = newest
        near = self._lost.between(
            (hop - 1) * self._plan.hop - self._reach, (hop + len(heads)) * self._plan.hop
        )
        if self._columns.is_idle(hop) and not len(near):
            return
        solved = [one for one in solving if one is not None]
        befores = [None] * len(heads) if completed is None else list(completed.moment)
        for i, before in enumerate(befores):
            events = self._events(hop + i, before, heads.moment[i], over)
            if events is None:
                continue
            for one in solved:
                one.eliminate(events, self._columns.held_from, hop + i)

    def _events(self, hop: int, completed: FloatArray | None, head: FloatArray, over: Over) -> Events | None:
        """Carry the columns on to a head's end; None where none is held."""
        start, newest = hop * self._plan.hop, hop * self._plan.hop + self._plan.head
        if completed is not None:
            lost = self._touching(hop - 1, newest)
            if len(lost) or not self._columns.is_idle(hop):
                self._columns.complete(hop - 1, lost, over(hop - 1, start) if len(lost) else None, completed)
        lost = self._touching(hop, newest)
        if not len(lost) and self._columns.is_idle(hop):
            return None
        return self._columns.until(hop, lost, over(hop, newest) if len(lost) else None, head)

    def _touching(self, hop: int, newest: int) -> Lost:
        """Return the lost readings before sample `newest` that may touch a hop."""
        start, stop = self._columns.reach(hop)
        return self._lost.between(start, min(stop, newest))
