"""When a parameter first reaches a limit, and how sure that is: P10, P50 and P90 over a family of laws.

The band holds what the estimates' sd leaves open, what a history leaves open of each law's parameters, and
which law it is. It is of the first passage of the parameter itself, not of the crossing of a mean line.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from agent.prognosis import tuning
from agent.prognosis.change import change
from agent.prognosis.family import MEMBERS, Scale, scale_of, way_left
from agent.prognosis.history import History, blocks, monotone, smoothed, sound
from agent.prognosis.learnt import Learnt, Specimen, as_prior, learn, specimen
from agent.prognosis.passage import first_passages, newest_levels
from agent.prognosis.posterior import FULL, Effort, Particles, Readings, posterior, selected
from agent.prognosis.prior import Prior, Student
from agent.prognosis.steps import events, find_steps, without
from agent.prognosis.traces import Alike, alike
from agent.types import FloatArray

COURSES = "like machines"
"""Member of the family that is no law: what like machines did from the level reached."""

Status = Literal["ok", "no trend", "too short", "beyond", "crossed"]


@dataclass(frozen=True, slots=True)
class Forecast:
    """A forecast, in the unit of time of the history, counted from its newest row.

    Attributes:
        status: "ok"; else why there are no quantiles. Only "ok" and, where they exist, "beyond" have them.
        p10, p50, p90: quantiles of the first passage.
        horizon: what `chance` is of; chance: of the first passage before it, None where nothing can be said.
        family: members and their weights. passages: sorted draws of the first passage, inf for none.
    """

    status: Status
    p10: float | None = None
    p50: float | None = None
    p90: float | None = None
    horizon: float = 0.0
    chance: float | None = None
    family: dict[str, float] = field(default_factory=dict)
    passages: FloatArray = field(default_factory=lambda: np.empty(0))


def forecast(
    history: History,
    limit: float,
    horizon: float | None = None,
    like: Learnt | None = None,
    effort: Effort = FULL,
) -> Forecast:
    """Forecast the first passage of a limit.

    history: rows until now, t in days. horizon: days ahead that the chance is of; None for as long again as
    the history is. like: what was learnt of like machines. effort: what it may cost. Nothing but the
    arguments enters: later rows cannot.
    """
    horizon = history.span if horizon is None else horizon
    history = without(history, events(find_steps(history)))
    thin = blocks(sound(history), effort.means)
    if len(thin) < tuning.FEWEST or thin.span <= 0.0:
        return Forecast("too short", horizon=horizon)
    readings, scale = readings_of(thin, limit)
    if scale.limit == 0.0 or _past_limit(readings, scale):
        return Forecast("crossed", horizon=horizon, chance=1.0)
    rng = np.random.default_rng(tuning.SEED)
    newest = float(readings.smooth[-1])
    left = way_left(newest, scale)
    prior = plain_prior(readings, left)
    if like is not None:
        prior = as_prior(like, prior, scale, thin.span, newest)
        readings = replace(readings, way=like.way)
    found = selected(posterior(readings, scale, prior, rng, effort), left)
    passages = first_passages(found, scale, newest, prior.later, rng, effort) * thin.span
    family = _weights(found)
    if like is not None and scale.relative:
        now = newest_levels(found, scale, newest, tuning.LEVELS, rng)
        kind = alike(like.traces, scale.limit, thin.t, readings.smooth, now, len(passages), rng)
        passages, family = _among(passages, family, kind, rng)
    passages = np.sort(passages)
    if passages[len(passages) // 2] == 0.0:
        return Forecast("crossed", horizon=horizon, chance=1.0, family=family, passages=passages)
    passages = np.maximum(
        passages - float(history.t[-1] - thin.t[-1]), 0.0
    )  # a mean is older than its newest row
    return _stated(passages, horizon, history.span, family, lambda: _steady(history))


def _among(
    passages: FloatArray, family: dict[str, float], kind: Alike | None, rng: np.random.Generator
) -> tuple[FloatArray, dict[str, float]]:
    """Return draws and weights of which as large a share as is probable is that of like machines."""
    if kind is None:
        return passages, family
    theirs = rng.uniform(size=len(passages)) < kind.share
    weights = {name: weight * (1.0 - kind.share) for name, weight in family.items()}
    return np.where(theirs, _pooled(kind.remains, passages), passages), weights | {COURSES: kind.share}


def _pooled(courses: FloatArray, laws: FloatArray) -> FloatArray:
    """Return draws (n,) whose quantiles lie between those of two sets, in logarithms, nearer to the sharper.

    A machine of a kind follows a law too, and late in its life its own rows often say more than others did:
    quantiles are averaged (Ratcliff 1979), weighed by the squared precision of each set. A set that leaves
    open whether the limit is reached at all counts for nothing.
    """
    courses, laws = np.sort(courses), np.sort(laws)
    spreads = [_log_spread(courses), _log_spread(laws)]
    if not np.isfinite(spreads[1]):
        return courses
    share = spreads[1] ** 4 / (spreads[0] ** 4 + spreads[1] ** 4)
    most = float(laws[np.isfinite(laws)][-1])
    with np.errstate(divide="ignore"):
        between = share * np.log(courses) + (1.0 - share) * np.log(np.minimum(laws, most))
    return np.exp(between)


def _log_spread(draws: FloatArray) -> float:
    """Return ln(P90 / P10) of sorted draws (n,), inf where either is no number to divide by."""
    p10, p90 = (float(draws[int(q * len(draws))]) for q in (0.1, 0.9))
    return float(np.log(p90 / p10)) if p10 > 0.0 and np.isfinite(p90) else float(np.inf)


def _steady(history: History) -> bool:
    found = change(history)
    return found is None or not found.trend


def _past_limit(readings: Readings, scale: Scale) -> bool:
    """Tell whether the newest means lie on the limit's other side, by more than they may be off."""
    newest = float(np.mean(readings.smooth[-tuning.NEWEST :]))
    off = tuning.SURE * float(np.linalg.norm(readings.sd[-tuning.NEWEST :])) / tuning.NEWEST
    beyond = -np.sign(scale.limit) * (scale.limit - np.array([newest - off, newest + off, readings.z[-1]]))
    return bool((beyond >= 0.0).all())


