"""How old rows are: the order of runs, elapsed monotonic time, and a wall clock as far as it can be believed.

A part of a run is what was stamped by one setting of the wall clock; within it, and between the parts of a
run, stamps tell monotonic time. From one run to the next only the wall clock knows how long nothing ran. It
is believed in runs whose stamps follow one another; which ones those are is the heaviest increasing
subsequence (by time that ran) among all that end with the newest run. A run that was a year ahead, or in
1995, is none of them and moves no other.
"""

import sqlite3
from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate, pairwise

from agent.records import ClockRecord, RunInfo
from agent.storage.tuning import AGE_SLEW, CONFIRMED_NS, CONFIRMED_RUNS
from agent.tuning import STEP_NS

_LARGE = 2**63  # fixed by 64 bits: beyond every row
_KEPT = (
    "rows from before are kept by how long the agent ran until a day of running, "
    "over several runs, confirms it"
)


@dataclass(frozen=True, slots=True)
class Part:
    """Rows of a run that were stamped by one setting of the wall clock.

    Attributes:
        seq: their number in `runs`; run: the run that they are of.
        offset_ns: wall clock minus monotonic clock; 0 where unknown, and then the part is the whole run.
        from_ns: its first stamp, whether that row is still there or not; last_ns: the newest there is.
        known: whether its stamps tell monotonic time.
    """

    seq: int
    run: int
    live: bool
    offset_ns: int
    from_ns: int
    last_ns: int
    known: bool

    @property
    def begin(self) -> int:
        """Its first instant by the monotonic clock."""
        return self.from_ns - self.offset_ns

    @property
    def end(self) -> int:
        """Its last instant by the monotonic clock."""
        return self.last_ns - self.offset_ns


@dataclass(slots=True)
class _Run:
    """A run by the monotonic clock, and what the wall clock said at its ends."""

    parts: list[Part]
    begin: int = field(init=False)
    end: int = field(init=False)
    length: int = field(init=False)
    known: bool = field(init=False)
    main: int = field(init=False)
    """The offset that lasted longest."""

    def __post_init__(self) -> None:
        self.begin = min(p.begin for p in self.parts)
        self.end = max(p.end for p in self.parts)
        self.known = all(p.known for p in self.parts)
        self.length = max(0, self.end - self.begin) if self.known else 0
        self.main = max(self.parts, key=lambda p: p.last_ns - p.from_ns).offset_ns


_EDGE = (
    "(SELECT {0}(t) FROM (SELECT (SELECT h.t_ns FROM hops h WHERE h.run_id = r.seq AND h.span = s.span "
    "ORDER BY h.t_ns {1} LIMIT 1) AS t FROM (SELECT 0 AS span UNION ALL SELECT 60 UNION ALL SELECT 3600) s))"
)
_PARTS = (
    "SELECT r.seq, coalesce(c.part_of, r.seq) AS run, r.kind = 'live', coalesce(c.offset_ns, 0), "  # noqa: S608 - own
    f"coalesce(c.from_ns, {_EDGE.format('min', 'ASC')}), {_EDGE.format('max', 'DESC')} AS last, c.seq IS NOT "
    "NULL FROM rigs g CROSS JOIN runs r ON r.rig_id = g.seq LEFT JOIN clocks c ON c.run_id = r.seq WHERE "
    "g.name = ? AND last IS NOT NULL ORDER BY run, r.seq"
)


def parts_of(connection: sqlite3.Connection, rig: str) -> list[Part]:
    """Return the parts of a rig's runs that have rows, in the order of runs."""
    return [Part(*cells) for cells in connection.execute(_PARTS, (rig,))]


def shifts(parts: Sequence[Part], *, confirmed: bool = False) -> dict[int, int]:
    """Return what is added to the stamps of each part (by seq) so that they count in true time.

    The stamps of the part with the newest live row stay as they are. Another kind of run has a time of its
    own, that of its newest part.

    Args:
        parts: of one rig, in the order of runs.
        confirmed: count time between runs only where the wall clock is confirmed on both sides, so that no
            row appears older than it is; otherwise wherever stamps follow one another.
    """
    found: dict[int, int] = {}
    live: dict[int, list[Part]] = {}
    others: dict[int, list[Part]] = {}
    for part in parts:
        (live if part.live else others).setdefault(part.run, []).append(part)
    for own in others.values():
        found |= _placed([_Run(own)], confirmed)
    return found | _placed([_Run(own) for own in live.values()], confirmed)


def _placed(runs: Sequence[_Run], confirmed: bool) -> dict[int, int]:
    """Lay runs one after the other; return the shifts of their parts."""
    found: dict[int, int] = {}
    begin, last = 0, 0
    for run, pause in zip(runs, _pauses(runs, confirmed), strict=True):
        begin += pause
        # of a run whose stamps may have jumped unseen no row is older than its end
        edge = run.begin if run.known or confirmed else run.end
        found |= {part.seq: begin - edge - part.offset_ns for part in run.parts}
        begin += run.length
        last = max(run.parts, key=lambda part: part.end).seq
    return {seq: shift - found[last] for seq, shift in found.items()}


