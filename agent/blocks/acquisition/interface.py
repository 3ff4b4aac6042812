"""The acquisition of a rig as the pipeline sees it, whether it has one source or several."""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from agent.blocks.acquisition.indexing import Indexer
from agent.types import Aligned, IntArray, Output, Samples
from drivers.port import SampleBlock

Label = Callable[[IntArray], IntArray]
"""Time stamps (n,), ns, of sample numbers (n,)."""
Ends = tuple[int, Counter[str]]
"""Samples that were used or still wait, and those that were refused, by reason."""


@dataclass(frozen=True, slots=True)
class ChannelScale:
    """SI value = (reading * scale + offset) * factor."""

    scale: float
    offset: float
    factor: float


@dataclass(frozen=True, slots=True)
class SourcePlan:
    """One source's columns: positions among the rig's channels, and how each becomes SI."""

    name: str
    columns: tuple[int, ...]
    scales: tuple[ChannelScale, ...]


@dataclass(slots=True)
class SourceState:
    """What is known of one source.

    passed counts samples handed on to the rig; rejected those refused here, by reason; gaps the jumps of the
    index.
    """

    plan: SourcePlan
    indexer: Indexer
    passed: int = 0
    rejected: Counter[str] = field(default_factory=Counter)
    gaps: int = 0
    missing: int = 0
    newest: int | None = None

    def refusals(self) -> Counter[str]:
        """All samples refused here, by reason."""
        return self.rejected + self.indexer.rejected


class SourceEvent(NamedTuple):
    """Something found of a source, once: cause as a short word, message for people."""

    source: str
    cause: str
    message: str


Acquired = Output[Aligned, SourceEvent]
"""Samples of the rig, cut at gaps, and what was found of the sources meanwhile."""


@dataclass(frozen=True, slots=True)
class Through:
    """Rows that were handed on: used by the estimation, waiting before it, refused on the way, by reason."""

    used: int
    waiting: int
    rejected: Counter[str]


class Acquisition(ABC):
    """Source blocks in, uninterrupted rig samples out; and a count of where each source's samples ended."""

    @property
    @abstractmethod
    def sources(self) -> Mapping[str, SourceState]:
        """What is known of each source, by its name."""

    @abstractmethod
    def step(
        self, source: str, block: SampleBlock, modulus: int | None, label: Label | None = None
    ) -> Acquired:
        """Take a block of one source; return the samples that it leads to, and what it shows of the sources.

        label gives time stamps; without it the samples' own are taken, or those of their numbers.
        """

    @abstractmethod
    def ends(self, source: str, through: Through) -> Ends:
        """Return where a source's samples ended that were not refused in `sources`."""

    @abstractmethod
    def lose(self, reason: str, through: Through) -> None:
        """Refuse the rows on their way: what comes after is made anew, with counts that begin at 0."""

    def finish(self) -> Acquired:
        """Return the rows that wait for samples that will not come."""
        return Acquired()

    def arrived(self, samples: Sequence[Samples]) -> None:  # noqa: B027 - of one source every row is a sample
        """Note what became of rows."""

    def skews(self) -> Mapping[str, tuple[float | None, float | None]]:
        """Return what is compensated of each source's skew, and its sd, s; None where it is not known."""
        return {}

    def hurry(self) -> None:  # noqa: B027 - of one source nothing is measured
        """Begin no measurement any more."""