def _weights(found: list[Particles]) -> dict[str, float]:
    evidence = np.array([p.log_evidence for p in found])
    weight = np.exp(evidence - evidence.max())
    return dict(zip((p.member for p in found), (weight / weight.sum()).tolist(), strict=True))


def _stated(
    passages: FloatArray, horizon: float, span: float, family: dict[str, float], steady: Callable[[], bool]
) -> Forecast:
    """Return what draws of the first passage allow to be said; steady: whether nothing changes."""
    p10, p50, p90 = (float(passages[int(q * len(passages))]) for q in (0.1, 0.5, 0.9))
    chance = float(np.mean(passages <= min(horizon, tuning.FARTHEST * span)))
    if not _is_wide(p10, p90, span):
        status: Status = "beyond" if p50 > horizon > span else "ok"
        return Forecast(status, p10, p50, p90, horizon, chance, family, passages)
    why: Status = "beyond" if np.isinf(p10) else "too short"
    return Forecast("no trend" if steady() else why, None, None, None, horizon, chance, family, passages)


def _is_wide(p10: float, p90: float, span: float) -> bool:
    """Whether it is left open if a passage is soon or far, or is at all."""
    return bool(np.isinf(p90)) or (p90 - p10 > tuning.SPANS * span and p90 > tuning.RATIO * p10)


def readings_of(thin: History, limit: float) -> tuple[Readings, Scale]:
    """Return a thinned history in the scale of the laws that lead to a limit."""
    smooth = smoothed(thin)
    scale = scale_of(smooth, limit)
    z, level = scale.scaled(thin.value), scale.scaled(smooth)
    breadth = 3.0 * max(float(np.ptp(level)), 1e-9)
    usual = max(abs(float(level[-1] - level[0])), float(np.ptp(level)) / 3.0, 1e-12)
    t = (thin.t - thin.t[-1]) / thin.span
    return Readings(t, z, thin.sd / scale.size, level, breadth, usual, float(np.sign(scale.limit))), scale


