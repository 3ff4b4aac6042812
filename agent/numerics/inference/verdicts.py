"""What the hypotheses on the constants say: which constant is off, by how much, how surely."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.special import ndtr

from agent.numerics.inference import tuning
from agent.numerics.inference.constants import APART, Constants, Hypothesis
from agent.numerics.model.uncertain import Constant
from agent.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Belief:
    """One statement about the constants.

    Attributes:
        name: what is off: "m1", "all masses", "x1", "delay" of the inputs, "x1 late", "k1 cubic".
        drifts: whether it changes from window to window.
        kind: "mass", "output", "input", "delay" or "cubic".
        probability: posterior.
        size, sd: how far it is off and how well that is known: a share (0.05: 5 % larger), or samples; of a
            spring by which share it is stiffer at `extension`, the widest rms so far, m.
    """

    name: str
    drifts: bool
    kind: str
    probability: float
    size: float
    sd: float
    extension: float = 0.0

    @property
    def label(self) -> str:
        """Name for tables: "m1", "x1 drifts"."""
        return f"{self.name} drifts" if self.drifts else self.name


@dataclass(frozen=True, slots=True)
class _Statements:
    """All that hypotheses say of constants, (n,) statements; one of (s,) may be said beside several others.

    Attributes:
        row: (n,) hypothesis;  same: (n,) which of (s,) it says, those of each in a row.
        share: (n, c) of the mean of what is off that each constant has.
        drifts, relative: (n,) whether it drifts; whether it is a logarithm and no share or samples.
        asked: (n,) whether its size has to be worth a word;  least: (n,) below which it is not.
        each: (s,) name, whether it drifts and kind of what is said;  starts: (s,) the first place of each.
    """

    row: IntArray
    same: IntArray
    share: FloatArray
    drifts: BoolArray
    relative: BoolArray
    asked: BoolArray
    least: FloatArray
    each: tuple[tuple[str, bool, str], ...]
    starts: IntArray


@lru_cache(maxsize=128)
def _statements(hypotheses: tuple[Hypothesis, ...], of: tuple[Constant, ...]) -> _Statements:
    """Return what hypotheses say of constants (c,), made once for each rig."""
    ways: dict[tuple[str, bool, str], list[tuple[int, FloatArray]]] = {}
    for row, hypothesis in enumerate(hypotheses):
        for off in hypothesis.off:
            kind = of[int(off.members.argmax())].kind
            ways.setdefault((off.name, off.drifts, kind), []).append((row, off.members))
    said = [(i, row, members) for i, group in enumerate(ways.values()) for row, members in group]
    same = np.array([i for i, *_ in said], dtype=np.int64)
    members = np.array([each for *_, each in said]).reshape(len(said), len(of))
    first = [of[i] for i in members.argmax(axis=1).tolist()] if said else []
    drifting = np.array([drifts for _, drifts, _ in ways], dtype=bool)
    return _Statements(
        np.array([row for _, row, _ in said], dtype=np.int64), same,
        members / members.sum(axis=1, keepdims=True),
        drifting[same], np.array([one.kind not in APART for one in first], dtype=bool),
        drifting[same] | np.array([one.kind == "cubic" for one in first], dtype=bool),
        tuning.WORTH_NAMING * np.array([one.sheet for one in first]),
        tuple(ways), np.searchsorted(same, np.arange(len(ways))),
    )  # fmt: skip


def beliefs(
    constants: Constants, of: Sequence[Constant], stretch: FloatArray | None = None
) -> tuple[Belief, ...]:
    """Return a belief for each hypothesis that something is off; of (c,): the constants.

    stretch: (s,) mean square extensions, m², at which springs' cubes are shares of their stiffness.

    What drifts within a share of its data sheet is no drift worth a word, however surely it is one; nor is a
    spring that hardens by as little.
    """
    said = _statements(constants.hypotheses, tuple(of))
    size = (said.share * constants.mean[said.row]).sum(axis=1)
    carried = (said.share[:, None] @ constants.covariance[said.row])[:, 0]
    sd = np.sqrt((carried * said.share).sum(axis=1))
    sd = np.where(said.relative, np.exp(size) * sd, sd)
    size = np.where(said.relative, np.expm1(size), size)
    spread = np.maximum(sd, 1e-300)
    larger = ndtr((-said.least - size) / spread) + ndtr((size - said.least) / spread)
    probability = constants.weight[said.row] * np.where(said.asked, larger, 1.0)
    found = _shared(_together(said, probability, size, sd), constants)
    springs = {c.name: c.number for c in of if c.kind == "cubic"}
    if stretch is None or not springs:
        return tuple(found)
    rms = np.sqrt(stretch).tolist()
    return tuple(replace(b, extension=rms[springs[b.name]]) if b.kind == "cubic" else b for b in found)


def _shared(found: list[Belief], constants: Constants) -> list[Belief]:
    """Let explanations of a scale that the data hardly tell apart share the probability of any of them.

    Evidence of 3 to 1 is not worth more than a bare mention (Kass & Raftery, J. Am. Stat. Assoc. 90 (1995)
    773): taken at its word it would name a sound part in one of four such cases.
    """
    scales = [b for b in found if b.kind not in APART]
    best = max((b.probability for b in scales), default=0.0)
    tied = [b for b in scales if b.probability > best / tuning.BARE_MENTION]
    if not tied or best >= tuning.BARE_MENTION / (1 + tuning.BARE_MENTION):
        return found
    off = {(b.name, b.drifts) for b in tied}
    names_one = [any((o.name, o.drifts) in off for o in h.off) for h in constants.hypotheses]
    # two that are off at once would else count for both
    each = min(sum(b.probability for b in tied), float(constants.weight[names_one].sum())) / len(tied)
    return [replace(b, probability=each) if b in tied else b for b in found]


def _together(said: _Statements, probability: FloatArray, size: FloatArray, sd: FloatArray) -> list[Belief]:
    """Ways (n,) in which the same may be off, each as one: probability, and mean and sd of their mixture."""
    if not len(said.starts):
        return []
    total = np.add.reduceat(probability, said.starts)
    whole = total[said.same]
    share = probability / np.where(whole > 0, whole, 1.0)
    mean = np.add.reduceat(share * size, said.starts)
    variance = np.add.reduceat(share * (sd**2 + (size - mean[said.same]) ** 2), said.starts)
    numbers = zip(total.tolist(), mean.tolist(), np.sqrt(variance).tolist(), strict=True)
    return [Belief(*what, *how) for what, how in zip(said.each, numbers, strict=True)]
