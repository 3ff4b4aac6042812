# ruff: noqa: S608 - statements are put together from this package's own names; values are always bound
"""The valid estimates of a parameter as arrays, a long stretch from rows of minutes or hours."""

import sqlite3
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from agent.storage.database.connect import Reader, damaged
from agent.storage.read.proof import NOTHING, Found, differing, joined, series_of, sound_points
from agent.storage.read.selection import (
    Stretch,
    check_parameter,
    one_rig,
    parameters_of,
    reading,
    stretches_of,
)
from agent.storage.tuning import MOST_POINTS
from agent.types import FloatArray, IntArray

_UNCOUNTED = 2**40  # fixed by its meaning: as many as there are


@dataclass(frozen=True, slots=True)
class Points:
    """Valid estimates of one parameter for a trend, in order of time.

    Attributes:
        rig, parameter, unit: what they are of.
        t_ns: (n,) times, by the wall clock as it is set now; of an aggregate, the middle of what it covers.
        value, sd: (n,) estimate and standard deviation.
        sd_repeat: (n,) standard deviation against the other points.
        span_s: (n,) 0, or what the aggregate covers.
        since_ns, until_ns: the stretch asked for; None where open.
        reference: what delta is counted from at the newest point; None without one.
        refused: rows that are left out because their checksums are wrong.
        references: what deltas were counted from over the stretch, oldest first.
        clock_steps: how often the wall clock was set otherwise meanwhile.
    """

    rig: str
    parameter: str
    unit: str
    t_ns: IntArray
    value: FloatArray
    sd: FloatArray
    sd_repeat: FloatArray
    span_s: IntArray
    since_ns: int | None
    until_ns: int | None
    reference: float | None
    refused: int
    references: tuple[float, ...] = ()
    clock_steps: int = 0


def points_of(
    db: Path | str, rig: str | None, parameter: str, since: str | None = None, until: str | None = None,
    most: int = MOST_POINTS,
) -> Points:  # fmt: skip
    """Return the valid estimates of one parameter as arrays.

    Stretches of more than `most` rows are read from the hourly or minutely rows, so that a year takes
    milliseconds; where there are too many hours, every second, third ... is.

    Raises:
        StoreError: the file; UsageError: an unknown rig or parameter, a rig needed because there are several,
            no time.
    """
    with reading(db) as connection:
        name = one_rig(connection, rig)
        check_parameter(connection, name, parameter)
        return _points(connection, name, (parameter,), since, until, most)[0]


def all_points(db: Path | str, rig: str, most: int = MOST_POINTS) -> list[Points]:
    """Return the same of every parameter of a rig, whose rows are read together; errors as `points_of`."""
    with reading(db) as connection:
        name = one_rig(connection, rig)
        return _points(connection, name, parameters_of(connection, name), None, None, most)


def longest_window(db: Path | str) -> float:
    """Return the longest window, s, that estimates of a database rest on; quicker than looking those up."""
    query = (
        "SELECT seq, window_s FROM fits WHERE chosen = 1 AND window_s IS NOT NULL "
        "ORDER BY window_s DESC LIMIT 1"
    )
    with reading(db) as connection:
        found = connection.execute(query).fetchone()
        connection.refuse(0 if found is None else len(differing(connection, "fits", (), {found[:1]})))
    return 0.0 if found is None else float(found[1])


def _points(
    connection: Reader, rig: str, names: Sequence[str], since: str | None, until: str | None, most: int
) -> list[Points]:
    stretches, first, last = stretches_of(connection, rig, since, until)
    parts = {stretch.part for stretch in stretches}
    series = {name: {p: n for p, n in series_of(connection, name).items() if p in parts} for name in names}
    together: dict[int, list[int]] = {}
    for runs_of_one in series.values():
        for part, numbers in runs_of_one.items():
            together.setdefault(part, []).extend(numbers)
    rows, spans = _tiered(connection, stretches, together, most)
    found = []
    for name in names:
        own = [number for numbers in series[name].values() for number in numbers]
        mine = np.isin(rows.series, own)
        one = rows.at(mine)
        unit, reference = _unit(connection, rig, name)
        found.append(Points(
            rig, name, unit, one.t_ns, one.value, one.sd, one.sd_repeat, spans[mine],
            None if since is None else first, None if until is None else last, reference, connection.refused,
            _references(connection, own), max(0, len({s.shift for s in stretches}) - 1),
        ))  # fmt: skip
    return found


