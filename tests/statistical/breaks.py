"""Random rigs of which a spring breaks or stiffens far beyond its limit, or a mass is loaded, at once."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from agent.records import Record
from agent.types import AlarmTransition, EstimateBatch, FloatArray, Status, Verdict
from tests.statistical.nearly_right import Case, Play, records
from tests.statistical.random_rigs import SETTLE, case

BEFORE, AFTER, LATER = 8, 8, 3
"""Windows before a change and after; windows after it from which on rows are to be understood."""
BROKEN, STIFFER = (0.1, 0.4), (1.5, 3.5)
"""What is left of its stiffness, from and to."""
HEAVIER, LIGHTER = (1.1, 1.3), (0.7, 0.9)
"""What a mass becomes, the same."""
SURE = 0.95
"""Probability from which a verdict is said."""


@dataclass(frozen=True, slots=True)
class Changed:
    """What the product says of a rig that changed.

    Attributes:
        name: of what changed; factor: on it; beyond: whether that passes a parameter's limit by half.
        understood: share of later rows that are valid or unexcited; cover: of valid ones that hold.
        alarms: parameters and channels alarmed;  verdicts: what is said of constants, surely, at the end.
    """

    name: str
    factor: float
    beyond: bool
    understood: float
    cover: float
    alarms: frozenset[str]
    verdicts: frozenset[str]

    @property
    def met(self) -> bool:
        """Whether all is as it is to be."""
        right = {self.name} if self.beyond else set()
        said = right <= self.alarms <= {self.name} and self.verdicts <= {self.name}
        return said and self.understood > 0.9 and not self.cover < 0.85


def broken(seed: int, left: tuple[float, float]) -> Changed:
    """Play the rig of a seed, of which one spring has what is left of its stiffness after BEFORE windows."""
    given, rng = case(seed, ()), np.random.default_rng([seed, 98])
    which, factor = _drawn(rng, len(given.chain.springs), left)
    theta = given.chain.theta.copy()
    theta[which] *= factor
    beyond = abs(factor - 1) > 1.5 * given.chain.limit
    return _played(given, seed, (given.chain.names[which], factor, beyond), theta, given.chain.masses)


def loaded(seed: int, to: tuple[float, float]) -> Changed:
    """Play the rig of a seed, of which one mass changes after BEFORE windows."""
    given, rng = case(seed, ()), np.random.default_rng([seed, 96])
    which, factor = _drawn(rng, len(given.chain.masses), to)
    masses = [m * factor if i == which else m for i, m in enumerate(given.chain.masses)]
    return _played(given, seed, (f"m{which + 1}", factor, False), given.chain.theta, masses)


def _drawn(rng: np.random.Generator, count: int, bounds: tuple[float, float]) -> tuple[int, float]:
    """One of so many, and a factor on it."""
    return int(rng.integers(count)), float(np.exp(rng.uniform(*np.log(bounds))))


def _played(
    given: Case, seed: int, change: tuple[str, float, bool], theta: FloatArray, masses: Sequence[float]
) -> Changed:
    """Play a rig whose parameters and masses are these after BEFORE windows."""
    chain = given.chain
    first = SETTLE * chain.window
    at = first + BEFORE * chain.window
    made = Play.of(chain, np.random.default_rng([seed, 0, 73]), at + AFTER * chain.window + 1)
    forces = made.others.copy()
    forces[:, -1] += made.force
    y = chain.motion(forces, thetas=[(0, chain.theta), (at, theta)], loads=[(at, masses)]) + made.noise
    found = records(given, np.column_stack([made.read, y])[first:-1])
    return _said(found, change, at - first + LATER * chain.window, theta)


def _said(found: list[Record], change: tuple[str, float, bool], later: int, theta: FloatArray) -> Changed:
    """What records say; rows from sample `later` on are to be understood."""
    batches = [r for r in found if isinstance(r, EstimateBatch)]
    index, status, lower, upper = (
        np.concatenate([getattr(b, part) for b in batches]) for part in ("index", "status", "lower", "upper")
    )
    rows = index >= later
    valid = status[rows] == Status.VALID
    held = valid & (lower[rows] <= theta) & (theta <= upper[rows])
    alarms = [r.parameter for r in found if isinstance(r, AlarmTransition) and r.to_state == "UNACK"]
    last = {r.hypothesis: r.probability for r in found if isinstance(r, Verdict)}
    return Changed(
        *change, float(np.isin(status[rows], (Status.VALID, Status.UNEXCITED)).mean()),
        float(held.sum() / valid.sum()) if valid.any() else float("nan"), frozenset(alarms),
        frozenset(name for name, probability in last.items() if probability > SURE),
    )  # fmt: skip
