"""`deltak listen`: a line a unit as it comes, and at the end rates by channel and what was rejected."""

from collections.abc import Mapping
from typing import Any

from agent.cli.terminal.output import print_table, show
from agent.cli.terminal.signals import INTERRUPTED
from agent.commissioning.setup.listen import Line
from agent.text import counted, number

__all__ = ["INTERRUPTED", "print_line", "print_summary", "silent"]


def silent(_line: Line) -> None:
    """Show nothing."""


def print_line(line: Line) -> None:
    """Print what came, and what it is."""
    if line.values is not None:
        decoded = "  ".join(f"{name} {number(value)} {unit}" for name, (value, unit) in line.values.items())
        what = f"{line.raw}  ->  {decoded or 'no channel'}"
    else:
        what = f"{line.reason}: {line.raw}"
    show(f"{line.at_s:8.2f} s  {line.source}  {what}")


def print_summary(document: Mapping[str, Any]) -> None:
    """Print rates and ranges by channel, then source ledgers with the first unit rejected for each reason."""
    columns = ("channel", "unit", "source", "field", "samples a second", "last", "least", "most")
    rows = (
        (
            c["name"], c["unit"], c["source"], c["field"], number(c["rate_hz"], 5), number(c["last"]),
            number(c["min"]), number(c["max"]),
        )
        for c in document["channels"]
    )  # fmt: skip
    print_table(f"{document['rig']}: {number(document['seconds'], 3)} s", columns, rows, right=columns[4:])
    for source in document["sources"]:
        _print_source(source)


def _print_source(source: Mapping[str, Any]) -> None:
    lost = "".join(f", {reason} {count} dropped" for reason, count in source["dropped"].items())
    show(f"{source['name']}: {source['received']} received, {counted(source['gaps'], 'gap')}{lost}")
    for reason, count in (source["rejected"] | source["faults"]).items():
        first = source["first_rejected"].get(reason)
        show(f"    {reason} {count}" + (f", the first: {first}" if first else ""))
