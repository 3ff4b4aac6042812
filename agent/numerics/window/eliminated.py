"""Windows with lost readings: the normal equations as if those readings were unknown.

With everything as in `solve`, and the columns h of the lost readings beside it, Γ projected out,

    min over d of |e* − ψ* δ + h d|² + Σ d²/sd²

leaves H − T_ψ' P T_ψ, g − T_ψ' P T_e, rss − T_e' P T_e, T = h'[e* ψ*], P = (h'h + diag 1/sd²)⁻¹ (Schur). What
the readings are at δ = 0 is put in before, so that the window's best initial state, where ψ* stands, is that
without them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from agent.numerics.window.filtering.summary import Summary
from agent.numerics.window.jump import Jumps, JumpScan, LostRight
from agent.numerics.window.lost import Events, Lost
from agent.numerics.window.operators import Operators
from agent.numerics.window.rows import Asked, Windowed
from agent.numerics.window.solve import Solved, Starts, WindowSolver, inverse
from agent.types import FloatArray, IntArray

UNSOLVED = -1
"""Fixed by its meaning: in the place of how many readings a window lost."""


@dataclass(frozen=True, slots=True)
class LostColumnsOfWindow:
    """The columns of the l readings that one window lost.

    Attributes:
        lost: the readings.
        cross: (l, 1+c) h'[e ψ].
        gram: (l, l) h'h.
        U: (l, r) h'U in coordinates of the window's start.
        events, membership: the events, and which readings (l, k) they are of.
    """

    lost: Lost
    cross: FloatArray
    gram: FloatArray
    U: FloatArray
    events: Events
    membership: FloatArray


def columns_of(events: Events, operators: Operators, fulls: int, hop: int) -> LostColumnsOfWindow | None:
    """Return columns of the window of so many whole hops before hop `hop`'s head; None where it lost none."""
    first = hop - fulls
    inside = (events.hop >= first) & (events.lost.sample >= first * operators.plan.hop)
    if not inside.any():
        return None
    events = events.part(np.flatnonzero(inside))
    key = np.stack([events.lost.sample, events.lost.channel])
    _, one, of = np.unique(key, axis=1, return_index=True, return_inverse=True)
    member = (np.arange(len(one))[:, None] == of.reshape(-1)[None]).astype(float)
    U = member @ _moved(_response_along(events, operators, hop), operators.powers[events.hop - first])
    return LostColumnsOfWindow(
        events.lost.part(one), member @ events.cross, member @ events.gram @ member.T, U, events, member
    )


def _response_along(events: Events, operators: Operators, hop: int) -> FloatArray:
    """Return h'U (k, r) from each event's hop on, in coordinates of its start."""
    age = hop - 1 - events.hop
    later = _moved(events.begun, operators.squares[np.maximum(age, 0)]) @ operators.basis.steps[2]
    return np.asarray(events.local + np.where(age[:, None] >= 0, later, 0.0))


def _moved(rows: FloatArray, matrices: FloatArray) -> FloatArray:
    """Return each row (k, r) times its matrix (k, r, r)."""
    return np.asarray((rows[:, None, :] @ matrices)[:, 0])


@dataclass(frozen=True, slots=True)
class Eliminated:
    """One window with its lost readings eliminated.

    Attributes:
        solved: normal equations as filled by what the readings are at δ = 0, before they are eliminated.
        H, g, rss: (c, c), (c,), () normal equations.
        columns: of the lost readings.
        value: (l,) what they are at δ = 0.
        cross: (l, 1+c) T.
        covariance: (l, l) P.
        components: (l, k) of h along the initial states.
    """

    solved: Solved
    H: FloatArray
    g: FloatArray
    rss: float
    columns: LostColumnsOfWindow
    value: FloatArray
    cross: FloatArray
    covariance: FloatArray
    components: FloatArray

    def found(self) -> tuple[FloatArray, FloatArray]:
        """Return what each reading is by δ: (l,) at δ = 0 and (l, c) times δ."""
        weighed = self.covariance @ self.cross
        return self.value - weighed[:, 0], weighed[:, 1:]

    def right_of(
        self, operators: Operators, right: int, hop: int, summary: Summary
    ) -> tuple[LostRight, Summary]:
        """Return what the readings do on the right of a boundary, and that part's summary as filled."""
        events = self.columns.events
        member = self.columns.membership
        first = hop - right
        later = events.hop >= first
        powers = operators.powers
        # a free response on the right, where the reading lies before the boundary
        alpha = _moved_by(events.begun, powers[np.maximum(first - 1 - events.hop, 0)])
        after = _moved(_response_along(events, operators, hop), powers[np.maximum(events.hop - first, 0)])
        U = member @ np.where(later[:, None], after, alpha @ operators.squares[right])
        cross = member @ np.where(later[:, None], events.cross, alpha @ summary.moment[0].T)
        gram, moment = summary.gram.copy(), summary.moment.copy()
        gram[0, 0] += self.value @ cross
        gram[0, 1:, 0] = gram[0, 0, 1:]
        moment[0, 0] += self.value @ U
        return LostRight(cross[:, 1:], U, self.components, self.cross, self.covariance), Summary(gram, moment)


def _moved_by(columns: FloatArray, matrices: FloatArray) -> FloatArray:
    """Return each matrix (k, r, r) times its column (k, r)."""
    return np.asarray((matrices @ columns[:, :, None])[:, :, 0])


