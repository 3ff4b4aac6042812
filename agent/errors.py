"""What the agent raises.

    AgentError                        exit_code
    ├── UsageError                    2   the command line
    ├── ConfigError                   2   the configuration; carries every fault found
    ├── ModelError                    2   the model cannot be observed or its parameters not told apart
    ├── RecordingError                2   a recording that cannot be used
    ├── StoreError                    3   the database: missing, not ours, newer, locked, unknown id
    │   └── StoreHeldError                another process owns it: that one may be asked (DB.sock)
    └── BusError                      4   a bus that cannot exist or be opened in demo and check --probe

Each prints as `deltak: error: <key path or file:line>: <what>; <what to do>`.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Self


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing that is wrong: where (key path or file:line), what, and what to do about it."""

    path: str
    message: str
    advice: str = ""

    def __str__(self) -> str:
        text = f"{self.path}: {self.message}" if self.path else self.message
        return f"{text}; {self.advice}" if self.advice else text


class AgentError(Exception):
    """Base of what the agent raises on purpose: one or several faults, shown one a line."""

    exit_code: ClassVar[int] = 1
    causes: tuple[Fault, ...] = ()
    """Faults behind these that stand on stderr already, from a process that this one waited for."""

    def __init__(self, faults: Iterable[Fault]) -> None:
        self.faults = tuple(faults)
        super().__init__("\n".join(str(fault) for fault in self.faults))

    def __reduce__(self) -> tuple[type[Self], tuple[tuple[Fault, ...]]]:
        """Say how to make it again: it passes from one process of an agent to another."""
        return type(self), (self.faults,)

    @classmethod
    def at(cls, path: str | Path, message: str, advice: str = "") -> Self:
        """Make the error of a single fault."""
        return cls([Fault(str(path), message, advice)])


class UsageError(AgentError):
    """The command line asks for what cannot be done."""

    exit_code = 2


class ConfigError(AgentError):
    """The configuration has faults."""

    exit_code = 2


class ModelError(AgentError):
    """The model is unobservable or some of its parameters cannot be told apart."""

    exit_code = 2


class RecordingError(AgentError):
    """The recording cannot be used."""

    exit_code = 2

    @classmethod
    def of(cls, words: str, advice: str) -> Self:
        """Make the error of words `FILE[:LINE]: what; what to do`, with this advice where they give none."""
        place, _, rest = words.partition(": ")
        what, _, own = rest.partition("; ")
        return cls.at(place, what, own or advice) if what else cls.at("", words, advice)


class StoreError(AgentError):
    """The database is missing, foreign, newer, locked, or lacks what was asked for."""

    exit_code = 3


class StoreHeldError(StoreError):
    """Another process owns the database."""


class BusError(AgentError):
    """The bus cannot exist here or cannot be opened."""

    exit_code = 4
