"""A window linearised about parameters and constants: Gauss-Newton, its columns' prior, the bins kept."""

from bisect import bisect_left
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from agent.numerics.inference import tuning
from agent.numerics.inference.constants import Constants
from agent.numerics.inference.noise.restricted_likelihood import NoiseFit, Ridge, layout_free
from agent.numerics.inference.noise.rounding import Rounding, RoundingErrors, reference
from agent.numerics.inference.noise.state import Noise
from agent.numerics.inference.posterior import Footing, Knowledge, Place, shifted
from agent.numerics.inference.scatter import by_repeats
from agent.numerics.inference.spectral.algebra import inverse, log_determinant, refined, scales, shown
from agent.numerics.inference.spectral.bins import bins_of
from agent.numerics.inference.spectral.columns import Layout, Regression, Regressor, Window
from agent.numerics.inference.spectral.covariance import Cells, HighPower, inverse_of, real_gram
from agent.numerics.inference.spectral.ends import Ends
from agent.numerics.inference.spectral.response import Response
from agent.numerics.inference.spectral.sources import Source, directions, spectra
from agent.numerics.inference.tuning import ALL_BINS, MOST_BINS
from agent.numerics.model.cubic import extensions
from agent.numerics.model.uncertain import Rig, Sampled, delays_of, sampled, unit_of
from agent.numerics.preprocessing.rows import rows_with
from agent.types import ComplexArray, FloatArray, IntArray


