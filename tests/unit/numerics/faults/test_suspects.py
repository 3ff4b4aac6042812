"""What a model lacks is named by the shape of what it leaves; a model that lacks nothing accuses nobody."""

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.numerics.faults.suspects import Accusation, suspects_of
from agent.numerics.fitting.fit import Problem, fit_window
from agent.numerics.model.mechanics import Element, Mass, MassSpringDamper, Output, Structure
from agent.numerics.model.observer import Gain, plain_gain, start_gain
from agent.numerics.model.sensors import Nuisance, SensedModel
from agent.numerics.model.statespace import Discrete, Model, discretise
from agent.types import Reason

FloatArray = NDArray[np.float64]
PERIOD_S = 2e-3
SIGMA = np.array([1e-6])
TRUE = (8.0, 400.0, 12.0)
"""kg, N/m, N s/m."""


def oscillator(nominal: tuple[float, ...] = TRUE) -> MassSpringDamper:
    """Return one mass on a spring and a damper, pushed by a force."""
    m, k, b = nominal
    structure = Structure((Mass("m", m),), (Element("k", ("ground", "m"), k),), (Element("B", ("ground", "m"), b),))
    return MassSpringDamper(structure, ("k", "B"), ("m",), (Output("displacement", "m"),))


def played(rng: np.random.Generator, dry: float = 0.0, cubic: float = 0.0, offset: float = 0.0) -> FloatArray:
    """Return v = (x, u) over 6 s of the mass with what the model does not know, integrated in fine steps."""
    (m, k, b), fine, x, v = TRUE, 20, 0.0, 0.0
    t = np.arange(3000) * PERIOD_S
    u = 20.0 * np.sin(2 * np.pi * 0.8 * t) + 15.0 * np.sin(2 * np.pi * 1.7 * t) + rng.normal(0.0, 3.0, len(t))
    rows = []
    for now, then in zip(u, np.append(u[1:], u[-1]), strict=True):
        rows.append((x + SIGMA[0] * rng.standard_normal(), now))
        for i in range(fine):
            force = now + (then - now) * (i + 0.5) / fine + offset - k * x - b * v - cubic * x**3
            free = v + PERIOD_S / fine * force / m
            v = float(np.sign(free) * max(abs(free) - PERIOD_S / fine * dry / m, 0.0))
            x += PERIOD_S / fine * v
    return np.array(rows)


def accused(model: Model, v: FloatArray) -> Accusation | None:
    """Fit a window and ask who explains what is left."""

    def sample(theta: FloatArray) -> Discrete:
        return discretise(model.continuous(theta), PERIOD_S, "first")

    def corrected(discrete: Discrete) -> Gain:
        return plain_gain(start_gain(discrete, np.array([[1.0], [0.0]]), SIGMA, 500), SIGMA)

    scale = np.where(model.nominal == 0.0, 1e-3, np.abs(model.nominal))
    problem = Problem(sample, v, scale, np.full(len(scale), -np.inf))
    fit = fit_window(problem, model.nominal, np.zeros(2), [corrected])
    suspects = suspects_of(model, PERIOD_S, "first", SIGMA)
    assert suspects is not None
    return suspects.accuse(fit.theta, corrected(sample(fit.theta)), v, float(len(v)))


@pytest.mark.parametrize(
    ("lacking", "reason"),
    [({"dry": 2.0}, Reason.DRY_FRICTION), ({"cubic": 4e5}, Reason.NONLINEAR), ({"offset": 1.0}, Reason.BIAS)],
)
def test_suspects_of_a_model_that_lacks_something_name_it(lacking: dict[str, float], reason: Reason) -> None:
    found = accused(oscillator(), played(np.random.default_rng(1), **lacking))
    assert found is not None
    assert found.suspect.reason is reason
    assert found.share > 0.5


@pytest.mark.parametrize("seed", range(5))
def test_suspects_of_a_right_model_accuse_nobody(seed: int) -> None:
    # the wide steps of the integration are the only difference between model and truth
    assert accused(oscillator(), played(np.random.default_rng(seed))) is None


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("wrong", [-0.2, 0.2])
def test_suspects_of_a_model_with_a_wrong_mass_name_it_and_by_how_much(wrong: float, seed: int) -> None:
    m, k, b = TRUE
    found = accused(oscillator((m * (1.0 + wrong), k, b)), played(np.random.default_rng(seed)))
    assert found is not None
    assert found.suspect.reason is Reason.MASS
    assert found.suspect.between[0] == "m"
    assert found.share > 0.9
    # one step from the wrong mass: its direction and about its size
    assert found.change == pytest.approx(1.0 / (1.0 + wrong) - 1.0, abs=0.08)


def test_suspects_beside_sensor_constants_are_still_named() -> None:
    model = SensedModel(oscillator(), (Nuisance("x.bias", "bias", "output", 0),))
    v = played(np.random.default_rng(3), dry=2.0)
    found = accused(model, np.hstack([v, np.ones((len(v), 1))]))
    assert found is not None
    assert found.suspect.reason is Reason.DRY_FRICTION


def test_suspects_where_the_offset_is_estimated_do_not_accuse_it() -> None:
    model = SensedModel(oscillator(), (Nuisance("x.bias", "bias", "output", 0),))
    v = played(np.random.default_rng(4), offset=1.0)
    assert accused(model, np.hstack([v, np.ones((len(v), 1))])) is None
