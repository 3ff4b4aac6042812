"""A change while it lasts: since when windows contradict the past, and which channel's sensor they blame for it."""

import numpy as np

from agent.numerics.estimator.memory import Memory
from agent.numerics.estimator.working_point import WorkingPoint
from agent.numerics.faults.verdict import Before, Verdict
from agent.numerics.fitting.fit import Fit, Problem
from agent.numerics.window.rows import Rows
from agent.types import Reason

MOST_HEARD = 6
"""A sensor that stays at fault is heard after a window, then after twice as long each time, this often."""
EAGER, LONGEST_PAUSE = 10, 8
"""Windows after which what lasts unexplained is fitted ever more seldom, and between two such fits at most."""


class Change:
    """What is known of a change from the first window that contradicts the past to the next that does not.

    Attributes:
        onset: newest sample of that first window; None where nothing changes.
        blamed: what the newest hearing found where it blames a sensor; None where it does not, or was none.
    """

    def __init__(self) -> None:
        self.onset: int | None = None
        self.blamed: Verdict | None = None
        self._named: dict[int, int] = {}  # channel -> the first window since the onset that blamed it
        self._heard = 0

    def forget(self) -> None:
        """Windows are like the past again."""
        self.onset = self.blamed = None
        self._named.clear()

    def begin(self, index: int) -> None:
        """Take the newest sample of a window that contradicts the past; the first one's stays."""
        self.onset = index if self.onset is None else self.onset

    def lasting(self, index: int) -> int:
        """Samples from the onset to sample `index`; 0 where nothing changes."""
        return index - (index if self.onset is None else self.onset)

    def note(self, verdict: Verdict | None, index: int) -> None:
        """Take the verdict on a window whose newest sample is `index`; None where it blames nothing but the machine."""
        self.blamed = verdict if verdict is not None and verdict.channel >= 0 else None
        if self.blamed is not None:
            self._named.setdefault(self.blamed.channel, index)
        # a sensor that stays at fault is heard ever more seldom; once it fits again that is seen at once
        self._heard = 0 if self.blamed is None else min(self._heard + 1, MOST_HEARD)

    @property
    def named(self) -> bool:
        """Whether some window of this change blamed a sensor."""
        return bool(self._named)

    def pause(self, index: int, window: int) -> int:
        """Samples from the fit of a window to the next; `index` is the newest sample.

        A sensor that is blamed is heard a window apart. What has long been without explanation need not be tried
        often: where it ends, windows are seen to be like the past again without any fit.
        """
        if self.blamed is not None:
            return window << (self._heard - 1)
        if self.named:
            return window // 4
        beyond = self.lasting(index) - EAGER * window
        return max(window // 4, min(beyond // 4, LONGEST_PAUSE * window))

    def mark(self, rows: Rows, row: int, last_fit: int, window: int) -> bool:
        """Name the sensor in a row's columns where windows apart blame it; return whether they do.

        What moves may look like the gain of its sensor in one window. last_fit: newest sample of the last one heard.
        """
        blamed = self.blamed
        if blamed is None or last_fit - self._named[blamed.channel] < window:
            return False
        reason = Reason.SENSOR if blamed.changed == "sensor" else Reason.INSEPARABLE
        rows.suspect[row], rows.channel[row] = reason, blamed.channel
        return True


def hear(point: WorkingPoint, memory: Memory, problem: Problem, fit: Fit) -> Verdict | None:
    """Say which sensor may have changed where a window contradicts the past; None where it is the structure.

    problem, fit: the window, and what it says by itself. memory: what the windows before it said.
    """
    court, past = point.settings.court, memory.past.reference
    if court is None:
        return None
    before = Before.of(past, point.scale, point.theta)
    if fit.converged and (not np.all(np.isfinite(fit.covariance)) or before.agrees(fit.theta, fit.covariance)):
        return None
    if not fit.converged and not np.diag(past.A).any():
        return None
    after = fit.theta if fit.converged else before.theta
    found = court.judge(problem, point.gain, before, after, point.usual_gate, point.usual_share)
    return None if found is None or found.changed == "structure" else found
