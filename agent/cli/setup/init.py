"""`deltak init`: questions on a terminal, and what was written."""

import sys
from collections.abc import Mapping
from typing import Any

import typer

from agent.cli.terminal.output import show
from agent.commissioning.setup.init import Ask


def asking() -> Ask | None:
    """Return what asks on the terminal; None without one."""
    return _ask if sys.stdin.isatty() and sys.stderr.isatty() else None


def _ask(question: str, default: str) -> str:
    return str(typer.prompt(question, default=default, show_default=bool(default), err=True)).strip()


def print_written(document: Mapping[str, Any]) -> None:
    """Print what was written and what to do next."""
    file = document["file"]
    show(f"{file}: {document['rig']}, channels {', '.join(document['channels'])}")
    if document["bus"]:
        show(f"next: deltak listen {file}")
    if document["to_identify"]:
        names = ", ".join(document["to_identify"])
        show(f"nobody stated {names}: deltak identify {file} RECORDING --write finds them")
