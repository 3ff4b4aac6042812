"""What the hypotheses on the constants say: which constant is off, by how much, how surely."""

from dataclasses import dataclass, replace

import numpy as np

from agent.numerics.inference.constants import Constants
from agent.types import FloatArray


@dataclass(frozen=True, slots=True)
class Belief:
    """One statement about the constants.

    Attributes:
        name: what is off: "m1", "all masses", "x1", "delay".
        drifts: whether it changes from window to window.
        kind: "mass", "output", "input" or "delay".
        probability: posterior.
        size, sd: how far it is off and how well that is known: a share (0.05: 5 % larger), or samples.
    """

    name: str
    drifts: bool
    kind: str
    probability: float
    size: float
    sd: float

    @property
    def label(self) -> str:
        """Name for tables: "m1", "x1 drifts"."""
        return f"{self.name} drifts" if self.drifts else self.name


def beliefs(constants: Constants, kinds: tuple[str, ...]) -> tuple[Belief, ...]:
    """Return a belief for each hypothesis that something is off; kinds (c,) of the constants."""
    found: dict[str, Belief] = {}
    for h, weight, mean, covariance in zip(
        constants.hypotheses, constants.weight, constants.mean, constants.covariance, strict=True
    ):
        for name, members, drifts in h.named:
            kind = kinds[int(np.argmax(members))]
            belief = _belief(Belief(name, drifts, kind, float(weight), 0.0, 0.0), members, mean, covariance)
            same = found.get(belief.label)
            found[belief.label] = belief if same is None else _together(same, belief)
    return tuple(found.values())


def _together(one: Belief, other: Belief) -> Belief:
    """Two ways in which the same may be off, as one: mean and sd of their mixture."""
    probability = one.probability + other.probability
    share = one.probability / max(probability, 1e-300)
    size = share * one.size + (1 - share) * other.size
    square = share * (one.sd**2 + one.size**2) + (1 - share) * (other.sd**2 + other.size**2)
    return replace(one, probability=probability, size=size, sd=float(np.sqrt(max(square - size**2, 0.0))))


def _belief(about: Belief, members: FloatArray, mean: FloatArray, covariance: FloatArray) -> Belief:
    """A belief with its size, from where the members (c,) of what is off are by its hypothesis."""
    share = members / members.sum()
    log, sd = float(share @ mean), float(np.sqrt(share @ covariance @ share))
    if about.kind == "delay":
        return replace(about, size=log, sd=sd)
    return replace(about, size=float(np.expm1(log)), sd=float(np.exp(log) * sd))
