"""`deltak alarms`: activations and what to do, the table of states, the measures of the standard."""

import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from agent.alarms.life_cycle import TABLE, legend, rules
from agent.alarms.rates import ACCEPTABLE_A_DAY, MOST_A_DAY, Announced, Key, Rates, rates
from agent.cli.terminal.output import print_json, print_rows, print_table, show
from agent.errors import UsageError
from agent.storage.read import queries, recent
from agent.storage.read.times import parse_time
from agent.text import iso_time, number, with_local

Row = Mapping[str, Any]
ALARM_COLUMNS = (
    "id", "rig", "run_id", "kind", "parameter", "priority", "state", "raised_at", "cleared_at", "acked_at",
    "acked_by", "shelved_until", "delta", "sd", "limit_value", "probability", "message", "advice", "percent",
    "site", "labels",
)  # fmt: skip
KINDS: Final = {
    "level": "a parameter has left its limit",
    "rate": "a parameter changes too fast",
    "forecast": "a parameter will reach its limit soon",
    "sensor": "a channel cannot be believed",
    "source": "samples do not come, or the agent cannot store or compute",
    "blind": "a parameter has not been estimated for too long",
    "mismatch": "the model does not explain the machine any more",
}
"""What an alarm of each kind says; the legend below the table has those that it shows."""


def alarms(db: Path, rig: str | None, form: str, *, active: bool) -> None:
    """Print the alarms of a file, one row an activation; active: only those whose condition still stands.

    Raises StoreError; UsageError for an unknown rig.
    """
    found = queries.alarms(db, rig, active)
    rows: Sequence[Row] = found
    if active:
        rows = _standing(rows, {run["run_id"]: run["kind"] for run in queries.runs(db)})
    if form == "table":
        _print_alarm_table(rows)
    else:
        print_rows("alarms", ALARM_COLUMNS, rows, form, found.refused)


def _standing(rows: Sequence[Row], kinds: Mapping[int, str]) -> list[Row]:
    """Return standing alarms: of one parameter the newest that runs of one kind (kinds: of each run) left so.

    One replay after another may leave an alarm standing; none of them may hide one of the live machine.
    """
    newest = {
        (row["rig"], row["kind"], row["parameter"], kinds.get(row["run_id"])): row
        for row in rows
        if row["cleared_at"] is None
    }
    return sorted(newest.values(), key=lambda row: row["id"])


def _print_alarm_table(rows: Sequence[Row]) -> None:
    if not rows:
        sys.stdout.write("no alarms\n")
        return
    is_plain = {place(row) for row in rows} == {rows[0]["rig"]}
    skip = 1 if is_plain else 0  # the name of the only rig, of which no site or label is known, says nothing
    columns = ("rig", "id", "kind", "priority", "state", "raised", "cleared", "what")
    print_table("", columns[skip:], (_alarm_cells(row)[skip:] for row in rows))
    for kind in dict.fromkeys(row["kind"] for row in rows):
        show(f"{kind}: {KINDS.get(kind, 'of another version')}")


def _alarm_cells(row: Row) -> tuple[str, ...]:
    raised, cleared = with_local(row["raised_at"]), with_local(row["cleared_at"])
    return place(row), str(row["id"]), row["kind"], row["priority"], state(row), raised, cleared, what(row)


def place(row: Row) -> str:
    """Return an alarm's rig with its site and labels."""
    labels = json.loads(row["labels"]) if row["labels"] else {}
    site = f" at {row['site']}" if row["site"] else ""
    return f"{row['rig']}{site}" + "".join(f", {name} {value}" for name, value in labels.items())


def state(row: Row) -> str:
    """Return an alarm's state, and who acknowledged it or until when it is shelved."""
    if row["state"] == "SHLVD" and row["shelved_until"]:
        return f"SHLVD until {with_local(row['shelved_until'])}"
    return f"{row['state']} by {row['acked_by']}" if row["acked_by"] else str(row["state"])


def what(row: Row) -> str:
    """Return an alarm's sentence with its change in per cent and the configuration's advice."""
    share = "" if row["percent"] is None else f" ({row['percent']:+.3g} %)"
    return f"{row['message']}{share}" + (f"; {row['advice']}" if row["advice"] else "")


