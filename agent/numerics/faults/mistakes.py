"""Channels that are wrong from the first sample: what else would explain a record that the model does not.

An encoder that was never zeroed, a sign, a scale or a delay that the configuration does not have leaves a motion that
unknown forces of the right colour would explain as well, at the price of springs that are bent to fit. Each such
mistake is a number or two more, so it is tried before forces are believed (Ljung, System Identification, 2nd ed. 1999,
section 16.5: among models that explain a record the simplest one).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from agent.numerics.faults.frozen import Frozen
from agent.numerics.faults.scale_asked import factor_of_input, factor_of_output
from agent.numerics.faults.skew import DELAY_SCALE_S, DelayedModel, Group
from agent.numerics.faults.suspects import ChannelSuspect
from agent.numerics.fitting.basin import fit_widely
from agent.numerics.fitting.colour import coloured_likelihood
from agent.numerics.fitting.fit import Fit, Problem, linearise
from agent.numerics.fitting.guarded import GuardedProblem
from agent.numerics.model.observer import Gain
from agent.numerics.model.sensors import Nuisance, SensedModel, Side
from agent.numerics.model.statespace import Discrete, Hold, Model, discretise

FloatArray = NDArray[np.float64]
Stages = Sequence[Callable[[Discrete], Gain]]
RECORD = 2048
"""Newest samples on which mistakes are tried: they are gross, and there are a dozen."""
SHARE = 0.75
"""Least share of what the model leaves that a mistake must explain: gross ones explain nearly everything."""
LESS = 0.5
"""The same of a mistake that leaves no more than noise."""
SURE = 6.0
"""Standard deviations that a mistake must be off what it should be."""
LEAST = {"bias": 0.02, "gain": 0.02, "delay": 0.25}
"""Nor smaller than this: an offset over the output's motion, a gain less one, a delay in samples."""
PRICE = 6.0
"""Log likelihood that a mistake must bring for each number that is free in it."""
STEPS = 8
"""Of a fit: one that needs more explains nothing gross."""
EXPLAINED = 1.1
"""Residual variance, in units of the noise, that leaves nothing more to explain."""
NEAR = 0.4
"""Logarithm of a gain that a fit reaches from 1; a larger one is guessed first."""
CLOSE = 0.6
"""Samples of a delay that first order serves for."""
TURNS = 4
"""Fits of one delay at most; each begins where the readings are resampled by what the last one found."""


@dataclass(frozen=True, slots=True)
class Mistake:
    """What explains a record where the model as it is does not.

    Attributes:
        suspect: which channels, and how they are wrong.
        sizes: of each of them, as `ChannelSuspect` says.
        share: of the sum of squares that the model leaves as it is, which the mistake explains.
        whole: it leaves no more than noise, so that nothing else need be looked for.
        likelihood: log likelihood with it, the residual taken as coloured noise, for as many samples as the record has.
    """

    suspect: ChannelSuspect
    sizes: tuple[float, ...]
    share: float
    whole: bool
    likelihood: float


@dataclass(frozen=True, slots=True)
class _Recorded:
    """A record to explain: its problem, its newest samples, where fits begin, and the observer's gains."""

    problem: Problem
    v: FloatArray
    theta: FloatArray
    stages: Stages


@dataclass(frozen=True, slots=True)
class _Trial:
    """A fit with a mistake mended, and its sizes."""

    suspect: ChannelSuspect
    sizes: tuple[float, ...]
    fit: Fit


