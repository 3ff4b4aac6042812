"""What came from a bus or file reaches no terminal as an order to it, in whatever form rows are asked for."""

import contextlib
import io
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import cast

import pytest
import typer

from agent.cli.commissioning.baseline import write_export
from agent.cli.terminal.errors import guarded
from agent.cli.terminal.output import print_csv, print_faults, print_json, print_rows, print_table, show
from agent.cli.terminal.signals import Terminated
from agent.commissioning.progress import on_terminal
from agent.config import files_of
from agent.errors import ConfigError, Fault

ORDERS = "\x1b]0;evil\x07\x9b2J\x7f"
"""Escape, and the single character that stands for escape and a bracket."""
ROW = {"message": f"k1 {ORDERS}"}


class Terminal(io.StringIO):
    """Looks like one."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    "write",
    [
        lambda: print_json(ROW), lambda: print_rows("rows", ["message"], [ROW], "json", 0),
        lambda: print_csv(["message"], [ROW]), lambda: print_table(ORDERS, ["message"], [[ROW["message"]]]),
        lambda: show(ORDERS), lambda: print_faults([Fault("a", ORDERS, "b")]),
        lambda: print_faults([Fault("a", ORDERS, "b")], as_json=True),
        lambda: write_export({"baselines": [ROW]}, None),
    ],
)  # fmt: skip
def test_orders_to_a_terminal_are_written_as_code_does(
    write: Callable[[], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NO_COLOR", "1")
    out, err = Terminal(), Terminal()
    monkeypatch.setattr(sys, "stdout", out)
    monkeypatch.setattr(sys, "stderr", err)
    write()
    written = out.getvalue() + err.getvalue()
    assert "evil" in written
    for order in ("\x1b]", "\x9b", "\x07", "\x7f"):
        assert order not in written


def test_progress_is_seen_and_cleared_on_any_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", err := Terminal())
    show_progress = on_terminal()
    show_progress("weighing")
    show_progress("")
    assert err.getvalue().strip("\r ") == "weighing"
    assert err.getvalue().endswith(" \r")


@pytest.mark.parametrize(("ended", "name"), [(KeyboardInterrupt, "SIGINT"), (Terminated, "SIGTERM")])
@pytest.mark.parametrize("begun", ["", "{}\n"])
def test_command_that_a_signal_ends_gives_one_json_document(
    ended: type[BaseException], name: str, begun: str, capsys: pytest.CaptureFixture[str]
) -> None:
    def app(*_: object, **__: object) -> None:
        sys.stdout.write(begun)
        raise ended

    with contextlib.suppress(Terminated):
        assert guarded(cast("typer.Typer", app), ["replay", "--json"]) == 130
    document = json.loads(capsys.readouterr().out)
    assert [error["message"] for error in document.get("errors", [])] == (
        [] if begun else [f"ended by {name} before it was done"]
    )


def test_folder_of_configurations_with_a_pipe_in_it_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "press.toml")
    with pytest.raises(ConfigError, match=r"press\.toml: is no file, its end may never come"):
        files_of([tmp_path])