def print_states(*, as_json: bool) -> None:
    """Print the table of states and causes, and what they mean."""
    if as_json:
        print_json(
            {"table": [line.split() for line in TABLE.splitlines()], "states": legend(), "causes": rules()}
        )
        return
    show(TABLE)
    show("-: stays as it is; x: refused; P/Q: P where the condition stands, else Q")
    print_table("", ("state", "ISA-18.2, 5.4", "meaning", "OPC UA Part 9"), legend())
    print_table("", ("cause", "ISA-18.2", "what brings it about"), rules())


def statistics(db: Path, rig: str | None, since: str | None) -> dict[str, Any]:
    """Return the measures of a file's alarms as the document of --stats. Raises StoreError, UsageError."""
    rows = queries.alarms(db, rig)
    by_id = {row["id"]: row for row in rows}
    events = recent.alarm_events(db, rig)
    runs = queries.runs(db, rig)
    newest = max(
        [event["t_ns"] for event in events] + [row["t_ns"] for row in queries.latest(db, rig)], default=0
    )  # fmt: skip
    oldest = min(
        [_instant(run["started_at"]) for run in runs] + [event["t_ns"] for event in events], default=0
    )
    # a replay starts long after its rows were
    first = min(oldest, newest) if since is None else parse_time(since, newest, "--since")
    if first > newest:
        raise UsageError.at("--since", f"{iso_time(first)} is after the newest row", "give an earlier time")
    announced = [
        Announced(event["t_ns"], _key(by_id[event["alarm_id"]]), by_id[event["alarm_id"]]["priority"])
        for event in events
        if event["to_state"] == "UNACK" != event["from_state"] and event["t_ns"] >= first
    ]
    standing = {_key(row): _instant(row["raised_at"]) for row in rows if row["cleared_at"] is None}
    return _document(rates(announced, standing, first, newest), first, newest)


def _key(row: Row) -> Key:
    return row["rig"], row["kind"], row["parameter"]


def _instant(text: str) -> int:
    return parse_time(text, None)


def _document(found: Rates, first: int, newest: int) -> dict[str, Any]:
    document = asdict(found)
    document["floods"] = [
        {"from": iso_time(flood.from_ns), "to": iso_time(flood.to_ns), "alarms": flood.alarms}
        for flood in found.floods
    ]
    document["chattering"] = [
        {"alarm": " ".join(key), "within_a_minute": n} for key, n in found.chattering.items()
    ]
    document["stale"] = [{"alarm": " ".join(key), "raised_at": iso_time(t)} for key, t in found.stale.items()]
    document["frequent"] = [{"alarm": " ".join(key), "times": n} for key, n in found.frequent]
    return {"stats": {"since": iso_time(first), "until": iso_time(newest), **document}}


def print_statistics(document: Mapping[str, Any]) -> None:
    """Print the measures beside what the standard aims at."""
    found = document["stats"]
    aims = f"{ACCEPTABLE_A_DAY} are acceptable for one operator, {MOST_A_DAY} the most"
    rows = (
        ("alarms announced", str(found["announced"]), f"over {number(found['days'], 3)} days"),
        ("a day", number(found["a_day"], 3), aims),
        ("most in 10 minutes", str(found["most_in_ten_minutes"]), "10 at most"),
        (
            "floods",
            str(len(found["floods"])),
            f"{number(found['flood_percent'], 2)} % of the time; under 1 %",
        ),
        ("chattering", _listed(found["chattering"], "within_a_minute"), "3 within a minute; none"),
        ("stale", _listed(found["stale"], "raised_at"), "standing for over 24 h; fewer than 5"),
        ("most frequent", _listed(found["frequent"], "times"), "ten make up 5 % at most"),
        (
            "by priority",
            ", ".join(f"{n} {p}" for p, n in found["priorities"].items()),
            "80 % low, 15 %, 5 % high",
        ),
    )
    print_table(
        f"{found['since']} to {found['until']}", ("measure", "found", "ANSI/ISA-18.2-2016, clause 16"), rows
    )


def _listed(entries: Iterable[Mapping[str, Any]], figure: str) -> str:
    return ", ".join(f"{entry['alarm']} ({entry[figure]})" for entry in entries) or "none"
