"""`deltak explain`: an alarm's verdict computed again from its record, and what it rests on in words."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from agent import __version__
from agent.errors import StoreError
from agent.evaluation.explain import words
from agent.evaluation.explain.recompute import Kept, Recomputed, read_kept, recomputed
from agent.evaluation.explain.tested import Tested, tested
from agent.evaluation.tuning import NEAR_SD
from agent.recording.event_files import state_name
from agent.recording.states import StateError
from agent.storage.read import queries
from agent.storage.read.times import parse_time
from agent.types import AlarmTransition

Row = Mapping[str, Any]
FIGURES: Final = ("delta", "sd", "probability")
EXACT: Final = 17
"""Fixed by double precision: digits of two figures that are the same number: digits of two figures that are
the same number."""


@dataclass(frozen=True, slots=True)
class Explained:
    """What `deltak explain` says: the document, and what a picture of it needs."""

    document: dict[str, Any]
    alarm: Row
    kept: Kept | None = None
    again: Recomputed | None = None


def explain(db: Path, alarm_id: int) -> Explained:
    """Explain an alarm of a file. Raises StoreError: the file, or no such alarm."""
    alarm = next((row for row in queries.alarms(db) if row["id"] == alarm_id), None)
    if alarm is None:
        raise StoreError.at(f"alarm {alarm_id}", "there is no such alarm", f"deltak alarms {db} lists them")
    run = next(row for row in queries.runs(db) if row["run_id"] == alarm["run_id"])
    raised_ns = parse_time(alarm["raised_at"], None)
    record = _record(queries.event_records(db, alarm["rig"]), alarm, raised_ns)
    refused = _unusable(db, record)
    if record is None or refused:
        return _unexplained(alarm, run, refused or words.no_record(run["kind"]), record)
    try:
        kept = read_kept(db.parent / record["file"])
        again = recomputed(kept)
    except StateError as error:
        return _unexplained(alarm, run, words.unusable(record["file"], str(error)), record)
    return _explained(alarm, run, record, kept, again)


def _record(rows: Sequence[Row], alarm: Row, raised_ns: int) -> Row | None:
    """Return the record that holds an alarm: the one that it began, else the one with most before it."""
    own = [
        row
        for row in rows
        if row["run_id"] == alarm["run_id"] and row["from_ns"] <= raised_ns <= row["to_ns"]
    ]
    return next((row for row in own if row["alarm_id"] == alarm["id"]), own[0] if own else None)


def _unusable(db: Path, record: Row | None) -> str | None:
    """Return why a record cannot be used, in words; None where it can."""
    if record is None:
        return None
    if record["state"] in {"purged", "failed"}:
        return words.gone(record["state"], record["message"])
    file = state_name(record["file"])
    return None if (db.parent / file).exists() else words.removed(file)


def _unexplained(alarm: Row, run: Row, why: str, record: Row | None) -> Explained:
    said = [words.stored(alarm), why, *words.version(run["code_version"])]
    return Explained(
        _document(alarm, run, record) | {"same": False, "digits": 0, "words": " ".join(said)}, alarm
    )


def _explained(alarm: Row, run: Row, record: Row, kept: Kept, again: Recomputed) -> Explained:
    raised_ns = parse_time(alarm["raised_at"], None)
    step = _same_step(again.steps, alarm, raised_ns)
    found = _figures(step)
    digits = 0 if found is None else agreeing(alarm, found)
    is_then = step is not None and step.t_ns == raised_ns
    same = is_then and _is_near(alarm, found or {})
    seen = tested(again, alarm, raised_ns)
    said = [
        words.stored(alarm),
        words.compared(alarm, found, digits, same=same),
        *words.version(run["code_version"]),
        *words.configuration(run["config_sha256"], again.config.sha256),
        *words.rivals(seen),
        words.samples(record, seen),
    ]
    document = _document(alarm, run, record) | {
        "same": same, "digits": digits, "words": " ".join(said), "recomputed": found, "tested": _tested(seen),
        "limit_confidence": seen.confidence,
    }  # fmt: skip
    return Explained(document, alarm, kept, again)


def _figures(step: AlarmTransition | None) -> dict[str, Any] | None:
    return (
        None if step is None else {name: getattr(step, name) for name in (*FIGURES, "limit_value", "message")}
    )


def _document(alarm: Row, run: Row, record: Row | None) -> dict[str, Any]:
    names = ("rig", "kind", "parameter", "priority", *FIGURES, "limit_value", "message", "advice", "percent")
    return {
        "alarm_id": alarm["id"],
        "verdict": {"raised_at": alarm["raised_at"], **{name: alarm[name] for name in names}},
        "recomputed": None,
        "code_version": run["code_version"],
        "code_version_here": __version__,
        "config_sha256": run["config_sha256"],
        "record": None if record is None else record["file"],
    }


def _tested(seen: Tested) -> list[dict[str, Any]]:
    parameters = [
        {"hypothesis": one.name, "size": one.delta, "sd": one.sd, "unit": one.unit, "limit": one.limit,
         "probability": one.probability, "status": one.status}
        for one in seen.parameters
    ]  # fmt: skip
    constants = [
        {"hypothesis": one.hypothesis, "size": one.size, "sd": one.sd, "unit": one.unit, "limit": None,
         "probability": one.probability, "status": None}
        for one in seen.constants
    ]  # fmt: skip
    return parameters + constants


def _same_step(steps: Sequence[AlarmTransition], alarm: Row, raised_ns: int) -> AlarmTransition | None:
    """Return the step that raised an alarm: of its kind and parameter, at its time, else the nearest."""
    same = [step for step in steps if (step.kind, step.parameter) == (alarm["kind"], alarm["parameter"])]
    raised = [step for step in same if step.to_state == "UNACK"]
    return min(raised, key=lambda step: abs(step.t_ns - raised_ns), default=None)


def agreeing(stored: Row, found: Row) -> int:
    """Return how many significant digits of all figures agree; without figures, the message decides."""
    pairs = [
        (stored[name], found[name]) for name in FIGURES if stored[name] is not None or found[name] is not None
    ]
    if not pairs:
        return EXACT if stored["message"] == found["message"] else 0
    return min(_digits(one, other) for one, other in pairs)


def _digits(one: float | None, other: float | None) -> int:
    if one is None or other is None or not (math.isfinite(one) and math.isfinite(other)):
        return 0
    if one == other:
        return EXACT
    return max(0, min(EXACT, math.floor(-math.log10(abs(one - other) / max(abs(one), abs(other))))))


def _is_near(stored: Row, found: Row) -> bool:
    """Tell whether figures are the same verdict's."""
    scale = {"delta": stored["sd"], "sd": stored["sd"], "probability": 1.0}
    for name in FIGURES:
        if (stored[name] is None) != (found[name] is None):
            return False
        if stored[name] is not None and abs(stored[name] - found[name]) > NEAR_SD * abs(scale[name] or 1.0):
            return False
    return True
