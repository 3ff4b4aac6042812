"""Random linear systems: entries are recovered to the last digits, at the bound under noise, or named as
hidden."""

import mpmath
import numpy as np
import pytest
from scipy.signal import cont2discrete

from agent.blocks.rig_model import rig_model
from agent.blocks.statistical_rig import estimator_settings
from agent.numerics.estimator.schedule import budget_of
from agent.numerics.estimator.sliding import SlidingEstimator
from agent.numerics.fitting.fit import FittedModel, WindowFit, fit_window
from agent.numerics.inference.spectral.columns import window_of
from agent.numerics.model.identifiability import identifiability
from agent.numerics.model.statespace import discretise
from agent.types import FloatArray, Status
from tests.property.linear_systems import (
    RATE_HZ,
    Entry,
    System,
    configuration,
    every_entry,
    random_system,
    rank,
    sensitivities,
    told,
)

PERIOD_S = 1.0 / RATE_HZ
SAMPLES = 400
QUICK, FULL = (0, 1, 2, 1007), range(1000, 1100)
OFF, NEARER = 0.05, 0.02
NOISE_SHARE = 1e-3


def recovered(seed: int) -> None:
    """Fit one noise-free window, entries up to 5 % of their matrix off, 2 % where it says it did not rest."""
    rng = np.random.default_rng([seed, 19])
    system = random_system(rng)
    u, x0 = rng.standard_normal((SAMPLES + 1, system.B.shape[1])), rng.standard_normal(len(system.A))
    entries = every_entry(system)
    psi = sensitivities(system, entries, u, x0)
    chosen = [entries[i] for i in told(rng, system, psi, 6)]
    nominal = np.array([system.entry(e) for e in chosen])
    sizes = np.array([np.abs(getattr(system, name)).max() for name, _, _ in chosen])
    away = sizes * rng.uniform(-1, 1, len(chosen))
    y = system.motion(u, x0)
    fit = fitted(system, chosen, nominal + OFF * away, sizes, u, y)
    if not fit.converged:
        fit = fitted(system, chosen, nominal + NEARER * away, sizes, u, y)
    np.testing.assert_allclose(fit.theta / sizes, nominal / sizes, rtol=0, atol=1e-8)


def fitted(
    system: System, chosen: list[Entry], values: FloatArray, sizes: FloatArray, u: FloatArray, y: FloatArray
) -> WindowFit:
    """Return the fit of a motion from entries that are off, or from the truth where no rig may have them."""
    start = system.moved(chosen, values)
    if start.radius > 1 + 1e-9:
        start = system  # nominal must be a system that the configuration takes
    model = rig_model(configuration(start, chosen, np.ones(len(system.C)), 1.0)).model
    hold = "zero" if system.discrete else "first"
    sigma = 1e-6 * y.std(axis=0)
    push = np.eye(len(system.A))
    problem = FittedModel(model, PERIOD_S, hold, push, sigma, 0.1 * sizes, np.full(len(chosen), -np.inf))
    return fit_window(problem, window_of(y, u[:-1]), model.nominal)


@pytest.mark.parametrize("seed", QUICK)
def test_noise_free_entries_of_a_random_system_are_recovered(seed: int) -> None:
    recovered(seed)


def hidden(seed: int) -> None:
    """Compare what the structure hides with the rank of the Fisher information of a long record."""
    rng = np.random.default_rng([seed, 20])
    system = random_system(rng)
    entries = every_entry(system)
    some = sorted(
        rng.choice(len(entries), min(len(entries), int(rng.integers(2, 25))), replace=False).tolist()
    )
    chosen = [entries[i] for i in some]
    u, x0 = rng.standard_normal((2 * SAMPLES + 1, system.B.shape[1])), rng.standard_normal(len(system.A))
    model = rig_model(configuration(system, chosen, np.ones(len(system.C)), 3.0)).model
    found = identifiability(model, system.B.shape[1], np.abs(model.nominal))
    assert len(chosen) - len(found.silent) - len(found.blends) == rank(sensitivities(system, chosen, u, x0))


@pytest.mark.parametrize("seed", QUICK)
def test_entries_that_cannot_be_told_apart_are_named(seed: int) -> None:
    hidden(seed)