def plain_prior(readings: Readings, left: float) -> Prior:
    """Return the prior without like machines: sizes from the history's own scatter, shapes as machines have.

    left: share of the way that is not gone yet. However short it is, the rate at the limit may differ as much
    from what the law says: parts fail faster than they wore.
    """
    second = np.diff(readings.z, 2)
    scatter = max(
        1.4826 * float(np.median(np.abs(second))) / np.sqrt(6.0), 1e-6 * max(float(np.ptp(readings.z)), 1e-9)
    )
    of = {
        "walk": Student(float(np.log(0.3 * scatter * np.sqrt(len(readings.z)))), 1.5),
        "wander": Student(float(np.log(0.05)), 0.9, 30.0),
        "scatter": Student(float(np.log(0.5 * scatter)), 1.2),
        "bend": Student(1.4, 1.0, 5.0),
        "onset": Student(0.0, 1.5),
        "run_in": Student(-1.0, 1.0),
        "saturation": Student(0.0, 1.0),
        "ramp": Student(1.0, 1.2),
        "growth": Student(0.7, 0.7),
    }
    members = dict(zip(MEMBERS, (0.14, 0.3, 0.06, 0.1, 0.14, 0.1, 0.16), strict=True))
    return Prior(of, members, later=Student(0.9 / left, 1.6 / left))


def learn_from(histories: Sequence[History], limit: float | None = None) -> Learnt:
    """Learn the prior that like machines' histories lead to, each up to its own first passage of a limit.

    Raises ValueError where none of them is long enough or moves.
    """
    specimens = [found for history in histories if (found := _specimen(history, limit)) is not None]
    if not specimens:
        way = "" if limit is None else f" half of the way to {limit:g}"
        raise ValueError(f"none of the histories of like machines has six rows that move{way}")
    return learn(specimens)


def _specimen(history: History, limit: float | None) -> Specimen | None:
    """Return what a history teaches; None where it has too few rows, does not move, or not half of the way.

    One that ends before the limit has not lived its life: what it took is the time to its own end, and its
    law says how long the rest would take.
    """
    thin = blocks(sound(_life(history, limit)), FULL.means)
    if len(thin) < tuning.FEWEST or 0.0 in {thin.span, float(np.ptp(thin.value))}:
        return None
    end = _end(smoothed(thin), limit)
    if end is None:
        return None
    readings, scale = readings_of(thin, end)
    moves = scale.limit != 0.0 and scale.relative
    return specimen(thin.t, readings.smooth, scale) if moves else None


def _end(smooth: FloatArray, limit: float | None) -> float | None:
    """Return the level that a history came to, which is the limit where it came about there.

    None where it went less than tuning.LEAST_WAY of the way.
    """
    begin, end = float(smooth[0]), float(smooth[-1])
    if limit is None or limit == begin:
        return end
    share = (end - begin) / (limit - begin)
    if share < tuning.LEAST_WAY:
        return None
    return limit if share >= 1.0 - tuning.SHORT else end


def _life(history: History, limit: float | None) -> History:
    """Return rows up to where the level reaches the limit, which may be on either side of the first rows.

    The first row beyond the limit is early by the rows' noise; the level is their isotonic regression, up to
    where they are back nearer to the start than to the limit, as after a repair.
    """
    if limit is None or not len(history):
        return history
    way = limit - float(np.median(history.value[:5]))
    gone = (history.value - (limit - way)) * np.sign(way)
    beyond = [row for row in np.flatnonzero(gone >= abs(way))[:50].tolist() if row >= 5]
    if not beyond:
        return history
    back = np.flatnonzero(gone[beyond[0] :] < 0.5 * abs(way))
    stop = beyond[0] + int(back[0]) if len(back) else len(history)
    reached = np.flatnonzero(monotone(gone[:stop], np.ones(stop)) >= abs(way))
    return history[: int(reached[0]) + 1 if len(reached) else stop]
