"""Where windows are linearised and compared: at the constants that data ask for."""

from dataclasses import replace

import numpy as np

from agent.numerics.inference import tuning
from agent.numerics.inference.posterior import shifted
from agent.numerics.inference.spectral.columns import window_of
from agent.numerics.model.uncertain import delays_of
from tests.unit.numerics.inference.chain import ChainRig, DenseNoise
from tests.unit.numerics.inference.frequency import learner_of, record

RIG = ChainRig(masses=(2.0, 1.0), springs=(800.0, 600.0), dampers=(2.0, 1.5), period=0.005)
NOISE = DenseNoise(np.full(2, 2e-5), np.zeros(2))
WINDOW, WINDOWS = 400, 12


def test_outputs_that_both_read_less_make_no_scatter_between_windows() -> None:
    """Three scales tie, and a window asks for their sum far more sharply than for any of them.

    Linearised a fifth of a per cent from each, parameters would make up for half a per cent of the sum, in
    each window differently.
    """
    rng = np.random.default_rng(5)
    u = rng.standard_normal((WINDOW * WINDOWS + 1, 1))
    eta = np.array([0.0, 0.0, np.log(0.9), np.log(0.9), 0.0, 0.0])
    y = RIG.readings(RIG.theta, eta, np.zeros(4), u[1:], np.diff(u, axis=0)).real
    y = y + NOISE.sigma * rng.standard_normal(y.shape)
    learner = learner_of(RIG, WINDOW)
    known = learner.prior(NOISE.sigma, np.full(2, 0.3))
    for first in range(0, WINDOW * WINDOWS, WINDOW):
        part = slice(first, first + WINDOW)
        _, known = learner.learn(window_of(y[part], u[1:][part], u[first]), known)
        np.testing.assert_array_equal(known.eta, known.constants.expected)
    assert known.scatter.factor.max() < 1.3


def test_a_window_that_hardly_knows_a_parameter_does_not_carry_the_point_away() -> None:
    """Constants move its parameters a hundred times as far as those of windows that the point rests on."""
    rng = np.random.default_rng(6)
    learner = learner_of(RIG, WINDOW)
    known = learner.prior(NOISE.sigma, np.full(2, 0.3))
    for _ in range(4):
        window, *_ = record(RIG, rng, NOISE, WINDOW, force=1.0, off=1.0)
        said, known = learner.learn(window, known)
    weak, *_ = record(RIG, rng, NOISE, WINDOW, force=0.01, off=1.0)
    at = learner.solve(weak, known)[1]
    eta = known.eta + 0.002
    point, footing = learner.lineariser.nearer(at, known, known.eta, eta)
    before = shifted(known.theta, known.footing.sensitivity @ (eta - known.eta))
    assert np.all(np.abs(point - before) < 0.5 * said.sd_repeat)
    sensitivity = known.footing.sensitivity
    np.testing.assert_allclose(footing.sensitivity, sensitivity, atol=0.02 * np.abs(sensitivity).max())


