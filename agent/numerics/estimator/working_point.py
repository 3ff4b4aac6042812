"""Where the estimator stands: the parameters it is linearised about, and what is known of the disturbances there."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from agent.numerics.estimator.calibrate import Calibration, Calibrator
from agent.numerics.estimator.window_settings import WindowSettings
from agent.numerics.faults.masses import MassError
from agent.numerics.faults.mistakes import Mistake
from agent.numerics.faults.suspects import mass_suspect
from agent.numerics.faults.verdict import Before
from agent.numerics.fitting.basin import fit_widely
from agent.numerics.fitting.colour import Colour, InputNoise
from agent.numerics.fitting.fit import Fit, Problem, fit_window, nowhere
from agent.numerics.fitting.guarded import GuardedProblem
from agent.numerics.fitting.jitter import Jitter, find_jitter
from agent.numerics.fitting.window_filter import WindowFilter
from agent.numerics.model.observer import Gain, Noise
from agent.numerics.model.sensitivity import sensitivity_filter
from agent.numerics.model.statespace import Discrete, Model, discretise
from agent.numerics.preprocessing.bridge import Bridge
from agent.numerics.window.choice import gate
from agent.numerics.window.commission import Commission
from agent.numerics.window.hops import HopOperators, Segment
from agent.numerics.window.reach import turns
from agent.numerics.window.reference import Reference
from agent.types import Calibrated, Reason

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class WorkingPoint:
    """theta_r with the model, observer and operators built about it; move it by setting theta and `rebuild`.

    Attributes:
        theta: (q,) theta_r.
        scale: (q,) sizes of the parameters.
        noise: of the sensors and of unknown forces.
        colour, commission: what they add to intervals.
        usual_share: the colour's share in undisturbed windows. That of one window is what the gate goes by, and a
            window that holds a movement may have little of it.
        wrong: a mass that explained a record better than unknown forces; None for none. It outlives a fit that failed.
        mistake: what is wrong with channels by the newest fit that learnt the noise; None for nothing.
        jitter: how the noise goes with the speed of the motion; None where nothing shows that.
        settled: noise and theta come from a fit, not from the configuration.
        rounding: (p,) what rounding leaves of each output, by the record that the noise was learnt from.
        discrete, gain, operators: the sampled model, the observer and the lifted filters at theta_r.
        turns: of each longer window the angles (q,) by which parameters turn modes in it (`reach`).
        unknowns: of a window; dof: degrees of freedom that its residual has left.
    """

    def __init__(self, model: Model, settings: WindowSettings) -> None:
        self.model = model
        self.settings = settings
        self.theta = np.array(model.nominal, dtype=float)
        self.scale = np.where(np.isfinite(settings.scale), settings.scale, 1.0)
        masses, mistakes, least = settings.masses, settings.mistakes, settings.least_force
        self.calibrator = Calibrator(settings.gains, settings.sigma, settings.floor, masses, mistakes, least)
        directions = settings.gains.disturbance
        unforced = np.zeros(0 if directions is None else directions.shape[1])
        self.noise = Noise(np.where(np.isfinite(settings.sigma), settings.sigma, 1.0), unforced)
        self.colour = Colour.white(len(self.theta))
        self.usual_share = 1.0
        self.jitter: Jitter | None = None
        self.commission = Commission(np.ones(len(self.theta)))
        self.wrong: MassError | None = None
        self.mistake: Mistake | None = None
        self.settled = False
        self.rounding = np.zeros(len(settings.sigma))
        self.rebuild()
        self.unknowns = self.discrete.model.n + len(self.theta)
        self.dof = self.dof_of(settings.plan.window)

    def calibrated(self, *, searched: bool) -> Calibrated:
        """Return what is known of the disturbances, as plain numbers."""
        factor = tuple(self.commission.factor.tolist()) if self.commission.known else None
        return Calibrated(tuple(self.noise.sigma.tolist()), tuple(self.noise.process.tolist()), factor, searched)

    def adopt(self, known: Calibrated) -> bool:
        """Begin with disturbances that are known, where they are of this rig's size; tell whether they were."""
        sigma, process = np.array(known.sigma), np.array(known.process)
        if (sigma.shape, process.shape) != (self.noise.sigma.shape, self.noise.process.shape):
            return False
        stated = self.settings.sigma
        self.noise = Noise(np.where(np.isfinite(stated), stated, sigma), process)
        if known.factor is not None and len(known.factor) == len(self.theta):
            self.commission.adopt(np.array(known.factor))
        self.rebuild()
        return True

    def forget_adopted(self) -> None:
        """Begin as if nothing had been known of the disturbances."""
        stated = self.settings.sigma
        self.noise = Noise(np.where(np.isfinite(stated), stated, 1.0), np.zeros_like(self.noise.process))
        self.commission = Commission(np.ones(len(self.theta)))
        self.jitter = None
        self.rebuild()

    def refutes_adopted(self, problem: Problem, fit: Fit) -> bool:
        """Tell whether a fit under adopted disturbances says that they are not those of its window.

        Either the window leaves far less than they would have it, or sensor noise alone explains it far better. A
        window that tells nothing of the parameters tells nothing of forces that act while the rig moves either.
        """
        s2 = float(np.mean(fit.residual**2)) if fit.residual.size else 1.0
        sd = np.sqrt(np.diag(fit.covariance) * s2)
        if not (fit.converged and self.noise.forced and np.any(sd < self.settings.enough_sd)):
            return False
        try:
            return s2 < 2.0 - self.gate or self.calibrator.needs_no_force(problem, fit, self.noise)
        except ValueError:
            return False  # without those forces the fit leaves the numbers

    def rebuild(self) -> None:
        """Make observer and operators about theta_r."""
        self.discrete = discrete = self.sampled(self.theta)
        gains = self.settings.gains
        self.gain: Gain = (gains.settled if self.settled else gains.start)(discrete, self.noise)
        system = sensitivity_filter(discrete.model, self.gain.L, self.gain.whitening)
        self.operators = HopOperators(system, self.settings.plan)
        self.turns = [turns(discrete.model, self.gain.L, window) for window in self.settings.longer]
        speed = float(np.max(np.abs(np.angle(np.linalg.eigvals(discrete.model.A)))))
        self._turned = self.settings.plan.window * speed
        self._filters: dict[int, WindowFilter] = {}

    def filter(self, samples: int) -> WindowFilter:
        """Return the filters over whole windows of `samples` samples."""
        if samples not in self._filters:
            self._filters[samples] = WindowFilter(self.discrete.model, self.gain, samples)
        return self._filters[samples]

    @property
    def n(self) -> int:
        """States."""
        return self.discrete.model.n

    @property
    def outputs(self) -> int:
        """Channels that are outputs."""
        return len(self.noise.sigma)

    @property
    def doubt(self) -> float:
        """2 where the reference of residuals was learnt from a window, which is as uncertain as any other."""
        return 2.0 if self.calibrator.learns else 1.0

    @property
    def gate(self) -> float:
        """Largest residual variance, in units of the reference, of an undisturbed window."""
        return float(gate(self.dof, self.doubt, self.colour.share))

    def gate_of(self, window: int) -> float:
        """Largest residual variance, in units of the reference, of an undisturbed window of that many samples."""
        return float(gate(self.dof_of(window), self.doubt, self.colour.share))

    @property
    def usual_gate(self) -> float:
        """The same by the colour that residuals have in undisturbed windows."""
        return float(gate(self.dof, self.doubt, self.usual_share))

    @property
    def widening(self) -> FloatArray:
        """(q,) honest sd over what white noise would have it."""
        return np.asarray(self.colour.inflation * self.commission.factor)

    @property
    def floor_ratio(self) -> float:
        """Least residual variance that the wire and arithmetic allow, in units of the reference."""
        rounding = self.rounding if self.calibrator.learns else 0.0
        return float(np.mean((np.maximum(self.settings.floor, rounding) / self.noise.sigma) ** 2))

    @property
    def exact(self) -> bool:
        """Whether what the model leaves is no more than rounding, which says nothing of what it may lack."""
        return self.calibrator.learns and bool(np.all(self.noise.sigma <= 1.01 * self.rounding))

    @property
    def negligible(self) -> FloatArray:
        """(q,) changes below this do not matter to the linearisation.

        Without correction the observer feels more: its phase runs away with the angle that a mode turns in a window.
        """
        size = np.maximum(np.abs(self.theta), 0.1 * self.scale)
        if self.gain.L.any():
            return np.asarray(0.02 * size)
        return np.asarray(0.02 * float(np.clip(2.0 / max(self._turned, 1e-9), 0.25, 1.0)) * size)

    def ratio(self, s2: FloatArray, segment: Segment, index: IntArray, window: int) -> FloatArray:
        """Residual variance s2 (N,) of windows whose newest samples are index (N,), over what their speed explains."""
        jitter = self._jitter()
        if jitter is None:
            return s2
        return jitter.ratio(s2, segment.v, index - segment.first, window)

    def _jitter(self) -> Jitter | None:
        """What is known of jitter beside the noise that is assumed now; None where that is another than it was."""
        same = self.jitter is not None and np.array_equal(self.jitter.sigma, self.noise.sigma)
        return self.jitter if same and not self.noise.forced else None

    def learn_jitter(self, residual: FloatArray, v: FloatArray) -> None:
        """Learn from what a fit of samples v (W, p+m) left (W, p) how the noise goes with the speed."""
        if not self.noise.forced:
            sigma, stated = self.noise.sigma, np.isfinite(self.settings.sigma)
            y, period = v[:, : self.outputs], self.settings.period_s
            self.jitter = find_jitter(residual, y, sigma, stated, period, self._jitter())

    def varying(self, residual: FloatArray, v: FloatArray) -> FloatArray | None:
        """Variance (W, p) of the readings of a window v (W, p+m) that left residual (W, p); None where it stays."""
        jitter = self._jitter()
        return None if jitter is None else jitter.variances(residual, v[:, : self.outputs])

    def dof_of(self, window: int, free: int = 0) -> float:
        """Degrees of freedom of the residual of `window` samples, `free` of them spent on missing readings."""
        return max(float(window * self.outputs - self.unknowns - free), 1.0)

    def sampled(self, theta: FloatArray) -> Discrete:
        """Return the sampled model at theta (q,)."""
        return discretise(self.model.continuous(theta), self.settings.period_s, self.settings.hold)

    def kept(self) -> Callable[[], None]:
        """Return what puts parameters and disturbances back as they are now; observer and operators stay."""
        before = (self.theta, self.noise, self.settled, self.colour, self.jitter)

        def restore() -> None:
            self.theta, self.noise, self.settled, self.colour, self.jitter = before

        return restore

    def take_sizes(self, v: FloatArray) -> None:
        """Take the size of each parameter that has none from its channel in a window v (W, p+m)."""
        if self.settings.scale_column is None:
            return
        rms = np.sqrt(np.mean(v**2, axis=0))[self.settings.scale_column]
        self.scale = np.where(np.isfinite(self.settings.scale), self.settings.scale, np.maximum(rms, 1e-300))

    def problem(self, v: FloatArray, bridge: Bridge | None) -> Problem:
        """Return the problem of fitting samples v (W, p+m), some of them perhaps missing."""
        return GuardedProblem(self.sampled, v, self.scale, self.settings.lower, bridge)

    def maximise(self, problem: Problem, theta: FloatArray, *, afresh: bool, near: bool) -> Fit:
        """Fit a window from theta (q,); afresh also learns what disturbs it, near needs no wide basin.

        A fit that leaves the numbers, or finds no gain that keeps the observer among them, did not converge.
        """
        try:
            return self._maximised(problem, theta, afresh=afresh, near=near)
        except ValueError:
            self.mistake = None
            return nowhere(problem, theta, np.zeros(self.n))

    def _maximised(self, problem: Problem, theta: FloatArray, *, afresh: bool, near: bool) -> Fit:
        if afresh:
            known = None if self.mistake is None else self.mistake.suspect
            calibration = self.calibrator.calibrate(problem, theta, known)
            self.noise, self.wrong = calibration.noise, self._confirmed(calibration, problem)
            self.rounding = self.calibrator.rounding(problem.v)
            self.jitter = None
            self.mistake = self._unrivalled(calibration, problem)
            return calibration.fit
        self.mistake = None
        gains, noise = self.settings.gains, self.noise
        stages = [lambda discrete: gains.start(discrete, noise), lambda discrete: gains.settled(discrete, noise)]
        x0 = np.zeros(self.n)
        fit = fit_window(problem, theta, x0, stages[1:]) if near else fit_widely(problem, theta, x0, stages)
        # from far away, or in a window that says little, the steps may not have sufficed
        return fit if fit.converged else fit_window(problem, fit.theta, fit.x0, stages[1:])

    def recalibrated(self, problem: Problem, past: Reference) -> Noise | None:
        """Calibrate a record that nothing explains as at a first start, the rig being what it was before.

        past: what the windows before said. Returns the disturbances that explain the record, None where there are none
        or where something else may as well: other parameters, wrong channels or masses, or what the model lacks.
        """
        calibration = self.calibrator.calibrate(problem, self.theta)
        fit, noise = calibration.fit, calibration.noise
        self.wrong, self.mistake = self._confirmed(calibration, problem), self._unrivalled(calibration, problem)
        if not fit.converged or calibration.wrong is not None or calibration.mistake is not None:
            return None
        if not (noise.forced or self.calibrator.learns):
            return None
        if not Before.of(past, self.scale, self.theta).agrees(fit.theta, fit.covariance):
            return None
        gain, suspects = self.settings.gains.settled(self.sampled(fit.theta), noise), self.settings.suspects
        samples = float(fit.residual.size)
        if suspects is not None and suspects.accuse(fit.theta, gain, problem.v, samples, problem.bridge, least=0.0):
            return None
        mistakes = self.settings.mistakes
        return None if mistakes is not None and mistakes.shows(problem, fit.theta, gain) else noise

    def _confirmed(self, calibration: Calibration, problem: Problem) -> MassError | None:
        """Return the wrong mass that a calibration found, unless the model lacks something that explains more."""
        wrong, fit, suspects = calibration.wrong, calibration.fit, self.settings.suspects
        if wrong is None or suspects is None:
            return wrong
        gain = self.settings.gains.settled(self.sampled(fit.theta), calibration.noise)
        chief = suspects.accuse(fit.theta, gain, problem.v, float(fit.residual.size), problem.bridge, least=0.0)
        return wrong if chief is None or chief.suspect == mass_suspect(wrong.name) else None

    def _unrivalled(self, calibration: Calibration, problem: Problem) -> Mistake | None:
        """Return the mistake that a calibration found, unless friction or a bent spring explains as much."""
        mistake, fit, suspects = calibration.mistake, calibration.fit, self.settings.suspects
        if mistake is None or mistake.whole or suspects is None or not np.all(np.isfinite(fit.theta)):
            return mistake
        gain = self.settings.gains.settled(self.sampled(fit.theta), calibration.noise)
        chief = suspects.accuse(fit.theta, gain, problem.v, float(fit.residual.size), problem.bridge)
        shaped = chief is not None and chief.suspect.reason in (Reason.DRY_FRICTION, Reason.NONLINEAR)
        return None if chief is not None and shaped and chief.share > mistake.share else mistake

    def input_noise(self, discrete: Discrete, gain: Gain, samples: int) -> InputNoise | None:
        """What noise of measured inputs adds to residuals; None where none is known."""
        sd = self.settings.input_sd
        return None if sd is None else InputNoise.of(discrete.model, gain, sd, samples)
