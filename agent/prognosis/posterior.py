"""The law's parameters given a history: population Monte Carlo over what is not linear, Kalman filters over the rest.

A Rao-Blackwellised particle set (Cappé et al. 2004): each particle is one (walk, wander, scatter, shape); level and
rate given a particle are Gaussian and exact. The sum of the weights is the member's evidence.
"""

from dataclasses import dataclass

import numpy as np

from agent.prognosis.family import MEMBERS, SHAPES, Scale, bent, instant, life_way, progress
from agent.prognosis.filter import State, Walk, run_filter
from agent.prognosis.prior import Prior
from agent.types import FloatArray

PARTICLES = 800
"""Of each member in each round."""
ROUNDS = 6
WITHIN = -40.0, 25.0
"""Logarithms that a proposal may reach; beyond, numbers overflow."""
RUN_IN = 50.0
"""How freely the rate wanders while a part runs in, in usual rates over a span."""
COMMON = ("walk", "wander", "scatter")


@dataclass(frozen=True, slots=True)
class Readings:
    """A thinned history in the law's scale.

    Attributes:
        t: (n,) in spans, 0 the newest and −1 the first.
        z, sd, smooth: (n,) scaled levels, their stated sd, and the levels without noise, about which laws are made
            linear.
        breadth: sd of the rate before anything is known of it, in sizes a span.
        usual: rate that the wander is relative to, in sizes a span.
        sign: of the rate that leads to the limit.
        way: that lives of like machines are counted over, in the law's own coordinate; 0 without any.
    """

    t: FloatArray
    z: FloatArray
    sd: FloatArray
    smooth: FloatArray
    breadth: float
    usual: float
    sign: float
    way: float = 0.0


@dataclass(frozen=True, slots=True)
class Particles:
    """Weighted particles of one member; theta (N, d) by `names`, states at the newest reading."""

    member: str
    names: tuple[str, ...]
    theta: FloatArray
    log_weight: FloatArray
    state: State
    log_evidence: float

    def column(self, name: str, default: float) -> FloatArray:
        """Return one parameter of every particle."""
        if name in self.names:
            return self.theta[:, self.names.index(name)]
        return np.full(len(self.theta), default)


def posterior(readings: Readings, scale: Scale, prior: Prior, rng: np.random.Generator) -> list[Particles]:
    """Return the particles of every member of the family that the prior allows."""
    return [_member(readings, scale, prior, rng, name) for name in MEMBERS if prior.members.get(name, 0.0) > 0.0]


def _member(readings: Readings, scale: Scale, prior: Prior, rng: np.random.Generator, member: str) -> Particles:
    names = (*COMMON, *(("life",) if "life" in prior.of else ()), *SHAPES[member])
    theta = prior.draw(rng, names, PARTICLES)
    proposal = prior.log_density(names, theta)
    for _ in range(ROUNDS):
        target = prior.log_density(names, theta)
        state, likelihood = filtered(readings, scale, member, names, theta)
        log_weight = np.where(np.isfinite(likelihood), likelihood + target - proposal, -np.inf)
        last = (theta, log_weight, state)
        theta, proposal = _proposed(theta, log_weight, prior, names, rng)
    theta, log_weight, state = last
    top = float(log_weight.max())
    evidence = top + float(np.log(np.mean(np.exp(log_weight - top)))) + float(np.log(prior.members[member]))
    return Particles(member, names, theta, log_weight - top, state, evidence)


def _proposed(
    theta: FloatArray, log_weight: FloatArray, prior: Prior, names: tuple[str, ...], rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return new particles of a t density about the old ones, a fifth of them of the prior, and their log density."""
    n, d = theta.shape
    weight = tempered(log_weight, 40.0 + 5.0 * d)
    mean = weight @ theta
    centred = theta - mean
    spread = 1.5 * (centred * weight[:, None]).T @ centred + 1e-8 * np.eye(d)
    root = np.linalg.cholesky(spread)
    dof = 5.0
    fresh = n // 5
    normal = rng.standard_normal((n, d)) / np.sqrt(rng.chisquare(dof, n) / dof)[:, None]
    drawn = mean + normal @ root.T
    drawn[:fresh] = prior.draw(rng, names, fresh)
    distance = np.linalg.solve(root, (drawn - mean).T)
    square = np.einsum("ij,ij->j", distance, distance)
    local = _student_constant(d, dof) - float(np.log(np.diag(root)).sum()) - 0.5 * (dof + d) * np.log1p(square / dof)
    share = fresh / n
    return drawn, np.logaddexp(np.log(1 - share) + local, np.log(share) + prior.log_density(names, drawn))


def _student_constant(d: int, dof: float) -> float:
    from scipy.special import gammaln

    return float(gammaln(0.5 * (dof + d)) - gammaln(0.5 * dof) - 0.5 * d * np.log(dof * np.pi))


def tempered(log_weight: FloatArray, least: float) -> FloatArray:
    """Return normalised weights, flattened until at least that many particles count."""
    top = log_weight - log_weight.max()
    power = 1.0
    weight: FloatArray = np.exp(top)
    for _ in range(30):
        weight = np.exp(power * top) / np.exp(power * top).sum()
        if 1.0 / float(weight @ weight) >= least:
            break
        power *= 0.7
    return weight


def filtered(
    readings: Readings, scale: Scale, member: str, names: tuple[str, ...], theta: FloatArray
) -> tuple[State, FloatArray]:
    """Return states at the newest reading and log likelihoods of particles (N, d)."""
    column = {name: np.clip(theta[:, index], *WITHIN) for index, name in enumerate(names)}
    bend = column.get("bend", np.zeros(len(theta)))
    if "life" in column:
        column["rate"] = np.log(life_way(bend, readings.way, scale)) - column["life"]
    u, slope = bent(readings.smooth[:, None], bend, scale)
    u = u + slope * (readings.z - readings.smooth)[:, None]
    variance = slope**2 * (readings.sd[:, None] ** 2 + np.exp(2.0 * column["scatter"]))
    state, likelihood = run_filter(u, variance, _walk(readings, member, column, theta), _start(readings, u[0], column))
    return state, likelihood + np.log(slope).sum(axis=0)


def _walk(readings: Readings, member: str, column: dict[str, FloatArray], theta: FloatArray) -> Walk:
    shape = np.column_stack([column[name] for name in SHAPES[member]]) if SHAPES[member] else np.zeros((len(theta), 0))
    h = np.diff(progress(readings.t, member, shape), axis=0)
    dt = np.diff(readings.t)[:, None]
    usual = np.exp(column["rate"]) if "rate" in column else readings.usual
    rate = np.broadcast_to((np.exp(column["wander"]) * usual) ** 2, h.shape)
    if "run_in" in column:
        rate = np.where(readings.t[1:, None] < instant(column["run_in"]), (RUN_IN * usual) ** 2, rate)
    return Walk(h, np.exp(2.0 * column["walk"]) * dt + rate * h * h * dt / 3.0, rate * dt, rate * h * dt / 2.0)


def _start(readings: Readings, u: FloatArray, column: dict[str, FloatArray]) -> State:
    n = len(u)
    mean = np.zeros(n)
    sd = np.full(n, readings.breadth)
    if "rate" in column:
        mean = readings.sign * np.exp(column["rate"])
        sd = 0.1 * np.abs(mean)
    apart = 10.0 * max(float(np.ptp(readings.smooth)), float(readings.sd.max()))
    return State(u, mean, apart**2 + np.exp(2.0 * column["scatter"]), np.zeros(n), sd**2)
