"""API documents by name: what each may be asked, and how it is made of the database; JSON as of --json."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from agent.cli.glance.files import Watched
from agent.cli.glance.state import overview
from agent.cli.prognosis.trend import document as trend_document
from agent.cli.terminal.output import json_ready
from agent.cli.tuning import MOST_INSTANTS, PAGE_POINTS, SHOWN_POINTS
from agent.cli.web.forecasts import forecasts
from agent.cli.web.model import drawing
from agent.clock import wall_ns
from agent.errors import UsageError
from agent.storage.read import queries, recent
from agent.storage.read.baselines import baselines
from agent.storage.read.points import Points, points_of
from agent.storage.read.queries import Rows

Asked = Mapping[str, str]
Make = Callable[[tuple[Watched, ...], Asked], Mapping[str, Any]]

PARAMETERS: Final = {
    "db": "name of a database, of those that /rigs names; all without",
    "rig": "name of a rig; all without",
    "parameter": "name of a parameter, such as k1",
    "since": "ISO 8601, or an age back from the newest row of the rig: 90s, 12h, 30d",
    "until": "as since; both ends belong to the answer",
    "active": "1: only alarms that are not in state NORM",
    "limit": "the value whose crossing is forecast, in the parameter's unit",
    "points": "how many points at most; 800 without",
}


@dataclass(frozen=True, slots=True)
class Document:
    """One document: what it is, which `PARAMETERS` it takes, how it is made, if it changes with the clock."""

    summary: str
    takes: tuple[str, ...]
    make: Make
    by_clock: bool = False


def _chosen(watched: tuple[Watched, ...], asked: Asked) -> tuple[Watched, ...]:
    """Return the databases that are meant. Raises UsageError for a name that none has."""
    name = asked.get("db")
    found = tuple(database for database in watched if name in {None, database.name})
    if not found:
        names = ", ".join(database.name for database in watched)
        raise UsageError.at("db", f"no database is called {name!r}", f"databases are {names}")
    return found


def _one(watched: tuple[Watched, ...], asked: Asked) -> Watched:
    """Return the database of one rig. Raises UsageError where several are meant."""
    found = _chosen(watched, asked)
    if len(found) > 1 and "rig" in asked:
        found = tuple(database for database in found if asked["rig"] in queries.rigs(database.path))
    if len(found) != 1:
        raise UsageError.at("db", "has to be given where there are several databases", "see /api/v1/rigs")
    return found[0]


def _needed(asked: Asked, name: str) -> str:
    if name not in asked:
        raise UsageError.at(name, "is needed", PARAMETERS[name])
    return asked[name]


def _of_rig(key: str, ask: Callable[[Path, str | None], Rows]) -> Make:
    """Return what makes a document of the rows of one rig or all, of all databases meant."""
    return _rows_of(key, lambda database, asked: ask(database.path, asked.get("rig")))


def _rows_of(key: str, ask: Callable[[Watched, Asked], Rows]) -> Make:
    """Return what makes a document of the rows of all databases meant, each with the database's name."""

    def make(watched: tuple[Watched, ...], asked: Asked) -> Mapping[str, Any]:
        rows: list[dict[str, Any]] = []
        refused = 0
        for database in _chosen(watched, asked):
            found = ask(database, asked)
            rows += [{**row, "db": database.name} for row in found]
            refused += found.refused
        return {key: rows, "refused": refused}

    return make


def _estimates(database: Watched, asked: Asked) -> Rows:
    return queries.estimates(
        database.path, asked.get("rig"), asked.get("parameter"), asked.get("since", "60s"),
        asked.get("until"), most=MOST_INSTANTS,
    )  # fmt: skip


def _alarms(database: Watched, asked: Asked) -> Rows:
    active = asked.get("active", "0")
    if active not in {"0", "1"}:
        raise UsageError.at("active", f"{active!r} is neither 0 nor 1", PARAMETERS["active"])
    return queries.alarms(database.path, asked.get("rig"), active=active == "1")


def _health(database: Watched, asked: Asked) -> Rows:
    found = recent.sources(database.path)
    kept = Rows(row for row in found if asked.get("rig") in {None, row["rig"]})
    kept.refused = found.refused
    return kept


def _rigs(watched: tuple[Watched, ...], asked: Asked) -> Mapping[str, Any]:
    """Return the names of databases, rigs, parameters, and which rigs have a model that can be drawn."""
    found = [
        {"db": database.name, "rig": rig, "parameters": queries.parameters(database.path, rig),
         "model": rig in database.configs}
        for database in _chosen(watched, asked)
        for rig in queries.rigs(database.path)
    ]  # fmt: skip
    return {"rigs": found}


def _overview(watched: tuple[Watched, ...], asked: Asked) -> Mapping[str, Any]:
    return overview(_chosen(watched, asked), wall_ns())


def _trend(watched: tuple[Watched, ...], asked: Asked) -> Mapping[str, Any]:
    database = _one(watched, asked)
    parameter = _needed(asked, "parameter")
    times = asked.get("since"), asked.get("until")
    limit = None if "limit" not in asked else _number("limit", asked["limit"])
    found = dict(trend_document(database.path, parameter, asked.get("rig"), times, limit))
    return {**found, "points": thinned(np.array(found["points"], dtype=object).reshape(-1, 3), SHOWN_POINTS)}


