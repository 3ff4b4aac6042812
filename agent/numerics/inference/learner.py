"""One window through the whole model: linearise, test for a change, learn the noise, weigh the constants.

window -> Gauss-Newton about θ_r -> jump? unexplained? -> noise -> hypotheses on the constants -> posterior
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from agent.numerics.inference import tuning
from agent.numerics.inference.constants import Constants, apart_of, farthest, hypotheses_of
from agent.numerics.inference.continuation import Continuation
from agent.numerics.inference.friction import columns, frictions
from agent.numerics.inference.hardening import changing, hardening, opened
from agent.numerics.inference.information import Information, Update
from agent.numerics.inference.linearise import Linearised, Lineariser
from agent.numerics.inference.mixture import NORMAL_975, interval95
from agent.numerics.inference.noise.after_window import learn
from agent.numerics.inference.noise.intensities import first_nodes
from agent.numerics.inference.noise.lines import with_lines
from agent.numerics.inference.noise.restricted_likelihood import NoiseFit, Ridge
from agent.numerics.inference.noise.state import Noise, chance, louder
from agent.numerics.inference.posterior import Knowledge, Line, Posterior, neglected, shifted
from agent.numerics.inference.scatter import Estimate, Scatter, block_grams, block_ratio, widened
from agent.numerics.inference.spectral.algebra import inverse, log_determinant, quadratic
from agent.numerics.inference.spectral.columns import Regressor, Window
from agent.numerics.inference.spectral.sources import sources_of
from agent.numerics.inference.tuning import FIRM, LOOKS_AN_EVALUATION, NOISE_PASS
from agent.numerics.model.uncertain import Rig
from agent.numerics.preprocessing.wire import Wire
from agent.types import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class _Tests:
    """What two tests say of one window.

    Attributes:
        jump: (cuts,) statistics of jumps;  raw: not divided by the misfit.
        excess, beyond: misfit without and with the best jump, predictive sds.
        power: of the residual, per degree of freedom;  dof: these.
        slide: variance that a gain which drifts adds to the score of a jump, in units of its own;  slid: (q,)
            what it does to the parameters.
    """

    jump: FloatArray
    raw: FloatArray
    excess: float
    beyond: float
    power: float
    dof: float
    slide: float
    slid: FloatArray


class Learner:
    """Learns from windows of one rig and one length.

    Args:
        rig: what is modelled.
        window: W, samples.
        outputs: p.
        floor: (p,) sensor sd that the wire's resolution alone causes.
        wire: what outputs come in, SI if not said.
    """

    def __init__(
        self, rig: Rig, window: int, outputs: int, floor: FloatArray, wire: Wire | None = None
    ) -> None:
        self.rig, self.window, self.p = rig, window, outputs
        self.wire = Wire.in_si(outputs) if wire is None else wire
        self.log_floor = np.log(np.maximum(floor, 1e-300))
        self.sources = sources_of(rig, window, outputs)
        self.hypotheses = hypotheses_of(rig.constants)
        self.apart = apart_of(rig.constants)
        self.cuts = np.unique(np.round(np.array(tuning.CUTS) * window).astype(np.int64))
        self.threshold = float(chdtri(rig.q, tuning.JUMP_LEVEL))
        self.lineariser = Lineariser(rig, window, outputs, self.sources, self.cuts)
        self.continuation = Continuation(self.lineariser)

    def prior(self, sigma: FloatArray, spread: FloatArray) -> Knowledge:
        """Return what is known before any window; sigma (p,) stated or guessed, spread (p,) of its log."""
        rig = self.rig
        c = len(self.rig.constants)
        total = self.window // 2 + 1
        noise = Noise.prior(
            np.maximum(sigma, np.exp(self.log_floor)), spread, total, len(self.sources), rig.q
        )
        return Knowledge(
            rig.nominal.copy(), np.zeros(c), noise, Constants.prior(self.hypotheses), Scatter.prior(rig.q)
        )

    def spread(self, noise: Noise) -> FloatArray:
        """Return the sd (p,) of each output's readings at rest: white and coloured noise of its sensor."""
        variance = noise.white.copy()
        for source, intensity in zip(self.sources, noise.intensity, strict=True):
            if source.kind == "sensor":
                variance[source.number] += intensity**2
        return np.asarray(np.sqrt(variance))

    def unknown_forces(self, window: Window, noise: Noise) -> float:
        """Return the largest unknown force as the equivalent white one, in units of the largest measured one.

        0 where none is measured.
        """
        measured = window.u[:, : len(self.rig.measured)][:, self.rig.driven].std(axis=0).max(initial=0.0)
        sources = [(a, s) for a, s in enumerate(self.sources) if s.kind == "force"]
        white = {s.number: noise.nodes[a, 0] for a, s in sources if s.pole == 0}
        forces = [noise.intensity[a] / noise.nodes[a, 0] * white[s.number] for a, s in sources]
        return float(max(forces, default=0.0) / measured) if measured > 0 else 0.0

    # ------------------------------------------------------------------ the way through one window
    def learn(
        self,
        window: Window,
        known: Knowledge,
        shaken: bool = False,
        believe: bool = False,
        later: float = 1.0,
        hard: bool | None = None,
    ) -> tuple[Posterior, Knowledge]:
        """Return what a window says and what is known after it; a window that changes teaches nothing.

        shaken: σ may have changed more than usual. believe: it holds no change, whatever the jump test says.
        later: windows since the one before it that was learnt from. hard: whether springs may harden while
        its noise is learnt; the window says so if not said.
        """
        before = known.noise.rounding
        known = self.lineariser.prepared(window, _met(window, known, self.wire))
        predicted = replace(self.lineariser.placed(known), constants=known.constants.predicted(later))
        at = self.lineariser.linearised(window, predicted, jumps=known.noise.is_started)
        led = predicted.noise
        if not at.converged and not led.windows:
            at, predicted, led = self._begun(window, predicted, at)
        tests = self._tests(at, predicted)
        if (self._jumps(tests.jump) and not believe) or not at.converged:
            return self._posterior(at, predicted), known
        for _ in range(tuning.ROUNDS):
            again = shaken or known.unexplained
            noise, settled, hard = self._noise_after(window, at, predicted, again, shaken, hard)
            update = known.constants.switching(later, self._information(settled, predicted))
            constants = self._settled(known, update)
            expected = self.lineariser.expected(constants)
            far = tuning.FAR_TOLERANCES * self.lineariser.eta_tolerance()
            moved = np.abs(expected - predicted.eta) > far
            if not moved.any():
                break
            # the constants are elsewhere: the model is made straight there before anything is believed
            predicted = replace(predicted, eta=expected, theta=at.theta)
            there = replace(predicted, constants=constants, noise=led)
            at = self.lineariser.linearised(window, there, jumps=False)
        if self._spread_out(window, settled, predicted, update):
            constants = self._settled(known, update)
        here = _estimate(settled, predicted.eta).at(self.lineariser.expected(constants))
        scatter = known.scatter.after(self._ratio(settled) / settled.inflation, here)
        rounding = self.lineariser.rounding_after(settled, noise, before)
        at_window = replace(predicted, noise=replace(noise, rounding=rounding), scatter=scatter)
        posterior = self._posterior(settled, at_window, constants)
        posterior = replace(
            posterior, jump=tests.jump, jump_raw=tests.raw, excess=tests.excess, beyond_jump=tests.beyond,
            slide=tests.slide, slid=tests.slid, rubs=self._rubs(settled, at_window, posterior),
        )  # fmt: skip
        theta, footing = self.lineariser.nearer(settled, known, predicted.eta, here.eta)
        place = self.lineariser.place(settled, predicted.eta)
        return posterior, replace(
            at_window, theta=theta, footing=footing, eta=here.eta, place=place, constants=constants,
            unexplained=posterior.mismatch,
        )  # fmt: skip

    def _begun(self, window: Window, known: Knowledge, at: Linearised) -> tuple[Linearised, Knowledge, Noise]:
        """Return a first window from elsewhere, or under other noise: what is known there, and that noise."""
        begun = self.continuation.of(window, known)
        elsewhere = at if begun is known else self.lineariser.linearised(window, begun, jumps=False)
        if elsewhere.converged:
            return elsewhere, begun, begun.noise
        at, led = self._under_other_noise(window, known, at)
        return at, known, led

    def _under_other_noise(
        self, window: Window, known: Knowledge, at: Linearised
    ) -> tuple[Linearised, Noise]:
        """Return a first window linearised under the noise it shows, in turns, and that noise.

        Under the sensors' noise alone a descent takes what strong unknown forces do for the parameters' work.
        """
        found = at
        for _ in range(tuning.ALTERNATIONS):
            begun = found.theta if found.converged else known.theta
            noise = self.other_noise(window, replace(known, theta=found.theta))
            forces = self.unknown_forces(window, noise)
            if forces > tuning.MANY_TIMES:
                break
            found = self.lineariser.linearised(window, replace(known, theta=begun, noise=noise), jumps=False)
            # forces as large as the measured ones would explain any motion
            if found.converged and forces < tuning.AS_LARGE:
                return found, noise
        return at, known.noise

    def _settled(self, known: Knowledge, update: Update) -> Constants:
        """What is known of the constants after a window; a first one says nothing of springs that harden.

        With no jump and no noise known yet they would stand for what the graph lacks.
        """
        constants = known.constants.switched(update)
        first = self.rig.cubics and not known.noise.windows
        return constants.refused(self.rig.of_kind("cubic")) if first else constants

    def _rubs(self, at: Linearised, known: Knowledge, posterior: Posterior) -> bool:
        """Whether dry friction across a damper is evident and would move an estimate by more than its sd."""
        if not self.rig.rubbings:
            return False
        layout, response = at.regression.layout, at.cells.response
        gain = Regressor(self.rig, response, self.sources, known.eta).output_gain
        more = columns(response, at.regression.states * self.rig.sizes, self.rig.rubbings, gain)
        misfit = max(1.0, float(known.scatter.within.max()))
        own = at.cells.gram(at.Si, more).diagonal()
        cross = at.cells.products(at.Si, at.regression.X, more)
        found = frictions(own, cross, *at.fitted, layout.psi, posterior.dof, misfit)
        return any(
            one.evidence > tuning.FRICTION_EVIDENCE and np.any(np.abs(at.unit * one.shift) > posterior.sd)
            for one in found
        )

    def _noise_after(
        self, window: Window, at: Linearised, known: Knowledge, shaken: bool, anew: bool, hard: bool | None
    ) -> tuple[Noise, Linearised, bool]:
        """The noise learnt from a linearised window, and the window under it.

        hard: whether springs may harden meanwhile; None where the window is to say so. What comes last says
        whether they did.
        """
        # what nothing known explains may be a constant that is off, rather than forces
        if anew:
            noise, fit = self._noise_within(
                window, at, known, self.lineariser.wide(known.constants), -known.eta, shaken, anew
            )
            return noise, self.lineariser.without_jumps(at, window, noise, fit), False
        centre = self.lineariser.expected(known.constants) - known.eta
        straight = self.lineariser.spread(known.constants)
        bent = self.lineariser.spread(known.constants, self.rig.of_kind("cubic"))
        noise, fit = self._noise_within(window, at, known, bent if hard else straight, centre, shaken, anew)
        settled = self.lineariser.without_jumps(at, window, noise, fit)
        if hard is not None or not self._may_harden(settled, known):
            return noise, settled, bool(hard)
        # forces take most of what a spring that hardens does: with a noise of its own for each they compare
        other, other_fit = self._noise_within(window, at, known, bent, centre, shaken, anew)
        price = 0.5 * float(log_determinant(bent) - log_determinant(straight))
        gain = other_fit.restricted_log_likelihood() - fit.restricted_log_likelihood() - price
        hardened = self.lineariser.without_jumps(at, window, other, other_fit)
        believed = known.constants.updated(self._information(hardened, known))
        rival = max(-np.log(tuning.PRIOR_CUBIC), changing(at, self._temper(at, known)))
        if gain < rival or not believed.believes(self.rig.of_kind("cubic")):
            return noise, settled, False
        return other, hardened, True

    def _noise_within(
        self, window: Window, at: Linearised, known: Knowledge, spread: FloatArray, centre: FloatArray,
        shaken: bool, anew: bool,
    ) -> tuple[Noise, NoiseFit]:  # fmt: skip
        """The noise learnt with the constants within N(centre, spread) of where they are linearised."""
        wide = self.lineariser.ridge(at.regression.layout, window, spread, centre)
        wide = wide if anew else _steady(at, wide, known)
        least = self._least(known.noise)
        lined = with_lines(known.noise, at.cells, at.regression)
        noise, fit = learn(lined, at.cells, at.regression, self.sources, wide, at.ridge, least, shaken, anew)
        self._count(fit)
        return replace(noise, log_sigma=np.maximum(noise.log_sigma, self._floor(window))), fit

    def _floor(self, window: Window) -> FloatArray:
        """(p,) least log σ: what the wire resolves, or more digits than any sensor has."""
        # column by column: a reduction over rows so short costs ten times more
        spread = np.array([column.std() for column in window.y.T])
        return np.asarray(np.maximum(self.log_floor, np.log(np.maximum(tuning.DIGITS * spread, 1e-300))))

    def _least(self, noise: Noise) -> FloatArray:
        """(p,) least that log σ may be: what is stated, or where nothing is, what the wire resolves."""
        spread = np.sqrt(noise.log_sigma_var)
        unknown = spread > tuning.SIGMA_UNKNOWN
        return np.where(unknown, np.maximum(self.log_floor, noise.log_sigma - 2 * spread), noise.log_sigma)

    def solve(
        self, window: Window, known: Knowledge, steps: int = tuning.STEPS, anew: bool = False
    ) -> tuple[Posterior, Linearised]:
        """Return what a window says under what is known, and where it came to rest; nothing is learnt.

        Nor of the constants: it may share most of its samples with one that was learnt from. anew: it begins
        as a first window does, since its parameters may be anywhere.
        """
        known = _of(window, known)
        if anew:
            begun = self.continuation.of(window, known)
            known = replace(known, theta=begun.theta, kept=begun.kept)
        at = self.lineariser.linearised(window, known, known.noise.is_started, steps)
        return self._posterior(at, known, known.constants), at

    def switched(self, window: Window, known: Knowledge, later: float) -> tuple[Posterior, Knowledge]:
        """Return what a window says if other constants have become true since, and what is known then.

        The noise is as it was: it explains such a window where that is straight, and no other. Springs do not
        begin to harden. later: windows since the one before it that was learnt from.
        """
        opened = replace(_of(window, known), constants=Constants.prior(self.hypotheses))
        there = self.continuation.of(window, opened)
        for turn in range(tuning.ROUNDS):
            at = self.lineariser.linearised(window, there, jumps=False)
            found = self._posterior(at, there, there.constants)
            strays = np.any(np.abs(at.theta - there.theta) > tuning.LONGEST_STEP * at.unit)
            # it is straight nowhere near
            if not at.converged and (strays or (found.mismatch and not turn)):
                return found, known
            said = self._information(at, there)
            update = known.constants.switching(later, said, shut=self.rig.of_kind("cubic"))
            constants = known.constants.switched(update)
            expected = self.lineariser.expected(constants)
            moved = np.abs(expected - there.eta) > self.lineariser.eta_tolerance()
            there = replace(there, theta=at.theta, eta=expected, constants=constants)
            if not moved.any():
                break
        posterior, at = self.solve(window, there)
        return posterior, replace(self.moved_to(at, there, same=False), noise=known.noise, place=None)

    def moved_to(self, at: Linearised, known: Knowledge, same: bool) -> Knowledge:
        """Return what is known with its point where a window came to rest, and the bins it kept.

        same: it says what windows before it said: no window alone is then the point, since of some directions
        one window may know next to nothing.
        """
        theta, footing = self.lineariser.nearer(at, known, known.eta, known.eta, same)
        return replace(known, theta=theta if same else at.theta, footing=footing, kept=at.cells.kept)

    def at_point(
        self, window: Window, known: Knowledge, jumps: bool = False, cuts: IntArray | None = None
    ) -> Linearised:
        """Return a window linearised at what is known, wherever its own best parameters are.

        jumps: with columns of them, at `cuts`, or where jumps are tested.
        """
        if cuts is None:
            cuts = self.cuts if jumps else np.zeros(0, dtype=np.int64)
        return self.lineariser.point(window, _of(window, known), known.theta, cuts)

    def lost_readings(
        self, window: Window, known: Knowledge, moved: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the errors (l,) of a window's filled-in readings, and their covariance (l, l).

        moved (l,): what the window is filled with beyond the mean of the prior.
        """
        at = self.lineariser.linearised(window, known, jumps=False, steps=2)
        layout = at.regression.layout
        V = inverse(at.G[: layout.base, : layout.base] + at.ridge.R)
        pull = at.ridge.b.copy()
        pull[layout.gaps] -= moved / window.lost_sd**2
        found = V @ (at.G[: layout.base, -1] + pull)
        return found[layout.gaps], V[layout.gaps, layout.gaps]

    def hardens(self, at: Linearised, known: Knowledge, *, lasting: bool) -> float:
        """Log odds by which springs that harden explain a window better than parameters that change in it.

        -inf where they do not explain it. lasting: windows are broken for longer than one jump is in the way.
        """
        if not self.rig.cubics:
            return -np.inf
        temper = self._temper(at, known)
        evidence = hardening(self.lineariser, at, known, temper)
        every = opened(self.lineariser, at, known, self.rig.of_kind("cubic"))
        explained = self._tests(every, known).excess <= tuning.EXPLAINED_SD
        if evidence < tuning.HARD_EVIDENCE or not explained:
            return -np.inf
        return evidence - changing(at, temper, jumps=not lasting)

    def _may_harden(self, at: Linearised, known: Knowledge) -> bool:
        """Whether springs that harden are asked for with a noise of their own; early on always.

        Where unknown forces take what such springs do a window hardly says so: now and then it is asked too.
        """
        windows = known.noise.windows
        if not self.rig.cubics or not windows:
            return False
        often = windows < tuning.SETTLED or windows % tuning.SELDOM == 0
        return often or hardening(self.lineariser, at, known, self._temper(at, known)) > 0

    def contested(self, window: Window, known: Knowledge, posterior: Posterior) -> bool:
        """Whether a change of the noise explains a window as well as a jump of the parameters does."""
        known = _of(window, known)
        at = self.lineariser.linearised(window, known, jumps=False)
        wide = self.lineariser.ridge(
            at.regression.layout, window, self.lineariser.wide(known.constants), -known.eta
        )
        before, fit = self._open_minded(at, known, wide)
        gain = fit.restricted_log_likelihood() - before
        price = 0.5 * self.rig.q * np.log(posterior.dof) + np.log(len(self.cuts))
        return bool(gain > 0.5 * posterior.jump_raw.max() - price)

    def other_noise(self, window: Window, known: Knowledge) -> Noise:
        """Return the noise that explains a window best at the point known; single bins stay as they are.

        A level of its own for a bin would take an offset for the noise of bin 0.
        """
        mean, P = known.constants.standing
        known = _of(window, known)
        at = self.at_point(window, known)
        ridge = self.lineariser.ridge(at.regression.layout, window, P, mean - known.eta)
        noise = known.noise
        firm = replace(noise, power=FIRM * noise.power, dof=FIRM * noise.dof)
        _, fit = self._open_minded(at, replace(known, noise=firm), ridge)
        nodes = noise.nodes if noise.is_started else first_nodes(at.cells, self._least(noise))
        log_sigma = np.maximum(fit.log_sigma, self._floor(window))
        return replace(noise, log_sigma=log_sigma, intensity=fit.intensity, nodes=nodes)

    def _open_minded(self, at: Linearised, known: Knowledge, ridge: Ridge) -> tuple[float, NoiseFit]:
        """Restricted log likelihood of a window under known noise, and the fit of noise that explains it."""
        before = NoiseFit(
            known.noise, at.cells, at.regression, self.sources, ridge
        ).restricted_log_likelihood()
        open_minded = replace(known.noise, windows=min(known.noise.windows, 1))
        least = self._least(known.noise)
        _, fit = learn(
            open_minded, at.cells, at.regression, self.sources, ridge, None, least, shaken=True, anew=True
        )
        self._count(fit)
        return before, fit

    def _count(self, fit: NoiseFit) -> None:
        """Note what learning the noise of a window cost."""
        self.lineariser.evaluations += NOISE_PASS + fit.looks // LOOKS_AN_EVALUATION

    # ------------------------------------------------------------------ what it says
    def _information(self, at: Linearised, known: Knowledge) -> Information:
        """What a window says of the constants about where (c,) it has them."""
        return self._said(at, known.eta, self._temper(at, known))

    def _said(self, at: Linearised, eta: FloatArray, temper: float) -> Information:
        (S, g), (_, V, Z) = at.information, at.given
        curved = np.vstack([Z, np.eye(len(eta))]) @ self.apart
        tells = np.concatenate([1.0 / np.diag(V), np.diag(S)])
        return Information(S / temper, g / temper, eta, at.cost / temper, curved, tells / temper)

    def _temper(self, at: Linearised, known: Knowledge) -> float:
        """By how much less a window says of the constants than its own linearisation has it."""
        unsure = np.maximum(1 + known.noise.spread.sum(axis=0), 1.0)
        return float(max(at.repeats, at.inflation * float(np.mean(known.scatter.factor * unsure))))

    def _spread_out(self, window: Window, at: Linearised, known: Knowledge, update: Update) -> bool:
        """Make a window straight wherever hypotheses stand that are possible and far from where it is.

        Return whether it is anywhere else now.
        """
        points = [at]
        while (place := update.farthest()) is not None:
            near = int(np.argmin([said.neglected(place[None])[0] for said in update.said]))
            begun = replace(known, eta=update.said[near].at)
            there = self.lineariser.elsewhere(points[near], window, begun, place)
            if there is not None:
                points.append(there)
                update.also(self._said(there, place, self._temper(at, known)))
        return len(points) > 1

    def _posterior(self, at: Linearised, known: Knowledge, after: Constants | None = None) -> Posterior:
        """Marginal posterior of the parameters over the hypotheses on the constants."""
        if after is None:
            after = known.constants.updated(self._information(at, known))
        alone, V, Z = at.given
        u = at.unit
        own = np.diag(V)
        here = at.theta + u * alone
        moved = after.mean - known.eta
        means = shifted(here, u * (moved @ -Z.T))
        # a square: what is below 0 is rounding
        unsure = np.maximum(((Z @ after.covariance) * Z).sum(axis=2), 0.0)
        bent = neglected(means - here, u, farthest(self.rig.constants, moved))
        variance = u**2 * (own + unsure) + bent**2
        mean = after.weight @ means
        # not knowing the intensities, and scatter beyond the model's, widen what the data say
        wider = np.maximum(1 + np.maximum(known.noise.spread, -0.3).sum(axis=0), 0.5)
        tests = self._tests(at, known)
        wider = widened(at.inflation * wider * known.scatter.factor, at.repeats)
        wider = wider * louder(tests.power, at.alike * tests.dof, known.noise.unsure)
        extra = u**2 * own * (wider - 1) + tests.slid**2
        sds = np.sqrt(np.maximum(variance + extra, 0.3 * variance))
        lower, upper = interval95(after.weight, means, sds)
        return Posterior(
            theta=mean, sd=(upper - lower) / (2 * NORMAL_975), lower=lower, upper=upper,
            sd_repeat=np.sqrt(np.maximum(u**2 * own + extra, 0.3 * u**2 * own)),
            converged=at.converged, jump=tests.jump, jump_raw=tests.raw, excess=tests.excess,
            beyond_jump=tests.beyond, changing=self._jumps(tests.jump), slide=tests.slide, slid=tests.slid,
            dof=tests.dof,
        )  # fmt: skip

    def _jumps(self, jump: FloatArray) -> bool:
        """Whether a statistic of jumps (cuts,) tells one."""
        return bool(len(jump) and jump.max() > self.threshold)

    def _tests(self, at: Linearised, known: Knowledge) -> _Tests:
        """Whether a window holds a change, and whether what is known explains it."""
        layout = at.regression.layout
        fit = at.fitted[1]
        rss = at.left
        dof = float(at.cells.weight.sum() * self.p - layout.n - layout.q)
        J, score = self._jump_scores(at, at.G[:, -1], fit)
        left = np.maximum([rss, rss - quadratic(J, score).max(initial=0.0)], 1e-300)
        expected = chance(at.alike * dof, known.noise.unsure)
        excess, beyond = np.log(left / dof) / expected * bool(known.noise.windows)
        misfit = max(1.0, rss / dof) * max(1.0, float(known.scatter.within.max())) * at.jumps
        by_slide, slid = self._slid(at)
        more = by_slide[:, :, None] * by_slide[:, None]
        jump, raw = quadratic(misfit[:, None, None] * J + more, score), quadratic(J + more, score)
        slide = float((quadratic(J, by_slide) / misfit).max(initial=0.0))
        return _Tests(jump, raw, float(excess), float(beyond), rss / dof, dof, slide, slid)

    def _slid(self, at: Linearised) -> tuple[FloatArray, FloatArray]:
        """What a gain that drifts in a window does to scores of jumps (cuts, q), and to parameters (q,)."""
        layout, q = at.regression.layout, self.rig.q
        if at.slide is None:
            return np.zeros((layout.cuts, q)), np.zeros(q)
        drift = at.cells.products(at.Si, at.regression.X[..., :-1], at.slide[..., None])[:, 0]
        fit = at.fitted[0] @ drift[: layout.base]
        return self._jump_scores(at, drift, fit)[1], at.unit * fit[layout.psi]

    def line(self, window: Window, known: Knowledge) -> Line:
        """Return what a window says if its parameters move on and on through it.

        The line of a parameter is taken as equal jumps at all cuts, which leaves a twenty-fifth of what a
        constant leaves of it. `changing` says that one jump of all parameters explains the window better.
        """
        known = _of(window, known)
        at = self.lineariser.linearised(window, known, jumps=True)
        layout, q = at.regression.layout, self.rig.q
        nb, cuts = layout.base, layout.cuts
        to = np.zeros((len(at.G), nb + q + 1))  # base columns at the window's middle, lines, residual
        to[:nb, :nb] = np.eye(nb)
        to[-1, -1] = 1.0
        for i in range(cuts):
            to[layout.jump(i), nb : nb + q] = np.eye(q) / cuts
        to[layout.psi, nb : nb + q] = -0.5 * np.eye(q)
        G = to.T @ at.G @ to
        R = np.zeros((nb + q, nb + q))
        R[:nb, :nb] = at.ridge.R
        R[nb:, nb:] = np.eye(q) / tuning.LINE_SD**2
        score = G[:-1, -1] + np.concatenate([at.ridge.b, np.zeros(q)])
        V = inverse(G[:-1, :-1] + R)
        fit = V @ score
        end = np.zeros((q, nb + q))
        end[:, layout.psi] = np.eye(q)
        end[:, nb:] = 0.5 * np.eye(q)
        theta, middle = at.theta + at.unit * (end @ fit), at.theta + at.unit * fit[layout.psi]
        left = max(float(G[-1, -1] - score @ fit), 1e-300)
        plain = self._posterior(
            at, known, known.constants
        )  # a window of this kind says nothing of the constants
        open_constants = plain.sd**2 - plain.sd_repeat**2
        misfit = at.inflation * known.scatter.factor * max(1.0, left / plain.dof)
        stair = fit[nb:] ** 2 / (12 * cuts**2)
        own = at.unit * np.sqrt(np.diag(end @ V @ end.T) * misfit + stair)
        sd = np.sqrt(own**2 + np.maximum(open_constants, 0.0))
        excess = float(np.log(left / plain.dof) / chance(at.alike * plain.dof, known.noise.unsure))
        said = replace(
            plain, theta=theta, sd=sd, lower=theta - NORMAL_975 * sd, upper=theta + NORMAL_975 * sd,
            sd_repeat=own,
            excess=excess, changing=excess > plain.beyond_jump,
        )  # fmt: skip
        moves = bool(np.any(np.abs(fit[nb:]) > tuning.AGREE_SD * np.sqrt(np.diag(V)[nb:] * misfit)))
        return Line(said, np.asarray(np.maximum(middle, self.rig.lower)), moves)

    def _jump_scores(
        self, at: Linearised, score: FloatArray, fit: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Information (cuts, q, q) of jumps of all parameters, and their scores (cuts, q).

        As in Willsky & Jones, IEEE TAC 21 (1976) 108. score: of all columns;  fit (base,): what the base
        columns take of it.
        """
        layout, V, q = at.regression.layout, at.fitted[0], self.rig.q
        jumps = [layout.jump(i) for i in range(layout.cuts)]
        if not jumps:
            return np.zeros((0, q, q)), np.zeros((0, q))
        cross = np.stack([at.G[: layout.base, t].T for t in jumps])
        J = np.stack([at.G[t, t] for t in jumps]) - cross @ V @ cross.transpose(0, 2, 1)
        return J, np.stack([score[t] for t in jumps]) - cross @ fit

    def _ratio(self, at: Linearised) -> FloatArray:
        """Jackknife ratio (q,) of this window."""
        layout, kept = at.regression.layout, at.cells.kept
        alone = slice(0, layout.xi.start)
        L = np.linalg.cholesky(at.Si[:kept])
        used = (at.cells.weight[:kept] > 0)[:, None, None]
        blocks = block_grams(used * (L.conj().transpose(0, 2, 1) @ at.apart), self.window)
        C = inverse(at.information[0] + at.ridge.R[layout.xi, layout.xi])
        return block_ratio(blocks, at.ridge.R[alone, alone], C, layout.psi)


def _of(window: Window, known: Knowledge) -> Knowledge:
    """Return what is known with the noise as it is in a window, whose readings are rounded as they are."""
    return replace(known, noise=known.noise.of(window.y))


def _met(window: Window, known: Knowledge, wire: Wire) -> Knowledge:
    """Return the same with the rounding that a window shows."""
    there = np.ones(window.length, dtype=bool)
    there[window.lost[:, 0]] = False
    return replace(known, noise=known.noise.met(window.y[there], wire).of(window.y))


def _estimate(at: Linearised, eta: FloatArray) -> Estimate:
    """Return what a window says with the constants eta (c,) at which it is linearised."""
    alone, V, Z = at.given
    unit = at.unit
    return Estimate(at.theta + unit * alone, at.repeats * np.outer(unit, unit) * V, -unit[:, None] * Z, eta)


def _steady(at: Linearised, wide: Ridge, known: Knowledge) -> Ridge:
    """Return a ridge with what the windows before say of the parameters, where this one agrees with them.

    Forces and colours show where the parameters do: by the bins of one window alone, all but those that tell
    of the parameters, most of their noise could be anything. What is known is θ at η as linearised, which θ
    and η share as they did in those windows.
    """
    before = known.scatter.steady(_estimate(at, known.eta))
    if before is None:
        return wide
    layout, unit = at.regression.layout, at.unit
    part = slice(layout.psi.start, layout.base)
    J = np.hstack([np.eye(layout.q), -before.sensitivity / unit[:, None]])
    pull = J.T @ inverse(before.covariance / np.outer(unit, unit))
    R, b = wide.R.copy(), wide.b.copy()
    R[part, part] += pull @ J
    b[part] += pull @ ((before.theta - at.theta) / unit)
    return Ridge(R, b)
