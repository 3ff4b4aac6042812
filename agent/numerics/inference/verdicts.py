"""What the hypotheses on the constants say: which constant is off, by how much, how surely."""

from dataclasses import dataclass

import numpy as np

from agent.numerics.inference.constants import Constants, Hypothesis
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
    found = []
    for h, weight, mean, covariance in zip(
        constants.hypotheses, constants.weight, constants.mean, constants.covariance, strict=True
    ):
        if h.members.any():
            found.append(_belief(h, float(weight), mean, covariance, kinds))
    return tuple(found)


def _belief(
    h: Hypothesis, weight: float, mean: FloatArray, covariance: FloatArray, kinds: tuple[str, ...]
) -> Belief:
    share = h.members / h.members.sum()
    kind = kinds[int(np.argmax(h.members))]
    log, sd = float(share @ mean), float(np.sqrt(share @ covariance @ share))
    if kind == "delay":
        return Belief(h.name, h.drifts, kind, weight, log, sd)
    return Belief(h.name, h.drifts, kind, weight, float(np.expm1(log)), float(np.exp(log) * sd))