def _points(watched: tuple[Watched, ...], asked: Asked) -> Mapping[str, Any]:
    database = _one(watched, asked)
    parameter = _needed(asked, "parameter")
    most = int(_number("points", asked.get("points", str(SHOWN_POINTS))))
    if not 1 <= most <= PAGE_POINTS:
        raise UsageError.at("points", f"{most} is not within 1 and {PAGE_POINTS}", "ask for fewer")
    times = asked.get("since"), asked.get("until")
    started = time.perf_counter()
    found = points_of(database.path, asked.get("rig"), parameter, *times)
    return {
        **{key: getattr(found, key) for key in ("rig", "parameter", "unit", "reference", "refused")},
        "db": database.name,
        "n": len(found.t_ns),
        "span_s": sorted(set(found.span_s.tolist())),
        "newest": _columns(found)[-1].tolist() if len(found.t_ns) else None,
        "points": thinned(_columns(found), most),
        "seconds": time.perf_counter() - started,
    }


def _columns(points: Points) -> "np.ndarray[Any, np.dtype[Any]]":
    table = np.empty((len(points.t_ns), 3), dtype=object)
    table[:, 0], table[:, 1], table[:, 2] = points.t_ns, points.value, points.sd
    return table


def thinned(table: "np.ndarray[Any, np.dtype[Any]]", most: int) -> list[list[float]]:
    """Return [t_ns, value, sd, lowest, highest] of rows (n, 3) of t_ns, value, sd: at most `most`, in order.

    A row that stands for several is of the time of the middle one and has the mean value and sd; no spike is
    lost, since lowest and highest are those of all it stands for.
    """
    if not len(table):
        return []
    t_ns = table[:, 0].astype(np.int64)
    value, sd = (table[:, column].astype(np.float64) for column in (1, 2))
    edges = np.unique(np.linspace(0, len(table), min(most, len(table)) + 1).astype(np.int64))
    starts = edges[:-1]
    sizes = np.diff(edges)
    columns = (
        t_ns[starts + sizes // 2], np.add.reduceat(value, starts) / sizes,
        np.add.reduceat(sd, starts) / sizes,
        np.minimum.reduceat(value, starts), np.maximum.reduceat(value, starts),
    )  # fmt: skip
    return [list(row) for row in zip(*(column.tolist() for column in columns), strict=True)]


def _number(name: str, text: str) -> float:
    try:
        found = float(text)
    except ValueError:
        found = float("nan")
    if not np.isfinite(found):
        raise UsageError.at(name, f"{text!r} is no number", PARAMETERS[name])
    return found


def _model(watched: tuple[Watched, ...], asked: Asked) -> Mapping[str, Any]:
    database = _one(watched, asked)
    rig = _needed(asked, "rig")
    if rig not in database.configs:
        raise UsageError.at(
            "rig", f"the model of {rig!r} is not known", "start deltak serve with --config FILE"
        )
    return {"rig": rig, "db": database.name, **drawing(database.configs[rig])}


def _forecasts(watched: tuple[Watched, ...], asked: Asked) -> Mapping[str, Any]:
    return forecasts(_chosen(watched, asked), asked.get("rig"), asked.get("parameter"))


_RIG: Final = ("db", "rig")
_PARAMETER: Final = (*_RIG, "parameter", "since", "until")
_POINTS_OF = (
    "Valid estimates for a chart, out of the tier that the time needs: t_ns, value, sd, lowest, highest."
)
DOCUMENTS: Final[Mapping[str, Document]] = {
    "rigs": Document("Databases, their rigs and parameters.", ("db",), _rigs),
    "overview": Document("The state of all rigs, the worst first.", ("db",), _overview, by_clock=True),
    "latest": Document("The newest row of each rig and parameter.", _RIG, _of_rig("rows", queries.latest)),
    "estimates": Document(
        "Rows of v_estimates; of the last minute without since.", _PARAMETER, _rows_of("rows", _estimates)
    ),
    "alarms": Document("Rows of v_alarms, oldest first.", (*_RIG, "active"), _rows_of("alarms", _alarms)),
    "alarm_events": Document(
        "Steps of alarms, oldest first.", _RIG, _of_rig("alarm_events", recent.alarm_events)
    ),
    "verdicts": Document(
        "What is believed of the rigs' constants.", _RIG, _of_rig("verdicts", queries.verdicts)
    ),
    "health": Document(
        "The newest ledger row of each source, with its rate.", _RIG, _rows_of("sources", _health)
    ),
    "baselines": Document("Rows of v_baselines, oldest first.", _RIG, _of_rig("baselines", baselines)),
    "forecasts": Document(
        "Stored forecasts, oldest first, the newest and at most 99 before it of each parameter; "
        "and their record.",
        (*_RIG, "parameter"),
        _forecasts,
    ),
    "trend": Document(
        "Whether a parameter changes, and when it reaches a limit.", (*_PARAMETER, "limit"), _trend
    ),
    "points": Document(_POINTS_OF, (*_PARAMETER, "points"), _points),
    "model": Document(
        "Masses, springs and dampers of a rig, or the elements of another domain, to be drawn.", _RIG, _model
    ),
}


def made(name: str, watched: tuple[Watched, ...], asked: Asked) -> Any:
    """Return a document as JSON carries it. Raises UsageError, StoreError."""
    return json_ready(DOCUMENTS[name].make(watched, asked))
