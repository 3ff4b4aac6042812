"""The command line: its sections, what needs no command, and the process around a command.

The commands are in `agent.cli.commands`, a module a section. This module knows no command; it turns errors
into lines and exit codes by `agent.cli.terminal`.
"""

import os
import sys
from collections.abc import Sequence
from typing import Annotated, NoReturn

import typer

from agent import __version__
from agent.cli.commands import (
    alarms,
    answers,
    commissioning,
    databases,
    displays,
    first_steps,
    running,
)
from agent.cli.group import CommandGroup
from agent.cli.terminal.signals import done_when_terminated, release_reload_signal
from agent.kernels import settled

SECTIONS = {
    "First steps": first_steps.part,
    "The agent": running.part,
    "Commissioning": commissioning.part,
    "Answers": answers.part,
    "Alarms": alarms.part,
    "Displays": displays.part,
    "Database files": databases.part,
}
"""Titles in the help, and the commands under each."""

app = typer.Typer(
    name="deltak",
    cls=CommandGroup,
    help="Estimate stiffness and damping of a structure over its field bus, and alarm when they leave "
    "their limits.",
    epilog="Exit codes: 0 done, 1 unforeseen, 2 usage or configuration, 3 database, 4 bus, 130 interrupted.",
    add_completion=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)

for _title, _part in SECTIONS.items():
    for _command in _part.registered_commands:
        _command.rich_help_panel = _title
    for _group in _part.registered_groups:
        _group.rich_help_panel = _title
    app.add_typer(_part)


@app.callback(invoke_without_command=True)
def _start(
    ctx: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version and stop.")] = False,
    _verbose: Annotated[
        int,
        typer.Option("-v", "--verbose", count=True, show_default=False, help="Log progress; -vv logs all."),
    ] = 0,
    _debug: Annotated[bool, typer.Option("--debug", help="Log all, and show tracebacks.")] = False,
) -> None:
    """Answer what needs no command; -v and --debug, taken out before, are here for the help."""
    release_reload_signal(ctx.invoked_subcommand)
    if version:
        sys.stdout.write(f"deltak {__version__}\n")
        raise typer.Exit
    if ctx.invoked_subcommand is None:
        sys.stderr.write(ctx.get_help() + "\n")
        raise typer.Exit(2)


def main(argv: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and leave with its exit code."""
    os.environ.update(settled())
    with done_when_terminated():
        from agent.cli.terminal.errors import guarded

        sys.exit(guarded(app, list(sys.argv[1:] if argv is None else argv)))
