"""Rows of estimates with status and reason, one a hop.

Of several windows each estimate is of the shortest one sharp enough, among those that hold no change.
"""

from dataclasses import dataclass, fields, replace
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.numerics.estimator.faults import Finding
from agent.numerics.estimator.reading import Reading
from agent.numerics.estimator.settings import EstimatorSettings
from agent.numerics.inference import tuning
from agent.numerics.inference.posterior import Posterior
from agent.numerics.inference.verdicts import Belief
from agent.types import BoolArray, CodeArray, FloatArray, IntArray, Reason, Status, WindowConditions

EVENTS = ("beliefs", "findings", "failures", "conditions")
"""Fields of `Outcome` that tell of the whole call, beside its columns."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """Estimates at N hops.

    Attributes:
        index: (N,) newest sample of each window, counted from the run's first.
        theta, sd, lower, upper, sd_repeat: (N, q); NaN while warming.
        status, reason: (N, q) codes of Status and Reason.
        window: (N, q) samples of the window that each estimate is of; 0 while warming.
        dof: (N,) degrees of freedom of the residual.
        others: what each of several windows says; empty where there is one.
        beliefs: (sample, beliefs about the rig's constants) of the windows learnt from meanwhile.
        findings: faults of channels that began or ended meanwhile.
        failures: (last sample, what was raised first) of each call that failed.
        conditions: (last sample, the paper's conditions) of windows that are looked at so.
    """

    index: IntArray
    theta: FloatArray
    sd: FloatArray
    lower: FloatArray
    upper: FloatArray
    sd_repeat: FloatArray
    status: CodeArray
    reason: CodeArray
    window: IntArray
    dof: FloatArray
    others: tuple["Outcome", ...] = ()
    beliefs: tuple[tuple[int, tuple[Belief, ...]], ...] = ()
    findings: tuple[Finding, ...] = ()
    failures: tuple[tuple[int, str], ...] = ()
    conditions: tuple[tuple[int, WindowConditions], ...] = ()

    @classmethod
    def warming(cls, index: IntArray, q: int) -> "Outcome":
        """Return rows without estimates."""
        shape = (len(index), q)
        theta, sd, lower, upper, repeat = (np.full(shape, np.nan) for _ in range(5))
        status = np.full(shape, int(Status.WARMING), dtype=np.uint8)
        none, window = np.zeros(shape, dtype=np.uint8), np.zeros(shape, dtype=np.int64)
        dof = np.full(len(index), np.nan)
        return cls(index, theta, sd, lower, upper, repeat, status, none, window, dof)

    @classmethod
    def unexplained(cls, index: IntArray, q: int, reason: Reason = Reason.MISMATCH) -> "Outcome":
        """Return rows of windows that nothing fits, or that a channel spoils."""
        rows = cls.warming(index, q)
        rows.status[:], rows.reason[:] = Status.INVALID, reason
        return rows

    @classmethod
    def of(cls, reading: Reading, enough_sd: FloatArray) -> "Outcome":
        """Return rows that hold what windows say, unexcited where it is too little."""
        shape = reading.theta.shape
        status = np.full(shape, int(Status.VALID), dtype=np.uint8)
        status[~(reading.sd <= enough_sd)] = Status.UNEXCITED
        window = np.full(shape, reading.samples, dtype=np.int64)
        return cls(
            reading.index, reading.theta.copy(), reading.sd.copy(), reading.lower.copy(),
            reading.upper.copy(),
            reading.sd_repeat.copy(), status, np.zeros(shape, dtype=np.uint8), window,
            reading.dof.copy(),
        )  # fmt: skip

    def copy(self) -> "Outcome":
        """Return rows that may be changed by themselves."""
        return replace(self, **{name: getattr(self, name).copy() for name in COLUMNS if name != "index"})

    def write(self, row: int, posterior: Posterior, enough_sd: FloatArray) -> None:
        """Put what a window was found to say by itself in the place of a row."""
        for name in ("theta", "sd", "lower", "upper", "sd_repeat"):
            getattr(self, name)[row] = getattr(posterior, name)
        self.status[row] = np.where(posterior.sd <= enough_sd, int(Status.VALID), int(Status.UNEXCITED))
        self.reason[row] = Reason.NONE

    def invalidate(self, rows: int | slice, reason: Reason) -> None:
        """Mark rows invalid."""
        self.status[rows], self.reason[rows] = Status.INVALID, reason

    def stand_still(self, rows: NDArray[np.bool_]) -> None:
        """Mark rows (N,) of windows in which nothing moved."""
        self.status[rows], self.reason[rows] = Status.UNEXCITED, Reason.STANDSTILL

    def lack(self, rows: NDArray[np.bool_]) -> None:
        """Mark rows (N,) of windows that lost too many readings."""
        self.status[rows], self.reason[rows] = Status.INVALID, Reason.GAP

    def take(
        self,
        rows: IntArray,
        wanted: NDArray[np.bool_],
        found: Reading,
        which: NDArray[np.bool_],
        enough: FloatArray,
    ) -> None:
        """Take estimates of rows (k,) from another window, where `wanted` (k, q); which: its k windows."""
        for name in ("theta", "sd", "lower", "upper", "sd_repeat"):
            mine = getattr(self, name)
            other = getattr(found, name)[which]
            mine[rows] = np.where(wanted, other, mine[rows])
        status = np.where(found.sd[which] <= enough, int(Status.VALID), int(Status.UNEXCITED))
        self.status[rows] = np.where(wanted, status, self.status[rows])
        self.window[rows] = np.where(wanted, found.samples, self.window[rows])

    @classmethod
    def joined(cls, pieces: "list[Outcome]", q: int) -> "Outcome":
        """Return rows one after the other."""
        if len(pieces) == 1:
            return pieces[0]
        pieces = pieces or [cls.warming(np.zeros(0, dtype=np.int64), q)]
        whole: dict[str, Any] = {n: np.concatenate([getattr(piece, n) for piece in pieces]) for n in COLUMNS}
        whole |= {
            name: tuple(chain.from_iterable(getattr(piece, name) for piece in pieces)) for name in EVENTS
        }
        count = max(len(piece.others) for piece in pieces)
        each = [[_other(piece, k, q) for piece in pieces] for k in range(count)]
        return replace(pieces[0], others=tuple(cls.joined(one, q) for one in each), **whole)

    def part(self, start: int, stop: int) -> "Outcome":
        """Return rows [start, stop)."""
        if stop - start == len(self.index):
            return self
        others = tuple(other.part(start, stop) for other in self.others)
        return replace(self, others=others, **{name: getattr(self, name)[start:stop] for name in COLUMNS})


COLUMNS = [field.name for field in fields(Outcome) if field.name not in ("others", *EVENTS)]
"""Fields that have an entry a hop."""


def clean(found: Reading, index: IntArray, broken: BoolArray, ended: IntArray) -> tuple[IntArray, BoolArray]:
    """Rows (k,) of a longer window's readings, and which of these hold no change that a shorter one saw.

    ended (N,): where the last stretch of broken rows before each row ended.
    """
    at = np.searchsorted(index, found.index)
    use = at < len(index)
    use[use] &= ~broken[at[use]]
    use &= (found.excess < tuning.MISMATCH_SD) & ~found.unsolved
    use[use] &= found.index[use] - found.samples >= ended[at[use]]
    return at, use


def chosen(
    rows: Outcome,
    longer: list[Reading | None],
    broken: BoolArray,
    ended: IntArray,
    settings: EstimatorSettings,
) -> Outcome:
    """Take each estimate from the shortest window that is sharp enough, among those that hold no change.

    What each window says by itself stands in `others`.
    """
    each = [rows.copy()]
    for found in longer:
        each.append(Outcome.warming(rows.index, settings.rig.q))
        if found is None:
            continue
        at, use = clean(found, rows.index, broken, ended)
        use &= ~found.far
        wanting = ~(rows.sd[at[use]] <= settings.wanted_sd) & (found.sd[use] < rows.sd[at[use]])
        rows.take(at[use], wanting, found, use, settings.enough_sd)
        whole = at < len(rows.index)
        each[-1].take(at[whole], np.ones_like(found.sd[whole], dtype=bool), found, whole, settings.enough_sd)
        for unusable in at[whole & ~use].tolist():
            each[-1].invalidate(unusable, Reason.CHANGING)
    return replace(rows, others=tuple(each))


def _other(piece: Outcome, number: int, q: int) -> Outcome:
    """Return what one of several windows says in some rows; nothing where there is but one."""
    return piece.others[number] if piece.others else Outcome.warming(piece.index, q)
