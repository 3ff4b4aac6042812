"""Random rigs of which a spring breaks, or stiffens, far beyond its limit in one sample."""

from dataclasses import dataclass

import numpy as np

from agent.types import AlarmTransition, EstimateBatch, Status
from tests.statistical.nearly_right import Play, records
from tests.statistical.random_rigs import SETTLE, case

BEFORE, AFTER, LATER = 8, 8, 3
"""Windows before a spring breaks and after; windows after it from which on rows are to be understood."""
BROKEN, STIFFER = (0.1, 0.4), (1.5, 3.5)
"""What is left of its stiffness, from and to."""


@dataclass(frozen=True, slots=True)
class Broken:
    """What the product says of a spring that breaks.

    Attributes:
        name: of the spring; factor: on its stiffness; beyond: whether that passes its limit by half.
        understood: share of later rows that are valid or unexcited; cover: of valid ones that hold.
        alarms: parameters alarmed.
    """

    name: str
    factor: float
    beyond: bool
    understood: float
    cover: float
    alarms: frozenset[str]

    @property
    def met(self) -> bool:
        """Whether all is as it is to be."""
        right = {self.name} if self.beyond else set()
        return right <= self.alarms <= {self.name} and self.understood > 0.9 and not self.cover < 0.85


def broken(seed: int, left: tuple[float, float]) -> Broken:
    """Play the rig of a seed, of which one spring has what is left of its stiffness after BEFORE windows."""
    given = case(seed, ())
    chain = given.chain
    rng = np.random.default_rng([seed, 98])
    which = int(rng.integers(len(chain.springs)))
    factor = float(np.exp(rng.uniform(*np.log(left))))
    theta = chain.theta.copy()
    theta[which] *= factor
    first = SETTLE * chain.window
    at = first + BEFORE * chain.window
    made = Play.of(chain, np.random.default_rng([seed, 0, 73]), at + AFTER * chain.window + 1)
    forces = made.others.copy()
    forces[:, -1] += made.force
    y = chain.motion(forces, thetas=[(0, chain.theta), (at, theta)]) + made.noise
    found = records(given, np.column_stack([made.read, y])[first:-1])
    batches = [r for r in found if isinstance(r, EstimateBatch)]
    index, status, lower, upper = (
        np.concatenate([getattr(b, part) for b in batches]) for part in ("index", "status", "lower", "upper")
    )
    later = index >= at - first + LATER * chain.window
    understood = np.isin(status[later], (Status.VALID, Status.UNEXCITED)).mean()
    valid = status[later] == Status.VALID
    held = valid & (lower[later] <= theta) & (theta <= upper[later])
    alarms = [r.parameter for r in found if isinstance(r, AlarmTransition) and r.to_state == "UNACK"]
    return Broken(
        chain.names[which], factor, abs(factor - 1) > 1.5 * chain.limit, float(understood),
        float(held.sum() / valid.sum()) if valid.any() else float("nan"), frozenset(alarms),
    )  # fmt: skip
