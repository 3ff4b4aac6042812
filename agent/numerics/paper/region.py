"""The worst point of a box of parameters: vertices first, then a search inside where vertices do not suffice.

Neither the spectral radius nor observability is convex in the parameters, so neither takes its worst value at
a vertex of necessity. Every vertex is tried (of many parameters a part of them, each then improved one side
at a time), and points inside that fill the box evenly; from the worst of both Powell's line searches go on
(Computer J. 7 (1964) 155), which need no derivative: both measures have kinks.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.linalg import expm

from agent.numerics.model.observer import balanced
from agent.numerics.model.statespace import Model, StateSpace
from agent.numerics.paper.tuning import FLIPPED, INSIDE, MOST_VERTICES, OFFSET, SEED, STARTS
from agent.types import FloatArray

Measure = Callable[[FloatArray], float]


@dataclass(frozen=True, slots=True)
class Worst:
    """Where in a box a measure is greatest: theta (q,), its value, whether that is at a vertex."""

    theta: FloatArray
    value: float
    at_vertex: bool


def worst_in_box(
    measure: Measure, nominal: FloatArray, half: FloatArray, rounds: int = 8, *, inside: bool = True
) -> Worst:
    """Return where in nominal -+ half (q,) a measure is greatest; NaN counts as infinite.

    Args:
        measure: of a point theta (q,).
        nominal: (q,) the middle of the box.
        half: (q,) half its sides; 0 leaves a parameter where it is.
        rounds: of line searches along all parameters; few for a measure that costs much.
        inside: search there as well; a convex measure is greatest at a vertex.
    """
    moving = np.flatnonzero(half > 0)

    def at(shares: FloatArray) -> float:
        theta = nominal.astype(float).copy()
        theta[moving] += shares * half[moving]
        value = measure(theta)
        return value if np.isfinite(value) else np.inf

    if not len(moving):
        return Worst(nominal, at(np.zeros(0)), at_vertex=True)
    points = [*_vertices(at, len(moving)), *(_inside(len(moving)) if inside else ())]
    found = sorted(((at(point), point) for point in points), key=lambda pair: -pair[0])
    worst, *others = [point for _, point in found[:STARTS]]
    # from a vertex that is not the worst a search goes to one that is worse, and those have all been tried
    promising = [point for point in others if not _is_vertex(point)]
    starts = [point for point in (worst, *promising) if inside and not _is_peak(at, point)]
    searched = [_searched(at, point, rounds) for point in starts]
    value, shares = max([found[0], *searched], key=lambda pair: pair[0])
    theta = nominal.astype(float).copy()
    theta[moving] += shares * half[moving]
    return Worst(theta, value, at_vertex=bool(np.all(np.abs(np.abs(shares) - 1.0) < 1e-6)))


def _vertices(at: Measure, count: int) -> list[FloatArray]:
    """Return the vertices of [-1, 1]^count, or of many the worst that flips of one side lead to from some."""
    if 2**count <= MOST_VERTICES:
        return [np.array(corner) for corner in product((-1.0, 1.0), repeat=count)]
    rng = np.random.default_rng(SEED)
    drawn = [rng.choice([-1.0, 1.0], count) for _ in range(MOST_VERTICES)]
    worst = sorted(drawn, key=at, reverse=True)[:FLIPPED]
    return [*drawn, *(_flipped(at, corner) for corner in worst)]


def _flipped(at: Measure, corner: FloatArray) -> FloatArray:
    """Return the vertex that no flip of one side makes worse."""
    value = at(corner)
    improved = True
    while improved:
        improved = False
        for i in range(len(corner)):
            other = corner.copy()
            other[i] = -other[i]
            if (there := at(other)) > value:
                corner, value, improved = other, there, True
    return corner


def _inside(count: int) -> list[FloatArray]:
    """Return the middle and points that fill [-1, 1]^count evenly: an additive recurrence (Weyl, 1916)."""
    steps = np.sqrt(_primes(count)) % 1.0
    lattice = (np.arange(1, INSIDE + 1)[:, None] * steps) % 1.0
    return [np.zeros(count), *(2.0 * lattice - 1.0)]


def _primes(count: int) -> FloatArray:
    found: list[int] = []
    number = 2
    while len(found) < count:
        if all(number % prime for prime in found):
            found.append(number)
        number += 1
    return np.array(found, dtype=float)


def _is_vertex(point: FloatArray) -> bool:
    return bool(np.all(np.abs(point) == 1.0))


def _is_peak(at: Measure, point: FloatArray) -> bool:
    """Tell whether a measure grows along no parameter from a vertex inwards: no search leads away from it."""
    if not _is_vertex(point):
        return False
    inwards = [point - OFFSET * side * point for side in np.eye(len(point))]
    value = at(point)
    return all(at(other) <= value for other in inwards)


def _searched(at: Measure, start: FloatArray, rounds: int) -> tuple[float, FloatArray]:
    from scipy.optimize import minimize  # 0.3 s to import, and commissioning alone asks for it

    def lowered(shares: FloatArray) -> float:
        return -min(at(shares), 1e300)

    bounds = [(-1.0, 1.0)] * len(start)
    found = minimize(
        lowered,
        start,
        method="Powell",
        bounds=bounds,
        options={"maxiter": rounds, "xtol": 1e-7, "ftol": 1e-11},
    )
    shares = np.clip(np.asarray(found.x, dtype=float), -1.0, 1.0)
    return at(shares), shares


def radius_of_model(model: Model, period_s: float) -> Measure:
    """Return the spectral radius of the sampled model as a measure; sampling maps a pole s to exp(s T)."""

    def measure(theta: FloatArray) -> float:
        at = model.continuous(theta)
        poles = np.linalg.eigvals(at.A)
        return float(np.abs(poles).max() if at.is_sampled else np.exp(period_s * poles.real.max()))

    return measure


def radius_of_observer(model: Model, period_s: float, gain: FloatArray) -> Measure:
    """Return the spectral radius of A - L C as a measure, L (n, p) the gain that runs."""

    def measure(theta: FloatArray) -> float:
        at = model.continuous(theta)
        return float(np.abs(np.linalg.eigvals(_sampled(at, period_s) - gain @ at.C)).max())

    return measure


def perturbation(model: Model, period_s: float, gain: FloatArray) -> Measure:
    """Return the norm of Delta of (4) as a measure; convex where A and C are straight in the parameters."""
    nominal = model.continuous(model.nominal)
    A = _sampled(nominal, period_s)

    def measure(theta: FloatArray) -> float:
        at = model.continuous(theta)
        dA, dC = _sampled(at, period_s) - A, at.C - nominal.C
        return float(np.linalg.norm(np.vstack([dA, gain @ dC - dA]), 2))

    return measure


def _sampled(at: StateSpace, period_s: float) -> FloatArray:
    """Return A (n, n) in discrete time; how inputs run between samples does not enter it."""
    return at.A if at.is_sampled else np.asarray(expm(period_s * at.A))


def hidden_mode(model: Model) -> Measure:
    """Return how near a model is to hiding a mode: minus the least singular value of [A - s I; C] over poles.

    By Popov, Belevitch and Hautus it is 0 where (A, C) is not observable. States are balanced and time scaled
    so that the fastest pole is 1, at nominal, and rows of C have length 1 there, so that units do not decide.
    """
    nominal = model.continuous(model.nominal)
    speed, scale = _units(nominal)
    norms = np.maximum(np.linalg.norm(nominal.C * scale, axis=1), 1e-300)

    def measure(theta: FloatArray) -> float:
        at = model.continuous(theta)
        A, C = _rates(at) * scale[None, :] / scale[:, None] / speed, at.C * scale / norms[:, None]
        stacks = [np.vstack([A - pole * np.eye(len(A)), C]) for pole in np.linalg.eigvals(A)]
        return -float(np.linalg.svd(np.array(stacks), compute_uv=False)[:, -1].min())

    return measure


def _rates(model: StateSpace) -> FloatArray:
    return model.A - np.eye(model.n) if model.is_sampled else model.A


def _units(model: StateSpace) -> tuple[float, FloatArray]:
    rates = _rates(model)
    speed = max(float(np.abs(np.linalg.eigvals(rates)).max(initial=0.0)), 1e-300)
    return speed, balanced(rates / speed)[1]


def named(parameters: Sequence[str], theta: FloatArray) -> dict[str, float]:
    """Return a point by the names of its parameters."""
    return dict(zip(parameters, theta.tolist(), strict=True))
