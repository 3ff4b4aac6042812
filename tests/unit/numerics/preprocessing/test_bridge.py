"""Missing readings as unknowns, against least squares written out in full."""

import tracemalloc

import numpy as np
import pytest

from agent.numerics.estimator.lacking import Lacking, answer
from agent.numerics.fitting.fit import Problem, fit_window, least_cost, linearise
from agent.numerics.fitting.impulses import Impulses, Written
from agent.numerics.fitting.window_filter import WindowFilter
from agent.numerics.model.observer import Gain, plain_gain
from agent.numerics.preprocessing.bridge import bridge_over, filled, lagrange, shrinkage
from tests.unit.numerics.paper_rig import NOMINAL, rig
from tests.unit.numerics.rigs import FloatArray, gain_of, noisy, sampled, zero_gain

SIGMA = 1e-6
W = 300


def gains() -> dict[str, Gain]:
    skewed = np.array([[1.0, 0.0], [0.4, 0.9]]) / SIGMA
    kalman = gain_of("kalman", sampled(), SIGMA).L
    return {
        "zero": plain_gain(zero_gain(sampled()), np.full(2, SIGMA)),
        "kalman": plain_gain(kalman, np.full(2, SIGMA)),
        "kalman, coloured": Gain(kalman, skewed),
    }


def window(seed: int = 1) -> tuple[FloatArray, FloatArray, np.ndarray]:
    """A complete window, the same with readings lost and filled, and what was lost."""
    v = noisy(np.random.default_rng(seed), W, SIGMA).v
    missing = np.zeros(v.shape, dtype=bool)
    missing[[50, 51, 120]] = missing[200, 2] = missing[30, 0] = True
    holes = np.column_stack([filled(column, lost) for column, lost in zip(v.T, missing.T, strict=True)])
    return v, holes, missing


