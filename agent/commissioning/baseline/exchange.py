"""`deltak baseline export` and `import`: baselines as JSON, taken in only by a rig that they are of."""

import json
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from agent.blocks.covariates.compensation import dependences
from agent.blocks.graph import graph_of
from agent.blocks.rig_model import estimated
from agent.commissioning.baseline.target import Target, target_of
from agent.errors import Fault, UsageError
from agent.records import Baseline
from agent.reference.covariates.dependence import Dependence
from agent.storage import maintenance
from agent.storage.read import baselines, queries

FORM = "deltak baselines"
VERSION = 1  # fixed by the document's form


def exported(path: Path, rig: str | None) -> dict[str, Any]:
    """Return the baselines a rig counts from, as a document for `import`. Raises UsageError for none."""
    target = target_of(path, rig)
    found = baselines.standing(target.db, target.rig)
    if not found:
        raise UsageError.at(target.db, f"{target.rig} has no baseline", "learn one: deltak baseline learn")
    return {"form": FORM, "version": VERSION, "baselines": [asdict(one) for one in found]}


def imported(path: Path, rig: str | None, file: Path) -> dict[str, Any]:
    """Store the baselines of a file for a rig; nothing where one of them does not fit.

    Raises UsageError for a file that holds none, or one of another graph, parameter or unit.
    """
    target = target_of(path, rig)
    found = [replace(one, rig=target.rig, baseline_id=None) for one in _read(file)]
    if faults := list(_unfitting(target, found, file)):
        raise UsageError(faults)
    numbers = maintenance.store_baselines(target.db, found)
    rows = {one.parameter: number for one, number in zip(found, numbers, strict=True)}
    return {"rig": target.rig, "db": str(target.db), "imported": rows}


def _read(file: Path) -> list[Baseline]:
    from pydantic import TypeAdapter

    try:
        document = json.loads(file.read_text(encoding="utf-8"), parse_constant=_no_number)
        rows = document["baselines"] if document.get("form") == FORM else []
        found = TypeAdapter(list[Baseline]).validate_python(rows)
        for one in found:
            TypeAdapter(tuple[Dependence, ...]).validate_json(one.covariates)
    except OSError as error:
        raise UsageError.at(file, f"cannot be read: {error.strerror}", "name a file there is") from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        why = str(error).partition("\n")[0]
        raise UsageError.at(
            file, f"is no export of baselines ({why})", "make it by baseline export"
        ) from error
    if not found:
        raise UsageError.at(file, "holds no baseline", "make it by deltak baseline export")
    return found


def _no_number(text: str) -> float:
    raise ValueError(f"{text} is no number")


def _unfitting(target: Target, found: list[Baseline], file: Path) -> Iterator[Fault]:
    """Yield why a rig cannot count from baselines."""
    units = _units(target)
    strange = _strange(target, found)
    graph = graph_of(target.config) if target.config is not None else target.graph()
    advice = "learn it from this rig's own rows"
    for one in found:
        if one.parameter not in units:
            yield Fault(
                str(file), f"{target.rig} has no parameter {one.parameter}", f"it has {', '.join(units)}"
            )
        elif one.unit != units[one.parameter]:
            what = f"{one.parameter} is in {one.unit} there, in {units[one.parameter]} here"
            yield Fault(str(file), what, advice)
        elif missing := [d.name for d in dependences(one) if d.name in strange]:
            what = f"{one.parameter} depends on {', '.join(missing)} there, which is no covariate here"
            yield Fault(str(file), what, 'give the configuration a channel with role = "covariate" for it')
        elif one.graph and graph and one.graph != graph:
            yield Fault(str(file), f"{one.parameter} is of another graph ({one.graph}), not {graph}", advice)


def _strange(target: Target, found: list[Baseline]) -> set[str]:
    """Return the covariates of baselines that a rig has not, where its configuration is known."""
    if target.config is None:
        return set()
    return {d.name for one in found for d in dependences(one)} - {one.name for one in target.config.covariate}


def _units(target: Target) -> dict[str, str]:
    if target.config is not None:
        return {name: target.config.parameters[name].unit for name in estimated(target.config)}
    rows = queries.latest(target.db, target.rig)
    return {row["parameter"]: row["unit"] for row in rows}
