"""The frequency-domain window against dense generalised least squares in the time domain, written here by
hand."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from agent.numerics.inference.learner import Learner
from agent.numerics.inference.linearise import Linearised
from agent.numerics.inference.noise.restricted_likelihood import NoiseFit
from agent.numerics.inference.posterior import Knowledge
from agent.numerics.inference.spectral.algebra import inverse
from agent.numerics.inference.spectral.columns import Window, window_of
from tests.unit.numerics.inference.chain import ChainRig, DenseNoise, DenseWindow
from tests.unit.numerics.inference.frequency import (
    W,
    in_time,
    knowledge,
    learner_of,
    linearised,
    record,
    start_of,
)

FloatArray = NDArray[np.float64]
SIGMA = np.array([1e-4, 2e-4])
RIGS = {
    "displacements": (ChainRig(), SIGMA),
    "an accelerometer where the force acts": (
        ChainRig(seen=("displacement", "acceleration")),
        np.array([1e-4, 5e-2]),
    ),
    "one mass": (ChainRig((2.0,), (180.0,), (4.0,), seen=("displacement",)), np.array([1e-4])),
}
WHITE = 0.6


def solved(at: Linearised) -> tuple[FloatArray, FloatArray]:
    """Steps of parameters and constants, and their covariance."""
    layout = at.regression.layout
    V = inverse(at.G[: layout.base, : layout.base] + at.ridge.R)
    step = V @ (at.G[: layout.base, -1] + at.ridge.b)
    wanted = slice(layout.psi.start, layout.base)
    return step[wanted], V[wanted, wanted]


def both(
    rig: ChainRig, noise: DenseNoise, window: Window, own_start: bool = False
) -> tuple[Learner, Knowledge, Linearised, DenseWindow]:
    learner = learner_of(rig, window.length)
    known = knowledge(learner, noise)
    at = linearised(learner, known, window)
    x0 = None if own_start else start_of(rig, at, window)
    dense = DenseWindow.of(
        rig, noise, window.y, window.u, window.slope, rig.theta, np.zeros(len(rig.constants)), x0
    )  # fmt: skip
    return learner, known, at, dense


def precision(P: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.inv(P), dtype=np.float64)


def apart(at: Linearised, known: Knowledge, dense: DenseWindow) -> tuple[float, float]:
    """Largest difference of estimates in sds, and of log sds."""
    found, V = solved(at)
    wanted, cov = dense.solve(precision(known.constants.total), np.zeros(len(known.eta)))
    sd = np.sqrt(np.diag(cov))
    return float(np.abs((found - wanted) / sd).max()), float(np.abs(np.log(np.sqrt(np.diag(V)) / sd)).max())


@pytest.mark.parametrize("name", RIGS)
@pytest.mark.parametrize("forces", [0.0, WHITE])
def test_inference_window_is_dense_generalised_least_squares(name: str, forces: float) -> None:
    rig, sigma = RIGS[name]
    noise = DenseNoise(sigma, np.full(rig.count, forces))
    window = record(rig, np.random.default_rng(3), noise)[0]
    _, known, at, dense = both(rig, noise, window)
    assert max(apart(at, known, dense)) < 1e-6


@pytest.mark.parametrize(
    ("kind", "which"),
    [("force", 0), ("sensor", 0), ("sensor", 2),
     *(pytest.param(*more, marks=pytest.mark.soak) for more in (("force", 1), ("sensor", 1)))],
)  # fmt: skip
def test_inference_colours_differ_from_dense_by_their_ends_only(kind: str, which: int) -> None:
    rig, samples = ChainRig(), 520
    learner = learner_of(rig, samples)
    poles = [s.pole for s in learner.sources if s.kind == kind and s.pole > 0 and s.number == 0]
    pole = poles[which]
    slow = ((0, pole, 2.0),) if kind == "force" else ()
    coloured = ((0, pole, 4e-4),) if kind == "sensor" else ()
    noise = DenseNoise(SIGMA, np.zeros(2), slow, coloured)
    window = record(rig, np.random.default_rng(4), noise, samples)[0]
    _, known, at, dense = both(rig, noise, window)
    # end effects: a share of the correlation time in the window, not of the sd
    estimate, sd = apart(at, known, dense)
    assert estimate < 0.1
    assert sd < 0.005


def test_inference_trajectory_begins_where_the_masses_were() -> None:
    rig = ChainRig()
    noise = DenseNoise(SIGMA, np.array([1.0, 0.5]))
    window = record(rig, np.random.default_rng(1), noise)[0]
    _, known, at, dense = both(rig, noise, window, own_start=True)
    # the state at the start is e0 and what unknown forces had driven by then: with e0 alone 0.09 sd
    assert max(apart(at, known, dense)) < 1e-3


def test_inference_restricted_log_likelihood_differs_from_dense_by_a_constant() -> None:
    rig = ChainRig()
    window = record(rig, np.random.default_rng(5), DenseNoise(SIGMA, np.zeros(2)), off=1.0)[0]
    found, wanted = [], []
    for scale, force in ((1.0, 0.0), (1.2, 0.0), (1.0, 0.8), (0.7, 2.0)):
        noise = DenseNoise(scale * SIGMA, np.array([force, 0.3 * force]))
        learner, known, at, dense = both(rig, noise, window)
        wide = learner.lineariser.ridge(
            at.regression.layout, window, learner.lineariser.wide(known.constants), np.zeros(len(known.eta))
        )
        fit = NoiseFit(known.noise, at.cells, at.regression, learner.sources, wide)
        found.append(fit.restricted_log_likelihood())
        wanted.append(
            dense.restricted_log_likelihood(
                precision(learner.lineariser.wide(known.constants)), np.zeros(len(known.eta))
            )
        )
    assert np.diff(found) == pytest.approx(np.diff(wanted), rel=1e-5)
    assert np.abs(np.diff(wanted)).min() > 1.0


def test_inference_likelihood_of_forces_is_that_of_all_bins_where_few_are_kept() -> None:
    rig, samples, rng = ChainRig(), 400, np.random.default_rng(8)
    learner = learner_of(rig, samples)
    pole = next(s.pole for s in learner.sources if s.is_slow_force and s.number == 1)
    unknown = lfilter([np.sqrt(1 - pole**2)], [1, -pole], 2.0 * rng.standard_normal(samples + 1))[:, None]
    force = 2.0 * rng.standard_normal((samples + 1, 1))
    pushed = force + unknown
    y = rig.readings(rig.theta, np.zeros(6), np.zeros(4), pushed[1:], np.diff(pushed, axis=0)).real
    window = window_of(y + SIGMA * rng.standard_normal(y.shape), force[1:], force[0])
    gains = []
    for bins in (80, samples // 2 + 1):
        found = []
        for slow, white in ((2.0, 0.0), (0.0, 4.0), (0.0, 8.0), (0.0, 12.0)):
            noise = DenseNoise(SIGMA, np.array([0.0, white]), ((1, pole, slow),) if slow else ())
            known = replace(knowledge(learner, noise), kept=bins)
            at = linearised(learner, known, window)
            wide = learner.lineariser.ridge(at.regression.layout, window, 1e-12 * np.eye(6), np.zeros(6))
            fit = NoiseFit(known.noise, at.cells, at.regression, learner.sources, wide)
            found.append(fit.restricted_log_likelihood())
        gains.append(np.diff(found))
    # the state that such forces drive once stood in the residual of the bins above: these differed by 5 to 40
    assert gains[0] == pytest.approx(gains[1], abs=1.5)
    assert np.abs(gains[1]).min() > 50.0


@pytest.mark.parametrize("cycles", [0.05, 0.0873, 0.12])
def test_inference_hum_costs_the_bins_it_is_in_and_no_others(cycles: float) -> None:
    rig, samples = ChainRig(), 400
    learner, quiet, sds = learner_of(rig, samples), DenseNoise(SIGMA, np.zeros(2)), []
    for size in (0.0, 4.0):
        known = learner.prior(SIGMA, np.full(2, 0.3))
        for w in range(4):
            window = record(rig, np.random.default_rng(w), quiet, samples, off=1.0)[0]
            hum = np.sin(2 * np.pi * cycles * (np.arange(samples) + w * samples))[:, None]
            said, known = learner.learn(replace(window, y=window.y + size * SIGMA * hum), known)
        sds.append(said.sd_repeat)
        assert np.exp(known.noise.log_sigma) == pytest.approx(SIGMA, rel=0.15)
    # taken for coloured noise it made intervals 1.15, 6 and 16 times as wide
    assert np.all(sds[1] < (1.5 if cycles < 0.08 else 1.15) * sds[0])  # the lowest stands in informative bins


def test_inference_columns_are_derivatives_of_the_simulated_window() -> None:
    rig = ChainRig(seen=("displacement", "acceleration"))
    noise = DenseNoise(np.array([1e-4, 5e-2]), np.zeros(2))
    window = record(rig, np.random.default_rng(6), noise)[0]
    _, _, at, dense = both(rig, noise, window)
    layout = at.regression.layout
    columns = in_time(at.regression.X[..., layout.psi.start : layout.base], window.length)
    wanted = np.hstack([dense.psi, dense.xi])
    off = np.linalg.qr(dense.flat)[0]
    left, right = (M - off @ (off.T @ M) for M in (columns, wanted))
    assert np.linalg.norm(left - right, axis=0) == pytest.approx(
        0.0, abs=1e-9 * np.linalg.norm(right, axis=0).max()
    )


@pytest.mark.parametrize("cut", [15, 60, 105])
def test_inference_jump_columns_are_those_of_a_window_that_jumps(cut: int) -> None:
    rig = ChainRig()
    noise = DenseNoise(SIGMA, np.zeros(2))
    window = record(rig, np.random.default_rng(7), noise)[0]
    learner = learner_of(rig)
    known = knowledge(learner, noise)
    at = linearised(learner, known, window, np.array([cut]))
    x0, eta = start_of(rig, at, window), np.zeros(len(rig.constants))
    found = in_time(at.regression.X[..., at.regression.layout.jump(0)], W)
    tiny = 1e-30
    wanted = np.column_stack([
        rig.readings(
            rig.theta, eta, x0, window.u, window.slope, rig.theta + 1j * tiny * rig.theta * e, cut
        ).imag.reshape(-1) / tiny
        for e in np.eye(4)
    ])  # fmt: skip
    flat = np.linalg.qr(
        DenseWindow.of(rig, noise, window.y, window.u, window.slope, rig.theta, eta, x0).flat
    )[0]
    left, right = (M - flat @ (flat.T @ M) for M in (found, wanted))
    # a straight force between the last sample before and the first after the jump belongs to neither side
    assert np.linalg.norm(left - right, axis=0).max() < 0.05 * np.linalg.norm(right, axis=0).min()


def test_inference_lost_output_counts_for_nothing() -> None:
    rig = ChainRig()
    noise = DenseNoise(SIGMA, np.array([0.4, 0.4]))
    whole = record(rig, np.random.default_rng(8), noise)[0]
    lost = np.array([[20, 0], [21, 0], [70, 1]])
    y = whole.y.copy()
    y[lost[:, 0], lost[:, 1]] += [0.3, -0.2, 0.1]
    window = Window(y, whole.u, whole.slope, lost, np.full(3, np.inf))
    _, known, at, _ = both(rig, noise, window)
    x0 = start_of(rig, at, window)
    kept = np.ones(y.size, dtype=bool)
    kept[lost[:, 0] * 2 + lost[:, 1]] = False
    dense = DenseWindow.of(rig, noise, y, whole.u, whole.slope, rig.theta, np.zeros(6), x0)
    wanted, cov = dense.solve(precision(known.constants.total), np.zeros(6), kept)
    found, V = solved(at)
    sd = np.sqrt(np.diag(cov))
    assert np.abs((found - wanted) / sd).max() < 1e-6
    assert np.sqrt(np.diag(V)) == pytest.approx(sd, rel=1e-6)


def test_inference_lost_input_is_an_unknown_with_a_prior() -> None:
    rig = ChainRig()
    noise = DenseNoise(SIGMA, np.zeros(2))
    whole = record(rig, np.random.default_rng(9), noise)[0]
    row, spread = 40, 5.0
    u = whole.u.copy()
    u[row] += 8.0
    window = Window(whole.y, u, whole.slope, np.array([[row, 2]]), np.array([spread]))
    _, known, at, _ = both(rig, noise, window)
    x0 = start_of(rig, at, window)
    eta = np.zeros(6)
    dense = DenseWindow.of(rig, noise, whole.y, u, whole.slope, rig.theta, eta, x0)
    pulse = np.zeros_like(u)
    pulse[row] = 1.0
    answer = rig.readings(rig.theta, eta, np.zeros(4), pulse, 0 * pulse).real.reshape(-1)
    dense.S = dense.S + spread**2 * np.outer(answer, answer)
    wanted, cov = dense.solve(precision(known.constants.total), np.zeros(6))
    found, V = solved(at)
    sd = np.sqrt(np.diag(cov))
    assert np.abs((found - wanted) / sd).max() < 1e-6
    assert np.sqrt(np.diag(V)) == pytest.approx(sd, rel=1e-6)


def test_inference_known_force_late_by_a_share_of_a_sample_is_found() -> None:
    rig = ChainRig(sheet=(0.0, 0.0, 0.0, 0.25))
    noise = DenseNoise(1e-2 * SIGMA, np.zeros(2))
    rng = np.random.default_rng(10)
    u = 20 * np.cumsum(rng.standard_normal((W + 1, 1)), axis=0) / 10
    slope = np.diff(u, axis=0)
    eta = np.array([0, 0, 0, 0, 0, 0.2])
    y = rig.readings(rig.theta, eta, np.zeros(4), u[1:], slope).real
    window = window_of(y + noise.sigma * rng.standard_normal(y.shape), u[1:], u[0])
    _, _, at, _ = both(rig, noise, window)
    step, cov = solved(at)
    assert step[-1] == pytest.approx(0.2, abs=4 * np.sqrt(cov[-1, -1]) + 0.01)
