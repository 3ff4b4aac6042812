"""What the readers of recorded files share: what is asked for, and the order in which rows come."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from drivers.port import DriverConfigError, FloatArray, IntArray

Rows = tuple[IntArray | None, FloatArray]
"""Times in ns (n,), or None without time stamps, and values (n, m)."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """What is asked of a recording.

    Attributes:
        path: the file.
        names: names of the columns in the file, in the order of the values.
        time: name of the time column.
        time_needed: whether a recording without the time column is an error.
        delimiter: between the cells of a table; None to find it.
        note: told of what is remarkable, in words.
        fault: told of each cell that is no number.
        optional: names that the recording may be without.
    """

    path: Path
    names: tuple[str, ...]
    time: str
    time_needed: bool
    delimiter: str | None
    note: Callable[[str], None]
    fault: Callable[[str], None]
    optional: frozenset[str] = frozenset()

    def found(self, present: list[str]) -> tuple[str, ...]:
        """Return the names of the columns to be read: all but optional ones that are not there."""
        return tuple(name for name in self.names if name in present or name not in self.optional)

    def place(self, name: str, present: list[str]) -> int:
        """Return where a column is; DriverConfigError names those there are, or says it is there twice."""
        if present.count(name) == 1:
            return present.index(name)
        if name in present:
            raise DriverConfigError(
                f'{self.path}: {present.count(name)} columns are called "{name}"; rename all but one'
            )
        shown = ", ".join(present[:20]) + (f" and {len(present) - 20} more" if len(present) > 20 else "")
        advice = "say under [columns] which of them it is"
        if len(present) == 1:
            advice = "between columns stand commas, semicolons or tabs, and the first line names them"
        elif name == self.time:
            advice += ', or rig.clock = "uniform" where rows follow one another at the rig\'s rate'
        raise DriverConfigError(f'{self.path}: no column is called "{name}"; columns are {shown}; {advice}')

    def time_place(self, present: list[str]) -> int | None:
        """Return where the time column is, None where there is none and none is needed."""
        return self.place(self.time, present) if self.time_needed or self.time in present else None

    def note_ignored(self, present: list[str]) -> None:
        """Say once which columns nobody asks for."""
        unused = [name for name in present if name not in self.names and name != self.time]
        if unused:
            self.note(f"{self.path}: columns that no channel names are ignored: {', '.join(unused)}")


class RecordedFile(ABC):
    """An open recording; names are those of the columns that it has of what was asked for."""

    names: tuple[str, ...]

    @abstractmethod
    def rows(self) -> Iterator[Rows]:
        """Yield the rows in pieces of about BLOCK_ROWS."""

    @abstractmethod
    def close(self) -> None:
        """Close the file; harmless when closed already."""
