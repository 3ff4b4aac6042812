"""Advisory of the model: what it was found to lack, and what to do about it, in words."""

from collections.abc import Iterable

import numpy as np

from agent.numerics.mechanics import GROUND
from agent.numerics.suspects import Accusation, Suspect
from agent.text import number
from agent.types import EstimateBatch, HealthEvent, Reason

SOURCE = "model"
AGAIN_S = 3600.0


class ModelAdvice:
    """Says what the model of one rig lacks, each thing at most once an hour of samples.

    Args:
        rig: its name.
        rate_hz: samples a second.
    """

    def __init__(self, rig: str, rate_hz: float) -> None:
        self._rig, self._pause = rig, round(AGAIN_S * rate_hz)
        self._said: dict[Suspect, int] = {}

    def step(self, findings: Iterable[tuple[int, Accusation]], batch: EstimateBatch) -> list[HealthEvent]:
        """Return events for findings (sample, accusation) that belong to rows of a batch."""
        events: list[HealthEvent] = []
        for sample, found in findings:
            said = self._said.get(found.suspect)
            if said is None or sample - said >= self._pause:
                self._said[found.suspect] = sample
                events.append(self._event(found, int(batch.t_ns[np.searchsorted(batch.index, sample)])))
        return events

    def _event(self, found: Accusation, t_ns: int) -> HealthEvent:
        cause = found.suspect.reason.name.lower().replace("_", " ")
        return HealthEvent(self._rig, SOURCE, t_ns, cause, words(found))


def words(found: Accusation) -> str:
    """Return what a model lacks and what to do about it."""
    node, other = found.suspect.between
    place = node if other == GROUND else f"{node} and {other}"
    if found.suspect.reason is Reason.MASS:
        larger = "larger" if found.change > 0 else "smaller"
        return (
            f"mass {node} looks {number(100 * abs(found.change), 2)} % {larger} than model.mass says: correct its "
            f'value, or make it a parameter: add "{node}" to estimator.estimate'
        )
    between = f"between {node} and {other}" if other != GROUND else f"at {node}"
    return {
        Reason.DRY_FRICTION: f"what the model leaves looks like dry friction {between}: add it under model.friction",
        Reason.NONLINEAR: f"what the model leaves looks like a spring {between} whose stiffness moves with its stroke: "
        "look for play or a stop, or keep to smaller strokes",
        Reason.BIAS: f"what the model leaves looks like a constant force at {place}: an offset of the force or of a "
        "displacement; set bias = true on that channel",
    }[found.suspect.reason]