def test_a_point_moves_with_the_constants_as_the_windows_that_it_rests_on() -> None:
    """Of windows that tell as much its sensitivity lies between theirs, the newest counting most."""
    rng = np.random.default_rng(7)
    learner = learner_of(RIG, WINDOW)
    known = learner.prior(NOISE.sigma, np.full(2, 0.3))
    _, known = learner.learn(record(RIG, rng, NOISE, WINDOW, force=1.0, off=1.0)[0], known)
    first = known.footing.sensitivity
    at = learner.solve(record(RIG, rng, NOISE, WINDOW, force=1.0, off=1.0)[0], known)[1]
    _, alone = learner.lineariser.nearer(at, known, known.eta, known.eta, same=False)
    _, pooled = learner.lineariser.nearer(at, known, known.eta, known.eta, same=True)
    own = alone.sensitivity
    total = 0.75 * known.footing.information + alone.information
    expected = np.linalg.solve(total, 0.75 * known.footing.information @ first + alone.information @ own)
    np.testing.assert_allclose(pooled.information, total)
    np.testing.assert_allclose(pooled.sensitivity, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_a_point_stays_while_windows_say_the_same_and_they_say_what_they_say_elsewhere() -> None:
    rng = np.random.default_rng(8)
    quiet = DenseNoise(0.1 * NOISE.sigma, np.zeros(2))
    learner, anew = learner_of(RIG, WINDOW), learner_of(RIG, WINDOW)
    known = moving = learner.prior(quiet.sigma, np.full(2, 0.3))
    places = []
    for _ in range(WINDOWS):
        window, *_ = record(RIG, rng, quiet, WINDOW, force=1.0, off=1.0)
        said, known = learner.learn(window, known)
        there, moving = anew.learn(window, replace(moving, place=None))
        places.append(known.place.theta)
        model, masses = learner.lineariser._response.at, RIG.count
        assert model.is_at(known.place.theta, known.place.eta[:masses], delays_of(RIG.rig, known.place.eta))
        assert np.all(np.abs(said.theta - there.theta) < 0.002 * said.sd)
        np.testing.assert_allclose(said.sd_repeat, there.sd_repeat, rtol=0.005)
    assert len(np.unique(places, axis=0)) < WINDOWS // 2


def test_a_point_moves_where_what_is_known_did() -> None:
    rng = np.random.default_rng(9)
    learner = learner_of(RIG, WINDOW)
    known = learner.prior(NOISE.sigma, np.full(2, 0.3))
    for _ in range(3):
        known = learner.learn(record(RIG, rng, NOISE, WINDOW, force=1.0, off=1.0)[0], known)[1]
    near, placed = known.place, learner.lineariser.placed
    at = replace(known, theta=near.theta + 0.9 * near.reach, eta=near.eta)
    np.testing.assert_array_equal(placed(at).theta, near.theta)
    one = np.zeros(len(near.theta))
    for i in range(len(one)):
        one[:] = 0.0
        one[i] = 1.1 * near.reach[i]
        away = replace(at, theta=near.theta + one)
        assert placed(away) is away
    tolerance = tuning.STAYS * learner.lineariser.eta_tolerance()
    other = replace(at, theta=near.theta, eta=near.eta + 1.2 * tolerance)
    assert placed(other) is other
    # constants that move take the parameters with them
    eta = near.eta + 0.8 * tolerance
    moved = np.abs(at.footing.sensitivity @ (eta - near.eta)) / near.reach
    footing = replace(at.footing, sensitivity=3.0 / moved.max() * at.footing.sensitivity)
    along = shifted(near.theta, footing.sensitivity @ (eta - near.eta))
    assert np.any(np.abs(along - near.theta) > 2.5 * near.reach)
    np.testing.assert_array_equal(placed(replace(at, theta=along, eta=eta, footing=footing)).eta, near.eta)


def test_constants_that_leave_nothing_of_the_parameters_are_no_place() -> None:
    """Accelerations show no state of masses that nothing holds."""
    rng = np.random.default_rng(10)
    rig = ChainRig(
        masses=RIG.masses,
        springs=RIG.springs,
        dampers=RIG.dampers,
        period=RIG.period,
        seen=("acceleration",) * 2,
    )
    learner = learner_of(rig, WINDOW)
    noise = DenseNoise(np.full(2, 0.01), np.zeros(2))
    known = learner.prior(noise.sigma, np.full(2, 0.3))
    window, *_ = record(rig, rng, noise, WINDOW, force=1.0, off=1.0)
    known = learner.learn(window, known)[1]
    at = learner.solve(window, known)[1]
    less = np.array([float(c.kind in {"mass", "input"}) for c in rig.rig.constants])
    assert learner.lineariser.elsewhere(at, window, known, known.eta - 0.01 * less) is not None
    assert learner.lineariser.elsewhere(at, window, known, known.eta - 1.2 * less) is None
