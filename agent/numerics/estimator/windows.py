"""Several windows: each estimate is of the shortest one sharp enough, among those that hold no change."""

from dataclasses import replace

import numpy as np

from agent.numerics.estimator.outcome import Outcome
from agent.numerics.estimator.reading import Reading
from agent.numerics.estimator.settings import EstimatorSettings
from agent.numerics.inference import tuning
from agent.types import BoolArray, IntArray, Reason


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
