"""What is known of the units on a line: how long each is waited for, and when a silent one is asked again.

A request to a silent unit holds the line for c seconds: until it is given up or its gateway says that nobody
answers. After the n-th failure in a row, n >= 3, the unit is left alone for p seconds,

    p = min(4**(n - 2) c, 99 c, max(1.4 s - c, 3 c)),

so that it takes the share c / (c + p) of the line: 20 %, then 6 %, and so on to 1 %, but where c is over 14
ms no less than what finding it again within 2 s costs. That is c / 1.4 s: 3.6 % at 50 ms, 11 % at 150 ms;
from 350 ms on it is 25 %, and the unit is found after 4 c. A request then is put where it disturbs least:
into the longest pause that the others leave within the next 0.2 s. A poll of theirs is lost only where c is
longer than that pause and their period together. A unit that returns right after it was asked in vain is
asked again after p + 0.2 s, and at most 0.2 s later where the line is never free: 1.8 s, and what it takes to
answer.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

from drivers.modbus import tuning


class LaterError(Exception):
    """The unit cannot be asked now.

    Attributes:
        until: when it can (clock.monotonic).
        asked: whether it was asked, and did not give what it was asked for.
    """

    def __init__(self, until: float, *, asked: bool = False) -> None:
        super().__init__(f"not before {until:g}")
        self.until = until
        self.asked = asked


@dataclass(slots=True)
class Unit:
    """What is known of one unit. Times are those of clock.monotonic.

    Attributes:
        slowest_s: its slowest answer of late; 0 before the first.
        unanswered: failures in a row.
        late_until: until when an answer of it may still be under way on a serial line.
        lost: when requests were given up whose answers it owes, by their number of registers.
        next_at, every_s: when its next request is due, and how far apart they are.
        cost_s: for how long the newest request that failed held the line.
        rest_until: until when it is left alone.
    """

    slowest_s: float = 0.0
    unanswered: int = 0
    late_until: float = 0.0
    lost: dict[int, float] = field(default_factory=dict)
    next_at: float = 0.0
    every_s: float = 0.0
    cost_s: float = 0.0
    rest_until: float = 0.0
    _placed: bool = False

    @property
    def is_lost(self) -> bool:
        """Whether it kept silent so often that the others go first."""
        return self.unanswered >= tuning.PATIENCE

    def is_active(self, now: float) -> bool:
        """Tell whether others have to mind it: it answers, and is asked again and again."""
        return self.unanswered == 0 and now < self.next_at + tuning.ACTIVE_S

    def plan(self, urgent_at: float) -> None:
        """Note that the next answer but this one should be there at `urgent_at`."""
        if urgent_at > self.next_at:
            self.every_s = urgent_at - self.next_at if self.next_at else 0.0
            self.next_at = urgent_at

    def allowed_s(self, timeout_s: float, usual_s: float) -> float:
        """Return how long it is waited for: all of its time as long as it answers, then seldom."""
        usual = self.slowest_s or usual_s
        first = tuning.FULL_FROM if self.slowest_s else tuning.FULL_FROM_UNKNOWN
        if not usual or self.unanswered == 0 or _is_power(self.unanswered, first):
            return timeout_s
        return min(timeout_s, max(tuning.SHORTEST_S, tuning.USUAL * usual))

    def answered(self, seconds: float) -> None:
        """Note an answer, and how long it took."""
        self.unanswered = 0
        self.lost.clear()
        self.slowest_s = max(seconds, tuning.FADE * self.slowest_s)

    def late(self, seconds: float) -> None:
        """Note an answer that came so long after the request that it was given up."""
        self.slowest_s = max(self.slowest_s, seconds)
        self.cost_s = max(self.cost_s, seconds)

    def failed(self, seconds: float, now: float, *, silent: bool) -> None:
        """Note a failure, and for how long it held the line."""
        self.unanswered = self.unanswered + 1 if silent else 0
        self.cost_s = seconds
        self.rest_until = now + self._rest_s() if self.is_lost else 0.0
        self._placed = False

    def _rest_s(self) -> float:
        cost = self.cost_s
        grown = tuning.GROWTH ** min(self.unanswered - tuning.PATIENCE + 1, tuning.PATIENCE + 1)
        return min(grown * cost, tuning.RAREST * cost, max(tuning.FOUND_S - cost, tuning.LEAST * cost))

    def start(self, now: float, others: Sequence["Unit"]) -> float:
        """Return when it can be asked without holding up the others more than must be."""
        if not others:
            return now
        if self._placed or self.rest_until > now:
            return self.rest_until
        self._placed = True
        self.rest_until = _longest_pause(now, self.cost_s, others)
        return self.rest_until

    def due_after(self, moment: float) -> float:
        """Return when its first request after a moment is due."""
        if self.next_at >= moment or not self.every_s:
            return max(self.next_at, moment)
        return moment + (self.next_at - moment) % self.every_s


def _is_power(number: int, first: int) -> bool:
    """Tell whether a number is first, 4 first, 16 first ..."""
    while number > first and number % 4 == 0:
        number //= 4
    return number == first


def _longest_pause(now: float, wanted_s: float, others: Sequence[Unit]) -> float:
    """Return the beginning of the longest pause in what is due; no more of it counts than is wanted."""
    ends = (unit.due_after(now) + unit.slowest_s for unit in others)
    begins = [now, *sorted(end for end in ends if end <= now + tuning.POLITE_S)]

    def pause(begin: float) -> float:
        return min(wanted_s, *(unit.due_after(begin) - begin for unit in others))

    return max(begins, key=pause)
