"""Other solutions that explain the recordings as well: few sensors let elements change places."""

from collections.abc import Sequence

import numpy as np

from agent.blocks.rig_model import rig_model
from agent.commissioning.identification.found import Rival
from agent.commissioning.identification.windows import windowed
from agent.commissioning.numerics.motion.pooled import Pooled, another
from agent.commissioning.progress import Progress
from agent.commissioning.readings import Recorded
from agent.commissioning.tuning import APART_SD, APART_SHARE, EVIDENCE
from agent.config import RigConfig
from agent.numerics.model.holds import straight
from agent.numerics.model.sensors import with_constant
from agent.numerics.model.statespace import Model, discretise, simulate
from agent.runtime.assembly.model_check import further_outputs
from agent.types import FloatArray


def rival_of(
    config: RigConfig, records: Sequence[Recorded], window: int, said: Pooled, others: Sequence[RigConfig],
    progress: Progress,
) -> Rival | None:  # fmt: skip
    """Return the first solution from other starts that is apart from `said` and not evidently worse."""
    if not others:
        return None
    _, settings, windows = windowed(config, records, window)
    for other in others:
        theta = np.array([parameter.nominal for parameter in rig_model(other).parameters])
        try:
            there, evidence = another(settings.rig, windows, said, theta, settings.floor, progress)
        except np.linalg.LinAlgError:
            continue  # a start that leads nowhere is no solution
        differs = np.abs(there.theta - said.theta) > APART_SD * np.hypot(there.sd, said.sd)
        if there.converged and differs.any() and evidence > -EVIDENCE:
            return Rival(there.theta, there.sd, differs, _place(config, records[0], window, said, there))
    return None


def _place(config: RigConfig, record: Recorded, window: int, said: Pooled, there: Pooled) -> str:
    """Return the unmeasured mass that moves most differently in two solutions; nothing if all move alike."""
    first, end = max(record.pieces, key=lambda piece: piece[1] - piece[0])
    end = min(end, first + window)
    apart = {
        place: _difference(_moved(config, model, record.u[first:end], (said.theta, there.theta)))
        for place, model in further_outputs(rig_model(config))
    }
    best = max(apart, key=lambda place: apart[place], default="")
    return best if apart.get(best, 0.0) > APART_SHARE else ""


def _moved(config: RigConfig, model: Model, u: FloatArray, solutions: Sequence[FloatArray]) -> FloatArray:
    """Return the model's last output (s, W) in solutions (q,) under inputs u (W, m), from rest."""
    period_s = 1.0 / config.rig.sample_rate_hz
    hold = straight(config.estimator.hold)
    moved = []
    for theta in solutions:
        discrete = discretise(model.continuous(theta), period_s, hold)
        whole = with_constant(u, discrete.model.m)
        moved.append(simulate(discrete, np.zeros(discrete.model.n), whole)[1][:, -1])
    return np.array(moved)


def _difference(moved: FloatArray) -> float:
    """Return by what share of the larger motion two motions (2, W) differ."""
    return float((moved[0] - moved[1]).std() / max(float(moved.std(axis=1).max()), 1e-300))
