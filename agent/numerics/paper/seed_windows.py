"""The paper's estimator over windows of several lengths: each row from the shortest that is sure of it."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain

import numpy as np

from agent.numerics.estimator.outcome import Outcome
from agent.numerics.paper.seed_window import RowsAlone, SeedWindow
from agent.types import BoolArray, FloatArray, Status

_CHOSEN = ("theta", "sd", "lower", "upper", "sd_repeat", "status", "reason", "window", "dof")


class SeedWindows(RowsAlone):
    """Windows of several lengths over one stream, the shortest first; the same calls as `SeedWindow`."""

    def __init__(self, windows: Sequence[SeedWindow]) -> None:
        self.windows = tuple(windows)

    def start_segment(self) -> None:
        """Forget the samples before a gap."""
        for window in self.windows:
            window.start_segment()

    def step(
        self, index: int, y: FloatArray, u: FloatArray, missing: BoolArray | None = None,
        suspect: BoolArray | None = None,
    ) -> Outcome:  # fmt: skip
        """Take consecutive samples; return the rows they end, with what each window says in `others`."""
        each = [window.step(index, y, u, missing, suspect) for window in self.windows]
        rows = each[0].copy()
        for other in each[1:]:
            # a longer window speaks where no shorter one is valid, and as soon as it is full
            better = ~np.all(rows.status == Status.VALID, axis=1) & np.any(
                other.status != Status.WARMING, axis=1
            )
            for name in _CHOSEN:
                getattr(rows, name)[better] = getattr(other, name)[better]
        conditions = sorted(chain.from_iterable(one.conditions for one in each), key=lambda found: found[0])
        return replace(rows, others=tuple(each), conditions=tuple(conditions))