def _tiered(
    connection: Reader, stretches: Sequence[Stretch], series: Mapping[int, Sequence[int]], most: int
) -> tuple[Found, IntArray]:
    """Return rows from the finest tier that is not too long, then finer ones, and what each covers, s."""
    bounds = {
        span: _bounds(connection, stretches, span, most if span < 3600 else _UNCOUNTED)
        for span in (0, 60, 3600)
    }
    start = _first_tier(bounds, most)
    tiers: list[Found] = []
    spans = sorted((s for s in bounds if s <= start), reverse=True)
    for span in spans:
        _, count = bounds[span] or (0, 0)
        each = max(1, -(-count // most)) if span == 3600 else 1
        tiers.append(_tier_points(connection, stretches, series, span, each))
        if len(tiers[-1].t_ns):
            reached = int(tiers[-1].t_ns[-1]) + span * 500_000_000 + (span == 0)
            stretches = [stretch.after(reached) for stretch in stretches]
    return joined(tiers), np.repeat(spans, [len(tier.t_ns) for tier in tiers])


def _first_tier(bounds: Mapping[int, tuple[int, int] | None], most: int) -> int:
    """Return the finest tier that reaches far enough and is not too long, else the coarsest with rows."""
    oldest = min((b[0] for b in bounds.values() if b), default=0)
    fits = [s for s, b in bounds.items() if b and b[0] <= oldest + (s or 3600) * 10**9 and b[1] <= most]
    return fits[0] if fits else max((span for span, b in bounds.items() if b), default=0)


def _bounds(
    connection: sqlite3.Connection, stretches: Sequence[Stretch], span: int, most: int
) -> tuple[int, int] | None:
    """Return a tier's oldest instant in stretches and how many it has there, counted as far as matters."""
    part = "FROM hops h WHERE h.run_id = ?1 AND h.span = ?2 AND h.t_ns BETWEEN ?3 AND ?4"
    query = (
        f"SELECT (SELECT h.t_ns {part} ORDER BY h.t_ns LIMIT 1), "
        f"(SELECT count(*) FROM (SELECT 1 {part} LIMIT ?5))"
    )
    found = []
    for stretch, shift, first, last in stretches:
        oldest, count = connection.execute(query, (stretch, span, first, last, most + 1)).fetchone()
        found += [(oldest + shift, count)] if count else []
    return (min(t for t, _ in found), sum(n for _, n in found)) if found else None


def _tier_points(
    connection: Reader,
    stretches: Sequence[Stretch],
    series: Mapping[int, Sequence[int]],
    span: int,
    each: int,
) -> Found:
    """Return the points of a tier in the order of true time."""
    found = [NOTHING]
    for part, shift, first, last in stretches:
        points = sound_points(connection, part, series.get(part, ()), span, first, last, each)
        found.append(points._replace(t_ns=points.t_ns + shift))
    rows = joined(found)
    return rows.at(np.argsort(rows.t_ns, kind="stable"))


def _unit(connection: Reader, rig: str, parameter: str) -> tuple[str, float | None]:
    query = (
        "SELECT s.unit, s.reference, s.seq FROM series s JOIN runs r ON r.seq = s.run_id "
        "JOIN rigs g ON g.seq = r.rig_id WHERE g.name = ? AND s.parameter = ? ORDER BY s.seq DESC LIMIT 1"
    )
    row = connection.execute(query, (rig, parameter)).fetchone()
    if row is None and not parameters_of(connection, rig):
        return "", None
    if row is None:  # found a moment ago, by another way
        raise damaged("an index does not list what its table holds")
    unit, reference, seq = row
    connection.refuse(len(differing(connection, "series", (), {(seq,)})))
    return str(unit), None if reference is None else float(reference)


def _references(connection: sqlite3.Connection, series: Sequence[int]) -> tuple[float, ...]:
    """Return the different references of some series, oldest first."""
    query = f"SELECT reference FROM series WHERE seq IN ({', '.join(map(str, series))}) ORDER BY seq"
    known = (reference for (reference,) in connection.execute(query) if reference is not None)
    return tuple(dict.fromkeys(known))
