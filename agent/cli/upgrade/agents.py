"""The agents of this machine, to be stopped and started: systemd units, or commands that somebody names."""

import subprocess
from collections.abc import Sequence
from typing import Protocol

from agent.errors import AgentError

_PATTERNS = ("deltak.service", "deltak@*.service", "deltak-*.service")
_OURS = "deltak-upgrade@"


class AgentsError(AgentError):
    """They cannot be stopped or started."""


class Agents(Protocol):
    """Whatever runs the agents."""

    def stop(self) -> None:
        """End them. Raises AgentsError."""

    def start(self, limit_s: float) -> None:
        """Start those that ran; on return they are ready. Raises AgentsError, also after the limit."""


class Units:
    """The units of systemd that are active when this is made: the agents, and what reads their databases."""

    def __init__(self) -> None:
        words = ["list-units", "--plain", "--no-legend", "--state=active,activating", *_PATTERNS]
        names = [line.split()[0] for line in _run(["systemctl", *words], 60.0).splitlines()]
        self._names = [name for name in names if not name.startswith(_OURS)]  # the one that this may run in

    def stop(self) -> None:
        self._all("stop", None)

    def start(self, limit_s: float) -> None:
        self._all("start", limit_s)

    def _all(self, verb: str, limit_s: float | None) -> None:
        if self._names:
            _run(["systemctl", verb, *self._names], limit_s)


class Commands:
    """Two commands, each a program and its arguments."""

    def __init__(self, stop: Sequence[str], start: Sequence[str]) -> None:
        self._stop = stop
        self._start = start

    def stop(self) -> None:
        _run(self._stop, None)

    def start(self, limit_s: float) -> None:
        _run(self._start, limit_s)


def _run(command: Sequence[str], limit_s: float | None) -> str:
    """Run a program and return what it says. Raises AgentsError where it fails or takes longer."""
    name = " ".join(command)
    try:
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, timeout=limit_s, check=False
        )
    except subprocess.TimeoutExpired as error:
        raise AgentsError.at(name, f"was not done after {limit_s:g} s", "see the agent's log") from error
    except OSError as error:
        raise AgentsError.at(name, f"cannot be run: {error.strerror}", "name --stop and --start") from error
    if done.returncode:
        said = done.stderr.decode("utf-8", "replace").strip().splitlines() or ["no word"]
        raise AgentsError.at(
            name, f"failed with exit code {done.returncode}: {said[-1]}", "see the agent's log"
        )
    return done.stdout.decode("utf-8", "replace")