@dataclass(frozen=True)
class Linearised:
    """A window at the end of Gauss-Newton.

    Attributes:
        theta: (q,) the point;  unit: (q,) size of a deviation of 1.
        regression, cells: the window there.
        G: Gram of all columns, residual last;  Si: S⁻¹;  ridge: the prior;  converged: it came to rest.
        slide: (kept, p) what the gain that drifts does inside the window; None where none does.
        repeats: factor on the variance, by readings that repeat one code.
        inflation: the same by rounding errors that are larger where readings tell more;  jumps: (cuts,) the
            same of the scores of jumps;  alike: share of the readings that would tell as much of their power
            if all were rounded alike;  rounding: of the readings, None where it is even.
    """

    theta: FloatArray
    unit: FloatArray
    regression: Regression
    cells: Cells
    G: FloatArray
    Si: ComplexArray
    ridge: Ridge
    converged: bool
    repeats: float
    inflation: float
    jumps: FloatArray
    slide: ComplexArray | None = None
    alike: float = 1.0
    rounding: Rounding | None = None

    @cached_property
    def fitted(self) -> tuple[FloatArray, FloatArray]:
        """Covariance (base, base) of all base columns' deviations, and their estimate (base,)."""
        nb = self.regression.layout.base
        V = inverse(self.G[:nb, :nb] + self.ridge.R)
        return V, V @ (self.G[:nb, -1] + self.ridge.b)

    @property
    def left(self) -> float:
        """Power that the base columns leave of the readings, and of where the prior has them."""
        b = self.G[: self.regression.layout.base, -1] + self.ridge.b
        return float(self.G[-1, -1] - b @ self.fitted[1])

    @property
    def log_precision(self) -> float:
        """Log determinant of the precision of the base columns' deviations."""
        nb = self.regression.layout.base
        return float(log_determinant(self.G[:nb, :nb] + self.ridge.R))

    @cached_property
    def _alone(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Estimates (na,) at η = 0 of all but the constants, their covariance, and what constants move."""
        layout = self.regression.layout
        na, nb = layout.xi.start, layout.base
        M = self.G[:na, :na] + self.ridge.R[:na, :na]
        V = inverse(M)
        alone = refined(M, V, self.G[:na, -1] + self.ridge.b[:na])
        # what the constants are known by is a small difference of large numbers
        return alone, V, refined(M, V, self.G[:na, na:nb])

    @property
    def given(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """With the constants given: θ at η = 0, its variance, dθ/dη."""
        psi = self.regression.layout.psi
        alone, V, Z = self._alone
        return alone[psi], V[psi, psi], Z[psi]

    @cached_property
    def information(self) -> tuple[FloatArray, FloatArray]:
        """Information and score of the constants, all else eliminated."""
        xi = self.regression.layout.xi
        alone, _, Z = self._alone
        rest = self.G[: xi.start, xi]
        S, g = self.G[xi, xi] - rest.T @ Z, self.G[xi, -1] - rest.T @ alone
        return shown(S, g, np.diag(self.G)[xi])

    @property
    def apart(self) -> ComplexArray:
        """Columns (kept, p, base + 1) but the constants; what they leave of these, all of the readings."""
        X, fit, Z = self.regression.X, self.fitted[1], self._alone[2]
        na, nb = self.regression.layout.xi.start, self.regression.layout.base
        columns = X[..., :nb]
        alone, constants = columns[..., :na], columns[..., na:]
        left = X[..., -1] - columns @ fit
        return np.concatenate([alone, constants - alone @ Z, left[..., None]], axis=2)

    @cached_property
    def cost(self) -> float:
        """Twice the negative log likelihood of the bins kept, all but the constants eliminated."""
        na = self.regression.layout.xi.start
        power = float(self.cells.gram(self.Si, self.regression.X[..., -1:])[0, 0])
        return power - float((self.G[:na, -1] + self.ridge.b[:na]) @ self._alone[0])


class Lineariser:
    """Linearises windows of one rig and one length.

    Args:
        rig: what is modelled.
        window: W, samples.
        outputs: p.
        sources: of noise.
        cuts: (cuts,) samples at which jumps are tested.

    Attributes:
        evaluations: of the model so far, or what costs as much: linearisations, trials of steps, passes over
            the noise.
        most: of them from which on no descent goes any further.
    """

    def __init__(
        self, rig: Rig, window: int, outputs: int, sources: tuple[Source, ...], cuts: IntArray
    ) -> None:
        self.rig, self.window, self.p, self.sources, self.cuts = rig, window, outputs, sources, cuts
        self._response: Response | None = None
        self._cells: tuple[FloatArray, Cells] | None = None
        self.evaluations = 0
        self.most: float = np.inf

    def prepared(self, window: Window, known: Knowledge) -> Knowledge:
        """Return what is known with the bins to keep chosen, to be linearised where the constants are now.

        Cubes of springs are shares of their stiffness at the widest extensions so far.
        """
        if self.rig.cubics:
            known = known.stretched(_stretch(window, self.rig), self.rig.of_kind("cubic"))
        mean = self.expected(known.constants)
        far = np.abs(mean - known.eta) > self.eta_tolerance()
        known = replace(known, eta=mean) if far.any() else known
        before = known.kept_for
        due = known.noise.windows in (0, 1, 3, 9, 27) or before is None or known.noise.is_other_than(before)
        return replace(known, kept=self.kept(window, known), kept_for=known.noise) if due else known

    def placed(self, known: Knowledge) -> Knowledge:
        """Return what is known at the newest window's place where that is as good: its model is at hand."""
        place, footing = known.place, known.footing
        if place is None or footing is None:
            return known
        there = shifted(known.theta, footing.sensitivity @ (place.eta - known.eta))
        same = np.abs(place.eta - known.eta) <= tuning.STAYS * self.eta_tolerance()
        if np.all(same) and np.all(np.abs(there - place.theta) <= place.reach):
            return replace(known, theta=place.theta, eta=place.eta)
        return known

    def place(self, at: Linearised, eta: FloatArray) -> Place:
        """Return where a window was linearised, constants at eta (c,)."""
        sd = np.sqrt(np.diag(at.given[1]))
        return Place(at.theta, eta, tuning.STAYS * at.unit * _straight(sd))

    def eta_tolerance(self) -> FloatArray:
        """Return by how much constants (c,) may be off where the model is linearised."""
        return np.array([0.02 if c.kind == "delay" else 2e-3 for c in self.rig.constants])

    def _at(self, theta: FloatArray, known: Knowledge, kept: int) -> Response:
        """The response at a point; the last one is kept."""
        old = self._response
        model = self._model(theta, known)
        if old is None or old.at is not model or old.bins.kept != kept:
            old = Response(model, bins_of(self.window, kept))
            self._response, self._cells = old, None
        return old

    def _model(self, theta: FloatArray, known: Knowledge) -> Sampled:
        """The sampled model at a point, which may be at hand for other bins."""
        log_mass = known.eta[: self.rig.masses]
        delays = delays_of(self.rig, known.eta)
        old = self._response
        if old is not None and old.at.is_at(theta, log_mass, delays):
            return old.at
        return sampled(self.rig, theta, log_mass, delays)

    def _sources_at(self, response: Response, output_gain: FloatArray) -> Cells:
        if self._cells is None or not np.array_equal(self._cells[0], output_gain):
            D = directions(response, self.sources, output_gain)
            self._cells = output_gain, Cells(response, D, spectra(self.sources, response.z))
        return self._cells[1]

    def linearised(
        self, window: Window, known: Knowledge, jumps: bool, steps: int = tuning.STEPS
    ) -> Linearised:
        """Return a window after Gauss-Newton; constants are given where estimated ones hide the curvature."""
        at = self._descended(window, known, jumps, steps, given=False)
        # a cube hides no curvature: springs are straight here, or it is known
        if at.converged or len(self.rig.constants) == len(self.rig.cubics):
            return at
        again = self._descended(window, known, jumps, steps, given=True)
        return again if again.converged else at

    def _descended(
        self, window: Window, known: Knowledge, jumps: bool, steps: int, given: bool
    ) -> Linearised:
        """Gauss-Newton from θ_r, until it is at rest, or its steps hardly shrink."""
        no_cuts = np.zeros(0, dtype=np.int64)
        cuts = self.cuts if jumps else no_cuts
        at = self.point(window, known, known.theta.copy(), cuts)
        # steps that hardly shrink go along what the constants estimated beside them hide
        most = np.inf if given else tuning.STEP_RATIO
        before = np.inf
        for _ in range(steps):
            delta, length = self._step(at, known, given)
            if length <= 1.0:
                return at
            if most * before < length < np.inf or self.evaluations >= self.most:
                break
            lower = self._lower(window, known, at, delta, given)
            if lower is None:
                break
            before = length
            at = self.point(window, known, lower, cuts)
        return replace(at, converged=False)

    def _lower(
        self, window: Window, known: Knowledge, at: Linearised, delta: FloatArray, given: bool
    ) -> FloatArray | None:
        """The point (q,) where the cost falls: a full step, a half, a quarter ...; None if there is none."""
        linear = self.rig.nominal == 0
        longest = np.where(linear, np.inf, tuning.LONGEST_STEP)
        share = 1.0
        before = self.cost(at, at.regression, given) + self._strayed(at.theta, known)
        for _ in range(tuning.HALVINGS):
            moved = at.theta + at.unit * np.clip(share * delta, -longest, 2 * longest)
            moved = np.maximum(moved, self.rig.lower)
            trial, _ = self._trial(at, window, known, moved)
            if self.cost(at, trial, given) + self._strayed(moved, known) <= before + 1.0:
                return np.asarray(moved)
            share *= 0.5
        return None

    def cost(self, at: Linearised, regression: Regression, given: bool) -> float:
        """Return twice the negative log posterior of a trajectory under a point's noise.

        All but the parameters, and the constants where they are given, are free.
        """
        X = regression.without_jumps
        G = at.cells.gram(at.Si, X)
        layout = regression.layout
        others = np.arange(layout.nuisance.stop)
        if not given:
            others = np.concatenate([others, np.arange(layout.xi.start, layout.base)])
        score = G[others, -1] + at.ridge.b[others]
        V = inverse(G[np.ix_(others, others)] + at.ridge.R[np.ix_(others, others)])
        return float(G[-1, -1] - score @ V @ score)

    def elsewhere(
        self, at: Linearised, window: Window, known: Knowledge, eta: FloatArray
    ) -> Linearised | None:
        """Return a window about constants eta (c,) and parameters that go with them, under the same noise.

        None where Gauss-Newton does not come to rest there.
        """
        alone, _, Z = at.given
        theta = shifted(at.theta + at.unit * alone, -at.unit * (Z @ (eta - known.eta)))
        there = replace(known, eta=eta)
        for _ in range(tuning.STEPS):
            theta = np.maximum(theta, self.rig.lower)
            columns, unit = self._trial(at, window, there, theta)
            G = at.cells.gram(at.Si, columns.X)
            at = replace(at, theta=theta, unit=unit, regression=columns, G=G)
            step, V, _ = at.given
            if self.length(at, step, np.sqrt(np.diag(V))) <= 1.0:
                return at
            longest = tuning.LONGEST_STEP
            theta = at.theta + at.unit * np.clip(step, -longest, 2 * longest)
        return None

    def _trial(
        self, at: Linearised, window: Window, known: Knowledge, theta: FloatArray
    ) -> tuple[Regression, FloatArray]:
        """The columns of a window at theta (q,), under the noise of another point, and their units (q,)."""
        self.evaluations += 1
        response = self._at(theta, known, known.kept)
        lasting = at.regression.layout.lasting
        regressor = Regressor(self.rig, response, self.sources, known.eta, lasting, known.stretch)
        no_cuts = np.zeros(0, dtype=np.int64)
        columns = regressor.build(window, lambda X: at.cells.gram(at.Si, X), no_cuts, whole=False)
        return columns, response.at.unit

    def point(
        self, window: Window, known: Knowledge, theta: FloatArray, cuts: IntArray, joint: bool = False
    ) -> Linearised:
        """Return the window at theta (q,), with columns of jumps at `cuts`.

        joint: with the motion that unknown forces make in it.
        """
        regressor, regression, cells, Si = self._regressed(window, known, theta, cuts, joint)
        response, noise = regressor.response, known.noise
        G = cells.gram(Si, regression.X)
        G[-1, -1] += HighPower(response, regression.high, noise.levels).quadratic(Si)
        constants = known.constants
        ridge = self.ridge(
            regression.layout,
            window,
            self.spread(constants),
            self.expected(constants) - known.eta,
            noise.intensity,
        )
        changes = int(np.count_nonzero(rows_with(np.diff(window.y, axis=0) != 0)))
        repeats = float(by_repeats(changes, self.window))
        at = Linearised(
            theta, response.at.unit, regression, cells, G, Si, ridge, True, repeats, 1.0, np.ones(len(cuts))
        )
        number, size = known.constants.slide
        if size > 0:
            at = replace(at, slide=size * regressor.slide(window, self.rig.constants[number]))
        return at if noise.rounding is None else _rounded(at, window, noise.rounding, cuts)

    def _regressed(
        self, window: Window, known: Knowledge, theta: FloatArray, cuts: IntArray, joint: bool = False
    ) -> tuple[Regressor, Regression, Cells, ComplexArray]:
        """The columns of a window at theta (q,), by what made them, with S⁻¹ on its cells."""
        self.evaluations += 1
        response = self._at(theta, known, known.kept)
        lasting = known.noise.lasting(self.sources)
        regressor = Regressor(self.rig, response, self.sources, known.eta, lasting, known.stretch)
        cells = self._sources_at(response, regressor.output_gain)
        noise = known.noise
        Si = inverse_of(cells.covariance(noise.white, noise.levels, noise.intensity))
        regression = regressor.build(
            window, lambda X: cells.gram(Si, X), cuts,
            lambda left: self._driven(cells, noise, (Si[: cells.kept] @ left[..., None])[..., 0]),
            joint=joint,
        )  # fmt: skip
        return regressor, regression, cells, Si

    def _driven(self, cells: Cells, noise: Noise, weighted: ComplexArray) -> ComplexArray:
        """(kept, n) the states that unknown forces drive, by S⁻¹ of readings (kept, p): Cov(x, y) S⁻¹ y."""
        kept, response = cells.kept, cells.response
        forces = [a for a, source in enumerate(self.sources) if source.kind == "force"]
        E = response.at.E[:, [self.sources[a].number for a in forces]]
        power = noise.intensity[forces, None] ** 2 * cells.spectra[forces, :kept]
        told = (cells.D[:kept][:, :, forces].conj() * weighted[..., None]).sum(axis=1)
        return np.asarray((response.R @ (power.T * told @ E.T)[..., None])[..., 0])

    def _step(self, at: Linearised, known: Knowledge, given: bool) -> tuple[FloatArray, float]:
        """The step (q,), constants estimated beside it or given, and its length; of one cut short infinite.

        Up to 1 the second-order term that is neglected is small against the sd with the constants given, or
        what would go further is held at the least that it may be.
        """
        at = self._anchored(at, known.theta)
        alone, V, Z = at.given
        if given:
            step = alone - Z @ (self.expected(known.constants) - known.eta)
        else:
            step = at.fitted[1][at.regression.layout.psi]
        return step, self.length(at, step, np.sqrt(np.diag(V)))

    def length(self, at: Linearised, step: FloatArray, sd: FloatArray) -> float:
        """Return the length of a step (q,) of sd (q,); of one that would be cut short infinite."""
        held = (at.theta <= self.rig.lower) & (step < 0)
        lengths = np.abs(step) / _straight(sd)
        lengths[np.abs(step) > tuning.LONGEST_STEP] = np.inf
        return float(np.max(lengths, where=~held, initial=0.0))

    def _anchored(self, at: Linearised, anchor: FloatArray) -> Linearised:
        """A window with the point's own prior on the parameters: what says little of one moves no point far.

        N(anchor, (POINT_SD unit)²) steers where the model is linearised, and enters nothing that is said of
        the window.
        """
        psi = at.regression.layout.psi
        spread = self._anchor_spread(anchor)
        R, b = at.ridge.R.copy(), at.ridge.b.copy()
        R[psi, psi] += np.diag((at.unit / spread) ** 2)
        b[psi] -= at.unit * (at.theta - anchor) / spread**2
        return replace(at, ridge=Ridge(R, b))

    def _strayed(self, theta: FloatArray, known: Knowledge) -> float:
        """Twice the negative log prior of a point."""
        return float((((theta - known.theta) / self._anchor_spread(known.theta)) ** 2).sum())

    def _anchor_spread(self, anchor: FloatArray) -> FloatArray:
        """(q,) sd of the point's prior; none for what is nominally 0, whose size says nothing."""
        return np.where(self.rig.nominal == 0, np.inf, tuning.POINT_SD * unit_of(self.rig, anchor))

    def wide(self, constants: Constants) -> FloatArray:
        """Return the constants' prior (c, c) while the noise is learnt: as far off as any of them may be.

        Springs are as straight as they are believed to be.
        """
        off = [tuning.OFF_DELAY if c.kind == "delay" else tuning.OFF_RELATIVE for c in self.rig.constants]
        sizes = np.where([c.sheet > 0 for c in self.rig.constants], off, 1e-6)
        cubic = self.rig.of_kind("cubic")
        mean, P = constants.standing
        sizes[cubic] = np.hypot(mean, np.sqrt(np.diag(P)))[cubic]
        return np.diag(sizes**2)

    def expected(self, constants: Constants) -> FloatArray:
        """Return the constants (c,) at which a window is linearised: their mean, springs by what stands.

        A cube that hardly any hypothesis has, and that scales with nothing, would else tell apart scales that
        no reading shows.
        """
        mean = constants.expected.copy()
        cubic = self.rig.of_kind("cubic")
        mean[cubic] = constants.standing[0][cubic]
        return mean

    def spread(self, constants: Constants, hard: IntArray | None = None) -> FloatArray:
        """Return the constants' prior (c, c) in a window: the mixture's, springs as far as hypotheses stand.

        A spring that hardly any hypothesis has harden would else take a little of all that happens. hard:
        springs, by their constants, that may harden or soften besides.
        """
        total = constants.total
        cubic = self.rig.of_kind("cubic")
        if not len(cubic):
            return total
        share = np.ones(len(total))
        share[cubic] = np.sqrt(np.minimum(np.diag(constants.standing[1])[cubic] / np.diag(total)[cubic], 1.0))
        spread = total * np.outer(share, share)
        if hard is not None:
            spread[hard, hard] += tuning.OFF_CUBIC**2
        return spread

    def ridge(
        self,
        layout: Layout,
        window: Window,
        P: FloatArray,
        mean: FloatArray,
        intensity: FloatArray | None = None,
    ) -> Ridge:
        """Return the base's prior: constants N(mean, P), lost readings, end effects of given intensities."""
        R = np.diag(layout_free(layout))
        b = np.zeros(layout.base)
        if len(window.lost):
            R[layout.gaps, layout.gaps] = np.diag(1.0 / window.lost_sd**2)
        if intensity is not None:
            assert self._response is not None  # noqa: S101 - the layout is of its regression
            ends = range(layout.ends.start, layout.ends.stop)
            R[ends, ends] = Ends(self._response, self.sources, layout.lasting).precision(intensity)
        if len(mean):
            precision = inverse(P)
            R[layout.xi, layout.xi] = precision
            b[layout.xi] = precision @ mean
        return Ridge(R, b)

    def without_jumps(self, at: Linearised, window: Window, noise: Noise, fit: NoiseFit) -> Linearised:
        """Return the same window under the noise that was just learnt."""
        layout = replace(at.regression.layout, cuts=0)
        R = at.ridge.R.copy()
        ends = range(layout.ends.start, layout.ends.stop)
        R[ends, ends] = fit.ridge()[ends, ends]
        regression = replace(at.regression, X=fit.X, layout=layout)
        no_cuts = np.zeros(0, dtype=np.int64)
        at = replace(
            at, G=fit.G, Si=fit.Si, regression=regression, ridge=replace(at.ridge, R=R), jumps=np.ones(0)
        )
        return at if noise.rounding is None else _rounded(at, window, noise.rounding, no_cuts)

    def rounding_after(self, at: Linearised, noise: Noise, before: Rounding | None) -> Rounding | None:
        """Return the rounding that the bank's filters count on, with what it does under what was learnt."""
        if at.rounding is None:
            return None
        usual = reference(before, at.rounding, max(1 - tuning.FORGET, 1 / max(noise.windows, 1)))
        there = replace(at.rounding, usual=usual)
        noise = replace(noise, rounding=there)
        S = at.cells.covariance(noise.white, noise.levels, noise.intensity)
        return _weighed(there, at, inverse_of(S))

    def nearer(
        self,
        at: Linearised,
        known: Knowledge,
        there: FloatArray,
        eta: FloatArray,
        same: bool | None = None,
    ) -> tuple[FloatArray, Footing]:
        """The next point (q,) and what it rests on: the information-weighted mean with this window's.

        there, eta: (c,) the constants at which the window is linearised, and of the next point: with
        constants that no data ask for, parameters make up for them, differently in each window. Where the
        window and the point before disagree the window alone is the next point; same: whether they are known
        to agree.
        """
        alone, V, Z = self._anchored(at, known.theta).given
        V = at.repeats * V
        slope = -at.unit[:, None] * Z
        information = inverse(V * np.outer(at.unit, at.unit))
        here = shifted(at.theta + at.unit * alone, slope @ (eta - there))
        footing = known.footing
        if footing is None:
            return np.maximum(here, self.rig.lower), Footing(information, slope)
        before = shifted(known.theta, footing.sensitivity @ (eta - known.eta))
        if same is None:
            same = bool(np.all(np.abs(here - before) < tuning.AGREE_SD * at.unit * np.sqrt(np.diag(V))))
        if same:
            total = tuning.POINT_MEMORY * footing.information + information
            gain = inverse(total) @ information
            here = before + gain @ (here - before)
            slope = footing.sensitivity + gain @ (slope - footing.sensitivity)
            information = total
        return np.maximum(here, self.rig.lower), Footing(information, slope)

    # ------------------------------------------------------------------ which bins
    def kept(self, window: Window, known: Knowledge) -> int:
        """Return the fewest bins that cost no parameter more than a share of its sd.

        With constants as good as given, and as their data sheets have them.
        """
        total = self.window // 2 + 1
        top = min(total, MOST_BINS)
        if total < ALL_BINS:
            return total
        no_cuts = np.zeros(0, dtype=np.int64)
        _, regression, cells, Si = self._regressed(window, replace(known, kept=top), known.theta, no_cuts)
        ladder = np.unique(np.round(np.geomspace(10, top, 24)).astype(np.int64))
        layout = regression.layout
        least = 2 * layout.n + 4
        priors = self._priors(layout, window, known)
        grams = _running(regression.X[..., :-1], cells, Si, ladder)
        most = (1 + tuning.INFORMATION_LOSS) * _sd_of(layout, grams[-1], priors)

        def is_enough(rung: int) -> bool:
            return bool(ladder[rung] > least and np.all(_sd_of(layout, grams[rung], priors) < most))

        # a bin more never widens an interval
        rung = bisect_left(range(len(ladder)), True, key=is_enough)
        best = int(ladder[min(rung, len(ladder) - 1)])
        return total if best > 0.8 * total else best

    def _priors(self, layout: Layout, window: Window, known: Knowledge) -> FloatArray:
        """Prior precisions of the base columns with constants as good as given, then at their data sheet.

        Springs are as they are believed to be.
        """
        believed = np.sqrt(np.diag(self.spread(known.constants))).tolist()
        each = zip(self.rig.constants, believed, strict=True)
        sheet = np.maximum([sd if c.kind == "cubic" else c.sheet for c, sd in each], 1e-6)
        none = np.full(len(self.sources), 1e-150)
        spreads = [np.diag((share * sheet) ** 2) for share in (0.1 * tuning.AS_CONFIGURED, 1.0)]
        ridges = [self.ridge(layout, window, P, np.zeros(len(sheet)), none).R for P in spreads]
        return np.array(ridges)


def _running(X: ComplexArray, cells: Cells, Si: ComplexArray, ladder: IntArray) -> list[FloatArray]:
    """Return Grams of columns (kept, p, c) up to each rung, every bin summed once."""
    weighted = (Si[: cells.kept] @ X) * cells.weight[: cells.kept, None, None]
    out = []
    total = np.zeros((X.shape[-1],) * 2)
    start = 0
    for stop in ladder.tolist():
        total = total + real_gram(X[start:stop], weighted[start:stop])
        out.append(total)
        start = stop
    return out


def _stretch(window: Window, rig: Rig) -> FloatArray:
    """Return the mean square (s,) of each spring's extension, m²; 1 of one that does not move."""
    square = (extensions(window.y, rig.cubics) ** 2).mean(axis=0)
    return np.where(square > 0, square, 1.0)


def _straight(sd: FloatArray) -> FloatArray:
    """Return deviations (q,) within which a model is straight for estimates of sd (q,)."""
    return np.maximum(sd, np.sqrt(tuning.CURVATURE * sd))


def _sd_of(layout: Layout, gram: FloatArray, priors: FloatArray) -> FloatArray:
    """Sds (r, q) of the parameters under each prior precision (r, base, base) of the base columns."""
    M = gram + priors
    d = scales(M)
    values, vectors = np.linalg.eigh(M * d[:, :, None] * d[:, None, :])
    size = np.abs(values)
    values = np.where(size > 1e-14 * size.max(axis=1, keepdims=True), values, np.inf)
    variance = (vectors[:, layout.psi] ** 2 / values[:, None]).sum(axis=2)
    return np.asarray(np.sqrt(np.abs(variance)) * d[:, layout.psi])


def _rounded(at: Linearised, window: Window, rounding: Rounding, cuts: IntArray) -> Linearised:
    """Return a window with what the rounding of its readings does there."""
    rounding = _weighed(rounding, at, at.Si)
    uneven = RoundingErrors(0, window.y, rounding)
    start = np.array(0)
    stop = np.array(window.length)
    return replace(
        at, inflation=float(uneven.inflation(start, stop)), jumps=uneven.jump(start, cuts, stop),
        alike=float(uneven.count(start, stop)) / window.length, rounding=rounding,
    )  # fmt: skip


def _weighed(rounding: Rounding, at: Linearised, Si: ComplexArray) -> Rounding:
    """Return the rounding with what it does to the residual's power and the parameters' scores under S⁻¹."""
    weight, kept = at.cells.weight, at.cells.kept
    psi = at.regression.X[..., at.regression.layout.psi]
    power = np.einsum("k,kcc->c", weight, Si).real / (weight.sum() * Si.shape[1])
    score = np.einsum("k,kcq->cq", weight[:kept], np.abs(Si[:kept] @ psi) ** 2)
    own = np.diag(at.cells.gram(Si, psi))
    return replace(rounding, of_power=power, of_score=np.mean(score / np.maximum(own, 1e-300), axis=1))
