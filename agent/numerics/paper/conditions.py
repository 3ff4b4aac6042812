"""What the paper's conditions say of one window, beside its estimate."""

import numpy as np

from agent.numerics.paper.seed import Batch, Descent, existence, general_solution, special_case_defect
from agent.types import FloatArray, WindowConditions


def window_conditions(
    states: Batch,
    outputs: Batch,
    last: tuple[Descent, ...],
    trail: FloatArray,
    nominal: FloatArray,
    scale: FloatArray,
) -> WindowConditions:
    """Evaluate (11), (12) and the special case (14), (15) on the batches of a window's last pass.

    Args:
        states: the batch of dA.
        outputs: the batch of dC.
        last: the descents of the last pass, over Z, and over W where there is one.
        trail: (passes, q) parameters after each pass.
        nominal: (q,) where the first pass began.
        scale: (q,) size of each parameter.
    """
    found = existence(states)
    middle = states.regressors[len(states.regressors) // 2]
    solution = general_solution(states)
    return WindowConditions(
        window=len(states.regressors),
        defect=found.defect,
        defect_outputs=existence(outputs).defect,
        rank=found.rank,
        rank_joined=found.rank_joined,
        defect_special=special_case_defect(solution.base, middle),
        z_zero=solution.rank == states.regressors.shape[1],
        iterations=sum(descent.iterations for descent in last),
        converged=all(descent.converged for descent in last),
        cost=last[0].cost,
        step=last[0].step,
        passes=len(trail),
        ratio=_ratio(np.vstack([nominal, trail]) / scale),
        trail=tuple(map(tuple, trail.tolist())),
    )


def _ratio(trail: FloatArray) -> float | None:
    """Return the ratio of the last two steps; None of fewer than two, or where the passes stood still."""
    steps = np.linalg.norm(np.diff(trail, axis=0), axis=1)
    moving = len(steps) > 1 and np.isfinite(steps[-1]) and steps[-2] > 0
    return float(steps[-1] / steps[-2]) if moving else None
