"""The first fit of a rig: parameters, sensor noise and unknown forces from one record.

At nominal parameters the search for unknown forces takes model error for noise, so it alternates with fits of theta.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from agent.numerics.faults.frozen import standing
from agent.numerics.faults.masses import MassError, Masses
from agent.numerics.faults.mistakes import Mistake, Mistakes
from agent.numerics.faults.suspects import ChannelSuspect
from agent.numerics.fitting.basin import fit_widely
from agent.numerics.fitting.colour import coloured_likelihood
from agent.numerics.fitting.fit import Fit, Problem, fit_window
from agent.numerics.fitting.noise import EVIDENCE, Record, find_process, likelihood, sensor_noise, share_of_motion
from agent.numerics.model.gains import Gains
from agent.numerics.model.observer import Gain, Noise
from agent.numerics.model.statespace import Discrete

FloatArray = NDArray[np.float64]
ROUND_OFF = 1e-10
"""Noise no larger than this share of the signal is taken for rounding, which a window's sums make the larger."""
QUIET = 1.21
"""A residual variance up to this over what the sensors' noise explains needs no unknown force."""
FAR = 3.0
"""Forces this many times weaker or stronger than assumed are other forces."""
MOST_FORCED = 0.5
"""Share of the motion that unknown forces may cause beside measured ones: estimates would rest on what is assumed."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """What a record says.

    Attributes:
        fit: of the parameters.
        noise: the disturbances under which it was made.
        wrong: a mass that would explain what neither they nor noise do; None where none does.
        mistake: what is wrong with channels, so that the fit says nothing; None where that is not known.
    """

    fit: Fit
    noise: Noise
    wrong: MassError | None = None
    mistake: Mistake | None = None


@dataclass(frozen=True, slots=True)
class Calibrator:
    """Fits records of a rig.

    Attributes:
        gains: the observer's rule.
        stated: (p,) noise sd of each output where it is known, NaN where it is to be learnt.
        floor: (p,) least sd that the wire's resolution allows.
        masses: those that the model takes as known; None for a rig without.
        mistakes: how channels may be wrong; None to believe them.
        least: (d,) unknown forces that are there in any case beside a stated noise; None for none.
    """

    gains: Gains
    stated: FloatArray
    floor: FloatArray
    masses: Masses | None = None
    mistakes: Mistakes | None = None
    least: FloatArray | None = None

    @property
    def learns(self) -> bool:
        """Whether some output's noise is to be learnt."""
        return not bool(np.all(np.isfinite(self.stated)))

    def first_noise(self, v: FloatArray) -> Noise:
        """Return the noise to begin with: as stated, else what the record's fastest differences show."""
        y = v[:, : len(self.stated)]
        guess = np.maximum(sensor_noise(y), self._least(v))
        directions = self.gains.disturbance
        count = 0 if directions is None else directions.shape[1]
        return Noise(np.where(np.isfinite(self.stated), self.stated, guess), np.zeros(count))

    def _least(self, v: FloatArray) -> FloatArray:
        return np.asarray(np.maximum(self.floor, self.rounding(v)))

    def rounding(self, v: FloatArray) -> FloatArray:
        """Return what rounding may leave of each output (p,) in a record v (N, p+m)."""
        peak = np.abs(v[:, : len(self.stated)]).max(axis=0)
        # an output that is nothing at all is no finer than the others, or its weight would outgrow the numbers
        return np.asarray(np.where(peak > 0, ROUND_OFF * peak, ROUND_OFF * max(float(peak.max()), 1e-100)))

    def calibrate(self, problem: Problem, theta: FloatArray, known: ChannelSuspect | None = None) -> Calibration:
        """Fit a record from theta (q,): without unknown forces where that explains it, else with those found.

        known: what was found wrong with channels before; it is looked for first.
        """
        found = self._calibrated(problem, theta, known)
        noise = self._with_least(found.noise)
        if noise is found.noise or found.mistake is not None or not found.fit.converged:
            return found
        fit = fit_window(problem, found.fit.theta, found.fit.x0, [lambda discrete: self.gains.settled(discrete, noise)])
        return replace(found, fit=fit, noise=noise)

    def _quiet(self, noise: Noise) -> Noise:
        return self._with_least(replace(noise, process=np.zeros_like(noise.process)))

    def _with_least(self, noise: Noise) -> Noise:
        if self.least is None or self.learns or self.gains.disturbance is None:
            return noise
        return replace(noise, process=np.maximum(noise.process, self.least))

    def _calibrated(self, problem: Problem, theta: FloatArray, known: ChannelSuspect | None) -> Calibration:
        noise = self.first_noise(problem.v)
        x0 = np.zeros(problem.sample(theta).model.n)
        quiet = fit_widely(problem, theta, x0, self._stages(noise))
        # a fit that found no maximum but leaves nothing to explain (standstill) is no reason to search either
        explained = float(np.mean(quiet.residual**2)) < QUIET
        if explained:
            return self._learnt(problem, quiet, noise)
        # coloured sensor noise and a wrong mass are other explanations: unknown forces must beat them
        coloured = coloured_likelihood(quiet.residual, noise.sigma) if quiet.converged else -np.inf
        # beside a fit that found no maximum anything would seem to explain much
        wrong = self._wrong_mass(problem, quiet, noise, self._stages(noise), coloured) if quiet.converged else None
        if self.gains.disturbance is None:
            return replace(self._learnt(problem, quiet, noise), wrong=wrong)
        bar = coloured if wrong is None else wrong.likelihood
        mistake = self._mistake(problem, theta, noise, -np.inf if wrong is None else wrong.likelihood, known)
        if mistake is not None and mistake.whole:
            return Calibration(quiet, noise, mistake=mistake)
        mistake = mistake if mistake is not None and mistake.likelihood > bar + EVIDENCE else None
        bar = bar if mistake is None else mistake.likelihood
        # the wide-basin gain alone: without correction a disturbed rig may not have converged at all
        try:
            wide = fit_window(problem, theta, x0, [self._start(noise)])
            begin = wide if wide.converged or not quiet.converged else quiet
            forced = self._alternate(problem, begin, noise, self.gains.disturbance, bar)
        except ValueError:
            forced = None  # under those forces the fit left the numbers
        if forced is not None:
            share = self._share(problem, forced.fit.theta, forced.noise)
            if share <= MOST_FORCED:
                return forced
            mistake = Mistake(ChannelSuspect("forces", self._resting(problem.v)), (share,), share, False, bar)
        wrong = wrong if mistake is None else None
        return replace(self._learnt(problem, quiet, noise), wrong=wrong, mistake=mistake)

    def _mistake(
        self, problem: Problem, theta: FloatArray, noise: Noise, without: float, known: ChannelSuspect | None
    ) -> Mistake | None:
        """Return what is wrong with channels where it explains a record decisively better than a log likelihood."""
        if self.mistakes is None:
            return None
        mistake = self.mistakes.find(problem, theta, self._stages(noise), noise.sigma, known)
        return mistake if mistake is not None and mistake.likelihood > without + EVIDENCE else None

    def _share(self, problem: Problem, theta: FloatArray, noise: Noise) -> float:
        """Return how much of the motion unknown forces cause; 0 where no force is measured, as they cause all of it."""
        directions = self.gains.disturbance
        if directions is None or self.mistakes is None or not self.mistakes.inputs:
            return 0.0
        return share_of_motion(problem.sample(theta), directions, noise, problem.v)

    def _resting(self, v: FloatArray) -> tuple[int, ...]:
        """Return the measured inputs of a record v (N, p+m) where none of them ever moves; else none."""
        p = len(self.stated)
        sensors = 0 if self.mistakes is None or self.mistakes.commanded else self.mistakes.inputs
        rest = standing(v[:, p : p + sensors])
        return tuple(range(p, p + len(rest))) if rest.all() else ()

    def _wrong_mass(
        self, problem: Problem, fit: Fit, noise: Noise, stages: Sequence[Callable[[Discrete], Gain]], without: float
    ) -> MassError | None:
        """Return the mass that would explain a record decisively better than a log likelihood `without` it."""
        if self.masses is None:
            return None
        wrong = self.masses.wrong(problem, fit, stages, noise.sigma)
        return wrong if wrong is not None and wrong.likelihood > without + EVIDENCE else None

    def _start(self, noise: Noise) -> Callable[[Discrete], Gain]:
        return lambda discrete: self.gains.start(discrete, noise)

    def _stages(self, noise: Noise) -> list[Callable[[Discrete], Gain]]:
        return [self._start(noise), lambda discrete: self.gains.settled(discrete, noise)]

    def _learnt(self, problem: Problem, fit: Fit, noise: Noise) -> Calibration:
        """Take the residual of each output whose noise is unknown for its noise, and fit again."""
        if not self.learns:
            return Calibration(fit, noise)
        for _ in range(2):
            unknowns = fit.residual.shape[0] * fit.residual.shape[1] - len(fit.theta) - len(fit.x0)
            share = max(unknowns / max(fit.residual.size, 1), 0.1)
            seen = np.sqrt(np.mean(fit.residual**2, axis=0) / share) * noise.sigma
            sigma = np.where(np.isfinite(self.stated), self.stated, np.maximum(seen, self._least(problem.v)))
            noise = replace(noise, sigma=sigma)
            fit = fit_window(problem, fit.theta, fit.x0, self._stages(noise)[1:])
        return Calibration(fit, noise)

    def _alternate(
        self, problem: Problem, fit: Fit, noise: Noise, disturbance: FloatArray, coloured: float
    ) -> Calibration | None:
        """Search forces and fit theta, twice; None where coloured sensor noise explains the record as well."""
        known = not self.learns
        for turn in range(2):
            discrete, record = problem.sample(fit.theta), Record(problem.v, fit.x0, problem.bridge)
            # at the first turn theta is rough and the likelihood of forces only a lower bound of what they can do; at
            # the second a coarse scan may step over the narrow peak of a long record, on which the first turn stands
            clear = not turn or self._value(problem, fit, noise) > coloured + EVIDENCE
            bar = None if clear else coloured + EVIDENCE
            searched = find_process(
                discrete, disturbance, noise.sigma, record, scale_known=known, unless_above=bar, roughly=not turn
            )
            if searched is None:
                return None
            noise = searched[0]

            def matched(discrete: Discrete, found: Noise = noise) -> Gain:
                return self.gains.settled(discrete, found)

            fit = fit_window(problem, fit.theta, fit.x0, [matched])
        discrete, record = problem.sample(fit.theta), Record(problem.v, fit.x0, problem.bridge)
        value = likelihood(discrete, matched(discrete), record, scale_known=known).value
        worth = value - coloured > EVIDENCE * np.count_nonzero(noise.process)
        if not (fit.converged and worth):
            return None
        # forces beside a wrong mass hide it: it still shows in what they leave
        without = coloured_likelihood(fit.residual, noise.sigma)
        return Calibration(fit, noise, self._wrong_mass(problem, fit, noise, [matched], without))

    def needs_no_force(self, problem: Problem, fit: Fit, noise: Noise) -> bool:
        """Tell whether a record is decisively likelier without the unknown forces under which it was fitted."""
        quiet = self._quiet(noise)
        alone = fit_window(problem, fit.theta, fit.x0, self._stages(quiet))
        return alone.converged and self._value(problem, alone, quiet) > self._value(problem, fit, noise) + EVIDENCE

    def doubts(self, problem: Problem, theta: FloatArray, noise: Noise) -> bool:
        """Tell whether a window at theta (q,) is likelier with far weaker or stronger forces: a search is due."""
        discrete = problem.sample(theta)
        record, known = Record(problem.v, np.zeros(discrete.model.n), problem.bridge), not self.learns

        def value(factor: float) -> float:
            gain = self.gains.settled(discrete, replace(noise, process=factor * noise.process))
            return likelihood(discrete, gain, record, scale_known=known).value

        return max(value(1.0 / FAR), value(FAR)) > value(1.0) + 0.5 * EVIDENCE

    def _value(self, problem: Problem, fit: Fit, noise: Noise) -> float:
        """Return the log likelihood of a record under a fit and the disturbances that it was made under."""
        discrete, record = problem.sample(fit.theta), Record(problem.v, fit.x0, problem.bridge)
        return likelihood(discrete, self.gains.settled(discrete, noise), record, scale_known=not self.learns).value

    def forces_in(self, problem: Problem, theta: FloatArray, noise: Noise) -> Noise | None:
        """Return disturbances that explain a longer record decisively better than what is assumed, else None."""
        if self.gains.disturbance is None:
            return None
        x0 = np.zeros(problem.sample(theta).model.n)
        # theta_r comes from one window: over many, its error would look like a force
        fit = fit_window(problem, theta, x0, self._stages(noise)[1:])
        if not fit.converged:
            return None
        without = None
        if noise.forced and self.needs_no_force(problem, fit, noise):
            without = noise = self._quiet(noise)
            fit = fit_window(problem, fit.theta, fit.x0, self._stages(noise))
        discrete, record, known = problem.sample(fit.theta), Record(problem.v, fit.x0, problem.bridge), not self.learns
        assumed = self._value(problem, fit, noise)
        coloured = coloured_likelihood(fit.residual, noise.sigma) if not noise.forced else assumed
        bar = max(assumed, coloured)
        wrong = self._wrong_mass(problem, fit, noise, self._stages(noise)[1:], bar)
        bar = bar if wrong is None else max(bar, wrong.likelihood)
        searched = find_process(
            discrete, self.gains.disturbance, noise.sigma, record, scale_known=known, unless_above=bar + 0.5 * EVIDENCE
        )
        if searched is None or searched[1] - bar <= EVIDENCE * np.count_nonzero(searched[0].process):
            return without
        return self._with_least(searched[0]) if self._share(problem, fit.theta, searched[0]) <= MOST_FORCED else None
