"""The bank against dense generalised least squares of each window's readings alone."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.numerics.model.mechanics import Output
from agent.numerics.window.filtering.hops import HopPlan
from agent.numerics.window.filtering.noise import Coloured, Line, NoiseModel, smallest_force
from agent.numerics.window.rows import Windowed
from tests.unit.numerics.window.bank_rigs import BankRig, bank_rig, rows_of
from tests.unit.numerics.window.dense import dense, mean_and_columns

FloatArray = NDArray[np.float64]
SIGMA = 1e-4
Y1, Y2 = Output("displacement", "m1"), Output("displacement", "m2")


def noise_of(rig: BankRig, force: float = 0.0, **more: object) -> NoiseModel:
    sigma = SIGMA * np.array([1.0, 0.7, 1.3])[: rig.model.p]
    sd = force * np.linspace(1.0, 0.5, rig.push.B.shape[1])
    return NoiseModel(sigma, sd, **more)  # type: ignore[arg-type]


def prior_of(rig: BankRig) -> FloatArray:
    constants = rig.model.q - rig.interest
    return np.concatenate([np.zeros(rig.interest), np.array([1e-2, 1e-3, 2e-2])[:constants] ** -2.0])


FIRST = bank_rig()
CASES = {
    "sensor noise only": (FIRST, noise_of(FIRST)),
    "white forces": (FIRST, noise_of(FIRST, 0.3)),
    "coloured force": (FIRST, noise_of(FIRST, 0.1, coloured=(Coloured("force", 1, 0.98, 0.4),))),
    "coloured force alone": (FIRST, noise_of(FIRST, 0.0, coloured=(Coloured("force", 0, 0.9, 0.4),))),
    "coloured sensor": (FIRST, noise_of(FIRST, 0.1, coloured=(Coloured("sensor", 0, 0.95, 3 * SIGMA),))),
    "coloured sensor alone": (
        FIRST,
        noise_of(FIRST, 0.0, coloured=(Coloured("sensor", 1, 0.95, 3 * SIGMA),)),
    ),
    "both coloured": (
        FIRST,
        noise_of(FIRST, 0.1, coloured=(Coloured("sensor", 1, 0.9, SIGMA), Coloured("force", 1, 0.99, 0.2))),
    ),
    "line": (FIRST, noise_of(FIRST, 0.1, lines=(Line(0, 0.7), Line(1, 1.9)))),
    "line and colour": (
        FIRST,
        noise_of(FIRST, 0.1, coloured=(Coloured("force", 0, 0.97, 0.3),), lines=(Line(1, 0.9),)),
    ),
    "zero hold": (r := bank_rig(hold="zero"), noise_of(r, 0.3)),
    "driving point": (r := bank_rig(outputs=(Output("acceleration", "m1"), Y2)), noise_of(r, 0.3)),
    "driving point, quiet": (
        r := bank_rig(hold="zero", outputs=(Output("acceleration", "m1"), Y1)),
        noise_of(r),
    ),
    "driving point, colour": (
        r := bank_rig(outputs=(Output("acceleration", "m1"), Y2)),
        noise_of(r, 0.1, coloured=(Coloured("force", 0, 0.9, 0.3),)),
    ),
    "free masses": (r := bank_rig(grounded=False), noise_of(r, 0.3)),
    "free masses, no force noise": (r := bank_rig(grounded=False), noise_of(r)),
    "one mass": (r := bank_rig(1), noise_of(r, 0.3)),
    "three masses": (r := bank_rig(3), noise_of(r, 0.3)),
    "six masses": (
        r := bank_rig(6, outputs=tuple(Output("displacement", f"m{i}") for i in (1, 3, 6))),
        noise_of(r, 0.3),
    ),
    "no constants": (r := bank_rig(constants=()), noise_of(r, 0.3)),
}


def assumed(rig: BankRig, noise: NoiseModel) -> NoiseModel:
    """The noise that the bank assumes: free masses that nothing pushes get the smallest force."""
    free = max(abs(np.linalg.eigvals(rig.model.A))) > 1 - 1e-6
    if not free or noise.force.any():
        return noise
    return replace(noise, force=smallest_force(rig.model, rig.push, noise.sigma))


def compared(
    rig: BankRig, noise: NoiseModel, record: tuple[FloatArray, FloatArray], windowed: Windowed, length: int
) -> None:
    """Hold the last row but one of a window length against the dense solution."""
    at = -2 if windowed.jumps is None else int(np.searchsorted(windowed.index, windowed.jumps.index[-1]))
    normal, prior = windowed.normal, prior_of(rig)
    last = int(windowed.index[at]) + 1
    y, u = (one[last - length : last] for one in record)
    truth = dense(rig.model, rig.push, assumed(rig, noise), y, u)
    covariance = np.linalg.inv(normal.H[at] + np.diag(prior))
    estimate = covariance @ normal.g[at]
    d, cov = truth.estimate(prior)
    sd = np.sqrt(np.diag(cov))
    assert np.max(np.abs(estimate - d) / sd) < 1e-6
    assert np.max(np.abs(covariance - cov) / np.outer(sd, sd)) < 1e-6
    assert normal.rss[at] == pytest.approx(truth.rss, rel=1e-6)
    assert normal.log_det == pytest.approx(truth.log_det, abs=1e-4)
    if windowed.jumps is None:
        return
    jumps = windowed.jumps.part(slice(-1, None))
    found = jumps.glr(estimate[None], covariance[None])[0]
    assert len(found) == 4
    for value, samples in zip(found, jumps.samples, strict=True):
        columns = mean_and_columns(rig.model, u, truth.x0, length - samples)[1][:, : rig.interest]
        assert value == pytest.approx(truth.glr(columns, prior), rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("name", CASES)
def test_each_window_equals_dense_least_squares_of_its_readings(name: str) -> None:
    rig, noise = CASES[name]
    rng = np.random.default_rng(7)
    record = rig.record(rng, noise, 420, 0.02 * rng.standard_normal(rig.model.n))
    rows = rows_of(rig, noise, HopPlan(133, 20), (3, 8), record)
    for windowed, length in zip(rows.windows, (133, 73, 173), strict=True):
        assert windowed is not None
        compared(rig, noise, record, windowed, length)


@pytest.mark.parametrize("window", [100, 113, 20, 7])
def test_windows_of_whole_hops_and_of_less_than_a_hop_equal_dense_least_squares(window: int) -> None:
    plan = HopPlan(window, 20)
    record = FIRST.record(np.random.default_rng(3), CASES["white forces"][1], 300, np.zeros(4))
    long = rows_of(FIRST, CASES["white forces"][1], plan, (6,), record).windows[1]
    assert long is not None
    compared(FIRST, CASES["white forces"][1], record, replace(long, jumps=None), plan.samples(6))


@pytest.mark.parametrize(("window", "stretch"), [(300, 40), (308, 40), (50, 20)])
def test_a_scan_of_some_rows_only_equals_dense_jump_columns(window: int, stretch: int) -> None:
    noise = CASES["coloured force"][1]
    record = FIRST.record(np.random.default_rng(3), noise, 500, np.zeros(4))
    windowed = rows_of(FIRST, noise, HopPlan(window, 10), (), record).windows[0]
    assert windowed is not None
    assert windowed.jumps is not None
    assert set(np.diff(windowed.jumps.index)) == {stretch}
    compared(FIRST, noise, record, windowed, window)


@pytest.mark.parametrize("name", ["free masses", "free masses, no force noise"])
def test_a_free_mass_that_has_drifted_far_keeps_its_estimates(name: str) -> None:
    rig, noise = CASES[name]
    start = np.zeros(rig.model.n)
    start[: rig.model.n // 2] = 0.5  # m/s: metres of way against a sensor's tenths of a millimetre
    record = rig.record(np.random.default_rng(11), noise, 2400, start)
    rows = rows_of(rig, noise, HopPlan(133, 20), (8,), record)
    for windowed, length in zip(rows.windows, (133, 173), strict=True):
        assert windowed is not None
        compared(rig, noise, record, windowed, length)


def test_a_short_window_beside_one_of_a_minute_loses_nothing() -> None:
    rig = bank_rig(period=1e-3)
    noise = noise_of(rig, 0.3)
    record = rig.record(np.random.default_rng(5), noise, 700, np.zeros(4))
    windowed = rows_of(rig, noise, HopPlan(250, 50), (1200,), record).windows[0]
    assert windowed is not None
    compared(rig, noise, record, windowed, 250)
