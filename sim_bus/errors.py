"""What the simulator raises on purpose.

    SimError(ValueError)     exit_code
    ├── SimUsageError        2   configuration, scenario or command line
    └── SimBusError          4   the bus cannot be opened here

Each carries one or several lines of the form `<key path or file>: <what>; <what to do>`.
"""

from collections.abc import Iterable
from typing import ClassVar


class SimError(ValueError):
    """Base of what the simulator raises on purpose; `lines` are shown one a line."""

    exit_code: ClassVar[int] = 1

    def __init__(self, lines: str | Iterable[str]) -> None:
        self.lines = (lines,) if isinstance(lines, str) else tuple(lines)
        super().__init__("\n".join(self.lines))


class SimUsageError(SimError):
    """The configuration, the scenario or the command line asks for what cannot be played."""

    exit_code = 2


class SimBusError(SimError):
    """The bus cannot be opened here."""

    exit_code = 4
