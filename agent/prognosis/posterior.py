"""Posterior of the law's parameters: population Monte Carlo over nonlinear ones, Kalman filters for the rest.

A Rao-Blackwellised particle set (Cappé et al. 2004): each particle is one (walk, wander, scatter, shape);
level and rate given a particle are Gaussian and exact. The sum of the weights is the member's evidence.
"""

from dataclasses import dataclass

import numpy as np

from agent.prognosis.family import MEMBERS, SHAPES, Scale, bent, instant, life_way, progress
from agent.prognosis.filter import State, Walk, moved, run_filter
from agent.prognosis.prior import Prior
from agent.types import FloatArray

WIDE = 960
"""Particles of one filter: fewer cost nearly as much; more take memory that a gateway may not have."""
AT_ONCE = 20
"""Readings whose numbers are made at once: of all 160 they took 12 MB while a forecast was made."""
WITHIN = -40.0, 25.0
"""Logarithms that a proposal may reach; beyond, numbers overflow."""
RUN_IN = 50.0
"""How freely the rate wanders while a part runs in, in usual rates over a span."""
COUNTED = 1.0 / 11.0
"""Share of the particles that need count for the next round: more, and a few hundred stay where they are."""
COMMON = ("walk", "wander", "scatter")


@dataclass(frozen=True, slots=True)
class Effort:
    """Effort of a forecast: means of the history, particles per member and round, rounds, paths, steps."""

    means: int
    particles: int
    rounds: int
    paths: int
    steps: int


FULL = Effort(160, 800, 6, 4000, 120)
BRIEF = Effort(24, 320, 3, 600, 60)
"""For tables of many parts, a fifth of the cost: few means rather than few particles, which lose the law."""


@dataclass(frozen=True, slots=True)
class Readings:
    """A thinned history in the law's scale.

    Attributes:
        t: (n,) in spans, 0 the newest and −1 the first.
        z, sd, smooth: (n,) scaled levels, their stated sd, and the levels without noise, about which laws are
            made linear.
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


@dataclass(frozen=True, slots=True)
class _Swarm:
    """Particles of one member in one round: theta (N, d), log density when drawn, and later weights."""

    member: str
    names: tuple[str, ...]
    theta: FloatArray
    proposal: FloatArray


@dataclass(frozen=True, slots=True)
class _Weighed:
    """A swarm that was held against the readings."""

    swarm: _Swarm
    log_weight: FloatArray
    state: State


def posterior(
    readings: Readings, scale: Scale, prior: Prior, rng: np.random.Generator, effort: Effort = FULL
) -> list[Particles]:
    """Return the particles of every member of the family that the prior allows."""
    members = [name for name in MEMBERS if prior.members.get(name, 0.0) > 0.0]
    swarms = [_first(prior, rng, name, effort.particles) for name in members]
    for round_ in range(effort.rounds):
        weighed = _weigh(readings, scale, prior, swarms)
        if round_ + 1 < effort.rounds:
            swarms = [_next(one, prior, rng) for one in weighed]
    return [_particles(one, prior) for one in weighed]


def _first(prior: Prior, rng: np.random.Generator, member: str, count: int) -> _Swarm:
    names = (*COMMON, *(("life",) if "life" in prior.of else ()), *SHAPES[member])
    theta = prior.draw(rng, names, count)
    return _Swarm(member, names, theta, prior.log_density(names, theta))


def _next(found: _Weighed, prior: Prior, rng: np.random.Generator) -> _Swarm:
    swarm = found.swarm
    return _Swarm(
        swarm.member, swarm.names, *_proposed(swarm.theta, found.log_weight, prior, swarm.names, rng)
    )  # fmt: skip


def _weigh(readings: Readings, scale: Scale, prior: Prior, swarms: list[_Swarm]) -> list[_Weighed]:
    """Return swarms with their weights; as many go through one filter as are as quick as one."""
    width = max(1, WIDE // max(1, len(swarms[0].theta))) if swarms else 1
    weighed = []
    for first in range(0, len(swarms), width):
        group = swarms[first : first + width]
        for swarm, (state, likelihood) in zip(group, filtered(readings, scale, group), strict=True):
            target = prior.log_density(swarm.names, swarm.theta)
            log_weight = np.where(np.isfinite(likelihood), likelihood + target - swarm.proposal, -np.inf)
            weighed.append(_Weighed(swarm, log_weight, state))
    return weighed


def _particles(found: _Weighed, prior: Prior) -> Particles:
    swarm, log_weight = found.swarm, found.log_weight
    top = float(log_weight.max())
    evidence = (
        top + float(np.log(np.mean(np.exp(log_weight - top)))) + float(np.log(prior.members[swarm.member]))
    )
    return Particles(swarm.member, swarm.names, swarm.theta, log_weight - top, found.state, evidence)


def _proposed(
    theta: FloatArray, log_weight: FloatArray, prior: Prior, names: tuple[str, ...], rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return new particles of a t density about the old ones, a fifth from the prior, and log densities."""
    n, d = theta.shape
    weight = tempered(log_weight, min(40.0 + 5.0 * d, COUNTED * n))
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
    local = (
        _student_constant(d, dof)
        - float(np.log(np.diag(root)).sum())
        - 0.5 * (dof + d) * np.log1p(square / dof)
    )
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


