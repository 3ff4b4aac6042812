"""Optimal powers against a convex solver, and signals of small peak that carry them."""

import cvxpy
import numpy as np
import pytest

from agent.commissioning.numerics.design import excess, optimal
from agent.commissioning.numerics.multisine import crest, multisine, schroeder, signal


def lines(seed: int, count: int = 60, q: int = 4) -> np.ndarray:
    """Information of lines of rank two each, of parameters whose sizes differ by thousands."""
    rng = np.random.default_rng(seed)
    sides = rng.standard_normal((count, q, 2)) * np.geomspace(1.0, 1e3, q)[:, None]
    return np.einsum("fkr,flr->fkl", sides, sides)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_determinant_is_that_of_a_convex_solver_and_no_line_could_do_better(seed: int) -> None:
    information = lines(seed)
    found = optimal(information)
    assert found.power.min() >= 0
    assert found.power.sum() == pytest.approx(1.0)
    scale = 1.0 / np.sqrt(np.einsum("fkk->k", information))
    scaled = information * np.outer(scale, scale)
    power = cvxpy.Variable(len(information), nonneg=True)
    total = sum(power[i] * scaled[i] for i in range(len(scaled)))
    best = cvxpy.Problem(cvxpy.Maximize(cvxpy.log_det(total)), [cvxpy.sum(power) == 1]).solve(
        solver=cvxpy.SCS
    )
    reached = np.linalg.slogdet(np.einsum("f,fkl->kl", found.power, scaled))[1]
    assert reached == pytest.approx(best, abs=2e-3)
    M = np.einsum("f,fkl->kl", found.power, information)
    traces = [np.trace(np.linalg.solve(M, one)) for one in information]
    assert max(traces) <= 4 * (1 + 1e-3)
    assert found.gap == pytest.approx(max(traces) / 4 - 1, abs=1e-9)
    assert excess(information, np.full(60, 1 / 60)) > 0.1


def test_lines_that_leave_a_parameter_unknown_are_refused() -> None:
    information = lines(0)
    information[:, 3] = information[:, :, 3] = 0.0
    with pytest.raises(ValueError, match="leaves no trace"):
        optimal(information)
    same = np.einsum("f,k,l->fkl", np.ones(9), [1.0, 2.0], [1.0, 2.0])
    with pytest.raises(ValueError, match="told apart"):
        optimal(same)


def test_multisine_has_the_powers_asked_for_and_a_small_peak() -> None:
    rng = np.random.default_rng(0)
    power, line = rng.random(30) + 0.1, np.arange(3, 63, 2)
    u = multisine(power, line, 2000)
    spectrum = np.abs(np.fft.rfft(u)) ** 2 * 2 / 2000**2
    assert spectrum[line] == pytest.approx(power, rel=1e-9)
    assert np.delete(spectrum, line).max() < 1e-20
    random = signal(np.sqrt(2 * power), rng.uniform(0, 2 * np.pi, 30), line, 2000)
    begun = signal(np.sqrt(2 * power), schroeder(power), line, 2000)
    assert crest(u) < crest(begun) < crest(random)
    assert crest(u) < 1.7
