"""Lost readings as unknowns of every window that holds them: their columns beside e and ψ.

A reading that was filled in is wrong by d ~ N(0, sd²), sd = ∞ where nothing is known: e of the true readings
is e + h d (intervention: Box & Tiao, J. Am. Stat. Assoc. 70 (1975) 70). Inside a hop h is an impulse response
of the whitening filter; from the hop's end on it is a free response, h = U α with

    α(b+1) = −Γ ẑ,    α(k+1) = Π α(k),    h'[e ψ] = local + Σ α'(moment),    h_i'h_j = local + Σ α_i' U'U α_j

so that what is kept of it does not grow with the window. One reading may touch several samples (taps of a
hold, a slope) and so two hops: what it does through each is an event, and a reading's column is the sum of
its events'.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from agent.numerics.window.filtering.filters import System
from agent.numerics.window.operators import Operators
from agent.numerics.window.tuning import MOST_EVENTS
from agent.types import BoolArray, FloatArray, IntArray

Taps = Sequence[Sequence[tuple[int, int, float]]]
"""Where readings of each channel enter: (samples later, column of v = (y, u), weight)."""


@dataclass(frozen=True, slots=True)
class Lost:
    """Readings that were filled in, by their samples.

    Attributes:
        sample, channel: (l,) number of the sample, which does not fall; column among the channels that Taps
            lists.
        sd: (l,) prior sd of what the fill-in is wrong by; inf where nothing is known.
        asked: (l,) whether the window's answer is wanted.
    """

    sample: IntArray
    channel: IntArray
    sd: FloatArray
    asked: BoolArray

    def __len__(self) -> int:
        return len(self.sample)

    @classmethod
    def none(cls) -> "Lost":
        """Return no readings."""
        return cls(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0), np.zeros(0, bool))

    def part(self, which: slice | IntArray) -> "Lost":
        """Return some of the readings."""
        return Lost(self.sample[which], self.channel[which], self.sd[which], self.asked[which])

    def followed(self, later: "Lost") -> "Lost":
        """Append readings of later samples."""
        pairs = [(getattr(self, n), getattr(later, n)) for n in ("sample", "channel", "sd", "asked")]
        return Lost(*(np.concatenate(pair) for pair in pairs))

    def between(self, start: int, stop: int) -> "Lost":
        """Return the readings of samples [start, stop)."""
        return self.part(slice(*np.searchsorted(self.sample, [start, stop]).tolist()))


class Impulses:
    """Responses of the whitening filter over a hop: of e, (H, p+m, p), and of its state, (H, p+m, a)."""

    def __init__(self, system: System, hop: int, taps: Taps) -> None:
        own = slice(system.size.n, system.size.n + system.size.a)
        F, N, H = system.step.predictor, system.N[own], system.H[0, :, own]
        states = [N]
        for _ in range(hop - 1):
            states.append(F @ states[-1])
        self.state = np.array(states).transpose(0, 2, 1)
        later = np.array([H @ state for state in states[:-1]]).reshape(hop - 1, *system.J[0].shape)
        self.output = np.concatenate([system.J[:1], later]).transpose(0, 2, 1)
        self.taps, self.hop = taps, hop
        offsets = [offset for channel in taps for offset, *_ in channel]
        self.earliest = min(0, *offsets)
        self.latest = max(0, *offsets)

    def events(self, lost: Lost, start: int) -> tuple[IntArray, FloatArray, FloatArray]:
        """Return which readings touch the hop from `start` on (k,), e (k, H, p), the state after (k, a)."""
        local = np.zeros((len(lost), self.hop, self.output.shape[2]))
        after = np.zeros((len(lost), self.state.shape[2]))
        touches = np.zeros(len(lost), dtype=bool)
        for i, (sample, channel) in enumerate(zip(lost.sample.tolist(), lost.channel.tolist(), strict=True)):
            for offset, column, weight in self.taps[channel]:
                place = sample + offset - start
                if 0 <= place < self.hop:
                    local[i, place:] += weight * self.output[: self.hop - place, column]
                    after[i] += weight * self.state[self.hop - 1 - place, column]
                    touches[i] = True
        return np.flatnonzero(touches), local[touches], after[touches]


@dataclass(frozen=True, slots=True)
class Events:
    """What k lost readings do to e through one hop each, over a stretch that ends at some row.

    Attributes:
        lost: the readings.
        hop: (k,) the hop.
        begun: (k, r) α at the hop's end.
        local: (k, r) h'U over the own hop alone, in coordinates of its start.
        cross: (k, 1+c) h'[e ψ].
        gram: (k, k) h'h.
    """

    lost: Lost
    hop: IntArray
    begun: FloatArray
    local: FloatArray
    cross: FloatArray
    gram: FloatArray

    def __len__(self) -> int:
        return len(self.hop)

    def part(self, which: IntArray) -> "Events":
        """Return some of them."""
        return Events(
            self.lost.part(which), self.hop[which], self.begun[which], self.local[which], self.cross[which],
            self.gram[np.ix_(which, which)],
        )  # fmt: skip

    def followed(self, new: "Events", between: FloatArray) -> "Events":
        """Append events of a later hop; between (k, k of new): h'h."""
        gram = np.block([[self.gram, between], [between.T, new.gram]])
        cat = np.concatenate
        return Events(
            self.lost.followed(new.lost), cat([self.hop, new.hop]), cat([self.begun, new.begun]),
            cat([self.local, new.local]), cat([self.cross, new.cross]), gram,
        )  # fmt: skip