def filtered(readings: Readings, scale: Scale, swarms: list[_Swarm]) -> list[tuple[State, FloatArray]]:
    """Return states at the newest reading and log likelihoods of each swarm's particles, from one filter."""
    columns = [_columns(readings, scale, swarm) for swarm in swarms]
    slopes = [np.zeros(len(swarm.theta)) for swarm in swarms]
    first = (_seen(readings, scale, column, slice(1))[0][0] for column in columns)
    state = _joined([_start(readings, u, column) for u, column in zip(first, columns, strict=True)])
    likelihood = np.zeros(len(state.u))
    for row in range(0, len(readings.t), AT_ONCE):
        seen = [_seen(readings, scale, column, slice(row, row + AT_ONCE)) for column in columns]
        t = readings.t[max(row - 1, 0) : row + AT_ONCE]
        walk = _beside([_walk(t, readings, *one) for one in zip(swarms, columns, strict=True)])
        if row > 0:
            state = moved(state, walk, 0)
            walk = walk.after(1)
        u, variance = (np.concatenate([one[k] for one in seen], axis=1) for k in range(2))
        state, likelihood = run_filter(u, variance, walk, state, likelihood)
        slopes = [_summed(total, np.log(slope)) for total, (_, _, slope) in zip(slopes, seen, strict=True)]
    return _apart(state, likelihood, slopes)


def _summed(total: FloatArray, rows: FloatArray) -> FloatArray:
    """Return a sum that rows (n, N) are added to one by one, so that it does not depend on their division."""
    summed: FloatArray = np.add.reduce([total, *rows])
    return summed


def _apart(state: State, likelihood: FloatArray, slopes: list[FloatArray]) -> list[tuple[State, FloatArray]]:
    """Return what one filter found for the particles of each swarm, with the slopes' logarithms."""
    ends = np.cumsum([len(slope) for slope in slopes])[:-1]
    parts = [np.split(getattr(state, name), ends) for name in _STATE]
    states = [State(*cells) for cells in zip(*parts, strict=True)]
    return [(s, one + more) for s, one, more in zip(states, np.split(likelihood, ends), slopes, strict=True)]


_STATE = ("u", "b", "uu", "ub", "bb")


def _joined(states: list[State]) -> State:
    return State(*(np.concatenate([getattr(state, name) for state in states]) for name in _STATE))


def _beside(walks: list[Walk]) -> Walk:
    names = ("h", "level", "rate", "cross")
    return Walk(*(np.concatenate([getattr(walk, name) for walk in walks], axis=1) for name in names))


def _columns(readings: Readings, scale: Scale, swarm: _Swarm) -> dict[str, FloatArray]:
    """Return the parameters of a swarm by name, (N,) each."""
    column = {name: np.clip(swarm.theta[:, index], *WITHIN) for index, name in enumerate(swarm.names)}
    if "life" in column:
        bend = column.get("bend", np.zeros(len(swarm.theta)))
        column["rate"] = np.log(life_way(bend, readings.way, scale)) - column["life"]
    return column


def _seen(
    readings: Readings, scale: Scale, column: dict[str, FloatArray], rows: slice
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return readings and their variances in the scale where each particle's law is a line, and its slope."""
    bend = column.get("bend", np.zeros(len(column["walk"])))
    smooth, sd = readings.smooth[rows, None], readings.sd[rows, None]
    u, slope = bent(smooth, bend, scale)
    u = u + slope * (readings.z[rows, None] - smooth)
    return u, slope**2 * (sd**2 + np.exp(2.0 * column["scatter"])), slope


def _walk(t: FloatArray, readings: Readings, swarm: _Swarm, column: dict[str, FloatArray]) -> Walk:
    """Return the steps between instants t (n,) of some of the readings."""
    member = swarm.member
    count = len(swarm.theta)
    shape = (
        np.column_stack([column[name] for name in SHAPES[member]]) if SHAPES[member] else np.zeros((count, 0))
    )
    h = np.diff(progress(t, member, shape), axis=0)
    dt = np.diff(t)[:, None]
    usual = np.exp(column["rate"]) if "rate" in column else readings.usual
    rate = np.broadcast_to((np.exp(column["wander"]) * usual) ** 2, h.shape)
    if "run_in" in column:
        rate = np.where(t[1:, None] < instant(column["run_in"]), (RUN_IN * usual) ** 2, rate)
    return Walk(
        h, np.exp(2.0 * column["walk"]) * dt + rate * h * h * dt / 3.0, rate * dt, rate * h * dt / 2.0
    )


def _start(readings: Readings, u: FloatArray, column: dict[str, FloatArray]) -> State:
    n = len(u)
    mean = np.zeros(n)
    sd = np.full(n, readings.breadth)
    if "rate" in column:
        mean = readings.sign * np.exp(column["rate"])
        sd = 0.1 * np.abs(mean)
    apart = 10.0 * max(float(np.ptp(readings.smooth)), float(readings.sd.max()))
    return State(u, mean, apart**2 + np.exp(2.0 * column["scatter"]), np.zeros(n), sd**2)
