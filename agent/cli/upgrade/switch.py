"""`deltak upgrade --to VERSION`: another version takes over, and goes back where valid rows stay away.

check by the new version -> stop -> copies of what it will migrate -> link -> start -> valid rows? -> done ->
                                                                                  none: stop, copies, link,
                                                                                  start
"""

import json
import sqlite3
import subprocess
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from agent.cli.terminal.output import show
from agent.cli.tuning import CHECK_S, POLL_S, RECENT_S
from agent.cli.upgrade import copies
from agent.cli.upgrade.agents import Agents, AgentsError
from agent.cli.upgrade.releases import Releases
from agent.clock import wall_ns
from agent.errors import AgentError, Fault, UsageError

Rigs = Mapping[tuple[Path, str], int]
"""By database and rig: the newest run."""
_NEWEST = "SELECT rig, run_id, t_ns, status, held_age_s FROM v_latest"


def giving(databases: Iterable[Path], within_s: float) -> Rigs:
    """Return the rigs that have given a valid row within so many seconds."""
    since_ns = wall_ns() - int(within_s * 1e9)
    found: dict[tuple[Path, str], int] = {}
    for path in databases:
        for rig, run_id, t_ns, status, held_age_s in _newest(path):
            valid_ns = t_ns if status == "valid" else t_ns - int((held_age_s or within_s) * 1e9)
            if valid_ns > since_ns:
                found[path, rig] = max(run_id, found.get((path, rig), 0))
    return found


def silent(expected: Rigs, shown: set[tuple[Path, str]]) -> list[str]:
    """Return the rigs that have given no valid row in a run newer than the expected one.

    shown: grows by those that did; a row that is valid once counts, since a machine may come to rest right
    after.
    """
    for path in {path for path, _ in expected}:
        rows = {(path, rig) for rig, run_id, _, status, _ in _newest(path)
                if status == "valid" and run_id > expected.get((path, rig), run_id)}  # fmt: skip
        shown |= rows
    return sorted(rig for path, rig in expected if (path, rig) not in shown)


def _newest(path: Path) -> list[tuple[str, int, int, str, float | None]]:
    """Return the newest row of every parameter; none while the file is being made, migrated or damaged."""
    try:
        with closing(
            sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, timeout=1.0)
        ) as connection:
            connection.execute("PRAGMA trusted_schema = OFF")
            return connection.execute(_NEWEST).fetchall()
    except sqlite3.Error:
        return []


Document = Mapping[str, Any]


class TakenBackError(AgentError):
    """The version gave no valid rows where the former one did; the former runs again."""


@dataclass(slots=True)
class Switch:
    """What a switch needs, and what it has done so far.

    Attributes:
        kept: databases of which there is a copy from before.
    """

    releases: Releases
    agents: Agents
    former: str
    version: str
    within_s: float
    poll_s: float = POLL_S
    kept: list[Path] = field(default_factory=list)


def upgrade(switch: Switch, named: Sequence[Path]) -> Document:
    """Have a version take over and return the document.

    Raises UsageError or AgentError where nothing was changed, TakenBackError where it was taken back.
    """
    if switch.version == switch.former:
        return _document(switch, {}, changed=False)
    found = checked(switch.releases.command(switch.version), named)
    databases = {Path(row["db"]): row["action"] for row in found["databases"]}
    expected = giving(databases, max(switch.within_s, RECENT_S))
    switch.agents.stop()
    with _going_back(switch, expected):
        for path, action in databases.items():
            if action == "migrate":
                copies.keep(path, switch.version)
                switch.kept.append(path)
        switch.releases.switch(switch.version)
        switch.agents.start(switch.within_s)
        _await(switch, expected)
    return _document(switch, expected, changed=True)


def checked(program: Path, named: Sequence[Path]) -> Document:
    """Return what a version says of itself, `upgrade --check --json`. Raises UsageError with its faults."""
    command = [str(program), "upgrade", "--check", "--json", *map(str, named)]
    try:
        done = subprocess.run(command, capture_output=True, timeout=CHECK_S, check=False)
        found = dict(json.loads(done.stdout))
    except (OSError, ValueError, subprocess.TimeoutExpired) as error:
        advice = "it is older than this command, or not whole; nothing was changed"
        raise UsageError.at(program, f"does not say what it would do ({error})", advice) from error
    if found.get("errors"):
        raise UsageError(Fault(**fault) for fault in found["errors"])
    return found


@contextmanager
def _going_back(switch: Switch, expected: Rigs) -> Iterator[None]:
    """Take the switch back whatever goes wrong inside, an interruption too."""
    try:
        yield
    except BaseException as error:
        why = (
            "; ".join(fault.message for fault in error.faults)
            if isinstance(error, AgentError)
            else repr(error)
        )
        raise _taken_back(switch, expected, why) from error


def _taken_back(switch: Switch, expected: Rigs, why: str) -> TakenBackError:
    """Go back to the former version; return the error that says so, and what it took."""
    switch.agents.stop()
    aside = [
        copies.restore(path, switch.version)
        for path in switch.kept
        if copies.copy_of(path, switch.version).exists()
    ]
    switch.releases.switch(switch.former)
    try:
        switch.agents.start(switch.within_s)
        _await(switch, expected)
        now = f"{switch.former} runs again and gives valid rows"
    except AgentError as error:
        now = f"{switch.former} was put back, but: {error.faults[0].message}"
    wrote = f"; what {switch.version} wrote lies in {', '.join(map(str, aside))}" if aside else ""
    return TakenBackError.at(f"upgrade to {switch.version}", f"taken back: {why}", f"{now}{wrote}")


def _await(switch: Switch, expected: Rigs) -> None:
    """Wait until every rig that gave valid rows does so again. Raises AgentsError after the time for it."""
    end = time.monotonic() + switch.within_s
    shown: set[tuple[Path, str]] = set()
    while absent := silent(expected, shown):
        if time.monotonic() > end:
            what = f"no valid row of {', '.join(absent)} within {switch.within_s:g} s"
            raise AgentsError.at("agents", what, "see the agent's log")
        time.sleep(switch.poll_s)


def _document(switch: Switch, expected: Rigs, *, changed: bool) -> Document:
    kept = [str(copies.copy_of(path, switch.version)) for path in switch.kept]
    return {
        "from": switch.former, "to": switch.version, "changed": changed,
        "rigs": sorted(rig for _, rig in expected), "copies": kept,
    }  # fmt: skip


def print_switch(document: Document) -> None:
    """Say what runs now."""
    if not document["changed"]:
        show(f"{document['to']} runs already")
        return
    rigs = ", ".join(document["rigs"])
    show(
        f"{document['to']} runs; "
        + (f"valid rows of {rigs}" if rigs else "no rig gave valid rows before, so none was awaited")
    )
    for copy in document["copies"]:
        show(f"{copy}: from before, to go back to {document['from']}; delete it when nobody will")
