"""Posterior of the law's parameters: population Monte Carlo over nonlinear ones, Kalman filters for the rest.

A Rao-Blackwellised particle set (Cappé et al. 2004): each particle is one (walk, wander, scatter, shape);
level and rate given a particle are Gaussian and exact. The sum of the weights is the member's evidence.
"""

from dataclasses import dataclass, replace

import numpy as np

from agent.prognosis.family import MEMBERS, SHAPES, STEADY, Scale, bent, instant, life_way, progress
from agent.prognosis.filter import State, Walk, moved, run_filter
from agent.prognosis.prior import Prior
from agent.prognosis.tuning import (
    AT_ONCE,
    COUNTED,
    GONE_POWER,
    LEAST_LEFT,
    RUN_IN,
    SELECTION_POWER,
    STEADY_ODDS,
    WITHIN,
)
from agent.types import FloatArray


@dataclass(frozen=True, slots=True)
class Effort:
    """Effort of a forecast: means of the history, particles per member and round, rounds, paths, steps."""

    means: int
    particles: int
    rounds: int
    paths: int
    steps: int


FULL = Effort(160, 800, 6, 4000, 120)
BRIEF = Effort(24, 320, 3, 600, 40)
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
    """Particles of one member in one round: theta (N, d), log densities as drawn and of the prior, (N,)."""

    member: str
    names: tuple[str, ...]
    theta: FloatArray
    proposal: FloatArray
    prior: FloatArray


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
        weighed = _weigh(readings, scale, swarms)
        if round_ + 1 < effort.rounds:
            swarms = [_next(one, prior, rng) for one in weighed]
    return [_particles(one, prior) for one in weighed]


def selected(found: list[Particles], left: float) -> list[Particles]:
    """Return members of which the steady one has nearly all of the weight or none.

    left: share of the way to the limit that is not gone yet. Rows seldom tell a steady rate from one that
    bends little, and a mixture spreads over all that may come of either. So the odds of a steady rate count
    to a power; they are less where it stayed over less of the way than it would have to.
    """
    steady = [one.log_evidence for one in found if one.member == STEADY]
    others = [one.log_evidence for one in found if one.member != STEADY]
    if not steady or not others:
        return found
    seen = min((1.0 - min(left, 1.0 - LEAST_LEFT)) / left, 1.0)
    odds = steady[0] - float(np.logaddexp.reduce(others))
    more = SELECTION_POWER * (odds + GONE_POWER * float(np.log(seen)) - float(np.log(STEADY_ODDS))) - odds
    return [
        replace(one, log_evidence=one.log_evidence + more) if one.member == STEADY else one for one in found
    ]


def _first(prior: Prior, rng: np.random.Generator, member: str, count: int) -> _Swarm:
    wander = () if member == STEADY else ("wander",)
    life = ("life",) if "life" in prior.of else ()
    names = ("walk", *wander, "scatter", *life, *SHAPES[member])
    theta = prior.draw(rng, names, count)
    density = prior.log_density(names, theta)
    return _Swarm(member, names, theta, density, density)


def _next(found: _Weighed, prior: Prior, rng: np.random.Generator) -> _Swarm:
    swarm = found.swarm
    return _Swarm(
        swarm.member, swarm.names, *_proposed(swarm.theta, found.log_weight, prior, swarm.names, rng)
    )  # fmt: skip


