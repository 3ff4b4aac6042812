"""What the hypotheses on the constants say: which constant is off, by how much, how surely."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from agent.numerics.inference import tuning
from agent.numerics.inference.constants import Constants
from agent.numerics.model.uncertain import Constant
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


def beliefs(constants: Constants, of: Sequence[Constant]) -> tuple[Belief, ...]:
    """Return a belief for each hypothesis that something is off; of (c,): the constants.

    What drifts within a share of its data sheet is no drift worth a word, however surely it is one.
    """
    found: dict[str, Belief] = {}
    for h, weight, mean, covariance in zip(
        constants.hypotheses, constants.weight, constants.mean, constants.covariance, strict=True
    ):
        for name, members, drifts in h.named:
            one = of[int(np.argmax(members))]
            about = Belief(name, drifts, one.kind, float(weight), 0.0, 0.0)
            belief = _belief(about, members, mean, covariance)
            if drifts:
                larger = _share_beyond(belief, tuning.WORTH_NAMING * one.sheet)
                belief = replace(belief, probability=larger * belief.probability)
            same = found.get(belief.label)
            found[belief.label] = belief if same is None else _together(same, belief)
    return tuple(_shared(list(found.values())))


def _share_beyond(belief: Belief, size: float) -> float:
    """Probability that something is off by more than a size, either way."""
    sd = max(belief.sd, 1e-300)
    return float(ndtr((-size - belief.size) / sd) + ndtr((belief.size - size) / sd))


def _shared(found: list[Belief]) -> list[Belief]:
    """Let explanations of a scale that the data hardly tell apart share their probability.

    Evidence of less than 3 to 1 is not worth more than a bare mention (Kass & Raftery, J. Am. Stat. Assoc. 90
    (1995) 773): taken at its word it would name a sound part in one of three such cases.
    """
    scales = [b for b in found if b.kind != "delay"]
    best = max((b.probability for b in scales), default=0.0)
    tied = [b for b in scales if b.probability > best / tuning.BARE_MENTION]
    if not tied or best >= tuning.BARE_MENTION / (1 + tuning.BARE_MENTION):
        return found
    each = sum(b.probability for b in tied) / len(tied)
    return [replace(b, probability=each) if b in tied else b for b in found]


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
