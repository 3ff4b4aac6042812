"""One window through the whole model: linearise, test for a change, learn the noise, weigh the constants.

window -> Gauss-Newton about θ_r -> jump? unexplained? -> noise -> hypotheses on the constants -> posterior
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from agent.numerics.inference import tuning
from agent.numerics.inference.algebra import inverse, quadratic, refined, scales, shown
from agent.numerics.inference.bins import Bins
from agent.numerics.inference.columns import Layout, Regression, Regressor, Window
from agent.numerics.inference.constants import Constants, hypotheses_of
from agent.numerics.inference.covariance import Cells, HighPower, inverse_of
from agent.numerics.inference.ends import Ends
from agent.numerics.inference.friction import column, friction
from agent.numerics.inference.mixture import NORMAL_975, interval95
from agent.numerics.inference.noise import Noise, NoiseFit, Ridge, chance, layout_free, learn, louder
from agent.numerics.inference.response import Response
from agent.numerics.inference.scatter import Scatter, block_grams, block_ratio
from agent.numerics.inference.sources import directions, sources_of
from agent.numerics.model.uncertain import Rig, sampled, unit_of

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
ComplexArray = NDArray[np.complex128]

FIRM = 1e6
"""Times as many degrees of freedom behind the level of each bin as were seen: one window moves none."""


@dataclass(frozen=True)
class Knowledge:
    """What is carried from window to window.

    Attributes:
        theta: (q,) where the model is linearised;  eta: (c,) likewise for the constants.
        noise, constants, scatter: what has been learnt.
        kept: bins kept with all columns; 0 until a window has shown how many are needed.
        unexplained: the newest window was not explained by the noise known before.
    """

    theta: FloatArray
    eta: FloatArray
    noise: Noise
    constants: Constants
    scatter: Scatter
    kept: int = 0
    unexplained: bool = False


@dataclass(frozen=True)
class Posterior:
    """What one window says.

    Attributes:
        theta, lower, upper: (q,) mean and 95 % interval, the constants' uncertainty in it.
        sd: (q,) that of the Gaussian with as wide an interval: a hypothesis of 1 % weight does not double it.
        linear: (q,) mean of the one Gaussian that has mean and covariance of the hypotheses that stand.
        sd_repeat: (q,) standard deviation against another window of the same rig: the constants taken as they are.
        sensitivity: (q, c) change of θ by a change of each constant.
        converged: Gauss-Newton came to rest.
        jump: (cuts,) twice the log likelihood ratio of a jump at each cut; jump_raw: not divided by the misfit.
        excess: predictive standard deviations by which the residual's power is too large;  beyond_jump: the same of
            what the best jump leaves.
        changing: a jump fits beyond what chance allows.
        dof: degrees of freedom of the residual.
        rubs: dry friction that the model has no term for is evident, and moves an estimate by more than its sd.
    """

    theta: FloatArray
    sd: FloatArray
    lower: FloatArray
    upper: FloatArray
    linear: FloatArray
    sd_repeat: FloatArray
    sensitivity: FloatArray
    converged: bool
    jump: FloatArray
    jump_raw: FloatArray
    excess: float
    beyond_jump: float
    changing: bool
    dof: float
    rubs: bool = False

    @property
    def mismatch(self) -> bool:
        """Whether the residual's power is not explained by what the noise may be."""
        return self.excess > tuning.MISMATCH_SD


@dataclass(frozen=True)
class Line:
    """What one window says if each of its parameters runs a straight line through it.

    Attributes:
        end: what it says of its end; `changing`: one jump of all parameters explains it better.
        middle: (q,) where they are at its middle.
        moves: some line is more than chance.
    """

    end: Posterior
    middle: FloatArray
    moves: bool

    @property
    def holds(self) -> bool:
        """Whether lines explain the window, and better than anything that jumps once."""
        end = self.end
        return end.converged and not end.mismatch and not end.changing and self.moves


@dataclass(frozen=True, slots=True)
class Linearised:
    """A window at the end of Gauss-Newton.

    Attributes:
        theta: (q,) the point;  unit: (q,) size of a deviation of 1.
        regression, cells, regressor: the window there.
        G: Gram of all columns, residual last;  Si: S⁻¹;  ridge: the prior;  converged: it came to rest.
    """

    theta: FloatArray
    unit: FloatArray
    regression: Regression
    cells: Cells
    G: FloatArray
    Si: ComplexArray
    ridge: Ridge
    converged: bool


