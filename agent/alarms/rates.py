"""What working with an alarm system is like, by ANSI/ISA-18.2-2016 and IEC 62682, clauses 3.1 and 16.

average       alarms announced a day; about 150 are very likely acceptable for one operator, 300 are the most
flood         more than 10 alarms in 10 minutes, and on until fewer than 5 come in 10 minutes (also
              EEMUA 191); less than 1 % of the time
chattering    one alarm announced three times or more within a minute; the aim is none
stale         a condition that has stood for more than 24 hours; fewer than 5, each known and with a plan
most frequent the ten alarms that come most often make up less than 1 % to 5 % of all
priorities    about 80 % low, 15 % medium, 5 % high and critical
"""

from collections import Counter, deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from agent.units import DAY_NS, MINUTE_NS

Key = tuple[str, str, str]
"""Rig, kind and parameter: what is one alarm."""
TEN_MINUTES_NS: Final = 10 * MINUTE_NS
FLOOD_BEGINS, FLOOD_ENDS, CHATTERS = 10, 5, 3
"""Fixed by ISA-18.2: alarms in ten minutes that begin and end a flood, in one that are chatter."""
ACCEPTABLE_A_DAY, MOST_A_DAY = 150, 300
"""Fixed by ISA-18.2: alarms a day that an operator can handle, and can at most."""


@dataclass(frozen=True, slots=True)
class Announced:
    """One alarm announced: when, which, how urgent."""

    t_ns: int
    key: Key
    priority: str


@dataclass(frozen=True, slots=True)
class Flood:
    """An alarm flood: more alarms than anybody takes in, from its first to its last, ns, and how many."""

    from_ns: int
    to_ns: int
    alarms: int


@dataclass(frozen=True, slots=True)
class Rates:
    """The measures of a stretch of time.

    Attributes:
        days: its length; announced: alarms in it; a_day: on average, None of less than a day.
        most_in_ten_minutes: the greatest number in any 10 minutes.
        floods, flood_percent: how much of the time they took.
        chattering: how often at most each came within a minute, of those that chattered.
        stale: conditions that have stood for more than 24 hours, and since when, ns.
        frequent: the ten that came most often, and how often.
        priorities: alarms by priority.
    """

    days: float
    announced: int
    a_day: float | None
    most_in_ten_minutes: int
    floods: Sequence[Flood]
    flood_percent: float
    chattering: Mapping[Key, int]
    stale: Mapping[Key, int]
    frequent: Sequence[tuple[Key, int]]
    priorities: Mapping[str, int]


def rates(announced: Iterable[Announced], standing: Mapping[Key, int], from_ns: int, until_ns: int) -> Rates:
    """Return the measures of a period; standing: since when conditions stand that are not over, ns."""
    alarms = sorted(announced, key=lambda alarm: alarm.t_ns)
    times = [alarm.t_ns for alarm in alarms]
    length = max(1, until_ns - from_ns)
    floods = floods_of(times)
    by_key: dict[Key, list[int]] = {}
    for alarm in alarms:
        by_key.setdefault(alarm.key, []).append(alarm.t_ns)
    bursts = {key: most_within(own, MINUTE_NS) for key, own in by_key.items()}
    return Rates(
        days=length / DAY_NS,
        announced=len(alarms),
        a_day=len(alarms) * DAY_NS / length if length >= DAY_NS else None,
        most_in_ten_minutes=most_within(times, TEN_MINUTES_NS),
        floods=floods,
        flood_percent=100.0 * sum(flood.to_ns - flood.from_ns for flood in floods) / length,
        chattering={key: count for key, count in bursts.items() if count >= CHATTERS},
        stale={key: since for key, since in standing.items() if until_ns - since > DAY_NS},
        frequent=Counter({key: len(own) for key, own in by_key.items()}).most_common(10),
        priorities=dict(Counter(alarm.priority for alarm in alarms)),
    )


def most_within(times: Sequence[int], length_ns: int) -> int:
    """Return how many of some instants in order lie in the fullest stretch of a length, ns."""
    recent = deque[int]()
    most = 0
    for t_ns in times:
        recent.append(t_ns)
        while t_ns - recent[0] >= length_ns:
            recent.popleft()
        most = max(most, len(recent))
    return most


def floods_of(times: Sequence[int]) -> list[Flood]:
    """Return the floods among instants in order, ns."""
    found: list[Flood] = []
    recent = deque[int]()
    begun = False
    for t_ns in times:
        while recent and t_ns - recent[0] >= TEN_MINUTES_NS:
            recent.popleft()
            begun = begun and len(recent) >= FLOOD_ENDS
        recent.append(t_ns)
        if begun:
            found[-1] = Flood(found[-1].from_ns, t_ns, found[-1].alarms + 1)
        elif len(recent) > FLOOD_BEGINS:
            found.append(Flood(recent[0], t_ns, len(recent)))
            begun = True
    return found
