"""Which story a window tells: a spring, a damper, a sensor's gain or offset, or one that nobody can tell."""

import numpy as np
import pytest

from agent.numerics.faults.verdict import Before, Court, Verdict
from agent.numerics.fitting.fit import Problem, linearise
from agent.numerics.model.observer import plain_gain
from agent.numerics.model.sensors import Nuisance, SensedModel
from agent.numerics.window.choice import gate
from agent.numerics.window.reference import Reference
from tests.bench.scene import play
from tests.unit.numerics.paper_rig import NOMINAL, rig
from tests.unit.numerics.rigs import PERIOD, FloatArray, noisy, sampled, zero_gain

W = 500
SIGMA = 2e-5
GAIN = plain_gain(zero_gain(sampled()), np.full(2, SIGMA))


def past(theta: FloatArray = NOMINAL) -> Before:
    """What three windows at theta say."""
    v = noisy(np.random.default_rng(9), 3 * W, SIGMA, theta).v
    reference = Reference.empty(4)
    for k in range(3):
        here = linearise(sampled(theta).model, GAIN, v[k * W : (k + 1) * W], np.zeros(4))
        H = here.psi.T @ here.psi
        found = theta + np.linalg.solve(H, here.psi.T @ here.e)
        H = H * np.outer(NOMINAL, NOMINAL)
        reference = Reference(reference.A + H, reference.b + H @ (found / NOMINAL))
    return Before.of(reference, NOMINAL, theta)


def judged(v: FloatArray, after: FloatArray, court: Court | None = None) -> Verdict | None:
    court = court or Court(rig(), 2, 1, PERIOD, "first")
    problem = Problem(sampled, v, NOMINAL, 0 * NOMINAL)
    return court.judge(problem, GAIN, past(), after, float(gate(2 * W - 8, 1.0)), 1.0)


@pytest.mark.parametrize("number", range(4))
@pytest.mark.parametrize("factor", [0.5, 0.85, 1.15, 1.5])
def test_court_finds_a_changed_spring_or_damper_in_the_structure(number: int, factor: float) -> None:
    theta = NOMINAL.copy()
    theta[number] *= factor if number < 2 else factor**2
    found = judged(noisy(np.random.default_rng(number), W, SIGMA, theta).v, theta)
    assert found is not None
    assert (found.changed, found.channel) == ("structure", -1)


@pytest.mark.parametrize("channel", range(3))
@pytest.mark.parametrize("gain", [0.95, 1.05])
def test_court_names_the_channel_whose_gain_changed(channel: int, gain: float) -> None:
    v = noisy(np.random.default_rng(channel), W, SIGMA).v
    v[:, channel] *= gain
    found = judged(v, NOMINAL * 1.1)
    assert found is not None
    assert (found.changed, found.channel) == ("sensor", channel)


@pytest.mark.parametrize("channel", range(3))
@pytest.mark.parametrize("seed", range(2))
def test_court_names_the_channel_that_was_turned_round(channel: int, seed: int) -> None:
    v = noisy(np.random.default_rng(10 + seed), W, SIGMA).v
    v[:, channel] *= -1.0
    found = judged(v, NOMINAL * 1.1)
    assert found is not None
    assert (found.changed, found.channel) == ("sensor", channel)


@pytest.mark.parametrize("channel", range(2))
def test_court_names_the_channel_whose_offset_changed(channel: int) -> None:
    v = noisy(np.random.default_rng(channel + 5), W, SIGMA).v
    v[:, channel] += 20 * SIGMA
    found = judged(v, NOMINAL * 1.1)
    assert found is not None
    assert (found.changed, found.channel) == ("sensor", channel)


def test_court_of_a_window_like_the_past_cannot_tell() -> None:
    found = judged(noisy(np.random.default_rng(3), W, SIGMA).v, NOMINAL)
    assert found is not None
    assert found.changed == "inseparable"


def test_court_of_a_window_that_nothing_explains_says_nothing() -> None:
    v = noisy(np.random.default_rng(4), W, SIGMA).v
    v[:, 0] += 100 * SIGMA * np.sign(np.sin(0.05 * np.arange(W)))
    assert judged(v, NOMINAL) is None


def test_court_names_no_sensor_that_explains_a_window_best_but_not_to_its_noise() -> None:
    rng = np.random.default_rng(6)
    truth = np.tile(NOMINAL, (2000 + W, 1))
    truth[2000:, 1] *= np.linspace(1.0, 1.3, W)
    played = play(truth, SIGMA, rng)
    v = np.hstack([played.y, played.u])[2000:]
    v[:, 0] *= 1.1
    found = judged(v, NOMINAL)
    assert found is not None
    assert (found.changed, found.channel) == ("unexplained", -1)


def test_court_does_not_suspect_constants_that_are_estimated() -> None:
    own = SensedModel(rig(), (Nuisance("x1.bias", "bias", "output", 0), Nuisance("x1.gain", "gain", "output", 0)))
    channels = [channel for channel, _ in Court(own, 2, 1, PERIOD, "first")._sensed]
    assert channels == [1, 2]


def test_before_of_unknown_parameters_binds_nothing() -> None:
    before = Before.of(Reference.empty(4), NOMINAL, NOMINAL)
    assert np.allclose(before.theta, NOMINAL)
    assert before.distance(2 * NOMINAL, np.zeros((4, 4))) < 0.01
