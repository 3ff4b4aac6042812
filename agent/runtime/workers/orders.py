"""What passes between the agent and its workers, beside records and runs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agent.config import RigConfig
from agent.runtime.process.databases import RunKind
from agent.runtime.process.heartbeats import Thread

MAKE, RUN, STOP, PREPARE, TAKE_UP, FORGET = "make", "run", "stop", "prepare", "take up", "forget"
"""What the agent asks a worker for, or says to it."""
COMMANDED, BASELINES = "commanded", "baselines"
"""What it says of alarms and of baselines."""
BEAT, LOG, DONE = "beat", "log", "done"
"""What a worker says: how it is, what it logs, what its rigs found."""


@dataclass(frozen=True, slots=True)
class Order:
    """What a worker is to run.

    Attributes:
        levels: from which level on loggers log, by their names; "" is the root.
        watchdog_s: the interval of the service manager's watchdog; None without one.
    """

    configs: tuple[RigConfig, ...]
    db: Path | None
    kind: RunKind
    levels: Mapping[str, int]
    watchdog_s: float | None


@dataclass(frozen=True, slots=True)
class Beat:
    """How a worker is: its rigs as status documents, its threads."""

    rigs: Sequence[dict[str, Any]]
    threads: Sequence[Thread]
