"""Arguments and options that several commands share, and the forms of what they print."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

Json = Annotated[bool, typer.Option("--json", help="One JSON document on stdout and nothing else.")]
Csv = Annotated[bool, typer.Option("--csv", help="CSV on stdout, every digit, empty for none.")]
Config = Annotated[
    Path, typer.Argument(metavar="CONFIG", help="Configuration file (TOML).", show_default=False)
]
Database = Annotated[
    Path, typer.Argument(metavar="DB", help="Database file of the agent.", show_default=False)
]
Agent = Annotated[
    Path | None,
    typer.Argument(
        metavar="[CONFIG|DB]", help="Whose agent; without it the only one there is.", show_default=False
    ),
]
NewDb = Annotated[
    Path | None, typer.Option("--db", metavar="FILE", help="Database to write; created if missing.")
]
Rig = Annotated[str | None, typer.Option("--rig", help="Only this rig.")]
Since = Annotated[
    str | None,
    typer.Option("--since", metavar="T", help="ISO 8601, or an age back from the newest row: 90s, 12h, 30d"),
]
Until = Annotated[
    str | None, typer.Option("--until", metavar="T", help="As --since; both ends belong to the answer.")
]
Plot = Annotated[
    Path | None, typer.Option("--plot", metavar="FILE", help="Draw to FILE (.png, .svg or .pdf).")
]
Duration = Annotated[
    float | None, typer.Option("--duration", metavar="S", min=0.0, help="Stop after S seconds.")
]
Place = Annotated[
    Path,
    typer.Argument(
        metavar="DB|CONFIG", help="Database, or the configuration that names it.", show_default=False
    ),
]


def answer(document: Mapping[str, Any], table: Callable[[Mapping[str, Any]], None], *, as_json: bool) -> None:
    """Print a document as JSON or as a table."""
    from agent.cli.terminal.output import print_json

    if as_json:
        print_json(document)
    else:
        table(document)


def named(db: Path | None) -> Path:
    """Return the database that was named. Raises UsageError for none."""
    from agent.errors import UsageError

    if db is None:
        raise UsageError.at("DB", "is missing", "name the database file of the agent")
    return db


def form_of(*, json: bool, csv: bool) -> str:
    """Return which form of output was asked for. Raises UsageError for two."""
    from agent.errors import UsageError

    if json and csv:
        raise UsageError.at("--csv", "cannot go with --json", "ask for one of them")
    return "json" if json else "csv" if csv else "table"
