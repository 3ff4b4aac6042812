"""The contest of explanations: the wrong channel wins, evidence is the dense one, a step is a step."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.numerics.inference.channels import ChannelTest, Contest, Fault, Kind
from agent.numerics.inference.spectral.columns import Window, window_of
from tests.unit.numerics.inference.chain import ChainRig, DenseNoise, DenseWindow
from tests.unit.numerics.inference.frequency import W, knowledge, learner_of, record

FloatArray = NDArray[np.float64]
RIGS = {
    1: ChainRig((2.0,), (180.0,), (4.0,), seen=("displacement",), sheet=(0.0, 0.0, 0.0, 0.0)),
    2: ChainRig(sheet=(0.0, 0.0, 0.0, 0.0)),
    3: ChainRig((5.0, 3.0, 2.0), (250.0, 400.0, 300.0), (5.0, 3.0, 4.0), seen=("displacement",) * 3,
                sheet=(0.0, 0.0, 0.0, 0.0)),
}  # fmt: skip
SURE = 0.01
"""Sd of θ as it was, a share of it."""
LATE, NEWTONS = 6, 4.0


def noise_of(rig: ChainRig) -> DenseNoise:
    return DenseNoise(np.full(len(rig.seen), 1e-4), np.zeros(rig.count))


def contest(rig: ChainRig, y: FloatArray, u: FloatArray) -> Contest:
    """Put the newest window of readings to a contest; θ was nominal."""
    learner = learner_of(rig)
    known = knowledge(learner, noise_of(rig))
    p, newest = y.shape[1], len(y)

    def late(channel: int, lag: int) -> Window | None:
        if newest - lag - W < 1:
            return None
        v = np.hstack([y, u])[newest - lag - W - 1 : newest - lag]
        v[:, channel] = np.hstack([y, u])[newest - W - 1 : newest, channel]
        return window_of(v[1:, :p], v[1:, p:], v[0, p:])

    window = late(0, 0)
    assert window is not None
    _, solved = learner.solve(window, known)
    return ChannelTest(learner).contest(window, known, SURE * rig.theta, solved.theta, late)


def spoilt(
    y: FloatArray, u: FloatArray, channel: int, kind: Kind, size: float
) -> tuple[FloatArray, FloatArray]:
    """Readings (N - LATE, p), (N - LATE, 1) of which a channel is wrong from the first on."""
    v = np.hstack([y, u])
    out = v[LATE:].copy()
    if kind == "delay":
        out[:, channel] = v[LATE - int(size) : len(v) - int(size), channel]
    else:
        out[:, channel] = out[:, channel] * (1 + size) if kind == "gain" else out[:, channel] + size
    return out[:, : y.shape[1]], out[:, y.shape[1] :]


@pytest.mark.parametrize("masses", [2, 3])
@pytest.mark.parametrize(
    ("kind", "size"), [("offset", 2e-3), ("gain", 0.05), ("gain", -2.0), ("delay", float(LATE))]
)
def test_contest_names_the_channel_that_is_wrong_and_by_how_much(
    masses: int, kind: Kind, size: float
) -> None:
    rig = RIGS[masses]
    rng = np.random.default_rng(masses)
    for channel in range(masses + 1):
        _, y, u = record(rig, rng, noise_of(rig), W + 40, off=1.0)
        wrong = NEWTONS if channel == masses and kind == "offset" else size
        found = contest(rig, *spoilt(y, u, channel, kind, wrong))
        fault = found.fault
        assert fault is not None, (channel, found)
        assert (fault.channel, fault.kind) == (channel, kind)
        assert abs(fault.size - wrong) < (0.1 if kind == "delay" else 5 * max(fault.sd, 1e-3 * abs(wrong)))


@pytest.mark.parametrize(("kind", "size"), [("gain", 0.05), ("offset", 2e-3)])
def test_contest_names_nobody_where_one_output_and_its_force_explain_the_same(
    kind: Kind, size: float
) -> None:
    rig = RIGS[1]
    _, y, u = record(rig, np.random.default_rng(3), noise_of(rig), W + 40, off=1.0)
    found = contest(rig, *spoilt(y, u, 0, kind, size))
    assert found.fault is None
    assert {e.fault.channel for e in found.channels if e.fault is not None} == {0, 1}


@pytest.mark.parametrize("counts", [(32, 32, 16), pytest.param((800, 800, 400), marks=pytest.mark.soak)])
def test_contest_blames_no_channel_for_steps_of_parameters(counts: tuple[int, int, int]) -> None:
    rng = np.random.default_rng(9)
    for masses, count in zip((1, 2, 3), counts, strict=True):
        rig = RIGS[masses]
        for _ in range(count):
            u = 20.0 * rng.standard_normal((W + 42, 1))
            factor = np.ones(2 * masses)
            factor[rng.integers(2 * masses)] = 1 + rng.choice([0.05, 0.15, 0.5]) * rng.choice([-1.0, 1.0])
            eta, x0 = np.zeros(len(rig.constants)), 0.01 * rng.standard_normal(2 * masses)
            y = rig.readings(factor * rig.theta, eta, x0, u[1:], np.diff(u, axis=0)).real
            y = y + 1e-4 * rng.standard_normal(y.shape)
            assert contest(rig, y, u[1:]).fault is None


@pytest.mark.parametrize("masses", [1, 2, 3])
def test_forces_that_push_are_told_from_parameters_that_change(masses: int) -> None:
    rig, length = RIGS[masses], 8 * W
    learner, rng = learner_of(rig, length), np.random.default_rng(11)

    def played(theta: FloatArray, push: float) -> Window:
        u = 20.0 * rng.standard_normal((length + 1, 1))
        force = u + push * rng.standard_normal(u.shape)
        eta, x0 = np.zeros(len(rig.constants)), 0.01 * rng.standard_normal(2 * masses)
        y = rig.readings(theta, eta, x0, force[1:], np.diff(force, axis=0)).real
        return window_of(y + 1e-3 * rng.standard_normal(y.shape), u[1:], u[0])

    known = learner.prior(np.full(masses, 1e-3), np.full(masses, 0.3))
    for _ in range(4):
        posterior, known = learner.learn(played(rig.theta, 0.0), known)
    known = replace(known, theta=posterior.theta)
    judge = ChannelTest(learner)
    for _ in range(4):
        factor = 1 + 0.2 * rng.choice([-1.0, 1.0], 2 * masses)
        for theta, push in ((rig.theta, 0.5), (factor * rig.theta, 0.0)):
            window = played(theta, push)
            _, solved = learner.solve(window, known)
            assert judge.is_pushed(window, known, posterior.sd_repeat, solved.theta) == (push > 0)


@pytest.mark.parametrize("masses", [1, 2, 3])
def test_evidence_of_a_mended_window_is_that_of_dense_least_squares(masses: int) -> None:
    rig, noise = RIGS[masses], noise_of(RIGS[masses])
    learner = learner_of(rig)
    known = knowledge(learner, noise)
    judge, precision = ChannelTest(learner), np.full(2 * masses, SURE**-2)
    window, *_ = record(rig, np.random.default_rng(5), noise, off=1.0)

    def both(one: Window) -> tuple[float, float]:
        found = judge._under_prior(learner.at_point(one, known), known, precision, 0)
        dense = DenseWindow.of(rig, noise, one.y, one.u, one.slope, rig.theta, np.zeros(len(rig.constants)))
        return found.evidence, -0.5 * cost(dense, precision)

    offset = 1e-4 * np.eye(masses)[0]
    whole, mended = both(window), both(replace(window, y=window.y + offset))
    assert mended[0] - whole[0] == pytest.approx(mended[1] - whole[1], rel=1e-4, abs=1e-3)


def test_scatter_beyond_the_models_tempers_all_of_an_outputs_evidence() -> None:
    rig, noise = RIGS[2], noise_of(RIGS[2])
    learner = learner_of(rig)
    known = knowledge(learner, noise)
    judge, sd = ChannelTest(learner), SURE * rig.theta
    window, *_ = record(rig, np.random.default_rng(6), noise, off=1.0)
    mended = replace(window, y=window.y * [1.2, 1.0])

    def gains(temper: float) -> float:
        scattered = replace(known, scatter=replace(known.scatter, within=np.full(4, temper)))
        at = learner.at_point(window, scattered)
        whole = judge._under_prior(at, scattered, (at.unit / sd) ** 2, 1)
        found = judge._under(Fault(0, "gain", 0.2, 0.0), mended, scattered, sd, np.zeros(2))
        return found.evidence - whole.evidence

    assert gains(6.0) == pytest.approx(gains(1.0) / 6.0, rel=1e-9)


def cost(dense: DenseWindow, precision: FloatArray) -> float:
    """What a window leaves with θ ~ N(as linearised, 1/precision), constants exact, initial state free."""
    L = np.linalg.cholesky(dense.S)
    psi, r = np.linalg.solve(L, dense.psi), np.linalg.solve(L, dense.residual)
    Q = np.linalg.qr(np.linalg.solve(L, dense.flat))[0]
    psi, r = psi - Q @ (Q.T @ psi), r - Q @ (Q.T @ r)
    g = psi.T @ r
    return float(r @ r - g @ np.linalg.solve(psi.T @ psi + np.diag(precision), g))