def _weigh(readings: Readings, scale: Scale, swarms: list[_Swarm]) -> list[_Weighed]:
    """Return swarms with their weights; one filter takes the particles of all."""
    weighed = []
    for swarm, (state, likelihood) in zip(swarms, filtered(readings, scale, swarms), strict=True):
        weight = likelihood + swarm.prior - swarm.proposal
        weighed.append(_Weighed(swarm, np.where(np.isfinite(likelihood), weight, -np.inf), state))
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
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return new particles of a t density about the old ones, a fifth from the prior, and log densities.

    The densities are (N,): that of which they were drawn, and the prior's.
    """
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
    density = prior.log_density(names, drawn)
    return drawn, np.logaddexp(np.log(1 - share) + local, np.log(share) + density), density


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
    column = _columns(readings, scale, swarms)
    state = _start(readings, _seen(readings, scale, swarms, column, slice(1))[0][0], column)
    likelihood = slopes = np.zeros(len(state.u))
    rows = max(1, AT_ONCE // len(state.u))
    for row in range(0, len(readings.t), rows):
        u, variance, slope = _seen(readings, scale, swarms, column, slice(row, row + rows))
        walk = _walk(readings.t[max(row - 1, 0) : row + rows], readings, swarms, column)
        if row > 0:
            state = moved(state, walk, 0)
            walk = walk.after(1)
        state, likelihood = run_filter(u, variance, walk, state, likelihood)
        # row by row, so that the sum does not depend on how many rows are made at once
        slopes = np.add.reduce([slopes, *slope])
    return [
        (State(*(cells[mine] for cells in state)), likelihood[mine] + slopes[mine])
        for mine in _places(swarms)
    ]


def _places(swarms: list[_Swarm]) -> list[slice]:
    """Return where the particles of each swarm stand among those of all."""
    ends = np.cumsum([len(swarm.theta) for swarm in swarms]).tolist()
    return [slice(begin, end) for begin, end in zip([0, *ends], ends, strict=False)]


def _columns(readings: Readings, scale: Scale, swarms: list[_Swarm]) -> dict[str, FloatArray]:
    """Return the parameters of all swarms' particles by name, (N,) each; 0 where a law has none of it.

    The wander is a logarithm: a law without one has the least there is.
    """
    places = list(zip(swarms, _places(swarms), strict=True))
    count = places[-1][1].stop
    column = {"bend": np.zeros(count), "wander": np.full(count, WITHIN[0])}
    for swarm, mine in places:
        for name, cells in zip(swarm.names, swarm.theta.T, strict=True):
            column.setdefault(name, np.zeros(count))[mine] = np.clip(cells, *WITHIN)
    if "life" in column:
        column["rate"] = np.log(life_way(column["bend"], readings.way, scale)) - column["life"]
    return column


def _seen(
    readings: Readings, scale: Scale, swarms: list[_Swarm], column: dict[str, FloatArray], rows: slice
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return readings, their variances and ln(du/dz), (n, N), where each particle's law is a line."""
    smooth, sd = readings.smooth[rows, None], readings.sd[rows, None]
    u, log_slope = np.empty((2, len(smooth), len(column["bend"])))
    for swarm, mine in zip(swarms, _places(swarms), strict=True):
        bend = column["bend"][mine] if "bend" in swarm.names else np.zeros(1)
        u[:, mine], log_slope[:, mine] = bent(smooth, bend, scale)
    slope = np.exp(log_slope)
    u += slope * (readings.z[rows, None] - smooth)
    return u, slope**2 * (sd**2 + np.exp(2.0 * column["scatter"])), log_slope


def _walk(t: FloatArray, readings: Readings, swarms: list[_Swarm], column: dict[str, FloatArray]) -> Walk:
    """Return the steps between instants t (n,) of some of the readings."""
    dt = np.diff(t)[:, None]
    usual = np.exp(column["rate"]) if "rate" in column else np.full(len(column["walk"]), readings.usual)
    h = np.empty((len(dt), len(usual)))
    rate = np.empty_like(h)
    rate[:] = (np.exp(column["wander"]) * usual) ** 2
    for swarm, mine in zip(swarms, _places(swarms), strict=True):
        names = SHAPES[swarm.member]
        shape = np.column_stack([column[name][mine] for name in names]) if names else swarm.theta[:, :0]
        h[:, mine] = np.diff(progress(t, swarm.member, shape), axis=0)
        if "run_in" in names:
            running_in = t[1:, None] < instant(column["run_in"][mine])
            rate[:, mine] = np.where(running_in, (RUN_IN * usual[mine]) ** 2, rate[:, mine])
    rate *= dt
    cross = rate * h
    return Walk(h, np.exp(2.0 * column["walk"]) * dt + cross * h / 3.0, rate, cross / 2.0)


def _start(readings: Readings, u: FloatArray, column: dict[str, FloatArray]) -> State:
    n = len(u)
    mean = np.zeros(n)
    sd = np.full(n, readings.breadth)
    if "rate" in column:
        mean = readings.sign * np.exp(column["rate"])
        sd = 0.1 * np.abs(mean)
    apart = 10.0 * max(float(np.ptp(readings.smooth)), float(readings.sd.max()))
    return State(u, mean, apart**2 + np.exp(2.0 * column["scatter"]), np.zeros(n), sd**2)
