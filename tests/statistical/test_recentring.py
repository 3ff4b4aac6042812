"""Every parameter jumps to half, one and a half or twice its value at once: the estimator follows, with any gain."""

from functools import partial

import numpy as np
import pytest

from agent.numerics.estimator.window_ml import WindowML
from agent.numerics.model.gains import Gains, KalmanGains
from agent.numerics.model.statespace import simulate
from agent.types import FloatArray
from tests.statistical.machine import each, say
from tests.unit.numerics.paper_rig import NOMINAL, rig
from tests.unit.numerics.rigs import FixedGains, disturbance, sampled, settings

WINDOW, HOP, SIGMA, SETTLE = 1000, 50, 1e-6, 2000
FACTORS = (0.5, 1.0, 1.5, 2.0)
GAINS = ("auto", "kalman", "poles")
QUICK, FULL = 3, 49


def gains(kind: str) -> Gains | None:
    """The observer as a configuration asks for it; a Kalman gain for half a newton on each mass."""
    matched = KalmanGains(disturbance(rig()), np.full(2, 0.5))
    return {"auto": None, "kalman": matched, "poles": FixedGains("poles")}[kind]


def stepped(rng: np.random.Generator) -> tuple[FloatArray, FloatArray, int, FloatArray]:
    """Displacements, force, the sample of the jump and the parameters behind it; the motion goes on through it."""
    theta, at = NOMINAL * rng.choice(FACTORS, len(NOMINAL)), int(rng.integers(3 * WINDOW, 4 * WINDOW))
    u = 5.0 * rng.standard_normal((SETTLE + at + 4 * WINDOW, 1))
    states, before = simulate(sampled(), np.zeros(4), u[: SETTLE + at])
    _, after = simulate(sampled(theta), states[-1], u[SETTLE + at - 1 :])
    y = np.vstack([before, after[1:]])[SETTLE:]
    return y + SIGMA * rng.standard_normal(y.shape), u[SETTLE:], at, theta


def followed(kind: str, seed: int) -> tuple[bool, float, float]:
    """Whether the last row is right, the share of rows that are believed from two windows on, largest error in sd."""
    y, u, at, theta = stepped(np.random.default_rng([seed, 5]))
    rows = WindowML(rig(), settings(WINDOW, HOP, SIGMA, gains=gains(kind))).step(0, y, u)
    late = rows.index >= at + 2 * WINDOW
    off = np.abs(rows.theta - theta)[late] / rows.sd[late]
    believed = ~(rows.changing | rows.mismatch)[late]
    right = bool(np.all(np.isfinite(off)) and np.all(off[-1] < 5.0) and not rows.mismatch[-1])
    return right, float(believed.mean()), float(off[believed].max(initial=0.0))


def measured(kind: str, runs: range, request: pytest.FixtureRequest) -> None:
    right, believed, off = (np.array(part) for part in zip(*each(partial(followed, kind), runs), strict=True))
    say(
        request,
        f"jumps of half the nominal and more, gain {kind}, {len(runs)} runs: followed in {right.sum()}, "
        f"{100 * believed.mean():.1f} % of rows believed from two windows on, largest error {off.max():.1f} sd",
    )
    assert right.all()
    assert believed.mean() > 0.95
    assert off.max() < 6.0


@pytest.mark.parametrize("kind", GAINS)
def test_jumps_of_half_the_nominal_are_followed(kind: str, request: pytest.FixtureRequest) -> None:
    measured(kind, range(QUICK), request)


@pytest.mark.soak
@pytest.mark.parametrize("kind", GAINS)
def test_jumps_of_half_the_nominal_are_followed_in_49_runs(kind: str, request: pytest.FixtureRequest) -> None:
    measured(kind, range(FULL), request)