def raw_columns(gain: Gain, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """[e psi] and Gamma of a window by a plain loop over samples."""
    model = sampled().model
    x, s = np.zeros(4), np.zeros((4, 4))
    carry, rows, leverage = np.eye(4), [], []
    for k in range(len(v)):
        y, u = v[k, :2], v[k, 2:]
        e = y - model.C @ x - model.D @ u
        psi = s @ model.C.T + model.dC @ x + model.dD @ u
        rows.append(gain.whitening @ np.column_stack([e, psi.T]))
        leverage.append(gain.whitening @ model.C @ carry)
        s = s @ (model.A - gain.L @ model.C).T + (model.dA - gain.L @ model.dC) @ x + (model.dB - gain.L @ model.dD) @ u
        x = model.A @ x + model.B @ u + gain.L @ e
        carry = (model.A - gain.L @ model.C) @ carry
    return np.vstack(rows), np.vstack(leverage)


@pytest.mark.parametrize("name", gains())
def test_linearise_with_missing_readings_leaves_what_full_least_squares_leaves(name: str) -> None:
    gain = gains()[name]
    _, holes, missing = window()
    bridge = bridge_over(holes, missing, 2)
    assert bridge is not None
    o, Gamma = raw_columns(gain, holes)
    e = o[:, 0]
    U = []
    for sample, channel in zip(bridge.sample, bridge.channel, strict=True):
        moved = holes.copy()
        moved[sample, channel] += 1.0
        U.append(raw_columns(gain, moved)[0][:, 0] - e)
    prior = np.where(np.isinf(bridge.sd), 0.0, 1.0 / bridge.sd)
    X = np.vstack([np.hstack([Gamma, np.array(U).T]), np.hstack([np.zeros((len(prior), 4)), np.diag(prior)])])
    full = np.concatenate([e, np.zeros(len(prior))])
    scale = np.linalg.norm(X, axis=0)
    found = np.linalg.lstsq(X / scale, full, rcond=1e-14)[0] / scale
    here = linearise(sampled().model, gain, holes, np.zeros(4), bridge)
    assert here.cost == pytest.approx(float(np.sum((full - X @ found) ** 2)), rel=1e-6)
    assert np.allclose(here.e0, found[:4], rtol=1e-5, atol=1e-9)


def responses(name: str, *, written: bool) -> Written | Impulses:
    """What the missing readings of the window do, by either way of computing it."""
    gain = gains()[name]
    _, holes, missing = window()
    bridge = bridge_over(holes, missing, 2)
    assert bridge is not None
    unknown, out = bridge.split(gain)
    window_filter = WindowFilter(sampled().model, gain, W)
    few, many = window_filter.responses(unknown, out), Impulses(window_filter.runs, unknown, out, W)
    assert isinstance(few, Written)
    return few if written else many


@pytest.mark.parametrize("written", [True, False])
@pytest.mark.parametrize("name", gains())
def test_responses_are_what_a_unit_more_does_to_the_innovations(name: str, written: bool) -> None:
    gain = gains()[name]
    found = responses(name, written=written)
    U = found.times(np.eye(len(found.unknown.sample)))
    holes, out = window()[1], np.zeros(0, dtype=np.int64)
    before = raw_columns(gain, holes)[0][:, 0]
    if name == "zero":
        out = np.flatnonzero(window()[2][:, :2].ravel())
    for i, (sample, channel) in enumerate(zip(found.unknown.sample, found.unknown.channel, strict=True)):
        moved = holes.copy()
        moved[sample, channel] += 1.0
        expected = raw_columns(gain, moved)[0][:, 0] - before
        expected[out] = 0.0
        assert np.allclose(U[:, i], expected, rtol=1e-7, atol=1e-4 * np.abs(U).max())


@pytest.mark.parametrize("name", gains())
def test_responses_that_are_not_written_out_have_the_products_of_those_that_are(name: str) -> None:
    few, many = responses(name, written=True), responses(name, written=False)
    assert isinstance(few, Written)
    lengths = np.linalg.norm(few.U, axis=0)
    assert np.allclose(many.gram() / np.outer(lengths, lengths), few.gram() / np.outer(lengths, lengths), atol=1e-13)
    columns = np.random.default_rng(4).standard_normal((len(few.U), 3))
    assert np.allclose(many.against(columns).T / lengths, few.against(columns).T / lengths, atol=1e-13)
    assert np.allclose(many.times(np.eye(len(lengths))) / lengths, few.U / lengths, atol=1e-13)


@pytest.mark.parametrize("name", gains())
def test_least_cost_is_what_linearise_leaves(name: str) -> None:
    gain = gains()[name]
    _, holes, missing = window()
    for bridge in (None, bridge_over(holes, missing, 2)):
        left = linearise(sampled().model, gain, holes, np.zeros(4), bridge).cost
        assert least_cost(sampled().model, gain, holes, np.zeros(4), bridge) == pytest.approx(left, rel=1e-6)


@pytest.mark.parametrize("name", ["zero", "kalman"])
def test_long_record_with_many_holes_is_judged_without_a_column_for_each(name: str) -> None:
    """The search for unknown forces does this some hundred times: written out, the columns were 48 MB here."""
    samples, lost = 10_000, 100
    rng = np.random.default_rng(7)
    v, missing = rng.standard_normal((samples, 3)), np.zeros((samples, 3), dtype=bool)
    missing[rng.choice(samples, lost, replace=False)] = True
    bridge = bridge_over(v, missing, 2)
    tracemalloc.start()
    least_cost(sampled().model, gains()[name], v, np.zeros(4), bridge)
    linearise(sampled().model, gains()[name], v, np.zeros(4), bridge)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    columns = 8 * 2 * samples
    assert most < 120 * columns  # initial states and sensitivities are 25 each; written out it was 700 and 2100


def test_missing_outputs_without_correction_are_rows_left_out() -> None:
    gain = gains()["zero"]
    _, holes, missing = window()
    missing[:, 2] = False
    v = np.column_stack([holes[:, :2], window()[0][:, 2]])
    here = linearise(sampled().model, gain, v, np.zeros(4), bridge_over(v, missing, 2))
    kept = ~missing[:, :2].ravel()
    o, Gamma = raw_columns(gain, v)
    e, Gamma = o[kept, 0], Gamma[kept]
    left = e - Gamma @ np.linalg.lstsq(Gamma, e, rcond=1e-12)[0]
    assert here.cost == pytest.approx(float(left @ left), rel=1e-6)
    assert np.all(here.e[~kept] == 0)


def test_fit_of_a_window_with_missing_readings_finds_a_far_truth() -> None:
    theta = NOMINAL * np.array([1.5, 0.6, 0.5, 1.4])
    v = noisy(np.random.default_rng(5), 800, SIGMA, theta).v
    missing = np.zeros(v.shape, dtype=bool)
    missing[np.random.default_rng(6).choice(np.arange(5, 795), 8, replace=False)] = True
    holes = np.column_stack([filled(column, lost) for column, lost in zip(v.T, missing.T, strict=True)])
    problem = Problem(sampled, holes, NOMINAL, 0 * NOMINAL, bridge_over(holes, missing, 2))
    gain = gains()["zero"]
    fit = fit_window(problem, NOMINAL, np.zeros(4), [lambda _: gains()["kalman"], lambda _: gain])
    assert fit.converged
    assert np.all(np.abs(fit.theta - theta) < 4.5 * np.sqrt(np.diag(fit.covariance)))
    assert np.all(np.sqrt(np.diag(fit.covariance)) < 0.05 * theta)


def test_interpolated_and_believed_forces_would_lie_far_outside_their_intervals() -> None:
    v, holes, missing = window()
    gain = gains()["zero"]
    model = sampled().model
    honest = answer(linearise(model, gain, holes, np.zeros(4), bridge_over(holes, missing, 2)), 0)
    naive = answer(linearise(model, gain, holes, np.zeros(4)), 0)
    complete = answer(linearise(model, gain, v, np.zeros(4)), 0)
    assert np.all(np.abs(honest.delta) < 4 * np.sqrt(np.diag(honest.covariance)))
    assert np.all(np.diag(honest.covariance) > np.diag(complete.covariance))
    assert np.any(np.abs(naive.delta) > 50 * np.sqrt(np.diag(naive.covariance)))


def test_filled_goes_through_cubics_exactly_and_repeats_at_the_ends() -> None:
    t = np.arange(40.0)
    signal = 1.0 + 0.3 * t - 0.02 * t**2 + 1e-3 * t**3
    missing = np.zeros(40, dtype=bool)
    missing[[0, 7, 15, 16, 17, 39]] = True
    found = filled(np.where(missing, np.nan, signal), missing)
    assert np.allclose(found[1:-1], signal[1:-1], rtol=1e-12)
    assert (found[0], found[-1]) == (signal[1], signal[-2])


def test_lagrange_weights_of_one_missing_reading_are_the_cubic_ones() -> None:
    assert np.allclose(lagrange(np.array([0, 1, 3, 4]), 2), np.array([-1, 4, 4, -1]) / 6)


def test_prior_of_a_missing_force_is_the_error_of_interpolation_elsewhere() -> None:
    rng = np.random.default_rng(3)
    v = np.column_stack([rng.standard_normal((4000, 2)), 2.0 * rng.standard_normal(4000)])
    missing = np.zeros(v.shape, dtype=bool)
    missing[[500, 900], 2] = missing[2000, 0] = True
    bridge = bridge_over(v, missing, 2)
    assert bridge is not None
    # of white noise the cubic interpolant's error has variance 1 + 34/36
    assert bridge.sd[bridge.channel == 2] == pytest.approx(2.0 * np.sqrt(1 + 34 / 36), rel=0.05)
    assert np.isinf(bridge.sd[bridge.channel == 0]).all()
    assert bridge.free == 1


def test_shrinkage_of_an_unknown_without_trace_takes_nothing_away() -> None:
    U = np.column_stack([np.zeros(50), np.ones(50)])
    column = np.ones(50)
    both = shrinkage(U.T @ U, np.array([np.inf, np.inf]))
    assert np.allclose(column - U @ both.taken @ U.T @ column, 0.0, atol=1e-7)
    assert np.allclose(both.unknowns @ U.T @ column, [0.0, 1.0])
    traceless = shrinkage(np.zeros((1, 1)), np.array([np.inf]))
    assert np.allclose(column - U[:, :1] @ traceless.taken @ U[:, :1].T @ column, 1.0)


def test_lacking_counts_samples_in_windows_and_forgets_old_ones() -> None:
    absent = Lacking(2)
    missing = np.zeros((10, 3), dtype=bool)
    missing[[2, 3], :] = missing[7, 1] = True
    absent.append(100, missing)
    assert absent.count(np.array([101, 102, 105, 107, 112, 117]), 10).tolist() == [0, 1, 2, 3, 2, 0]
    assert absent.bridge(np.zeros((5, 3)), 108) is not None
    assert absent.bridge(np.zeros((3, 3)), 107) is None
    absent.trim(105)
    assert absent.count(np.array([109]), 10).tolist() == [1]


def test_windows_without_any_information_answer_with_nothing_known() -> None:
    v = np.zeros((50, 3))
    found = answer(linearise(sampled().model, gains()["zero"], v, np.zeros(4)), 0)
    assert np.isinf(np.diag(found.covariance)).all()
    assert np.isnan(found.delta).all()
    assert rig().nominal.shape == found.delta.shape