def eliminated(
    solver: WindowSolver, summary: Summary, starts: Starts, columns: LostColumnsOfWindow
) -> Eliminated:
    """Solve one window whose readings in `columns` are unknown."""
    precision = 1.0 / columns.lost.sd**2
    components = columns.U @ solver.directions
    covariance = inverse(columns.gram - components @ components.T + np.diag(precision))
    value = -covariance @ _projected(solver, solver.solve(summary, starts), columns, components)[:, 0]
    solved = solver.solve(_filled(summary, columns, value), starts)
    cross = _projected(solver, solved, columns, components)
    cross[:, 0] += (columns.gram + np.diag(precision)) @ value
    weighed = covariance @ cross
    normal = solved.normal
    return Eliminated(
        solved, normal.H[0] - cross[:, 1:].T @ weighed[:, 1:], normal.g[0] - cross[:, 1:].T @ weighed[:, 0],
        max(float(normal.rss[0] + value @ (precision * value) - cross[:, 0] @ weighed[:, 0]), 0.0),
        columns, value, cross, covariance, components,
    )  # fmt: skip


def _projected(
    solver: WindowSolver, solved: Solved, columns: LostColumnsOfWindow, components: FloatArray
) -> FloatArray:
    """Return h'[e* ψ*] (l, 1+c), Γ projected out; of h'e itself that of e as it came, not as filled."""
    r = columns.U.shape[1]
    shift = solved.moved[0, :, :r]
    along = -2 * solved.moved[0, :, r:]
    return np.asarray(columns.cross + columns.U @ shift.T - components @ (along + shift @ solver.reach.T).T)


def _filled(summary: Summary, columns: LostColumnsOfWindow, value: FloatArray) -> Summary:
    """Return a window's summary with e of the readings as they were found to be, (l,)."""
    gram, moment = summary.gram.copy(), summary.moment.copy()
    more = value @ columns.cross
    gram[0, 0] += more
    gram[0, 1:, 0] = gram[0, 0, 1:]
    gram[0, 0, 0] += more[0] + value @ columns.gram @ value
    moment[0, 0] += value @ columns.U
    return Summary(gram, moment)


@dataclass(frozen=True, slots=True)
class Scanning:
    """Windows scanned for a jump: the columns, and for each boundary the right parts and filters there."""

    jumps: Jumps
    parts: Sequence[Summary]
    starts: Sequence[Starts]


@dataclass(frozen=True, slots=True)
class Solving:
    """Newest windows of one length, the `number`-th of the bank, on their way to rows."""

    operators: Operators
    number: int
    index: IntArray
    summary: Summary
    starts: Starts
    solved: Solved
    scanning: Scanning | None
    lost: dict[int, int] = field(default_factory=dict)
    asked: list[Asked] = field(default_factory=list)

    def eliminate(self, events: Events, held_from: int, hop: int) -> None:
        """Eliminate what the window ending in hop `hop` lost; one that reaches before `held_from` is left."""
        plan, fulls = self.operators.plan, self.operators.lengths[self.number]
        i = int(np.searchsorted(self.index, hop * plan.hop + plan.head - 1))
        if i == len(self.index) or self.index[i] // plan.hop != hop:
            return
        if hop - fulls < held_from:
            self.lost[i] = UNSOLVED
            return
        columns = columns_of(events, self.operators, fulls, hop)
        if columns is None:
            return
        solver = self.operators.solvers[self.number]
        row = slice(i, i + 1)
        found = eliminated(solver, self.summary.part(row), self.starts.part(row), columns)
        normal = self.solved.normal
        normal.H[i], normal.g[i], normal.rss[i], normal.x0[i] = (
            found.H,
            found.g,
            found.rss,
            found.solved.normal.x0[0],
        )
        self.lost[i] = int(np.isinf(columns.lost.sd).sum())
        if self.scanning is not None and self.operators.scan is not None:
            self._scan(self.operators.scan, self.scanning, found, i, hop)
        if self.number == 0 and columns.lost.asked.any():
            self.asked.append(_answer(found, int(self.index[i])))

    def _scan(self, scan: JumpScan, scanning: Scanning, found: Eliminated, i: int, hop: int) -> None:
        """Put the window's own columns of a jump in the place of those with its readings as filled in."""
        at = int(np.searchsorted(scanning.jumps.index, self.index[i]))
        if at == len(scanning.jumps.index) or scanning.jumps.index[at] != self.index[i]:
            return
        row = slice(at, at + 1)
        each = zip(self.operators.rights, scanning.parts, strict=True)
        rights = [found.right_of(self.operators, right, hop, part.part(row)) for right, part in each]
        starts = self.starts.part(slice(i, i + 1))
        ats = [start.part(row) for start in scanning.starts]
        lost, filled = [one[0] for one in rights], [one[1] for one in rights]
        cross, own = scan.columns(found.solved, filled, starts, ats, lost)
        scanning.jumps.cross[at], scanning.jumps.own[at] = cross[:, 0], own[:, 0]

    def windowed(self) -> Windowed:
        """Return the rows."""
        lost = np.zeros(len(self.index), dtype=np.int64)
        for i, count in self.lost.items():
            lost[i] = count
        jumps = None if self.scanning is None else self.scanning.jumps
        return Windowed(
            self.index,
            self.solved.normal,
            self.starts,
            jumps,
            np.maximum(lost, 0),
            lost == UNSOLVED,
            tuple(self.asked),
        )


def _answer(found: Eliminated, index: int) -> Asked:
    which = found.columns.lost.asked
    value, slope = found.found()
    lost = found.columns.lost
    return Asked(
        index, lost.sample[which], lost.channel[which], lost.sd[which], value[which], slope[which],
        found.covariance[np.ix_(which, which)],
    )  # fmt: skip
