"""What the hypotheses on the constants say: which constant is off, by how much, how surely."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.numerics.inference import tuning
from agent.numerics.inference.constants import Constants, Hypothesis

FloatArray = NDArray[np.float64]


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


def beliefs(constants: Constants, kinds: tuple[str, ...], windows: int) -> tuple[Belief, ...]:
    """Return a belief for each hypothesis that something is off; kinds (c,) of the constants.

    windows: that the noise is known from. What is said rests on that noise, which is known no better than they tell:
    evidence counts as Student's (Gelman et al., Bayesian Data Analysis, 3.2). A little more noise explains what makes
    sure in a first window, but not what a hundred windows agree on.
    """
    weights = _cautious(constants, windows)
    found = []
    for h, weight, mean, covariance in zip(
        constants.hypotheses, weights, constants.mean, constants.covariance, strict=True
    ):
        if h.members.any():
            found.append(_belief(h, float(weight), mean, covariance, kinds))
    return tuple(found)


def _cautious(constants: Constants, windows: int) -> FloatArray:
    """Probabilities (h,) with the noise as sure as so many windows make it."""
    prior = np.array([h.prior for h in constants.hypotheses])
    evidence = np.log(np.maximum(constants.weight, 1e-300) / prior)
    half = 0.5 * tuning.EVIDENCE_DOF * max(windows, 1)
    weight = prior * np.exp(-half * np.log1p((evidence.max() - evidence) / half))
    return np.asarray(weight / weight.sum())


def _belief(h: Hypothesis, weight: float, mean: FloatArray, covariance: FloatArray, kinds: tuple[str, ...]) -> Belief:
    share = h.members / h.members.sum()
    kind = kinds[int(np.argmax(h.members))]
    log, sd = float(share @ mean), float(np.sqrt(share @ covariance @ share))
    if kind == "delay":
        return Belief(h.name, h.drifts, kind, weight, log, sd)
    return Belief(h.name, h.drifts, kind, weight, float(np.expm1(log)), float(np.exp(log) * sd))
