"""deltak(1) and the shells' completion, made from the commands' own help, so neither leaves anything out."""

import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer
from typer.completion import get_completion_script  # type: ignore[attr-defined]  # what --show-completion prints

from agent import __version__
from agent.cli.app import app

PAGE = "usr/share/man/man1/deltak.1"
COMPLETION = {
    "bash": "usr/share/bash-completion/completions/deltak",
    "zsh": "usr/share/zsh/vendor-completions/_deltak",
    "fish": "usr/share/fish/vendor_completions.d/deltak.fish",
}
"""Where Debian's shells look for what completes a command."""
_ON_FIRST_CALL = '\nif [ "$funcstack[1]" = _deltak ]; then _deltak_completion "$@"; fi'
"""zsh loads the file when the command is first completed, and would complete nothing that time."""
EXITS = (
    ("0", "done, also after SIGTERM and --duration"),
    ("1", "unforeseen; or a scenario of score is not as expected; or an upgrade was taken back"),
    (
        "2",
        (
            "the command line, the configuration, a model that cannot be observed, "
            "a recording that cannot be used"
        ),
    ),
    ("3", "the database: missing, not deltak's, damaged, newer than this version, locked, not to be written"),
    ("4", "a bus that cannot exist or be opened, in demo and check --probe"),
    ("130", "interrupted"),
)
FILES = (
    ("/etc/deltak/conf.d/*.toml", "configurations that deltak.service runs, one a rig"),
    ("/etc/deltak/NAME.toml", "the configuration that deltak@NAME.service runs"),
    ("/var/lib/deltak", "databases, and beside them raw recordings, locks and sockets"),
    (
        "/opt/deltak/releases",
        "versions of the program; the link /opt/deltak/current leads to the one that runs",
    ),
    ("/usr/share/doc/deltak", "the runbook, the table of alarms, the bill of materials"),
)


def commands() -> Iterator[tuple[str, Any, typer.Context]]:
    """Yield every command with its whole name and its context, groups before what they hold, plug-ins too."""
    root: Any = typer.main.get_command(app)
    yield from _below(root, typer.Context(root, info_name="deltak", **root.context_settings))


def _below(command: Any, context: typer.Context) -> Iterator[tuple[str, Any, typer.Context]]:
    yield context.command_path, command, context
    for name in command.list_commands(context) if hasattr(command, "list_commands") else ():
        inner = command.get_command(context, name)
        yield from _below(inner, typer.Context(inner, info_name=name, parent=context))


def page(epoch: int) -> str:
    """Return deltak(1) in the language of man(7), dated by the second of its making."""
    date = time.strftime("%Y-%m-%d", time.gmtime(epoch))
    (_, root, context), *inner = commands()
    lines = [
        f'.TH DELTAK 1 "{date}" "deltak {__version__}" "User Commands"',
        ".SH NAME", r"deltak \- watches stiffness and damping of mechanical structures over their field bus",
        ".SH SYNOPSIS", _usage(context, root),
        ".SH DESCRIPTION", _text(root.help),
        ".SH OPTIONS", *_parameters(root, context),
        ".SH COMMANDS", *(line for item in inner for line in _section(*item)),
        ".SH EXIT STATUS", *(line for row in EXITS for line in _row(*row)),
        ".SH FILES", *(line for row in FILES for line in _row(*row)),
        ".SH SEE ALSO", r"\fBsystemctl\fR(1), \fBjournalctl\fR(1), \fBsqlite3\fR(1)",
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def completion(shell: str) -> str:
    """Return the file that completes the command in a shell: "bash", "zsh" or "fish"."""
    script = get_completion_script(prog_name="deltak", complete_var="_DELTAK_COMPLETE", shell=shell)
    return f"{script}{_ON_FIRST_CALL if shell == 'zsh' else ''}\n"


def write(to: Path, epoch: int) -> None:
    """Write the page and the completion of every shell where Debian has them, below a folder."""
    texts = {PAGE: page(epoch)} | {target: completion(shell) for shell, target in COMPLETION.items()}
    for target, text in texts.items():
        (to / target).parent.mkdir(parents=True, exist_ok=True)
        (to / target).write_text(text, encoding="utf-8")


def _section(name: str, command: Any, context: typer.Context) -> Iterator[str]:
    yield f".SS {_text(name)}"
    yield _usage(context, command)
    yield ".PP"
    yield _text(command.help)
    yield from _parameters(command, context)


def _usage(context: typer.Context, command: Any) -> str:
    words = " ".join(command.collect_usage_pieces(context))
    return rf"\fB{_text(context.command_path)}\fR {_text(words)}"


def _parameters(command: Any, context: typer.Context) -> Iterator[str]:
    for parameter in command.get_params(context):
        record = parameter.get_help_record(context)  # none for those that are hidden
        if record is not None:
            yield from _row(*record)


def _row(term: str, words: str) -> Iterator[str]:
    yield ".TP"
    yield rf"\fB{_text(term)}\fR"
    yield _text(words) or r"\&"


def _text(words: str | None) -> str:
    """Return words on one line, with nothing in them that man would take for an order."""
    plain = " ".join((words or "").split()).replace("\\", r"\e").replace("-", r"\-")
    return rf"\&{plain}" if plain.startswith((".", "'")) else plain


if __name__ == "__main__":
    write(Path(sys.argv[1]), int(sys.argv[2]))
