"""`deltak examples`: the table of examples, and what was copied."""

from collections.abc import Mapping
from typing import Any

from agent.cli.terminal.output import print_table, show


def print_examples(document: Mapping[str, Any]) -> None:
    """Print each example with what it is."""
    rows = ((row["name"], row["words"], ", ".join(row["files"])) for row in document["examples"])
    print_table("examples", ("name", "what it is", "files"), rows)
    show("deltak examples copy NAME [DIR] puts one into a folder")


def print_copied(document: Mapping[str, Any]) -> None:
    """Print which files were written."""
    for file in document["files"]:
        show(file)