def _pauses(runs: Sequence[_Run], confirmed: bool) -> list[int]:
    """Return how long nothing ran before each run, ns, as far as it is believed."""
    pauses = [0] * len(runs)
    for chain in _chains(runs):
        lengths = [runs[i].length for i in chain]
        first, last = (
            (_needed(lengths), len(chain) - _needed(lengths[::-1])) if confirmed else (1, len(chain) - 1)
        )
        for place, (one, other) in enumerate(pairwise(chain), 1):
            if first <= place <= last:
                between = sum(run.length for run in runs[one + 1 : other])
                pauses[other] = max(0, _shortest(runs[one], runs[other]) - between)
    return pauses


def _needed(lengths: Sequence[int]) -> int:
    """Return how many of these run lengths confirm a wall clock; more than there are where they do not."""
    reached = accumulate(lengths)
    counts = accumulate(length > 0 for length in lengths)
    enough = (n for n, (ran, runs) in enumerate(zip(reached, counts, strict=True), 1)
              if ran >= CONFIRMED_NS and runs >= CONFIRMED_RUNS)  # fmt: skip
    return next(enough, len(lengths) + 1)


def _shortest(run: _Run, later: _Run) -> int:
    """Return the shortest time between two runs that any setting of their clocks allows."""
    ends = {run.end + part.offset_ns for part in run.parts}
    begins = {later.begin + part.offset_ns for part in later.parts}
    return min((b - e for b in begins for e in ends if b >= e), default=0)


def _chains(runs: Sequence[_Run]) -> list[list[int]]:
    """Return runs whose stamps follow one another: the heaviest such sequence that ends with the last run.

    What lies before its first run is divided in the same way.
    """
    before = _followed(runs)
    chains: list[list[int]] = []
    place = len(runs) - 1
    while place >= 0:
        chain = [place]
        while (earlier := before.get(chain[-1], -1)) >= 0:
            chain.append(earlier)
        chains.append(chain[::-1])
        place = chain[-1] - 1
    return chains


def _followed(runs: Sequence[_Run]) -> dict[int, int]:
    """Return for each run the one before it in the heaviest sequence that ends with it; -1 for none."""
    best: list[
        tuple[int, int, int]
    ] = []  # (wall clock at the end, weight, place): the first two increase together
    before: dict[int, int] = {}
    for place, run in enumerate(runs):
        if run.known:
            at = bisect_right(best, (run.begin + run.main, _LARGE, 0))
            before[place] = best[at - 1][2] if at else -1
            _keep(best, (run.end + run.main, run.length + (best[at - 1][1] if at else 0), place))
    return before


def _keep(best: list[tuple[int, int, int]], entry: tuple[int, int, int]) -> None:
    """Add an entry unless an earlier end weighs more; drop later ends that weigh no more."""
    at = bisect_right(best, (entry[0], _LARGE, 0))
    if at and best[at - 1][1] > entry[1]:
        return
    while at < len(best) and best[at][1] <= entry[1]:
        del best[at]
    best.insert(at, entry)


def newest_of(parts: Iterable[Part], found: Mapping[int, int]) -> int | None:
    """Return the true time of the newest of some parts' rows; None without any."""
    return max((part.last_ns + found[part.seq] for part in parts), default=None)


def jump_words(connection: sqlite3.Connection, run: RunInfo, run_id: int, now: ClockRecord) -> str | None:
    """Say how a live run's first stamp fits those of the live runs before; None if nothing is to be said."""
    before = [part for part in parts_of(connection, run.rig) if part.live and part.run < run_id]
    if run.kind != "live" or not before:
        return None
    last = max((part for part in before if part.run == before[-1].run), key=lambda part: part.end)
    gap_ns = now.t_ns - last.last_ns
    step_ns = _step(connection, run, last, now)
    if abs(step_ns) > STEP_NS:
        return f"the wall clock was stepped by {step_ns / 1e9:+.3f} s since the run before; {_KEPT}"
    if gap_ns < -STEP_NS:
        return f"the wall clock is {-gap_ns / 1e9:.3f} s behind the newest row of the run before; {_KEPT}"
    if gap_ns > CONFIRMED_NS:
        ahead_days = gap_ns / 86_400e9
        return f"the wall clock is {ahead_days:.1f} days ahead of the newest row of the run before; {_KEPT}"
    return None


def _step(connection: sqlite3.Connection, run: RunInfo, last: Part, now: ClockRecord) -> int:
    """Return by how much the wall clock was stepped since a part of an earlier run; 0 where unknown."""
    query = "SELECT r.boot_id, c.offset_ns FROM runs r JOIN clocks c ON c.run_id = r.seq WHERE r.seq = ?"
    found = connection.execute(query, (last.seq,)).fetchone()
    if found is None or None in found:
        return 0
    boot, offset = found
    passed = now.t_ns - now.offset_ns - last.end
    if boot != run.boot_id or passed < 0:
        return 0
    step = now.offset_ns - int(offset)
    return step if abs(step) > passed * AGE_SLEW else 0