class LostColumns:
    """The columns of the lost readings of the newest windows, carried on from hop to hop.

    Args:
        operators: of the bank.
        taps: where readings enter.
    """

    def __init__(self, operators: Operators, taps: Taps) -> None:
        self._operators, self._taps = operators, taps
        self._impulses = Impulses(operators.system, operators.plan.hop, taps)
        basis, size = operators.basis, operators.size
        self._hop_U, self._gamma = basis.U, basis.gamma[:, : size.a].T
        self._head_U = basis.U[: operators.plan.head * size.p]
        self._squares = basis.U.T @ basis.U, self._head_U.T @ self._head_U
        r = basis.U.shape[1]
        nothing = np.zeros((0, r))
        self._events = Events(
            Lost.none(), np.zeros(0, np.int64), nothing, nothing, np.zeros((0, 1 + size.c)), np.zeros((0, 0))
        )
        self._alpha = nothing  # of the events, at the start of the first hop that is not whole
        self.held_from = -(1 << 60)  # hop from which on all events are held

    def is_idle(self, hop: int) -> bool:
        """Whether no window that ends in a hop holds an event."""
        return not len(self._events) and hop - self._operators.longest >= self.held_from

    def reach(self, hop: int) -> tuple[int, int]:
        """Return the samples [start, stop) whose readings touch a hop."""
        H = self._operators.plan.hop
        return hop * H - self._impulses.latest, (hop + 1) * H - self._impulses.earliest

    def complete(self, hop: int, lost: Lost, columns: FloatArray | None, moment: FloatArray) -> None:
        """Take a whole hop: the readings that may touch it, [e ψ] (1+c, H p) over it if any, its moment."""
        events, alpha = self._events, self._alpha
        square, step = self._squares[0], self._operators.basis.steps[2]
        if len(alpha):
            events.cross[:] += alpha @ moment.T
            events.gram[:] += alpha @ square @ alpha.T
        after = alpha @ step.T
        if columns is not None and len(lost):
            new = self._new(hop, lost, columns, self._hop_U)
            self._events = events.followed(new[0], alpha @ (self._hop_U.T @ new[1].T))
            after = np.concatenate([after, new[0].begun])
        self._alpha = after
        self._let_go(hop)

    def _let_go(self, hop: int) -> None:
        """Drop events that no window will hold, and the oldest where there are too many."""
        oldest = hop + 1 - self._operators.longest
        hops = self._events.hop
        if len(hops) > MOST_EVENTS:
            self.held_from = max(self.held_from, int(hops[-MOST_EVENTS - 1]) + 1)
        kept = np.flatnonzero(hops >= max(oldest, self.held_from))
        if len(kept) < len(hops):
            self._events, self._alpha = self._events.part(kept), self._alpha[kept]

    def _new(self, hop: int, lost: Lost, columns: FloatArray, U: FloatArray) -> tuple[Events, FloatArray]:
        """Return the events of a hop or of its head, whose [e ψ] is given, and their e."""
        H = self._operators.plan.hop
        which, local, after = self._impulses.events(lost, hop * H)
        local = local.reshape(len(which), len(self._hop_U))[:, : len(U)]
        events = Events(
            lost.part(which), np.full(len(which), hop), -after @ self._gamma, local @ U, local @ columns.T,
            local @ local.T,
        )  # fmt: skip
        return events, local

    def until(self, hop: int, lost: Lost, columns: FloatArray | None, moment: FloatArray) -> Events:
        """Return the events up to a head's end; as for `complete`, of the head."""
        alpha, square = self._alpha, self._squares[1]
        events = self._events
        held = Events(
            events.lost, events.hop, events.begun, events.local, events.cross + alpha @ moment.T,
            events.gram + alpha @ square @ alpha.T,
        )  # fmt: skip
        if columns is None or not len(lost):
            return held
        new, local = self._new(hop, lost, columns, self._head_U)
        return held.followed(new, alpha @ (self._head_U.T @ local.T))