def errors(seed: int, windows: int) -> tuple[FloatArray, FloatArray]:
    """Return errors in units of the bound, and whether the interval holds the truth, (windows, q) each."""
    rng = np.random.default_rng([seed, 21])
    system = random_system(rng)
    count = SAMPLES * (windows + 1)
    u, x0 = rng.standard_normal((count + 1, system.B.shape[1])), rng.standard_normal(len(system.A))
    entries = every_entry(system)
    psi = sensitivities(system, entries, u[: SAMPLES + 1], x0)
    chosen = [entries[i] for i in told(rng, system, psi, 4)]
    y = system.motion(u, x0)
    sigma = NOISE_SHARE * y[:SAMPLES].std(axis=0)
    observer = 'observer = { gain = "kalman", process_sd = 0 }\n'
    config = configuration(system, chosen, sigma, SAMPLES * PERIOD_S, observer)
    estimator = SlidingEstimator(
        estimator_settings(config, np.zeros(len(sigma))), budget_of(SAMPLES, 1 / config.rig.sample_rate_hz)
    )
    rows = estimator.step(0, y + sigma * rng.standard_normal(y.shape), u[:-1])
    keep = rows.index >= 2 * SAMPLES - 1
    # without an alarm an entry is unexcited beyond a share of its nominal, whatever that is; it has its
    # interval
    assert np.mean(rows.status[keep] == int(Status.INVALID)) < 0.02
    truth = np.array([system.entry(e) for e in chosen])
    states = system.states(u, x0)
    firsts = (rows.index[keep] + 1 - SAMPLES).tolist()
    bounds = [bound(system, chosen, u[first : first + SAMPLES + 1], states[first], sigma) for first in firsts]
    held = (rows.lower[keep] <= truth) & (truth <= rows.upper[keep])
    return (rows.theta[keep] - truth) / np.array(bounds), held


def bound(
    system: System, chosen: list[Entry], u: FloatArray, x0: FloatArray, sigma: FloatArray
) -> FloatArray:
    """Return the Cramer-Rao bound (q,) of a window, the state at its start unknown."""
    psi = sensitivities(system, chosen, u, x0, sigma)
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(psi.T @ psi))))


def judged(seeds: range, windows: int, ratio: tuple[float, float], coverage: tuple[float, float]) -> None:
    found = [errors(seed, windows) for seed in seeds]
    rmse = np.sqrt(np.mean(np.concatenate([error.ravel() for error, _ in found]) ** 2))
    held = np.concatenate([held.ravel() for _, held in found]).mean()
    assert ratio[0] <= rmse <= ratio[1], f"RMSE / bound {rmse:.3f}"
    assert coverage[0] <= held <= coverage[1], f"coverage {held:.3f}"


def test_noisy_entries_are_known_as_well_as_they_can_be() -> None:
    judged(range(4), 6, (0.75, 1.25), (0.88, 1.0))  # three standard deviations of so few figures


def precise(system: System) -> FloatArray:
    """Return A, B0 and B1 side by side, in 40 digits, of a series."""
    n, m = system.B.shape
    with mpmath.workdps(40):
        big = mpmath.zeros(n + 2 * m)
        for i, j in np.ndindex(n, n + m):
            big[i, j] = mpmath.mpf(float(np.hstack([system.A, system.B])[i, j])) / int(RATE_HZ)
        for i in range(m):
            big[n + i, n + m + i] = 1
        grown = mpmath.expm(big)
        return np.array([[float(grown[i, j]) for j in range(n + 2 * m)] for i in range(n)])


@pytest.mark.parametrize("seed", range(4))
def test_sampling_agrees_with_scipy_and_with_forty_digits(seed: int) -> None:
    rng = np.random.default_rng([seed, 22])
    system = next(one for one in iter(lambda: random_system(rng), None) if not one.discrete)
    model = rig_model(configuration(system, [("A", 0, 0)], np.ones(len(system.C)), 1.0)).model
    n, m = system.B.shape
    grown = precise(system)
    matrices = (system.A, system.B, system.C, system.D)
    for hold, method in (("zero", "zoh"), ("first", "foh")):
        ours = discretise(model.continuous(model.nominal), PERIOD_S, hold)  # type: ignore[arg-type]
        theirs = cont2discrete(matrices, PERIOD_S, method)
        for a, b in zip((ours.model.A, ours.model.B, ours.model.C, ours.model.D), theirs[:4], strict=True):
            np.testing.assert_allclose(a, b, rtol=0, atol=1e-12 * max(1.0, np.abs(b).max()))
        G1, G2 = grown[:, n : n + m], grown[:, n + m :]
        B1 = G2 if hold == "first" else 0 * G2
        np.testing.assert_allclose(ours.model.A, grown[:, :n], rtol=0, atol=1e-12)
        np.testing.assert_allclose(ours.model.B, grown[:, :n] @ B1 + G1 - B1, rtol=0, atol=1e-12)


@pytest.mark.soak
@pytest.mark.parametrize("seed", FULL)
def test_hundred_systems_are_recovered_and_what_they_hide_is_named(seed: int) -> None:
    recovered(seed)
    hidden(seed)


@pytest.mark.soak
def test_hundred_noisy_systems_reach_the_bound() -> None:
    judged(FULL, 20, (0.85, 1.15), (0.93, 0.97))
