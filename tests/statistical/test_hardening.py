"""Springs that harden or soften are named, and their stiffness at small extensions is right."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from agent.types import FloatArray
from tests.figures import figure
from tests.statistical.chains import ONE, THREE, TWO, Chain
from tests.statistical.hardening import motion
from tests.statistical.nearly_right import (
    SETTLE_WINDOWS,
    Case,
    Change,
    Found,
    Play,
    hold,
    masses,
    pushed,
    said,
    together,
)

SURE = 0.95


@dataclass(frozen=True)
class Hard:
    """A rig, by which share each of its springs is stiffer at its rms extension, and what else is off."""

    chain: Chain
    shares: tuple[float, ...]
    changes: tuple[Change, ...] = ()
    right: frozenset[str] = frozenset()

    @property
    def case(self) -> Case:
        hard = {f"k{i + 1} cubic" for i, share in enumerate(self.shares) if share}
        return Case(self.chain, right=self.right | hard)


CASES = {
    "k1 +5 %": Hard(TWO, (0.05, 0.0)),
    "k2 +5 %": Hard(TWO, (0.0, 0.05)),
    "k1 -1 %, k2 +3 %": Hard(TWO, (-0.01, 0.03)),
    "k1 +5 % and m1 +3 %": Hard(TWO, (0.05, 0.0), (masses(1.03, 1.0),), frozenset({"m1"})),
    "k2 +5 % and 0.02 N": Hard(TWO, (0.0, 0.05), (pushed(0.02, 0.99),)),
    "one mass, k1 +10 %": Hard(ONE, (0.1,)),
    "one mass, k1 -1 %": Hard(ONE, (-0.01,)),
    "three masses, k2 +5 %": Hard(THREE, (0.0, 0.05, 0.0)),
}
QUICK, QUICK_WINDOWS = ("k2 +5 %", "k1 -1 %, k2 +3 %", "one mass, k1 -1 %"), 40


UNSEEN = Hard(replace(TWO, sensors=TWO.sensors[1:], noise=TWO.noise[1:]), (0.05, 0.0))
"""The spring's extension is the motion of a mass that no sensor follows."""


def play(hard: Hard, name: str, seed: int, windows: int) -> Found:
    chain, rng = hard.chain, np.random.default_rng([seed, *name.encode()])
    first = SETTLE_WINDOWS * chain.window
    made = Play.of(chain, rng, first + windows * chain.window)
    for change in hard.changes:
        change(made, rng)
    forces = made.others.copy()
    forces[:, -1] += made.force
    y = motion(chain, forces, hard.shares, made.masses)[:, [mass for _, mass in chain.sensors]]
    return said(hard.case, np.column_stack([made.read, y + made.noise])[first:])


def check(name: str, found: Found) -> None:
    figure(f"springs that harden, {name}: {found}")
    case = CASES[name].case
    hold(name, case, found, SURE)
    for spring in case.right - CASES[name].right:
        assert found.last.get(spring, 0.0) > SURE, f"{name}: {found.last}"


@pytest.mark.parametrize("name", QUICK)
def test_spring_that_hardens_is_named_and_its_stiffness_is_right(name: str) -> None:
    check(name, play(CASES[name], name, 31, QUICK_WINDOWS))


@pytest.mark.soak
@pytest.mark.parametrize("name", CASES)
def test_springs_that_harden_are_named_and_their_stiffness_is_right(name: str) -> None:
    check(name, together([play(CASES[name], name, seed, 100) for seed in (41, 42, 43)]))


@pytest.mark.soak
def test_spring_that_hardens_unseen_is_as_stiff_as_it_moves_and_nothing_else_is_blamed() -> None:
    found = together([play(UNSEEN, "unseen", seed, 100) for seed in (51, 52, 53)])
    figure(f"a spring that hardens, its extension not shown: {found}")
    assert set(found.alarms) <= {"k1"}
    assert not found.wrong(frozenset())


def test_motion_of_straight_springs_is_the_simulators(rng: np.random.Generator) -> None:
    forces = np.zeros((2000, 2))
    forces[:, 1] = TWO.force(rng, len(forces))
    straight: FloatArray = TWO.motion(forces)
    np.testing.assert_allclose(motion(TWO, forces, (0.0, 0.0)), straight, atol=1e-8 * np.abs(straight).max())
