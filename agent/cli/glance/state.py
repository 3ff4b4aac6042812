"""State of rigs: newest estimates against limits, alarms that need somebody, sources, lag; worst first."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from agent.cli.glance.covariates import covariates_now
from agent.cli.glance.files import Watched
from agent.cli.glance.known import known_now, known_words
from agent.cli.tuning import STALE_S
from agent.errors import StoreError
from agent.storage.read import baselines, covariates, queries, recent

Row = Mapping[str, Any]
_PRIORITIES = ("low", "medium", "high", "critical")
_STATES = ("NORM", "DSUPR", "OOSRV", "SHLVD", "RTNUN", "ACKED", "UNACK")
"""The states of ISA-18.2 in the order in which they ask for somebody."""


def overview(watched: Iterable[Watched], now_ns: int) -> dict[str, Any]:
    """Return {"rigs": [...], "refused": rows with bad checksums, "errors": [...]} of all files, worst first.

    One file that cannot be read does not hide the rigs of others. Raises StoreError where none can be.
    """
    databases = list(watched)
    rigs: list[dict[str, Any]] = []
    errors: list[StoreError] = []
    refused = 0
    for database in databases:
        try:
            found, wrong = _rigs_of(database, now_ns)
        except StoreError as error:
            errors.append(error)
            continue
        rigs += found
        refused += wrong
    if errors and len(errors) == len(databases):
        raise errors[0]
    rigs.sort(key=lambda rig: rig["severity"], reverse=True)
    return {"rigs": rigs, "refused": refused, "errors": [str(error) for error in errors]}


def _rigs_of(database: Watched, now_ns: int) -> tuple[list[dict[str, Any]], int]:
    tables = {
        "latest": queries.latest(database.path),
        "alarms": queries.alarms(database.path, active=True),
        "sources": recent.sources(database.path),
    }
    refused = sum(rows.refused for rows in tables.values())
    found = []
    for name in queries.rigs(database.path):
        own = {key: [row for row in rows if row["rig"] == name] for key, rows in tables.items()}
        found.append(_rig(database, name, own, now_ns))
    return found, refused


def _rig(database: Watched, name: str, tables: Mapping[str, Sequence[Row]], now_ns: int) -> dict[str, Any]:
    latest, alarms = tables["latest"], tables["alarms"]
    limits = {**_limits_of_alarms(alarms), **database.limits(name)}
    parameters = [_parameter(row, limits.get(row["parameter"]), alarms) for row in latest]
    newest = max((row["t_ns"] for row in latest), default=None)
    found = {
        "rig": name,
        "db": database.name,
        "t_ns": newest,
        "lag_s": None if newest is None else (now_ns - newest) / 1e9,
        "parameters": parameters,
        "known": known_words(parameters),
        "alarms": sorted(alarms, key=urgency, reverse=True),
        "sources": [{**row, "stale": (now_ns - row["t_ns"]) / 1e9 > STALE_S} for row in tables["sources"]],
        "covariates": covariates_now(
            covariates.newest(database.path, name), baselines.standing(database.path, name), now_ns
        ),
    }
    return found | {"severity": _severity(found), "words": _words(found)}


def _limits_of_alarms(alarms: Iterable[Row]) -> dict[str, Row]:
    """Return what alarms say of the limits that they stand for, where no configuration does."""
    levels = (row for row in alarms if row["kind"] == "level" and row["limit_value"] is not None)
    nothing = {"limit_percent": None, "side": "both"}
    return {
        row["parameter"]: {"limit": abs(row["limit_value"]), "priority": row["priority"], **nothing}
        for row in levels
    }


def _parameter(row: Row, limit: Row | None, alarms: Iterable[Row]) -> dict[str, Any]:
    size = _limit_of(limit, row["reference"])
    known = size is not None and row["delta"] is not None
    return {
        **row,
        "limit": size,
        "side": None if limit is None else limit["side"],
        "used": abs(row["delta"]) / size if known and size else None,  # share of the limit
        "alarm": _most_urgent(a for a in alarms if a["parameter"] == row["parameter"]),
        "known": known_now(row, size),
    }


def _most_urgent(alarms: Iterable[Row]) -> str | None:
    """Return the state of the alarm that asks for somebody most: earlier ones may stand beside it."""
    worst = max(alarms, key=urgency, default=None)
    return None if worst is None else str(worst["state"])


def _limit_of(limit: Row | None, reference: float | None) -> float | None:
    """Return how far a parameter may be from its reference, in its unit."""
    if limit is None or limit["limit"] is not None:
        return None if limit is None else limit["limit"]
    return None if reference is None else abs(reference) * limit["limit_percent"] / 100.0


def urgency(alarm: Row) -> tuple[int, int, int]:
    """Return what alarms are ordered by: state, priority, number."""
    state = _STATES.index(alarm["state"]) if alarm["state"] in _STATES else len(_STATES)
    priority = _PRIORITIES.index(alarm["priority"]) if alarm["priority"] in _PRIORITIES else len(_PRIORITIES)
    return state, priority, alarm["id"]


def _severity(rig: Mapping[str, Any]) -> list[float]:
    """Return what rigs are ordered by: unacknowledged alarms, standing ones, lack of data, margins."""
    standing = [a for a in rig["alarms"] if a["state"] in {"UNACK", "ACKED", "RTNUN"}]
    worst = [
        max((urgency(a)[1] + 1 for a in standing if a["state"] == state), default=0)
        for state in ("UNACK", "ACKED")
    ]
    silent = sum(bool(source["stale"]) for source in rig["sources"])
    doubtful = sum(p["status"] != "valid" for p in rig["parameters"])
    return [
        *worst,
        len(standing),
        silent,
        doubtful,
        max((p["used"] or 0.0 for p in rig["parameters"]), default=0.0),
    ]


def _words(rig: Mapping[str, Any]) -> str:
    """Say in one word or two what a rig's state is."""
    open_alarms = sum(a["state"] == "UNACK" for a in rig["alarms"])
    standing = sum(a["state"] == "ACKED" for a in rig["alarms"])
    if open_alarms or standing:
        return f"{open_alarms} unacknowledged" if open_alarms else f"{standing} acknowledged"
    if any(source["stale"] for source in rig["sources"]):
        return "no data"
    valid = all(p["status"] == "valid" for p in rig["parameters"])
    return "normal" if valid and rig["parameters"] else "cannot tell"