@dataclass(frozen=True, slots=True)
class Mistakes:
    """The channels of one rig and how they may be wrong.

    Attributes:
        model: the rig's.
        outputs, inputs: how many are measured.
        period_s, hold: of the sampled model.
    """

    model: Model
    outputs: int
    inputs: int
    period_s: float
    hold: Hold

    def frozen(self) -> Frozen:
        """Return what is known at the beginning of channels that stand still."""
        return Frozen(self.outputs, self.inputs, commanded=self.commanded)

    @property
    def commanded(self) -> bool:
        """Whether the inputs are what was commanded, held from sample to sample, and no sensor's readings."""
        return self.hold == "zero"

    def find(
        self, problem: Problem, theta: FloatArray, stages: Stages, sigma: FloatArray,
        known: ChannelSuspect | None = None,
    ) -> Mistake | None:  # fmt: skip
        """Return the mistake that explains most of what a record leaves; None where none explains nearly all of it.

        Args:
            problem: the record; one that lacks readings is not looked at.
            theta: (q,) where fits begin.
            stages: the observer's gains, as for `fit_window`.
            sigma: (p,) unit of the residuals.
            known: what an earlier record gave away; it is tried first.
        """
        if problem.bridge is not None or not self.inputs:
            return None
        record = _Recorded(problem, problem.v[-RECORD:], theta, stages)
        plain = self._fit(record, record.v, self.model, theta)
        if plain is None:
            return None
        left, found = max(float(np.mean(plain.residual**2)), 1e-300), []
        still = np.flatnonzero(np.ptp(record.v[:, : self.outputs], axis=0) == 0).tolist()
        if still and left >= EXPLAINED:
            return _stuck(record.v, still)
        for trial in self._trials(record, known):
            rest = float(np.mean(trial.fit.residual**2))
            least = LESS if rest < EXPLAINED else SHARE if plain.converged else np.inf
            if trial.fit.converged and (share := 1.0 - rest / left) >= least:
                likelihood = _likelihood(trial.fit, sigma, len(problem.v))
                found.append(Mistake(trial.suspect, trial.sizes, share, rest < EXPLAINED, likelihood))
            if rest < EXPLAINED:
                break
        return max(found, key=_worth, default=None)

    def shows(self, problem: Problem, theta: FloatArray, gain: Gain) -> bool:
        """Tell whether channels that are late, offset or mis-scaled, be it by little, show in what a gain leaves.

        problem: a record, theta (q,) its estimate, gain that of the observer there.
        """
        outputs, late = range(self.outputs), tuple(Group((), (r,)) for r in range(self.outputs))
        offsets = [r for r in outputs if not self._estimates("bias", r)]
        scales = [r for r in range(self.outputs + self.inputs) if self.outputs > 1 and not self._estimates("gain", r)]
        added = [Nuisance(f"bias {r}", "bias", "output", r) for r in offsets]
        added += [Nuisance(f"gain {r}", "gain", *self._place(r)) for r in scales]
        inner, known = (
            (self.model.model, self.model.nuisances) if isinstance(self.model, SensedModel) else (self.model, ())
        )
        sensed = SensedModel(inner, (*known, *added))
        right = np.concatenate([theta, np.zeros(len(offsets)), np.ones(len(scales))])
        delayed = np.concatenate([theta, np.zeros(len(late))])
        return self._in_what_is_left(sensed, right, replace(problem, v=self._with_constant(problem.v)), gain) or (
            self._in_what_is_left(DelayedModel(self.model, late, 0), delayed, problem, gain)
        )

    def _in_what_is_left(self, model: Model, theta: FloatArray, problem: Problem, gain: Gain) -> bool:
        """Tell whether the parameters of a model that the rig's own lacks, the last, explain some of what is left."""
        sampled, own = discretise(model.continuous(theta), self.period_s, self.hold).model, len(self.model.parameters)
        here = linearise(sampled, gain, problem.v, np.zeros(sampled.n), problem.bridge)
        columns = here.psi / np.maximum(np.linalg.norm(here.psi, axis=0), 1e-300)
        basis = np.linalg.qr(columns[:, :own])[0]
        left, tested = here.e - basis @ (basis.T @ here.e), columns[:, own:]
        tested = tested - basis @ (basis.T @ tested)
        # a column that is nearly one of the model's own says nothing that is its own
        more = np.linalg.qr(tested[:, np.linalg.norm(tested, axis=0) > 1e-3])[0]
        explained, most = float(np.sum((more.T @ left) ** 2)), SURE**2 + 2.0 * more.shape[1]
        return bool(explained * len(left) > most * float(left @ left))

    def _trials(self, record: "_Recorded", known: ChannelSuspect | None) -> Iterator[_Trial]:
        tried = {"bias": self._biased, "gain": self._gained, "input gain": self._gained, "delay": self._late}
        for suspect in sorted(self._suspects(), key=lambda one: known is None or one.kind != known.kind):
            trial = tried.get(suspect.kind, self._mended)(record, suspect.channels)
            if trial is not None:
                yield trial

    def _suspects(self) -> Iterator[ChannelSuspect]:
        """Everything that may be wrong, the likeliest first."""
        outputs = tuple(range(self.outputs))
        unknown = tuple(r for r in outputs if not self._estimates("bias", r))
        if unknown:
            yield ChannelSuspect("bias", unknown)
        # with one output and one input, turning round the one is turning round the other
        for channel in range(self.outputs + self.inputs if self.outputs + self.inputs > 2 else 1):
            yield ChannelSuspect("sign", (channel,))
        for pair in combinations(outputs, 2):
            yield ChannelSuspect("swap", pair)
        for late in dict.fromkeys([*((r,) for r in outputs), outputs]):
            yield ChannelSuspect("delay", late)
        # beside one output its gain cannot be told from masses
        for channel in range(self.outputs + self.inputs) if self.outputs > 1 else ():
            if not self._estimates("gain", channel):
                yield ChannelSuspect("gain" if channel < self.outputs else "input gain", (channel,))

    def _fit(
        self, record: "_Recorded", v: FloatArray, model: Model, theta: FloatArray, extra: FloatArray | None = None
    ) -> Fit | None:
        """Fit a model whose last parameters, of the sizes `extra`, the rig's own lacks; None without success."""
        sizes = np.zeros(0) if extra is None else extra
        freed = GuardedProblem(
            lambda at: discretise(model.continuous(at), self.period_s, self.hold),
            v,
            np.concatenate([record.problem.scale, sizes]),
            np.concatenate([record.problem.lower, np.full(len(sizes), -np.inf)]),
        )
        with np.errstate(all="ignore"):  # what a wrong explanation does to a fit is its own affair
            try:
                fit = fit_widely(freed, theta, np.zeros(len(model.state_names)), record.stages, STEPS, 1e-3)
            except (ValueError, np.linalg.LinAlgError):
                return None
        return fit if np.all(np.isfinite(fit.residual)) and fit.residual.size else None

    def _sensed(self, kind: Literal["bias", "gain"], side: Side, numbers: Sequence[int]) -> SensedModel:
        """Return the rig's model with one more constant for each of some outputs, or inputs."""
        added = tuple(Nuisance(f"{kind} {r}", kind, side, r) for r in numbers)
        if isinstance(self.model, SensedModel):
            return SensedModel(self.model.model, self.model.nuisances + added)
        return SensedModel(self.model, added)

    def _with_constant(self, v: FloatArray) -> FloatArray:
        """Return readings with the input that is always 1, where the rig's own model has none."""
        return v if isinstance(self.model, SensedModel) else np.hstack([v, np.ones((len(v), 1))])

    def _estimates(self, kind: str, channel: int) -> bool:
        """Tell whether the rig estimates that constant of a channel anyway."""
        known = self.model.nuisances if isinstance(self.model, SensedModel) else ()
        return any((n.kind, n.side, n.number) == (kind, *self._place(channel)) for n in known)

    def _biased(self, record: "_Recorded", outputs: tuple[int, ...]) -> _Trial | None:
        """Fit all offsets at once and blame those that are surely there."""
        v, count = record.v, len(outputs)
        sizes = np.sqrt(np.mean(v[:, outputs] ** 2, axis=0)) + 1e-300
        begin = np.concatenate([record.theta, np.zeros(count)])
        fit = self._fit(record, self._with_constant(v), self._sensed("bias", "output", outputs), begin, sizes)
        if fit is None:
            return None
        wrong = _surely(fit, count, LEAST["bias"] * v[:, outputs].std(axis=0))
        blamed = np.flatnonzero(wrong).tolist()
        channels = ChannelSuspect("bias", tuple(outputs[i] for i in blamed))
        return _Trial(channels, tuple(float(fit.theta[i - count]) for i in blamed), fit) if blamed else None

    def _gained(self, record: "_Recorded", channels: tuple[int, ...]) -> _Trial | None:
        """Divide one channel by the factor that the model asks of it, roughly, and fit the rest of its gain."""
        channel, v = channels[0], record.v.copy()
        asked = self._asked(record, channel)
        v[:, channel] /= asked
        side, number = self._place(channel)
        model = self._sensed("gain", side, (number,))
        fit = self._fit(record, self._with_constant(v), model, np.append(record.theta, 1.0), np.ones(1))
        # an output reads its gain times what moves there, an input is multiplied by its own
        output = side == "output"
        right = 1.0 / asked if output else asked
        if fit is None or not _surely(fit, 1, np.array([LEAST["gain"] * right]), right)[0]:
            return None
        rest = float(fit.theta[-1])
        if not _is_size(fit):
            return None
        suspect = ChannelSuspect("gain" if output else "input gain", channels)
        return _Trial(suspect, (asked * rest if output else asked / rest,), fit)

    def _place(self, channel: int) -> tuple[Side, int]:
        """Return on which side a channel is, and which of them it is there."""
        return ("output", channel) if channel < self.outputs else ("input", channel - self.outputs)

    def _asked(self, record: "_Recorded", channel: int) -> float:
        """Return the factor that the model asks of a channel where a fit from 1 would not come to it."""
        v, p = self._with_constant(record.v), self.outputs
        sampled = discretise(self._sensed("gain", "output", ()).continuous(record.theta), self.period_s, self.hold)
        if channel < p:
            asked = factor_of_output(sampled, v[:, :p], v[:, p:], channel)
        else:
            without = v[:, p:].copy()
            without[:, channel - p] = 0.0
            asked = factor_of_input(sampled, v[:, :p], v[:, p:], without)
        return 1.0 if asked is None or abs(np.log(asked)) < NEAR else asked

    def _mended(self, record: "_Recorded", channels: tuple[int, ...]) -> _Trial | None:
        """Turn one channel round, or exchange two."""
        mended = record.v.copy()
        mended[:, channels] = -mended[:, channels] if len(channels) == 1 else mended[:, channels[::-1]]
        fit = self._fit(record, mended, self.model, record.theta)
        kind = "sign" if len(channels) == 1 else "swap"
        return None if fit is None else _Trial(ChannelSuspect(kind, channels), (), fit)

    def _late(self, record: "_Recorded", outputs: tuple[int, ...]) -> _Trial | None:
        """Fit a delay to first order, take the whole samples of it from the readings, and fit the rest."""
        model, whole, theta = DelayedModel(self.model, (Group((), outputs),), 0), 0, record.theta
        for turn in range(TURNS):
            late = _earlier(record.v, outputs, whole)
            fit = self._fit(record, late, model, np.append(theta, 0.0), np.array([DELAY_SCALE_S]))
            if fit is None:
                return None
            rest = float(fit.theta[-1]) / self.period_s
            if abs(rest) < CLOSE or turn == TURNS - 1 or not abs(whole + rest) < 0.1 * len(record.v):
                return self._lateness(fit, outputs, whole)
            whole, theta = whole + round(rest), fit.theta[:-1]
        return None

    def _lateness(self, fit: Fit, outputs: tuple[int, ...], whole: int) -> _Trial | None:
        """Return what a fit says of readings that were taken `whole` samples later; None where they are not late."""
        found_s = float(fit.theta[-1]) + whole * self.period_s
        sure = _surely(fit, 1, np.array([LEAST["delay"] * self.period_s]), -whole * self.period_s)[0]
        return _Trial(ChannelSuspect("delay", outputs), (found_s,), fit) if sure else None


