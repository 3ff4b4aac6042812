"""Input readings that may be spikes: the window takes them for unknown, and the motion says what they were.

A suspect reading u is replaced by the newest trusted one, h; what that is wrong by is an unknown of the
window with prior N(0, (u − h)²). A blow that moved the rig comes out near u − h, a spike near 0. A confirmed
blow is a reading like any other from then on.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from agent.numerics.estimator.tuning import CONFIRMED_SD, CONFIRMED_SPREAD
from agent.types import BoolArray, FloatArray, IntArray

Place = tuple[int, int]
"""Sample and channel of a reading."""


@dataclass(frozen=True, slots=True)
class Found:
    """What a window says of readings.

    Attributes:
        places: of the l readings.
        value: (l,) mean of reading less its replacement; covariance: (l, l) of that.
        prior_sd: (l,) sd of the same before the window.
    """

    places: tuple[Place, ...]
    value: FloatArray
    covariance: FloatArray
    prior_sd: FloatArray

    @classmethod
    def nothing(cls) -> "Found":
        """Return what a window without such readings says."""
        return cls((), np.zeros(0), np.zeros((0, 0)), np.zeros(0))

    def share(self, sizes: Mapping[Place, float]) -> tuple[float, float]:
        """Return what share of these sizes, all alike, the window alone finds in the readings, and its sd."""
        which = [self.places.index(place) for place in sizes]
        size = np.array(list(sizes.values()))
        precision = np.linalg.inv(self.covariance[np.ix_(which, which)])
        score = size @ precision @ self.value[which]
        information = float(size @ precision @ size - np.sum((size / self.prior_sd[which]) ** 2))
        if not information > 0:
            return 0.0, np.inf
        return float(score) / information, information**-0.5


class Doubts:
    """Suspect readings of a segment's newest samples: (sample, channel) -> reading less its replacement."""

    def __init__(self) -> None:
        self.size: dict[Place, float] = {}
        self._undecided: set[Place] = set()
        self._refused: set[int] = set()
        self._trusted: FloatArray | None = None

    def forget(self) -> None:
        """Let go of a segment that ended."""
        self.size = {}
        self._undecided = set()
        self._trusted = None

    def replaced(self, index: int, u: FloatArray, suspect: BoolArray | None, outputs: int) -> FloatArray:
        """Return inputs u (N, m), from sample `index` on, with trusted readings in place of suspect ones."""
        if not len(u):
            return u
        trusted = np.zeros(u.shape[1]) if self._trusted is None else self._trusted
        out = np.array(u, dtype=float)
        places = [] if suspect is None else np.argwhere(suspect[:, outputs:]).tolist()
        for row, column in places:
            out[row, column] = out[row - 1, column] if row else trusted[column]
            place = (index + row, outputs + column)
            self.size[place] = float(u[row, column] - out[row, column])
            self._undecided.add(place)
        self._trusted = out[-1].copy()
        return out

    def among(self, lost: IntArray, first: int) -> BoolArray:
        """Return which (l,) of a window's lost readings (l, 2) are suspect; `first` is its first sample."""
        return np.array([(first + row, channel) in self.size for row, channel in lost.tolist()], dtype=bool)

    def read(self, lost: IntArray, first: int) -> FloatArray:
        """Return by how much lost readings (l, 2) exceed their replacements (l,); 0 if trusted."""
        return np.array([self.size.get((first + row, channel), 0.0) for row, channel in lost.tolist()])

    def due(self, newest: int, window: int) -> set[Place]:
        """Return the undecided ones in a window ending with sample `newest`, a quarter of it after them.

        Those that follow at once on one of them are part of the same event.
        """
        whole = {p for p in self._undecided if newest - window < p[0] <= newest - window // 4}
        while more := {(s + 1, c) for s, c in whole if (s + 1, c) in self._undecided and s < newest} - whole:
            whole |= more
        return whole

    def first_due(self, window: int) -> int | None:
        """Return the newest sample of the first window with a quarter after an undecided one, or None."""
        return min((p[0] + window // 4 for p in self._undecided), default=None)

    def lapse(self, oldest: int) -> None:
        """Let those up to a sample be: no window holds them any more."""
        self._undecided = {p for p in self._undecided if p[0] > oldest}

    def decide(self, due: set[Place], found: Found) -> tuple[int, dict[Place, float]]:
        """Decide once on those due from what a window found of each.

        Returns:
            how many samples are newly refused; the readings that are confirmed, and what each is above its
                replacement.
        """
        known = {p for p in due if p in found.places}
        confirmed = {p for run in _runs(known) if self._is_confirmed(run, found) for p in run}
        refused = {p[0] for p in known - confirmed} - self._refused
        self._undecided -= due
        self._refused |= refused
        return len(refused), {p: self.size.pop(p) for p in sorted(confirmed)}

    def _is_confirmed(self, run: list[Place], found: Found) -> bool:
        share, sd = found.share({place: self.size[place] for place in run})
        # a blow of few samples is not straight between them: the motion finds it, not quite as it was read
        near = CONFIRMED_SD * np.hypot(sd, CONFIRMED_SPREAD)
        return bool(abs(share - 1) < min(near, abs(share)))

    def trim(self, first: int) -> None:
        """Let go of what lies before sample `first`."""
        self.size = {p: size for p, size in self.size.items() if p[0] >= first}
        self._undecided = {p for p in self._undecided if p[0] >= first}
        self._refused = {sample for sample in self._refused if sample >= first}


def _runs(places: set[Place]) -> list[list[Place]]:
    """Return readings that follow at once on each other together: the motion tells their sum, not each."""
    runs: list[list[Place]] = []
    for sample, channel in sorted(places, key=lambda place: (place[1], place[0])):
        if runs and runs[-1][-1] == (sample - 1, channel):
            runs[-1].append((sample, channel))
        else:
            runs.append([(sample, channel)])
    return runs
