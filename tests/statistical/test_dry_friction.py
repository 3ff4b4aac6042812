"""Intervals of a sliding mass under dry friction hold the truth; a mass that mostly sticks says so (soak: all
runs)."""

import numpy as np
import pytest

from agent.types import FloatArray
from tests.statistical.machine import each, say
from tests.statistical.stick_slip import Case, run

SLIDING = {
    "3 N": Case(3.0, 3.0),
    "3 N, 15 N configured": Case(3.0, 15.0),
    "15 N": Case(15.0, 15.0),
    "15 N under 10 um": Case(15.0, 15.0, noise=1e-5),
}
STICKING = Case(15.0, 15.0, strength=0.25)


def assess(name: str, seeds: range, request: pytest.FixtureRequest) -> None:
    found = each(_Sliding(name), seeds)
    valid = np.concatenate([f[0] for f in found])
    wrong = np.concatenate([f[1] for f in found])
    covered = (valid & (wrong <= 1.0)).sum(axis=0) / valid.sum(axis=0).clip(1)
    stuck = np.mean([f[2] for f in found])
    texts = [f"{p} {100 * c:.0f} %" for p, c in zip(("k", "c", "Fc"), covered, strict=True)]
    say(
        request,
        f"dry friction {name}: {', '.join(texts)} of {valid.all(axis=1).sum()} valid windows cover, "
        f"{100 * valid.mean():.0f} % of {len(valid)} valid, {100 * stuck:.1f} % stuck",
    )
    assert covered.min() >= 0.9
    assert valid.mean() >= 0.6


class _Sliding:
    """A run of one case, to be sent to other processes."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __call__(self, seed: int) -> tuple[FloatArray, FloatArray, float]:
        return run(SLIDING[self.name], seed)


@pytest.mark.parametrize("name", ["3 N", "15 N"])
def test_intervals_under_dry_friction_hold_the_truth(name: str, request: pytest.FixtureRequest) -> None:
    assess(name, range(2), request)


@pytest.mark.soak
@pytest.mark.parametrize("name", SLIDING)
def test_intervals_under_dry_friction_hold_the_truth_in_40_runs(
    name: str, request: pytest.FixtureRequest
) -> None:
    assess(name, range(100, 140), request)


def test_windows_in_which_dry_friction_holds_the_mass_are_not_valid() -> None:
    valid, _, stuck = run(STICKING, 0)
    assert stuck > 0.2
    assert not valid.any()