def _stuck(v: FloatArray, outputs: Sequence[int]) -> Mistake:
    """Return that sensors are stuck: a scale, a sign or a delay would hide it, and the others would be blamed."""
    suspect = ChannelSuspect("stuck", tuple(outputs))
    return Mistake(suspect, tuple(v[-1, outputs].tolist()), share=1.0, whole=True, likelihood=np.inf)


def _worth(mistake: Mistake) -> float:
    """Log likelihood, less what numbers that are free bring anyway."""
    return mistake.likelihood - PRICE * len(mistake.sizes)


def _likelihood(fit: Fit, sigma: FloatArray, samples: int) -> float:
    """Return the log likelihood of so many samples that fit as well as those fitted."""
    return samples / len(fit.residual) * coloured_likelihood(fit.residual, sigma)


def _earlier(v: FloatArray, outputs: tuple[int, ...], samples: int) -> FloatArray:
    """Return readings (N - |samples|, c) with some outputs taken so many samples later, which makes up for a delay."""
    if not samples:
        return v
    count = len(v) - abs(samples)
    moved, kept = (samples, 0) if samples > 0 else (0, -samples)
    shifted = v[kept : kept + count].copy()
    shifted[:, list(outputs)] = v[moved : moved + count, list(outputs)]
    return shifted


def _is_size(fit: Fit) -> bool:
    """Tell whether the gain that a fit ends with is known to be more than nothing: else the channel plays no part."""
    sd = np.sqrt(fit.covariance[-1, -1] * float(np.mean(fit.residual**2)))
    return bool(abs(float(fit.theta[-1])) > SURE * sd)


def _surely(fit: Fit, count: int, least: FloatArray, right: float = 0.0) -> NDArray[np.bool_]:
    """(count,) the last parameters of a fit are off what is right, beyond chance and enough to matter."""
    off = np.abs(fit.theta[-count:] - right)
    variance = np.diag(fit.covariance)[-count:] * float(np.mean(fit.residual**2))
    with np.errstate(invalid="ignore"):
        return np.asarray(np.isfinite(variance) & (off > SURE * np.sqrt(variance)) & (off > least))
