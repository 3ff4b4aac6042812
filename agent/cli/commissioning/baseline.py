"""`deltak baseline`: what was learnt of a healthy machine, as tables and sentences."""

import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from agent.cli.terminal.output import print_table, show, stdout_text
from agent.commissioning.baseline.target import target_of
from agent.errors import UsageError
from agent.storage.read import baselines
from agent.text import counted, interval, iso_time, number, short_time, with_sd

Document = Mapping[str, Any]
COLUMNS = ("id", "parameter", "reference", "unit", "spread", "between days", "lasts", "rows", "from", "until")
_RIGHT = {"reference", "spread", "between days", "lasts", "rows"}


def print_learnt(document: Document) -> None:
    """Print what was learnt, and what it does not know."""
    rows = document["parameters"]
    print_table(
        f"{document['rig']}: learnt", COLUMNS, [_cells(name, row) for name, row in rows.items()], right=_RIGHT
    )
    print_dependences(rows.items())
    for words in document["warnings"]:
        show(f"warning: {words}")
    if all(row["days_sd"] is None for row in rows.values()):
        show("the spread between days is not known from so few of them: learn again when there are more")
    show("rows count their change from these references from now on; limits that they allow: deltak limits")


def standing(path: Path, rig: str | None) -> dict[str, Any]:
    """Return the baselines that rigs count from. Raises UsageError where there is none."""
    rows = [row for row in _rows(path, rig) if row["newest"]]
    if not rows:
        raise UsageError.at(path, "has no baseline", "learn one: deltak baseline learn")
    return {"baselines": rows}


def every(path: Path, rig: str | None) -> dict[str, Any]:
    """Return all baselines, also those that were learnt anew since."""
    return {"baselines": _rows(path, rig)}


def _rows(path: Path, rig: str | None) -> list[dict[str, Any]]:
    if path.suffix.lower() != ".toml" and rig is None:
        return list(baselines.baselines(path))
    target = target_of(path, rig)
    return list(baselines.baselines(target.db, target.rig))


def print_baselines(document: Document) -> None:
    """Print baselines, a table a rig."""
    rows: Sequence[Document] = document["baselines"]
    if not rows:
        show("no baselines")
    for rig in dict.fromkeys(row["rig"] for row in rows):
        cells = [_cells(row["parameter"], row) for row in rows if row["rig"] == rig]
        print_table(rig, COLUMNS, cells, right=_RIGHT)
        print_dependences((row["parameter"], {**row, "covariates": json.loads(row["covariates"])})
                          for row in rows if row["rig"] == rig)  # fmt: skip


def print_dependences(rows: Iterable[tuple[str, Document]]) -> None:
    """Print what references depend on, a line each; nothing where no covariate was looked at."""
    cells = [_dependence(name, row, one) for name, row in rows for one in row["covariates"]]
    if cells:
        print_table("what references depend on", _DEPENDENCE, cells)


_DEPENDENCE = (
    "parameter",
    "covariate",
    "change a unit",
    "95 %",
    "of reference",
    "follows it",
    "learnt between",
    "",
)


def _dependence(name: str, row: Document, one: Document) -> tuple[str, ...]:
    change = f"{with_sd(one['coefficient'], one['sd'])} {row['unit']}"
    share = f"{100.0 * one['coefficient'] / row['reference']:.2g} %" if row["reference"] else "-"
    between = f"{number(one['low'], 3)} and {number(one['high'], 3)} {one['unit']}"
    used = "taken out" if one["used"] else "no dependence is seen; left in"
    return (
        name,
        one["name"],
        change,
        interval(one["lower"], one["upper"]),
        share,
        _followed(one),
        between,
        used,
    )


def _followed(one: Document) -> str:
    if one["shape"] == "none":
        return "at once"
    between = f"({lasting(one['lag_lower_s'])} to {lasting(one['lag_upper_s'])})"
    word = "after" if one["shape"] == "delay" else "time constant"
    return f"{word} {lasting(one['lag_s'])} {between}"


def _cells(name: str, row: Document) -> tuple[str, ...]:
    return (
        str(row["baseline_id"]),
        name,
        with_sd(row["reference"], row["sd"]),
        row["unit"],
        number(row["spread_sd"], 3),
        number(row["days_sd"], 3),
        lasting(row["correlation_s"]),
        str(row["n"]),
        short_time(iso_time(row["from_ns"])),
        short_time(iso_time(row["until_ns"])),
    )


def lasting(seconds: float | None) -> str:
    """Write a duration in the unit that suits it: `2.1 h`."""
    if seconds is None:
        return "-"
    for unit, size in (("d", 86_400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= size:
            return f"{seconds / size:.2g} {unit}"
    return f"{seconds:.2g} s"


def write_export(document: Document, to: Path | None) -> None:
    """Write an export to a file, or to stdout. Raises UsageError where the file cannot be written."""
    text = json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False) + "\n"
    if to is None:
        stdout_text().write(text)
        return
    try:
        to.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UsageError.at("--to", f"{to}: {error.strerror}", "give a file that you may write to") from error
    sys.stderr.write(f"{to}: {counted(len(document['baselines']), 'baseline')}\n")


def print_imported(document: Document) -> None:
    """Print which baselines were taken in."""
    names = ", ".join(document["imported"])
    show(f"{document['rig']} counts {names} from the references of the file from now on")
