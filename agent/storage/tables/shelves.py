"""Shelved alarms: for how long, by elapsed time. A step of the wall clock neither ends nor prolongs a shelf.

Within a boot the monotonic clock tells, whether the agent ran or not. Over a boot time passes as it does for
the ages of rows (`ages`): what ran counts, and what lay between as far as the wall clock is believed.
"""

import sqlite3
from dataclasses import dataclass
from typing import NamedTuple

from agent.clock import boot_id, monotonic_ns, wall_ns
from agent.storage.database.checksum import checked
from agent.storage.database.columns import columns_of
from agent.storage.tables.ages import newest_of, parts_of, shifts
from agent.storage.tables.rows import Numbers, Plan


class Moment(NamedTuple):
    """An instant by the clocks of this machine, ns."""

    wall_ns: int
    monotonic_ns: int
    boot: str | None


def moment() -> Moment:
    """Return this instant."""
    return Moment(wall_ns(), monotonic_ns(), boot_id())


@dataclass(frozen=True, slots=True)
class Shelf:
    """One shelving, in the order of the columns of table `shelves`.

    Attributes:
        run_id: the part of a run (see `clocks`) by whose wall clock t_ns counts; 0 for none.
        length_ns: for how long from then.
    """

    alarm_id: int
    run_id: int
    boot_id: str | None
    monotonic_ns: int
    t_ns: int
    length_ns: int

    def add_to(self, plan: Plan, numbers: Numbers) -> None:
        """Add the row to a plan."""
        facts = (self.alarm_id, self.run_id, self.boot_id, self.monotonic_ns, self.t_ns, self.length_ns)
        plan.sealed("shelves", numbers.take("shelves"), *facts)


def shelf_of(connection: sqlite3.Connection, alarm_id: int) -> Shelf | None:
    """Return the newest shelf of an alarm; None without one whose checksum is right."""
    query = (
        f"SELECT {', '.join(columns_of('shelves'))} FROM shelves WHERE alarm_id = ? ORDER BY seq DESC LIMIT 1"  # noqa: S608 - own names
    )
    cells = checked(connection.execute(query, (alarm_id,)).fetchone())
    return None if cells is None else Shelf(*cells[1:])


def left_ns(connection: sqlite3.Connection, rig: str, shelf: Shelf, now: Moment) -> int:
    """Return for how long an alarm of a rig is still shelved, ns; not positive when it is over."""
    if shelf.boot_id is not None and shelf.boot_id == now.boot:
        return shelf.length_ns - (now.monotonic_ns - shelf.monotonic_ns)
    parts = [part for part in parts_of(connection, rig) if part.live]
    found = shifts(parts)
    newest = newest_of(parts, found)
    if newest is None or shelf.run_id not in found:
        return shelf.length_ns - max(0, now.wall_ns - shelf.t_ns)
    ran = max(0, newest - shelf.t_ns - found[shelf.run_id])
    return shelf.length_ns - ran - max(0, now.wall_ns - newest)
