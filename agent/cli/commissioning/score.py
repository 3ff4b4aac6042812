"""The table of `deltak score`, and its progress on a terminal."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from agent.cli.terminal.output import print_table, show
from agent.commissioning.progress import on_terminal
from agent.text import number

NOT_MET = 1
"""Fixed by the command line: exit code when a scenario is not as expected: exit code when a scenario is not
as expected."""
_COLUMNS = ("scenario", "", "error rms / sd", "covered %", "delay s", "missed", "false", "lost", "gaps",
            "recovery s", "events")  # fmt: skip


def progress() -> Callable[[str, float], None]:
    """Return what shows how far a scenario has been played, in one line; nothing without a terminal."""
    show_words = on_terminal()
    return lambda name, share: show_words(f"{name}: {100.0 * share:3.0f} %" if share < 1.0 else "")


def print_score(document: Mapping[str, Any]) -> None:
    """Print a line a scenario, and below what was not as expected."""
    rows = [_row(scored) for scored in document["scenarios"]]
    print_table("", _COLUMNS, rows, right=_COLUMNS[2:10])
    failures = [f"{s['scenario']}: {words}" for s in document["scenarios"] for words in s["failures"]]
    for words in failures:
        show(words)
    met = sum(scored["ok"] for scored in document["scenarios"])
    show(f"{met} of {len(rows)} scenarios as expected")


def _row(scored: Mapping[str, Any]) -> Sequence[str]:
    errors = [error for error in scored["parameters"].values() if error["rows"]]
    alarms = scored["alarms"]
    delays = [one["delay_s"] for one in alarms["excursions"] if one["delay_s"] is not None]
    recoveries = [fault["recovery_s"] for fault in scored["faults"]]
    return (
        scored["scenario"], "ok" if scored["ok"] else "NOT MET", _worst(error["rms_sd"] for error in errors),
        number(min((error["covered_percent"] for error in errors), default=None), 3), _worst(delays),
        str(len(alarms["missed"])), str(len(alarms["false"])), str(scored["samples"]["lost"]),
        str(scored["samples"]["gaps"]), "never" if None in recoveries else _worst(recoveries),
        ", ".join(cause for _, cause in scored["events"]),
    )  # fmt: skip


def _worst(values: Any) -> str:
    return number(max(values, default=None), 3)
