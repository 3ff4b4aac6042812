"""`deltak limits`: what a healthy machine's spread allows, and what other limits would have raised."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from agent.cli.terminal.output import print_table, show
from agent.commissioning.baseline import limits as body
from agent.commissioning.baseline import tried as trial
from agent.commissioning.baseline.written import write_limits
from agent.errors import UsageError
from agent.text import counted, number, percent, short_time

Document = Mapping[str, Any]
WRITTEN = ("limit", "on_delay_s")


def proposed(
    place: Path, rig: str | None, per_year: float, config: Path | None, *, write: bool
) -> dict[str, Any]:
    """Return proposed limits, written to the configuration where asked. Raises UsageError without a file."""
    own = place.suffix.lower() == ".toml"
    file = place if own else config
    if write and file is None:
        advice = "give the configuration in place of the database, or beside it with --config"
        raise UsageError.at("--write", "there is no configuration to write to", advice)
    document = body.limits(place, rig, per_year, None if own else config)
    if write and file is not None:
        rows = document["parameters"]
        write_limits(file, {name: {key: row[key] for key in WRITTEN} for name, row in rows.items()})
        document["written"] = str(file)
    return document


def print_limits(document: Document) -> None:
    """Print a limit a parameter, with what it costs and finds."""
    columns = ("parameter", "limit", "unit", "of reference", "on-delay s", "false a year", "")
    rows = [_cells(name, row) for name, row in document["parameters"].items()]
    title = f"{document['rig']}: limits for at most {number(document['per_year'])} false alarms a year each"
    print_table(title, columns, rows, right={*columns[1:2], *columns[3:6]})
    for name, row in document["parameters"].items():
        if row["compensated"]:
            show(
                f"{name}: what {', '.join(row['compensated'])} does is taken out of these, "
                "as of rows and alarms"
            )
    written = document["written"]
    show(
        f"written to {written}"
        if written
        else "nothing was written; --write puts these into the configuration"
    )


def _cells(name: str, row: Document) -> tuple[str, ...]:
    share = percent(row["limit"] / row["reference"]) if row["reference"] else "-"
    figures = number(row["on_delay_s"], 3), number(row["false_per_year"], 2)
    return name, number(row["limit"], 3), row["unit"], share, *figures, row["words"]


def tried(
    place: Path, rig: str | None, file: Path, stretch: tuple[str | None, str | None], *, write: bool
) -> dict[str, Any]:
    """Return what the limits of a file would have raised. Raises UsageError."""
    if write:
        raise UsageError.at(
            "--write", "cannot go with --try", "FILE has its limits already; write them without --try"
        )
    return trial.tried(place, rig, file, *stretch)


def print_tried(document: Document) -> None:
    """Print which alarms would be more and which fewer."""
    counts = f"{counted(len(document['would']), 'alarm')} in place of {len(document['were'])}"
    show(f"{document['rig']}: {document['tried']} makes {counts} of {document['rows']} rows")
    if document["counted_from_baseline"]:
        show(f"counted from the baseline: {', '.join(document['counted_from_baseline'])}")
    if document["without_rows"]:
        show(f"there are no rows of {', '.join(document['without_rows'])}")
    _print_some("would be raised, and were not", document["more"])
    _print_some("were raised, and would not be", document["fewer"])


def _print_some(title: str, rows: Sequence[Document]) -> None:
    if not rows:
        show(f"none {title}")
        return
    columns = ("raised", "cleared", "what")
    cells = [(short_time(row["raised_at"]), short_time(row["cleared_at"]), row["message"]) for row in rows]
    print_table(title, columns, cells)
