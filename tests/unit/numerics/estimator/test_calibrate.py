"""The first fit of a rig from one record: where it ends, and what it may be held to prove."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from agent.numerics.estimator.calibrate import Calibration, Calibrator
from agent.numerics.faults.masses import masses_of
from agent.numerics.faults.mistakes import Mistakes
from agent.numerics.fitting.fit import Problem
from agent.numerics.model.gains import AutomaticGains
from agent.numerics.model.mechanics import Element, Mass, MassSpringDamper, Output, Structure
from agent.numerics.model.statespace import Discrete, discretise
from tests.unit.numerics.rigs import PERIOD, FloatArray, disturbance, record

TRUTH = np.array([25.0, 100.0, 5.0, 5.0])
WINDOW = 1000


def soft_rig(forced: str, *seen: str) -> MassSpringDamper:
    """Two masses on soft springs, the force on one of them, the displacements of some measured."""
    edges = [("ground", "m1"), ("m1", "m2")]
    springs = tuple(Element(f"k{i + 1}", edge, TRUTH[i]) for i, edge in enumerate(edges))
    dampers = tuple(Element(f"B{i + 1}", edge, TRUTH[2 + i]) for i, edge in enumerate(edges))
    structure = Structure((Mass("m1", 5.0), Mass("m2", 3.0)), springs, dampers)
    return MassSpringDamper(
        structure, ("k1", "k2", "B1", "B2"), (forced,), tuple(Output("displacement", at) for at in seen)
    )


@dataclass(frozen=True)
class Rig:
    """A model with what calibrates it."""

    model: MassSpringDamper
    sigma: FloatArray

    def sampled(self, theta: FloatArray) -> Discrete:
        return discretise(self.model.continuous(theta), PERIOD)

    def problem(self, v: FloatArray) -> Problem:
        return Problem(self.sampled, v, TRUTH, np.zeros(4))

    @property
    def calibrator(self) -> Calibrator:
        outputs = len(self.sigma)
        mistakes = Mistakes(self.model, outputs, 1, PERIOD, "first")
        gains = AutomaticGains(disturbance(self.model), WINDOW)
        masses = masses_of(self.model, PERIOD, "first")
        return Calibrator(gains, self.sigma, np.zeros(outputs), masses, mistakes)

    def shaken(self, rng: np.random.Generator, noise: float, theta: FloatArray = TRUTH) -> FloatArray:
        """(WINDOW, p+m) readings under 5 N rms of white force, settled for five seconds."""
        made = record(self.sampled(theta), 5.0 * rng.standard_normal((WINDOW + 5000, 1)))
        v = made.v[5000:].copy()
        v[:, : len(self.sigma)] += noise * rng.standard_normal((WINDOW, len(self.sigma)))
        return v

    def calibrated(self, v: FloatArray, start: FloatArray = TRUTH) -> Calibration:
        return self.calibrator.calibrate(self.problem(v), start)


@pytest.mark.parametrize("noise", [1e-6, 1e-5])
@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize("start", [1.0, 1.1])
def test_calibrate_one_displacement_where_the_force_acts_finds_the_parameters(
    noise: float, stated: bool, start: float, rng: np.random.Generator
) -> None:
    rig = Rig(soft_rig("m1", "m1"), np.full(1, noise if stated else np.nan))
    for _ in range(3):
        found = rig.calibrated(rig.shaken(rng, noise), start * TRUTH)
        assert found.mistake is None
        assert found.wrong is None
        assert found.fit.converged
        assert np.all(found.noise.process == 0)
        assert np.mean(found.fit.residual**2) == pytest.approx(1.0, abs=0.2)
        sd = np.sqrt(np.diag(found.fit.covariance))
        assert np.all(np.abs(found.fit.theta - TRUTH) < 4.5 * sd)


def test_calibrate_one_displacement_turned_round_is_named(rng: np.random.Generator) -> None:
    rig = Rig(soft_rig("m1", "m1"), np.full(1, 1e-6))
    v = rig.shaken(rng, 1e-6, TRUTH * [1.1, 0.9, 1.1, 1.0])
    v[:, 0] *= -1.0
    mistake = rig.calibrated(v).mistake
    assert mistake is not None
    assert mistake.suspect.kind == "sign"
    assert mistake.whole


@pytest.mark.parametrize("pushed", [0, 1])
def test_calibrate_forces_nobody_measures_beside_one_displacement_accuse_nobody(
    pushed: int, rng: np.random.Generator
) -> None:
    """Fits of the model as it is find no maximum there: what is tried beside it must not seem to explain much."""
    rig = Rig(soft_rig("m1", "m1"), np.full(1, 1e-6))
    pushing = replace(rig.model, forces=("m1", "m2"))
    u = np.pad(5.0 * rng.standard_normal((WINDOW + 5000, 1)), ((0, 0), (0, 1)))
    acting = u.copy()
    acting[:, pushed] += 4.0 * rng.standard_normal(len(u))
    y = record(discretise(pushing.continuous(TRUTH), PERIOD), acting).y
    v = np.hstack([y + 1e-6 * rng.standard_normal(y.shape), u[:, :1]])[5000:]
    found = rig.calibrated(v, 1.1 * TRUTH)
    assert found.wrong is None
    assert found.mistake is None or found.mistake.suspect.kind == "forces"
