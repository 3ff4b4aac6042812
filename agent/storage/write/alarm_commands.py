# ruff: noqa: S608 - statements are put together from this package's own names; values are always bound
"""What operators do to alarms: all in a request take the step, or none does and each refusal says why."""

import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from agent.alarms.life_cycle import COMMANDS, Alarm, Cause
from agent.errors import Fault, StoreError
from agent.storage.database.checksum import checked
from agent.storage.database.columns import columns_of
from agent.storage.tables.alarms import AlarmRow, alarm_of, event_cells, kind_of
from agent.storage.tables.rows import Plan
from agent.storage.tables.shelves import Moment, Shelf, left_ns, shelf_of
from agent.storage.tuning import COMMAND_ALARMS, COMMENT_LETTERS, LONGEST_SHELF_NS
from agent.storage.write.store import Store
from agent.text import iso_time
from agent.types import AlarmTransition

_DONE: Final[Mapping[Cause, str]] = {
    "acknowledge": "acknowledged", "shelve": "shelved", "unshelve": "unshelved",
    "out of service": "out of service", "return": "returned to service",
    "expire": "no longer shelved, its time is over", "re-alarm": "acknowledged for long and not over",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Request:
    """What somebody asks for.

    Attributes:
        cause: one of `life_cycle.COMMANDS`; ids: of rows of v_alarms.
        by, comment: who and why.
        length_ns: for how long to shelve; None for the others.
    """

    cause: Cause
    ids: tuple[int, ...]
    by: str
    comment: str | None = None
    length_ns: int | None = None

    @classmethod
    def read(cls, asked: Mapping[str, Any]) -> "Request":
        """Return the request that a document holds. Raises StoreError for one that makes no sense."""
        cause = next((cause for cause in COMMANDS if cause == asked.get("cause")), None)
        ids = _sound_ids(asked.get("ids"))
        if cause is None or not ids:
            advice = f"causes are {', '.join(COMMANDS)}; ids whole numbers"
            raise StoreError.at("alarm", "is no command on alarms", advice)
        by, comment, length_ns = (asked.get(key) for key in ("by", "comment", "length_ns"))
        made = cls(cause, ids, str(by or ""), comment, length_ns)
        faults = list(made.faults())
        if faults:
            raise StoreError(faults)
        return made

    def document(self) -> dict[str, Any]:
        """Return the request as JSON carries it."""
        return {"cause": self.cause, "ids": list(self.ids), "by": self.by, "comment": self.comment,
                "length_ns": self.length_ns}  # fmt: skip

    def faults(self) -> Iterator[Fault]:
        """Yield what is wrong with it by itself."""
        texts: dict[str, object] = {
            "--by": self.by,
            "--comment": "" if self.comment is None else self.comment,
        }
        for path, text in texts.items():
            if not isinstance(text, str) or len(text) > COMMENT_LETTERS or not _is_unicode(text):
                yield Fault(path, f"is no text of at most {COMMENT_LETTERS} characters", "shorten it")
        if not self.by:
            yield Fault("--by", "is empty", "say who does it")
        if self.cause == "shelve":
            yield from _length_faults(self.length_ns)


def _sound_ids(ids: object) -> tuple[int, ...]:
    """Return whole numbers, each once; none at all for what is no list of them or too long a one."""
    if not isinstance(ids, list) or len(ids) > COMMAND_ALARMS:
        return ()
    return tuple(dict.fromkeys(ids)) if all(type(one) is int for one in ids) else ()


def _is_unicode(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def _length_faults(length_ns: object) -> Iterator[Fault]:
    advice = (
        "give a time such as --for 8h; what is to be silent for longer is taken out of service: deltak oos"
    )
    if type(length_ns) is not int:
        yield Fault("--for", "an alarm is not shelved for ever", advice)
    elif not 0 < length_ns <= LONGEST_SHELF_NS:
        yield Fault("--for", f"{length_ns / 86_400e9:.3g} days are not within 7 days", advice)


@dataclass(frozen=True, slots=True)
class Found:
    """An alarm of the file: its row, whose it is, and the newest row of the same alarm."""

    row: AlarmRow
    rig: str
    run_kind: str
    newest: int

    @property
    def is_newest(self) -> bool:
        return self.row.seq == self.newest

    @property
    def alarm(self) -> Alarm:
        return alarm_of(self.row)


@dataclass(frozen=True, slots=True)
class Taken:
    """A step that an alarm took, and its row after it."""

    found: Found
    row: AlarmRow
    step: AlarmTransition
    shelf: Shelf | None = None

    def document(self) -> dict[str, Any]:
        """Return what happened, as JSON carries it."""
        step, until = self.step, self.row.shelved_until_ns
        return {
            "id": self.row.seq, "rig": step.rig, "kind": step.kind, "parameter": step.parameter,
            "from_state": step.from_state, "to_state": step.to_state, "cause": step.cause, "by": step.by,
            "comment": step.comment, "t_ns": step.t_ns,
            "shelved_until": None if until is None else iso_time(until), "message": self.row.message,
        }  # fmt: skip


def carry_out(store: Store, request: Request, now: Moment) -> list[Taken]:
    """Have alarms take a step and return all steps once they are committed; shelves that are over end first.

    Raises StoreError with one fault an alarm that there is not or that refuses; then nothing is changed.
    """
    faults: list[Fault] = []
    over: list[Taken] = []
    taken: list[Taken] = []
    for seq in request.ids:
        found = find(store, seq)
        if found is None:
            faults.append(
                Fault(f"alarm {seq}", "there is no such alarm", f"deltak alarms {store.path} lists them")
            )
            continue
        ended = _expired(store, found, now)
        if ended is not None:
            over.append(ended)
            found = replace(found, row=ended.row)
        step = _taken(store, found, request, now)
        faults += [step] if isinstance(step, Fault) else []
        taken += [step] if isinstance(step, Taken) else []
    if faults:
        raise StoreError(faults)
    _commit(store, [*over, *taken])
    return [*over, *taken]


def documents(steps: Sequence[Taken], request: Request) -> list[dict[str, Any]]:
    """Return the steps that were asked for, without shelves that were over, as JSON carries them."""
    return [taken.document() for taken in steps if taken.step.cause == request.cause]


def expire_shelves(store: Store, now: Moment) -> list[Taken]:
    """End the shelves of open runs whose time is over; return the steps once they are committed."""
    found = [find(store, row.seq) for row in store.open_runs.standing() if row.state == "SHLVD"]
    ended = [_expired(store, one, now) for one in found if one is not None]
    over = [one for one in ended if one is not None]
    if over:
        _commit(store, over)
    return over


def find(store: Store, seq: int) -> Found | None:
    """Return an alarm by its number: as open runs have it, else as the file has it; None if there is none."""
    if not 0 < seq < 2**63:
        return None
    row = next((row for row in store.open_runs.standing() if row.seq == seq), None) or _stored(
        store.connection, seq
    )
    if row is None:
        return None
    whose = store.connection.execute(_RIG, (row.run_id,)).fetchone()
    if whose is None:
        return None
    rig, kind = whose
    same = (rig, kind, row.kind, row.parameter)
    newest = int(store.connection.execute(_NEWEST, same).fetchone()[0] or 0)
    opened = [other.seq for other in store.open_runs.standing(rig, kind) if other.key == row.key]
    return Found(row, rig, kind, max(newest, row.seq, *opened))


_RIG = "SELECT g.name, r.kind FROM runs r JOIN rigs g ON g.seq = r.rig_id WHERE r.seq = ?"
_NEWEST = (
    "SELECT max(a.seq) FROM alarms a JOIN runs r ON r.seq = a.run_id JOIN rigs g ON g.seq = r.rig_id "
    "WHERE g.name = ? AND r.kind = ? AND a.kind = ? AND a.parameter = ?"
)


def _stored(connection: sqlite3.Connection, seq: int) -> AlarmRow | None:
    query = f"SELECT {', '.join(columns_of('alarms'))} FROM alarms WHERE seq = ?"
    cells = checked(connection.execute(query, (seq,)).fetchone())
    return None if cells is None else AlarmRow(*cells)


def _expired(store: Store, found: Found, now: Moment) -> Taken | None:
    """Return how a shelf that is over ends; None for an alarm that is not shelved, or still is."""
    if found.row.state != "SHLVD":
        return None
    shelf = store.shelf(found.row.seq, lambda: shelf_of(store.connection, found.row.seq))
    if shelf is not None and shelf.boot_id != now.boot:
        shelf = _anchored(store, found, shelf, now)
    if shelf is not None and left_ns(store.connection, found.rig, shelf, now) > 0:
        return None
    ended = _taken(store, found, Request("expire", (found.row.seq,), "deltak"), now)
    return ended if isinstance(ended, Taken) else None


def _anchored(store: Store, found: Found, shelf: Shelf, now: Moment) -> Shelf:
    """Count on by the clock of this boot what is left of a shelf of another."""
    left = max(0, left_ns(store.connection, found.rig, shelf, now))
    return _keep(store, _shelf(store, found, left, now))


def _shelf(store: Store, found: Found, length_ns: int, now: Moment) -> Shelf:
    part, offset = store.open_runs.clock(found.rig, found.run_kind)
    t_ns = now.wall_ns if offset is None else now.monotonic_ns + offset
    return Shelf(found.row.seq, part, now.boot, now.monotonic_ns, t_ns, length_ns)


def _keep(store: Store, shelf: Shelf) -> Shelf:
    plan = Plan()
    shelf.add_to(plan, store.numbers)
    store.commit([plan])
    store.shelves[shelf.alarm_id] = shelf
    return shelf


def _taken(store: Store, found: Found, request: Request, now: Moment) -> Taken | Fault:
    row, cause = found.row, request.cause
    if not found.is_newest and cause not in {"acknowledge", "expire"}:
        what = f"{row.parameter} was raised again since, as alarm {found.newest}"
        return Fault(f"alarm {row.seq}", what, f"name {found.newest}")
    alarm = found.alarm.step(cause)
    if alarm is None:
        return Fault(f"alarm {row.seq}", *_refusal(row, cause))
    shelf = _shelf(store, found, request.length_ns, now) if request.length_ns is not None else None
    step = AlarmTransition(
        found.rig, kind_of(row), row.parameter, row.priority, now.wall_ns, found.alarm.state, alarm.state,
        cause, f"{row.parameter}: {_DONE[cause]}", by=request.by, comment=request.comment,
    )  # fmt: skip
    return Taken(found, _row_after(row, step, shelf), step, shelf)


def _row_after(row: AlarmRow, step: AlarmTransition, shelf: Shelf | None) -> AlarmRow:
    """Return the row as an operator's step leaves it."""
    until = None if shelf is None else step.t_ns + shelf.length_ns
    row = replace(row, state=step.to_state, shelved_until_ns=until)
    if step.to_state == "UNACK":  # to be acknowledged again
        return replace(row, acked_ns=None, acked_by=None)
    accepted = step.to_state == "ACKED" or step.cause == "acknowledge"
    return replace(row, acked_ns=step.t_ns, acked_by=step.by) if accepted else row


def _refusal(row: AlarmRow, cause: Cause) -> tuple[str, str]:
    """Return why an alarm refuses, and what to do."""
    advice = f"it is {row.state}; deltak alarms --states says what each state allows"
    known = row.acked_ns is not None
    if cause == "acknowledge" and known and row.state in {"ACKED", "NORM"}:
        return (
            f"{row.parameter} was acknowledged already, by {row.acked_by} at {iso_time(row.acked_ns or 0)}",
            advice,
        )
    if row.state == "SHLVD" and row.shelved_until_ns is not None:
        until = iso_time(row.shelved_until_ns)
        return f"{row.parameter} is shelved until {until}", "unshelve it first: deltak unshelve"
    if row.state == "OOSRV":
        return f"{row.parameter} is out of service", "return it first: deltak return"
    words = {"acknowledge": "there is nothing to acknowledge", "unshelve": "it is not shelved",
             "return": "it is not out of service"}  # fmt: skip
    return f"{row.parameter}: {words.get(cause, 'that cannot be done')}", advice


def _commit(store: Store, taken: Sequence[Taken]) -> None:
    """Store steps in one transaction, then let open runs go on with the rows."""
    plan = Plan()
    for one in taken:
        plan.sealed("alarms", *one.row.cells())
        event_id = store.numbers.take("alarm_events")
        plan.sealed("alarm_events", event_id, one.row.seq, *event_cells(one.step))
        store.outbox.add(plan, event_id, one.step, store.numbers)
        if one.shelf is not None:
            one.shelf.add_to(plan, store.numbers)
    store.commit([plan])
    for one in taken:
        store.shelves.pop(one.row.seq, None)
        if one.shelf is not None:
            store.shelves[one.row.seq] = one.shelf
        if one.found.is_newest:
            store.open_runs.take_up(one.found.rig, one.found.run_kind, one.row)
