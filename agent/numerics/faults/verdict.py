"""Sensor or structure: what changed, when a window no longer fits what the rig was.

A few stories of one window are held against each other by their sums of squares, penalised for what each leaves free
(Schwarz, Annals of Statistics 6 (1978) 461): the structure changed (all parameters, or one of them, the others being as
before), or one channel did (its offset and its gain, all parameters being as before). What was before is known with
its own uncertainty from the windows before. Where no story is clearly better, the readings cannot tell.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from agent.numerics.fitting.fit import Problem
from agent.numerics.model.observer import Gain
from agent.numerics.model.sensors import Nuisance, SensedModel, Side, with_constant
from agent.numerics.model.statespace import Discrete, Hold, Model, discretise
from agent.numerics.window.reference import Reference

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
MARGIN = 12.0
"""By how much one story's penalised sum of squares must be less than another's to be believed: odds of 400 to 1."""
DRIFT = 0.002
"""What parameters may have moved, as a share of their sizes, since the windows before."""
STEPS = 6


@dataclass(frozen=True, slots=True)
class Verdict:
    """What changed: the structure, one channel's sensor, one of the two, or nothing that any story tells.

    Attributes:
        changed: "structure", "sensor", "inseparable" or, where a sensor's story beats the structure's but leaves more
            than noise itself, "unexplained".
        channel: number of the channel (outputs, then inputs) that may be at fault; -1 where none is named.
        odds: by how much the best story beats the best of the other kind.
    """

    changed: Literal["structure", "sensor", "inseparable", "unexplained"]
    channel: int
    odds: float


@dataclass(frozen=True, slots=True)
class Before:
    """What parameters (q,) were, and their covariance (q, q); a large one where they were not known."""

    theta: FloatArray
    covariance: FloatArray

    @classmethod
    def of(cls, reference: Reference, scale: FloatArray, theta: FloatArray) -> "Before":
        """Take what windows before said, in units of scale (q,); theta (q,) stands for what they did not say."""
        known = np.diag(reference.A) > 0
        A = reference.A + np.diag(np.where(known, 1e-9 * np.diag(reference.A), 0.0)) + 1e-4 * np.eye(len(scale))
        inverse = np.linalg.inv(A)
        b = reference.b + 1e-4 * theta / scale
        covariance = (inverse + DRIFT**2 * np.eye(len(scale))) * np.outer(scale, scale)
        return cls(inverse @ b * scale, np.asarray(covariance))

    def precision(self, free: BoolArray) -> FloatArray:
        """Return the precision (q, q) of the parameters that are as before; nothing for those that are free (q,)."""
        kept = np.flatnonzero(~free)
        precision = np.zeros_like(self.covariance)
        if len(kept):
            precision[np.ix_(kept, kept)] = np.linalg.inv(self.covariance[np.ix_(kept, kept)])
        return precision

    def distance(self, theta: FloatArray, covariance: FloatArray) -> float:
        """Return the squared distance of an estimate theta (q,) in units of both uncertainties."""
        off = theta - self.theta
        return float(off @ np.linalg.lstsq(self.covariance + covariance, off, rcond=1e-14)[0])

    def agrees(self, theta: FloatArray, covariance: FloatArray) -> bool:
        """Tell whether an estimate theta (q,) of known covariance (q, q) is off by no more than chance."""
        q = len(theta)
        return bool(np.all(np.isfinite(covariance))) and self.distance(theta, covariance) < q + 5 * np.sqrt(2 * q)


@dataclass(frozen=True, slots=True)
class Story:
    """One account of a window: which channel changed (-1: the structure), what is free, and its model."""

    channel: int
    model: Model
    free: BoolArray
    start: FloatArray

    def turned(self, q: int) -> "Story":
        """Return the same with a channel that begins as turned round, behind q parameters."""
        start = self.start.copy()
        start[q:][start[q:] == 1.0] = -1.0
        return replace(self, start=start)


class Court:
    """Hears the stories of one rig's windows.

    Args:
        model: the rig's model; theta is its parameters'.
        outputs, inputs: channels that may be at fault: all outputs, and the first so many inputs.
        period_s, hold: of the sampled model.
    """

    def __init__(self, model: Model, outputs: int, inputs: int, period_s: float, hold: Hold) -> None:
        self._model, self._outputs, self._inputs = model, outputs, inputs
        self._period_s, self._hold = period_s, hold
        self._sensed = [(channel, sensed) for channel, sensed in self._suspected()]

    def judge(
        self, problem: Problem, gain: Gain, before: Before, after: FloatArray, limit: float, share: float
    ) -> Verdict | None:
        """Say what changed in a window; None where no story explains it and the structure's does best.

        A movement inside the window is no step of a parameter, and the offset and gain of a sensor may come nearer to
        it than any constant does; so a sensor is named only where its story leaves no more than noise.

        Args:
            problem: the window.
            gain: of the observer, the same for all stories.
            before: what the parameters were.
            after: (q,) what a fit of the window with all parameters free found, or a guess.
            limit: largest residual variance of a window that is explained, as undisturbed windows have it.
            share: effective degrees of freedom of their residual over their count.
        """
        dof = problem.v.shape[0] * self._outputs - len(after) - len(gain.L)
        dof = max(dof - (0 if problem.bridge is None else problem.bridge.free), 1)
        heard = [(story, self._least(story, problem, gain, before)) for story in self._stories(before, after)]
        if min(squares for _, squares in heard) > limit * dof:
            # steps from a sound sensor seldom find one that is turned round
            turned = [(story, story.turned(len(before.theta))) for story, _ in heard if story.channel >= 0]
            heard += [(story, self._least(other, problem, gain, before)) for story, other in turned]
        noise = max(min(squares for _, squares in heard) / dof, 1e-300)
        price = np.log(max(dof * share, 2.0))
        judged = [(squares * share / noise + price * int(story.free.sum()), story, squares) for story, squares in heard]
        structure = min((j for j in judged if j[1].channel < 0), key=lambda j: j[0])
        sensor = min((j for j in judged if j[1].channel >= 0), key=lambda j: j[0], default=None)
        if sensor is None:
            return None if structure[2] > limit * dof else Verdict("structure", -1, np.inf)
        odds = structure[0] - sensor[0]
        if sensor[2] > limit * dof:
            if structure[2] <= limit * dof:
                return Verdict("structure", -1, -odds)
            return Verdict("unexplained", -1, odds) if odds > MARGIN else None
        if abs(odds) < MARGIN:
            return Verdict("inseparable", sensor[1].channel, abs(odds))
        return Verdict("sensor", sensor[1].channel, odds) if odds > 0 else Verdict("structure", -1, -odds)

    def _suspected(self) -> Iterator[tuple[int, SensedModel]]:
        """The model with the constants of one channel more, for each channel that has some that are not estimated."""
        inner, own = (
            (self._model.model, self._model.nuisances) if isinstance(self._model, SensedModel) else (self._model, ())
        )
        known = {(n.kind, n.side, n.number) for n in own}
        for channel in range(self._outputs + self._inputs):
            output = channel < self._outputs
            number = channel if output else channel - self._outputs
            extra = [
                Nuisance(f"{channel}.{kind}", kind, side, number)
                for kind, side in _constants("output" if output else "input")
                if (kind, side, number) not in known
            ]
            if extra:
                yield channel, SensedModel(inner, (*own, *extra))

    def _stories(self, before: Before, after: FloatArray) -> Iterator[Story]:
        q = len(before.theta)
        yield Story(-1, self._model, np.ones(q, dtype=bool), after)
        for i in range(q if q > 1 else 0):
            free = np.arange(q) == i
            yield Story(-1, self._model, free, np.where(free, after, before.theta))
        for channel, sensed in self._sensed:
            free = np.arange(len(sensed.nominal)) >= q
            yield Story(channel, sensed, free, np.concatenate([before.theta, sensed.nominal[q:]]))

    def _least(self, story: Story, problem: Problem, gain: Gain, before: Before) -> float:
        """Return the least sum of squares of a window under a story, what was before counted in."""
        q, count = len(before.theta), len(story.start)
        prior = np.zeros((count, count))
        prior[:q, :q] = before.precision(story.free[:q])
        mean = np.concatenate([before.theta, np.zeros(count - q)])
        told = self._told(story, problem)
        z, x0, least = story.start.copy(), np.zeros(gain.L.shape[0]), np.inf
        size = np.concatenate([problem.scale, np.full(count - q, np.inf)])
        for _ in range(STEPS):
            try:
                here = told.at(z, gain, x0)
            except ValueError:
                break  # a step went where the model outgrows the numbers
            squares = here.cost + float((z - mean) @ prior @ (z - mean))
            H = here.psi.T @ here.psi + prior
            if not (np.isfinite(squares) and np.all(np.isfinite(H))):
                break
            g = here.psi.T @ here.e - prior @ (z - mean)
            root = 1.0 / np.sqrt(np.maximum(np.diag(H), 1e-300))
            step = root * np.linalg.lstsq(H * np.outer(root, root), root * g, rcond=1e-13)[0]
            gained = float(g @ step)
            if squares > 1.5 * least:
                break
            least = min(least, squares - gained if gained < 0.01 * squares else squares)
            if gained < 1e-3:
                break
            step = np.clip(step, -0.5 * size, 0.5 * size)
            z, x0 = z + step, x0 + here.e0 + here.e0_by_theta @ step
            z[:q] = np.maximum(z[:q], problem.lower)
        return least

    def _told(self, story: Story, problem: Problem) -> Problem:
        """Return the window with the model of a story."""
        p = self._outputs

        def sample(theta: FloatArray) -> Discrete:
            return discretise(story.model.continuous(theta), self._period_s, self._hold)

        inputs = sample(story.start).model.m
        v = np.hstack([problem.v[:, :p], with_constant(problem.v[:, p:], inputs)])
        return replace(problem, sample=sample, v=v)


def _constants(side: Side) -> Sequence[tuple[Literal["bias", "gain"], Side]]:
    return (("bias", side), ("gain", side))