class Learner:
    """Learns from windows of one rig and one length.

    Args:
        rig: what is modelled.
        window: W, samples.
        outputs: p.
        floor: (p,) sensor sd that the wire's resolution alone causes.
    """

    def __init__(self, rig: Rig, window: int, outputs: int, floor: FloatArray) -> None:
        self.rig, self.window, self.p = rig, window, outputs
        self.log_floor = np.log(np.maximum(floor, 1e-300))
        self.sources = sources_of(rig, window, outputs)
        self.hypotheses = hypotheses_of(rig.constants)
        self.cuts = np.unique(np.round(np.array(tuning.CUTS) * window).astype(np.int64))
        self.threshold = float(chdtri(rig.q, tuning.JUMP_LEVEL))
        self._response: Response | None = None
        self._cells: tuple[FloatArray, Cells] | None = None

    def prior(self, sigma: FloatArray, spread: FloatArray) -> Knowledge:
        """Return what is known before the first window; sigma (p,) stated or guessed, spread (p,) of its logarithm."""
        rig, c = self.rig, len(self.rig.constants)
        total = self.window // 2 + 1
        noise = Noise.prior(np.maximum(sigma, np.exp(self.log_floor)), spread, total, len(self.sources), rig.q)
        return Knowledge(rig.nominal.copy(), np.zeros(c), noise, Constants.prior(self.hypotheses), Scatter.prior(rig.q))

    def spread(self, noise: Noise) -> FloatArray:
        """Return the sd (p,) of each output's readings where nothing moves: white and coloured noise of its sensor."""
        variance = np.exp(2 * noise.log_sigma)
        for source, intensity in zip(self.sources, noise.intensity, strict=True):
            if source.kind == "sensor":
                variance[source.number] += intensity**2
        return np.asarray(np.sqrt(variance))

    # ------------------------------------------------------------------ the way through one window
    def learn(
        self, window: Window, known: Knowledge, shaken: bool = False, believe: bool = False
    ) -> tuple[Posterior, Knowledge]:
        """Return what a window says and what is known after it; a window that changes teaches nothing.

        shaken: σ may have changed more than usual. believe: it holds no change, whatever the jump test says.
        """
        known = self._prepared(window, known)
        predicted = replace(known, constants=known.constants.predicted())
        at = self._linearised(window, predicted, jumps=known.noise.is_started)
        posterior = self._posterior(at, predicted)
        if (posterior.changing and not believe) or not posterior.converged:
            return posterior, known
        for _ in range(tuning.ROUNDS):
            noise, settled = self._noise_after(window, at, predicted, shaken or known.unexplained)
            constants = self._constants_after(settled, predicted)
            moved = np.abs(constants.expected - predicted.eta) > tuning.FAR_TOLERANCES * self._eta_tolerance()
            if not moved.any():
                break
            # the constants are elsewhere: the model is made straight there before anything is believed
            predicted = replace(predicted, eta=constants.expected, theta=at.theta)
            at = self._linearised(window, replace(predicted, constants=constants), jumps=False)
        ratio = self._ratio(settled)
        _, _, alone, V, _ = self._eliminated(settled)
        unit = settled.unit
        scatter = known.scatter.after(ratio, settled.theta + unit * alone, unit**2 * np.diag(V))
        learnt = replace(predicted, theta=self._nearer(settled, known.theta), noise=noise, scatter=scatter)
        posterior = replace(
            self._posterior(settled, replace(learnt, constants=predicted.constants), constants),
            jump=posterior.jump, jump_raw=posterior.jump_raw, excess=posterior.excess,
            beyond_jump=posterior.beyond_jump,
        )  # fmt: skip
        posterior = replace(posterior, rubs=self._rubs(settled, learnt, posterior))
        return posterior, replace(learnt, constants=constants, unexplained=posterior.mismatch)

    def _rubs(self, at: Linearised, known: Knowledge, posterior: Posterior) -> bool:
        """Whether dry friction across some damper is evident and would move an estimate by more than its sd."""
        layout = at.regression.layout
        gain = Regressor(self.rig, at.cells.response, self.sources, known.eta).output_gain
        misfit = max(1.0, float(known.scatter.within.max()))
        for rubbing in self.rig.rubbings:
            more = column(at.cells.response, at.regression.states, rubbing, gain)[..., None]
            X = np.concatenate([at.regression.X[..., : layout.base], more, at.regression.X[..., -1:]], axis=2)
            found = friction(at.cells.gram(at.Si, X), at.ridge.R, at.ridge.b, layout.psi, posterior.dof, misfit)
            moved = np.abs(at.unit * found.shift) > posterior.sd
            if found.evidence > tuning.FRICTION_EVIDENCE and moved.any():
                return True
        return False

    def _noise_after(self, window: Window, at: Linearised, known: Knowledge, shaken: bool) -> tuple[Noise, Linearised]:
        """The noise learnt from a linearised window, and the window under it."""
        wide = self._ridge(at.regression.layout, window, self._wide(), -known.eta)
        least = self._least(known.noise)
        noise, fit = learn(known.noise, at.cells, at.regression, self.sources, wide, at.ridge, least, shaken)
        return replace(noise, log_sigma=np.maximum(noise.log_sigma, self.log_floor)), self._without_jumps(at, fit)

    def _least(self, noise: Noise) -> FloatArray:
        """(p,) least that log σ may turn out to be: what is stated, or where nothing is, what the wire resolves."""
        spread = np.sqrt(noise.log_sigma_var)
        unknown = spread > tuning.SIGMA_UNKNOWN
        return np.where(unknown, np.maximum(self.log_floor, noise.log_sigma - 2 * spread), noise.log_sigma)

    def solve(self, window: Window, known: Knowledge, steps: int = tuning.STEPS) -> tuple[Posterior, FloatArray]:
        """Return what a window says under what is known, and where it came to rest; nothing is learnt."""
        at = self._linearised(window, known, jumps=known.noise.is_started, steps=steps)
        return self._posterior(at, known), at.theta

    def at_point(self, window: Window, known: Knowledge, jumps: bool = False) -> Linearised:
        """Return a window linearised at what is known, wherever its own best parameters are."""
        return self._point(window, known, known.theta, self.cuts if jumps else np.zeros(0, dtype=np.int64))

    def lost_readings(self, window: Window, known: Knowledge, moved: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what the filled-in readings of a window are wrong by (l,), and the covariance of that (l, l).

        moved (l,): what the window is filled with beyond the mean of the prior.
        """
        at = self._linearised(window, known, jumps=False, steps=2)
        layout = at.regression.layout
        V = inverse(at.G[: layout.base, : layout.base] + at.ridge.R)
        pull = at.ridge.b.copy()
        pull[layout.gaps] -= moved / window.lost_sd**2
        found = V @ (at.G[: layout.base, -1] + pull)
        return found[layout.gaps], V[layout.gaps, layout.gaps]

    def contested(self, window: Window, known: Knowledge, posterior: Posterior) -> bool:
        """Whether a change of the noise explains a window as well as a jump of the parameters does."""
        at = self._linearised(window, known, jumps=False)
        wide = self._ridge(at.regression.layout, window, self._wide(), -known.eta)
        before, fit = self._open_minded(at, known, wide)
        gain = fit.restricted_log_likelihood() - before
        q, dof = self.rig.q, posterior.dof
        price = 0.5 * q * np.log(dof) + np.log(len(self.cuts))
        return bool(gain > 0.5 * posterior.jump_raw.max() - price)

    def other_noise(self, window: Window, known: Knowledge) -> Noise:
        """Return the noise that explains a window best at the point known; single bins stay as they are.

        A level of its own for a bin would take an offset for the noise of bin 0.
        """
        mean, P = known.constants.standing
        at = self.at_point(window, known)
        ridge = self._ridge(at.regression.layout, window, P, mean - known.eta)
        noise = known.noise
        firm = replace(noise, power=FIRM * noise.power, dof=FIRM * noise.dof)
        _, fit = self._open_minded(at, replace(known, noise=firm), ridge)
        return replace(noise, log_sigma=np.maximum(fit.log_sigma, self.log_floor), intensity=fit.intensity)

    def _open_minded(self, at: Linearised, known: Knowledge, ridge: Ridge) -> tuple[float, NoiseFit]:
        """Restricted log likelihood of a window under the noise known, and the fit of whatever noise explains it."""
        before = NoiseFit(known.noise, at.cells, at.regression, self.sources, ridge).restricted_log_likelihood()
        open_minded = replace(known.noise, log_weight=0.1 * known.noise.log_weight, windows=min(known.noise.windows, 1))
        least = self._least(known.noise)
        _, fit = learn(open_minded, at.cells, at.regression, self.sources, ridge, None, least, shaken=True)
        return before, fit

    # ------------------------------------------------------------------ linearisation
    def _prepared(self, window: Window, known: Knowledge) -> Knowledge:
        """Choose the bins to keep, and linearise where the constants are now."""
        mean = known.constants.expected
        far = np.abs(mean - known.eta) > self._eta_tolerance()
        eta = np.where(far.any(), mean, known.eta)
        known = replace(known, eta=eta)
        due = known.noise.windows in (0, 1, 4, 13, 40)
        return replace(known, kept=self._kept(window, known)) if due or not known.kept else known

    def _eta_tolerance(self) -> FloatArray:
        return np.array([0.02 if c.kind == "delay" else 2e-3 for c in self.rig.constants])

    def _at(self, theta: FloatArray, known: Knowledge, kept: int) -> Response:
        """The response at a point; the last one is kept."""
        log_mass = known.eta[: self.rig.masses]
        old = self._response
        same = (
            old is not None and old.bins.kept == kept
            and np.array_equal(old.at.theta, theta) and np.array_equal(old.at.log_mass, log_mass)
        )  # fmt: skip
        if old is None or not same:
            old = Response(sampled(self.rig, theta, log_mass), Bins(self.window, kept))
            self._response, self._cells = old, None
        return old

    def _sources_at(self, response: Response, output_gain: FloatArray) -> Cells:
        if self._cells is None or not np.array_equal(self._cells[0], output_gain):
            spectra = np.array([source.spectrum(response.z) for source in self.sources])
            spectra = spectra.reshape(len(self.sources), len(response.z))
            self._cells = (output_gain, Cells(response, directions(response, self.sources, output_gain), spectra))
        return self._cells[1]

    def _linearised(self, window: Window, known: Knowledge, jumps: bool, steps: int = tuning.STEPS) -> Linearised:
        """The window at the end of Gauss-Newton; with constants given where estimated ones hide what is curved."""
        at = self._descended(window, known, jumps, steps, given=False)
        if at.converged or not len(self.rig.constants):
            return at
        again = self._descended(window, known, jumps, steps, given=True)
        return again if again.converged else at

    def _descended(self, window: Window, known: Knowledge, jumps: bool, steps: int, given: bool) -> Linearised:
        """Gauss-Newton from θ_r: until the second-order term that is neglected is small against the sd."""
        no_cuts = np.zeros(0, dtype=np.int64)
        cuts = self.cuts if jumps else no_cuts
        at = self._point(window, known, known.theta.copy(), cuts)
        for _ in range(steps):
            delta, sd = self._step(at, known, given)
            held = (at.theta <= self.rig.lower) & (delta < 0)
            far = ~held & (np.abs(delta) > np.maximum(sd, np.sqrt(tuning.CURVATURE * sd)))
            if not far.any():
                return at
            lower = self._lower(window, known, at, delta, given)
            if lower is None:
                break
            at = self._point(window, known, lower, cuts)
        return replace(at, converged=False)

    def _lower(
        self, window: Window, known: Knowledge, at: Linearised, delta: FloatArray, given: bool
    ) -> FloatArray | None:
        """The point (q,) towards which the cost falls: a full step, half of it, a quarter ...; None where none does."""
        linear = self.rig.nominal == 0
        longest = np.where(linear, np.inf, tuning.LONGEST_STEP)
        share, before = 1.0, self._cost(at, at.regression, given) + self._strayed(at.theta, known)
        for _ in range(tuning.HALVINGS):
            moved = at.theta + at.unit * np.clip(share * delta, -longest, 2 * longest)
            moved = np.maximum(moved, self.rig.lower)
            response = self._at(moved, known, known.kept)
            regressor = Regressor(self.rig, response, self.sources, known.eta)
            trial = regressor.build(window, lambda X: at.cells.gram(at.Si, X), np.zeros(0, dtype=np.int64))
            if self._cost(at, trial, given) + self._strayed(moved, known) <= before + 1.0:
                return np.asarray(moved)
            share *= 0.5
        return None

    def _cost(self, at: Linearised, regression: Regression, given: bool) -> float:
        """Twice the negative log posterior of a trajectory under the noise of a point, all but the parameters free."""
        X = regression.without_jumps
        G = at.cells.gram(at.Si, X)
        layout = regression.layout
        others = np.arange(layout.nuisance.stop)
        if not given:
            others = np.concatenate([others, np.arange(layout.xi.start, layout.base)])
        score = G[others, -1] + at.ridge.b[others]
        V = inverse(G[np.ix_(others, others)] + at.ridge.R[np.ix_(others, others)])
        return float(G[-1, -1] - score @ V @ score)

    def _point(self, window: Window, known: Knowledge, theta: FloatArray, cuts: IntArray) -> Linearised:
        response = self._at(theta, known, known.kept)
        regressor = Regressor(self.rig, response, self.sources, known.eta)
        cells = self._sources_at(response, regressor.output_gain)
        noise = known.noise
        S = cells.covariance(noise.log_sigma, noise.levels, noise.intensity)
        Si = inverse_of(S)
        driven = self._driven(response, cells, noise, Si)
        regression = regressor.build(window, lambda X: cells.gram(Si, X), cuts, driven)
        G = cells.gram(Si, regression.X)
        G[-1, -1] += HighPower(response, regression.high, noise.levels).quadratic(Si)
        constants = known.constants
        ridge = self._ridge(regression.layout, window, constants.total, constants.expected - known.eta, noise.intensity)
        return Linearised(theta, response.at.unit, regression, cells, G, Si, ridge, True)

    def _driven(self, response: Response, cells: Cells, noise: Noise, Si: ComplexArray) -> ComplexArray:
        """(kept, n, p) regression of the states that unknown forces drive on the readings: Cov(x, y) S⁻¹."""
        kept = response.bins.kept
        out = np.zeros((kept, response.at.n, self.p), dtype=complex)
        RE = response.R @ response.at.E
        for a, source in enumerate(self.sources):
            if source.kind == "force":
                power = noise.intensity[a] ** 2 * cells.spectra[a, :kept]
                out += (power[:, None] * RE[:, :, source.number])[:, :, None] * cells.D[:kept, :, a].conj()[:, None, :]
        return out @ Si[:kept]

    def _step(self, at: Linearised, known: Knowledge, given: bool) -> tuple[FloatArray, FloatArray]:
        """The step (q,), constants estimated beside it or given, and the sd (q,) with them given."""
        at = self._anchored(at, known.theta)
        _, _, alone, V, Z = self._eliminated(at)
        sd = np.sqrt(np.diag(V))
        if given:
            return alone - Z @ (known.constants.expected - known.eta), sd
        layout, nb = at.regression.layout, at.regression.layout.base
        step = inverse(at.G[:nb, :nb] + at.ridge.R) @ (at.G[:nb, -1] + at.ridge.b)
        return step[layout.psi], sd

    def _anchored(self, at: Linearised, anchor: FloatArray) -> Linearised:
        """A window with the point's own prior on the parameters: what says little of one moves no point far.

        N(anchor, (POINT_SD unit)²) steers where the model is linearised, and enters nothing that is said of the window.
        """
        psi, spread = at.regression.layout.psi, self._anchor_spread(anchor)
        R, b = at.ridge.R.copy(), at.ridge.b.copy()
        R[psi, psi] += np.diag((at.unit / spread) ** 2)
        b[psi] -= at.unit * (at.theta - anchor) / spread**2
        return replace(at, ridge=Ridge(R, b))

    def _strayed(self, theta: FloatArray, known: Knowledge) -> float:
        """Twice the negative log prior of a point."""
        return float((((theta - known.theta) / self._anchor_spread(known.theta)) ** 2).sum())

    def _anchor_spread(self, anchor: FloatArray) -> FloatArray:
        return tuning.POINT_SD * unit_of(self.rig, anchor)

    def _wide(self) -> FloatArray:
        """(c, c) prior of the constants while the noise is learnt: as far off as any of them may be."""
        sizes = [tuning.OFF_DELAY if c.kind == "delay" else tuning.OFF_RELATIVE for c in self.rig.constants]
        known = np.array([c.sheet > 0 for c in self.rig.constants], dtype=bool)
        return np.diag(np.where(known, sizes, 1e-6) ** 2) if sizes else np.zeros((0, 0))

    def _ridge(
        self, layout: Layout, window: Window, P: FloatArray, mean: FloatArray, intensity: FloatArray | None = None
    ) -> Ridge:
        """Prior of the base columns: constants N(mean, P), lost readings, end effects where an intensity is given."""
        R, b = np.diag(layout_free(layout)), np.zeros(layout.base)
        if len(window.lost):
            R[layout.gaps, layout.gaps] = np.diag(1.0 / window.lost_sd**2)
        if intensity is not None:
            assert self._response is not None  # noqa: S101 - the layout is of its regression
            ends = range(layout.ends.start, layout.ends.stop)
            R[ends, ends] = Ends(self._response, self.sources).precision(intensity)
        if len(mean):
            precision = inverse(P)
            R[layout.xi, layout.xi] = precision
            b[layout.xi] = precision @ mean
        return Ridge(R, b)

    # ------------------------------------------------------------------ what it says
    def _without_jumps(self, at: Linearised, fit: NoiseFit) -> Linearised:
        """The same window under the noise that was just learnt."""
        layout = replace(at.regression.layout, cuts=0)
        R = at.ridge.R.copy()
        ends = range(layout.ends.start, layout.ends.stop)
        R[ends, ends] = fit.ridge()[ends, ends]
        regression = replace(at.regression, X=fit.X, layout=layout)
        return replace(at, G=fit.G, Si=fit.Si, regression=regression, ridge=replace(at.ridge, R=R))

    def _nearer(self, at: Linearised, before: FloatArray) -> FloatArray:
        """The next point (q,): what this window says, averaged with the last point where they agree."""
        _, _, alone, V, _ = self._eliminated(self._anchored(at, before))
        here, sd = at.theta + at.unit * alone, at.unit * np.sqrt(np.diag(V))
        agree = np.all(np.abs(here - before) < tuning.AGREE_SD * sd)
        share = tuning.POINT_SHARE if agree else 1.0
        return np.asarray(np.maximum(before + share * (here - before), self.rig.lower))

    def _eliminated(self, at: Linearised) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """Everything but the constants eliminated: their information and score, θ at η = 0, its variance, dθ/dη."""
        layout = at.regression.layout
        na, nb, psi = layout.xi.start, layout.base, layout.psi
        M = at.G[:na, :na] + at.ridge.R[:na, :na]
        V = inverse(M)
        rest = at.G[:na, na:nb]
        alone = refined(M, V, at.G[:na, -1] + at.ridge.b[:na])
        Z = refined(M, V, rest)  # what the constants are known by is a small difference of large numbers
        S = at.G[na:nb, na:nb] - rest.T @ Z
        g = at.G[na:nb, -1] - rest.T @ alone
        return *shown(S, g, np.diag(at.G)[na:nb]), alone[psi], V[psi, psi], Z[psi]

    def _constants_after(self, at: Linearised, known: Knowledge) -> Constants:
        S, g, *_ = self._eliminated(at)
        temper = max(1.0, float(np.mean(known.scatter.factor)))
        return known.constants.updated(S / temper, g / temper, known.eta)

    def _posterior(self, at: Linearised, known: Knowledge, after: Constants | None = None) -> Posterior:
        """Marginal posterior of the parameters over the hypotheses on the constants."""
        if after is None:
            after = self._constants_after(at, known)
        _, _, alone, V, Z = self._eliminated(at)
        u, own = at.unit, np.diag(V)
        means = _moved(at.theta + u * alone, u * ((after.mean - known.eta) @ -Z.T))
        # a square: what is below 0 is rounding
        unsure = np.maximum(np.einsum("ia,hab,ib->hi", Z, after.covariance, Z, optimize=True), 0.0)
        variance = u**2 * (own + unsure)
        mean = after.weight @ means
        # not knowing the intensities, and scatter beyond the model's, widen what the data say
        wider = np.maximum(1 + np.maximum(known.noise.spread, -0.3).sum(axis=0), 0.5)
        jump, raw, (excess, beyond), power, dof = self._tests(at, known)
        wider = wider * known.scatter.factor * louder(power, dof, known.noise.unsure)
        extra = u**2 * own * (wider - 1)
        sds = np.sqrt(np.maximum(variance + extra, 0.3 * variance))
        lower, upper = interval95(after.weight, means, sds)
        return Posterior(
            theta=mean, sd=(upper - lower) / (2 * NORMAL_975), lower=lower, upper=upper,
            linear=at.theta + u * (alone - Z @ (after.standing[0] - known.eta)),
            sd_repeat=np.sqrt(np.maximum(u**2 * own + extra, 0.3 * u**2 * own)), sensitivity=-u[:, None] * Z,
            converged=at.converged, jump=jump, jump_raw=raw, excess=excess, beyond_jump=beyond,
            changing=bool(len(jump) and jump.max() > self.threshold), dof=dof,
        )  # fmt: skip

    def _tests(
        self, at: Linearised, known: Knowledge
    ) -> tuple[FloatArray, FloatArray, tuple[float, float], float, float]:
        """Jump statistics; misfit without and with the best jump, predictive sds; power a degree of freedom; these."""
        layout = at.regression.layout
        nb = layout.base
        V = inverse(at.G[:nb, :nb] + at.ridge.R)
        fit = V @ (at.G[:nb, -1] + at.ridge.b)
        rss = float(at.G[-1, -1] - (at.G[:nb, -1] + at.ridge.b) @ fit)
        dof = float(at.cells.weight.sum() * self.p - layout.n - layout.q)
        raw = np.array([self._jump(at, V, fit, i) for i in range(layout.cuts)])
        left = np.maximum([rss, rss - raw.max(initial=0.0)], 1e-300)
        excess, beyond = np.log(left / dof) / chance(dof, known.noise.unsure) * bool(known.noise.windows)
        misfit = max(1.0, rss / dof) * max(1.0, float(known.scatter.within.max()))
        return raw / misfit, raw, (float(excess), float(beyond)), rss / dof, dof

    def line(self, window: Window, known: Knowledge) -> Line:
        """Return what a window says if its parameters move on and on through it.

        The line of a parameter is taken as equal jumps at all cuts, which leaves a twenty-fifth of what a constant
        leaves of it. `changing` says that one jump of all parameters explains the window better.
        """
        at = self._linearised(window, known, jumps=True)
        layout, q = at.regression.layout, self.rig.q
        nb, cuts = layout.base, layout.cuts
        to = np.zeros((len(at.G), nb + q + 1))  # base columns at the window's middle, lines, residual
        to[:nb, :nb], to[-1, -1] = np.eye(nb), 1.0
        for i in range(cuts):
            to[layout.jump(i), nb : nb + q] = np.eye(q) / cuts
        to[layout.psi, nb : nb + q] = -0.5 * np.eye(q)
        G = to.T @ at.G @ to
        R = np.zeros((nb + q, nb + q))
        R[:nb, :nb], R[nb:, nb:] = at.ridge.R, np.eye(q) / tuning.LINE_SD**2
        score = G[:-1, -1] + np.concatenate([at.ridge.b, np.zeros(q)])
        V = inverse(G[:-1, :-1] + R)
        fit = V @ score
        end = np.zeros((q, nb + q))
        end[:, layout.psi] = np.eye(q)
        end[:, nb:] = 0.5 * np.eye(q)
        theta, middle = at.theta + at.unit * (end @ fit), at.theta + at.unit * fit[layout.psi]
        left = max(float(G[-1, -1] - score @ fit), 1e-300)
        plain = self._posterior(at, known, known.constants)  # a window of this kind says nothing of the constants
        open_constants = plain.sd**2 - plain.sd_repeat**2
        misfit = known.scatter.factor * max(1.0, left / plain.dof)
        stair = fit[nb:] ** 2 / (12 * cuts**2)
        own = at.unit * np.sqrt(np.diag(end @ V @ end.T) * misfit + stair)
        sd = np.sqrt(own**2 + np.maximum(open_constants, 0.0))
        excess = float(np.log(left / plain.dof) / chance(plain.dof, known.noise.unsure))
        said = replace(
            plain, theta=theta, sd=sd, lower=theta - NORMAL_975 * sd, upper=theta + NORMAL_975 * sd, sd_repeat=own,
            excess=excess, changing=excess > plain.beyond_jump,
        )  # fmt: skip
        moves = bool(np.any(np.abs(fit[nb:]) > tuning.AGREE_SD * np.sqrt(np.diag(V)[nb:] * misfit)))
        return Line(said, np.asarray(np.maximum(middle, self.rig.lower)), moves)

    def _jump(self, at: Linearised, V: FloatArray, fit: FloatArray, i: int) -> float:
        """Score statistic of one jump of all parameters at cut i (Willsky & Jones, IEEE TAC 21 (1976) 108)."""
        nb, t = at.regression.layout.base, at.regression.layout.jump(i)
        cross = at.G[:nb, t]
        J = at.G[t, t] - cross.T @ V @ cross
        g = at.G[t, -1] - cross.T @ fit
        return quadratic(J, g)

    def _ratio(self, at: Linearised) -> FloatArray:
        """Jackknife ratio (q,) of this window."""
        layout = at.regression.layout
        kept = at.cells.kept
        L = np.linalg.cholesky(at.Si[:kept])
        used = (at.cells.weight[:kept] > 0)[:, None, None]
        whitened = used * (L.conj().transpose(0, 2, 1) @ at.regression.X)
        low = float(at.cells.gram(at.Si, at.regression.X)[-1, -1])
        blocks = block_grams(whitened, self.window, max(0.0, float(at.G[-1, -1]) - low))
        return block_ratio(blocks, at.ridge.R, at.ridge.b, layout.psi)

    # ------------------------------------------------------------------ which bins
    def _kept(self, window: Window, known: Knowledge) -> int:
        """The fewest bins that cost no parameter more than a share of its sd, constants given and at data sheet."""
        total = self.window // 2 + 1
        top = min(total, tuning.MOST_BINS)
        if total < tuning.ALL_BINS:
            return total
        at = self._point(window, replace(known, kept=top), known.theta, np.zeros(0, dtype=np.int64))
        ladder = np.unique(np.round(np.geomspace(10, top, 24)).astype(np.int64))
        layout = at.regression.layout
        least = 2 * layout.n + 4
        sds = [self._sd_of(at, window, gram) for gram in self._running(at, ladder)]
        enough = [
            kept for kept, sd in zip(ladder, sds, strict=True)
            if kept > least and np.all(sd < (1 + tuning.INFORMATION_LOSS) * sds[-1])
        ]  # fmt: skip
        best = int(enough[0]) if enough else top
        return total if best > 0.8 * total else best

    def _running(self, at: Linearised, ladder: IntArray) -> list[FloatArray]:
        """Grams of the base columns up to each rung, every bin summed once."""
        X = at.regression.without_jumps[..., :-1]
        weighted = (at.Si[: at.cells.kept] @ X) * at.cells.weight[: at.cells.kept, None, None]
        out, total, start = [], np.zeros((X.shape[-1],) * 2), 0
        for stop in ladder:
            a, b = X[start:stop].reshape(-1, X.shape[-1]), weighted[start:stop].reshape(-1, X.shape[-1])
            total = total + a.real.T @ b.real + a.imag.T @ b.imag
            out.append(total)
            start = int(stop)
        return out

    def _sd_of(self, at: Linearised, window: Window, gram: FloatArray) -> FloatArray:
        """Sds of the parameters with constants as good as given, then at their data sheet."""
        layout = at.regression.layout
        sheet = np.array([max(c.sheet, 1e-6) for c in self.rig.constants])
        out = []
        for share in (0.1 * tuning.AS_CONFIGURED, 1.0):
            P = np.diag((share * sheet) ** 2)
            R = self._ridge(layout, window, P, np.zeros(len(sheet)), np.full(len(self.sources), 1e-150)).R
            M = gram + R
            d = scales(M)
            V = np.linalg.pinv(M * np.outer(d, d), rcond=1e-14, hermitian=True)
            out.append(np.sqrt(np.abs(np.diag(V))[layout.psi]) * d[layout.psi])
        return np.concatenate(out)


def _moved(theta: FloatArray, shift: FloatArray) -> FloatArray:
    """Parameters theta (q,) moved by shifts (h, q) that constants cause: as factors, since constants scale parameters.

    All masses, springs, dampers and forces times c give the same motion: along that line the logarithms run straight.
    """
    size = np.abs(theta)
    relative = shift / np.where(size > 0, size, 1.0)
    as_factor = (size > 0) & (np.abs(relative) < 1.0)
    return np.where(as_factor, theta * np.exp(np.sign(theta) * np.where(as_factor, relative, 0.0)), theta + shift)
