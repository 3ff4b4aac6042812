"""A contest of explanations: did the parameters change, or does one channel read wrongly?

All are put to one window by evidence (Schwarz, Ann. Stat. 6 (1978) 461), 2 log L − k log ν, under the noise
known:

    structure    θ as it was, free, one of its elements free, or free with a jump inside the window
    channel      θ ~ N(as it was, sd²), and one channel mended by one number: offset, gain or delay

At given θ the window is linear in the readings, so the column of an offset is a constant, that of a gain the
reading itself; that of a delay is the change a sample. A number found so is mended in the readings and the
window looked at again, until it rests: what counts is the evidence of the mended window.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from agent.numerics.inference import tuning
from agent.numerics.inference.learner import Learner
from agent.numerics.inference.linearise import Linearised
from agent.numerics.inference.noise.state import chance
from agent.numerics.inference.posterior import Knowledge
from agent.numerics.inference.spectral.algebra import inverse
from agent.numerics.inference.spectral.bins import unitary
from agent.numerics.inference.spectral.columns import Regressor, Window
from agent.numerics.inference.tuning import FLAT, LEAST_FACTOR, RESTS_SAMPLES, RESTS_SD
from agent.numerics.model.uncertain import Rig
from agent.types import ComplexArray, FloatArray

Kind = Literal["offset", "gain", "delay", "stood"]
Late = Callable[[int, int], Window | None]
"""(channel, lag) -> window with a channel's readings moved back by so many samples; None where not whole"""


@dataclass(frozen=True, slots=True)
class Fault:
    """What one channel does wrong.

    Attributes:
        channel: outputs first, then inputs.
        kind: what it does;  size, sd: how much: what is read too much (SI), a share, samples; the value it
            stood at.
    """

    channel: int
    kind: Kind
    size: float
    sd: float

    @property
    def lag(self) -> int:
        """Whole samples that a channel comes late; 0 where that is not its fault."""
        return round(self.size) if self.kind == "delay" else 0

    def moved(self, step: float) -> "Fault":
        """Return the fault with what was still found of it once its size was put right."""
        size = (1 + self.size) * (1 + step) - 1 if self.kind == "gain" else self.size + step
        return replace(self, size=size)


@dataclass(frozen=True, slots=True)
class Explanation:
    """One explanation of a window.

    Attributes:
        fault: None where it is the structure.
        evidence: log of the marginal likelihood, but for what all have in common.
        excess: predictive standard deviations by which what it leaves is too large.
    """

    fault: Fault | None
    evidence: float
    excess: float

    @property
    def explains(self) -> bool:
        """Whether what it leaves is like the noise: no more, and no less."""
        return abs(self.excess) <= tuning.EXPLAINED_SD


@dataclass(frozen=True, slots=True)
class Contest:
    """The explanations of a window: the best by the structure, and the best of each channel, best first."""

    structure: Explanation
    channels: tuple[Explanation, ...]

    @property
    def fault(self) -> Fault | None:
        """What is believed of a channel: it explains the window, and nothing else does nearly as well."""
        return self.ahead_by(tuning.CHANNEL_EVIDENCE)

    def ahead_by(self, evidence: float) -> Fault | None:
        """The fault that explains the window and leads all else by so much evidence; None where none does."""
        if not self.channels or not self.channels[0].explains:
            return None
        best = self.channels[0]
        others = [self.structure, *self.channels[1:2]]
        clear = all(best.evidence - other.evidence > evidence for other in others)
        return best.fault if clear else None

    @property
    def leads(self) -> Fault | None:
        """A fault that explains the window even slightly better than the structure; None where none does."""
        explain = [e for e in self.channels if e.explains]
        best = explain[0] if explain else None
        return best.fault if best is not None and best.evidence > self.structure.evidence else None

    def with_stood(self, one: Explanation) -> "Contest":
        """Return the contest with an input that is not believed as one more explanation."""
        return replace(self, channels=_best_of_each([*self.channels, one]))


@dataclass(frozen=True, slots=True)
class _Prior:
    """Precision R (k, k) of columns, R times their means b (k,), and meansᵀ R means."""

    R: FloatArray
    b: FloatArray
    constant: float

    def towards(self, count: float) -> "_Prior":
        """Return the prior with -2 count log(1 + s) in the cost, to second order in s, the last column's."""
        R, b = self.R.copy(), self.b.copy()
        R[-1, -1] += count
        b[-1] += count
        return replace(self, R=R, b=b)


class ChannelTest:
    """Weighs explanations of windows of one rig."""

    def __init__(self, learner: Learner) -> None:
        self._learner, self._rig = learner, learner.rig
        self._inputs = np.flatnonzero(learner.rig.driven).tolist()

    def contest(
        self,
        window: Window,
        known: Knowledge,
        sd: FloatArray,
        solved: FloatArray,
        late: Late,
        everything: bool = False,
    ) -> Contest:
        """Weigh a window; known: what held before, sd (q,) of its θ; solved (q,): θ where it converged."""
        there = self._learner.at_point(window, replace(known, theta=solved), jumps=True)
        before = self._learner.at_point(window, known)
        structure = max((self._structure(at, known, sd) for at in (before, there)), key=lambda e: e.evidence)
        # linear evidences are of one scale: what is far behind is not mended
        first = list(self._looked(before, window, known, sd))
        least = min((value for _, value in first), default=0.0)
        worth = [
            fault
            for fault, value in first
            if everything or value - least < 2 * tuning.WORTH_MENDING * _temper(known)
        ]
        found = [e for fault in worth if (e := self._mended(fault, known, sd, late)) is not None]
        contest = Contest(structure, _best_of_each(found))
        if contest.leads is None:
            return contest
        return replace(contest, structure=self._noisier(window, known, solved, contest))

    def is_pushed(self, window: Window, known: Knowledge, sd: FloatArray, solved: FloatArray) -> bool:
        """Whether other noise or unknown forces, θ as it was, explain a window better than the structure.

        known: with the θ that was learnt last, sd (q,) of it; solved (q,): θ where the window converged. That
        may have been under other noise too.
        """
        if not known.noise.shows_colours:
            return False
        there = replace(known, theta=solved)
        before = self._structure(self._learner.at_point(window, known), known, sd).evidence
        # a change that passes through the window must not be taken for forces because no cut is near it
        cuts = np.arange(1, tuning.FINE_CUTS) * window.length // tuning.FINE_CUTS
        few = np.array_split(cuts, len(tuning.CUTS))  # columns of all at once would take megabytes
        moved = max(
            self._structure(self._learner.at_point(window, there, cuts=some), known, sd).evidence
            for some in few
        )
        at = self._with_other_noise(window, known)
        pushed = self._under_prior(at, known, (at.unit / sd) ** 2, 0).evidence
        if pushed <= max(before, moved):
            return False
        at = self._with_other_noise(window, there)
        return pushed > self._under_prior(at, known, np.full(self._rig.q, FLAT), self._rig.q).evidence

    def forces_lead_by(self, window: Window, learnt: Knowledge) -> float:
        """Log evidence by which a window's unknown forces explain it better than none; θ free with either.

        learnt: from this window.
        """
        are_forces = [source.kind == "force" for source in self._learner.sources]
        noise = learnt.noise
        if not (noise.is_started and any(are_forces)):
            return 0.0
        without = replace(noise, intensity=np.where(are_forces, noise.nodes[:, 0], noise.intensity))
        flat = np.full(self._rig.q, FLAT)
        with_, none = (
            self._under_prior(self._learner.at_point(window, known), known, flat, self._rig.q).evidence
            for known in (learnt, replace(learnt, noise=without))
        )
        return with_ - none

    def _with_other_noise(self, window: Window, known: Knowledge) -> Linearised:
        """Return a window at the point known, under the noise that explains it best there."""
        return self._learner.at_point(window, replace(known, noise=self._learner.other_noise(window, known)))

    def _noisier(self, window: Window, known: Knowledge, solved: FloatArray, contest: Contest) -> Explanation:
        """The structure with other noise or unknown forces, where that explains a window better."""
        options = [contest.structure]
        for theta in (solved, known.theta):
            there = replace(known, theta=theta)
            noisier = replace(there, noise=self._learner.other_noise(window, there))
            if self._learner.unknown_forces(window, noisier.noise) > tuning.MANY_TIMES:
                continue  # such forces would explain whatever a channel reads
            at = self._learner.at_point(window, noisier)
            free = self._under_prior(at, known, np.full(self._rig.q, FLAT), self._rig.q)
            options.append(replace(free, evidence=free.evidence - tuning.NOISE_PRICE))
        return max(options, key=lambda e: e.evidence)

    # ------------------------------------------------------------------ the structure
    def _structure(self, at: Linearised, known: Knowledge, sd: FloatArray) -> Explanation:
        layout = at.regression.layout
        dof = self._dof(at)
        q, nb = self._rig.q, layout.base
        flat = np.full(q, FLAT)
        held = (at.unit / sd) ** 2
        base = list(range(nb))
        options = [(base, held, 0), (base, flat, q)]
        options += [(base, np.where(np.arange(q) == i, flat, held), 1) for i in range(q)]
        for cut in range(layout.cuts):
            t = layout.jump(cut)
            options.append(([*base, *range(t.start, t.stop)], flat, 2 * q))
            options += [([*base, t.start + i], np.where(np.arange(q) == i, flat, held), 2) for i in range(q)]
        best = (-np.inf, np.inf)
        for columns, precision, count in options:
            prior = self._prior(at, known, precision, len(columns) - nb)
            rss, _, _ = _fit(at.G[np.ix_([*columns, -1], [*columns, -1])], prior)
            best = max(best, (self._evidence(at, known, rss, count), self._excess(rss, dof, known)))
        return Explanation(None, *best)

    # ------------------------------------------------------------------ the channels
    def _looked(
        self, at: Linearised, window: Window, known: Knowledge, sd: FloatArray
    ) -> Iterator[tuple[Fault, float]]:
        """Yield each fault at its linear size, with what it leaves."""
        p = self._learner.p
        kinds: tuple[Kind, ...] = ("offset", "gain", "delay")
        faults = [
            (channel, kind) for channel in (*range(p), *(p + j for j in self._inputs)) for kind in kinds
        ]
        columns = np.stack([self._column(at, window, known, *fault) for fault in faults], axis=2)
        scales = [self._scales(*fault) for fault in faults]
        for (channel, kind), found in zip(faults, self._with(at, known, sd, columns, scales), strict=True):
            if found is not None:
                yield Fault(channel, kind, found[1], found[2]), found[0]

    def _scales(self, channel: int, kind: Kind) -> bool:
        """Whether a fault scales readings with their noise."""
        return kind == "gain" and channel < self._learner.p

    def _with(
        self, at: Linearised, known: Knowledge, sd: FloatArray, more: ComplexArray, scales: Sequence[bool]
    ) -> Iterator[tuple[float, float, float] | None]:
        """Yield what each column (kept, p, f) leaves, its size and its sd; None where nothing shows it.

        scales (f,): columns that scale readings. Least squares alone would make these small, their noise with
        them: the density of readings as they came has log(1 + size) for each of them, here to second order.
        """
        nb = at.regression.layout.base
        G = at.cells.gram(
            at.Si, np.concatenate([at.regression.X[..., :nb], more, at.regression.X[..., -1:]], axis=2)
        )
        G[-1, -1] = at.G[-1, -1]
        prior = self._prior(at, known, (at.unit / sd) ** 2, 1)
        # columns show, and shrink, the noise of the kept bins only
        scaled = prior.towards(float(at.cells.weight[: at.cells.kept].sum()) * _temper(known))
        for i, by_scale in enumerate(scales, nb):
            columns = [*range(nb), i, -1]
            if G[i, i] <= 0:
                yield None
                continue
            rss, fit, V = _fit(G[np.ix_(columns, columns)], scaled if by_scale else prior)
            yield rss, float(fit[-1]), float(np.sqrt(V[-1, -1]))

    def _column(
        self, at: Linearised, window: Window, known: Knowledge, channel: int, kind: Kind
    ) -> ComplexArray:
        """(kept, p) the residual where a channel reads 1 too little, 1/2 of what it should, 1 late."""
        response, p = at.cells.response, self._learner.p
        kept = response.bins.kept
        regressor = Regressor(self._rig, response, self._learner.sources, known.eta, stretch=known.stretch)
        if channel < p:
            out = np.zeros((kept, p), dtype=complex)
            out[:, channel] = self._signal(at, regressor, window, kind, channel)
            return out
        change = window.slope if kind == "delay" else window.u if kind == "gain" else np.ones_like(window.u)
        taps = self._rig.taps_of(channel - p)
        U = unitary(change[:, taps])[:kept] * regressor.input_gain[taps]
        driven = [response.driven(int(j), U[:, i]) for i, j in enumerate(taps)]
        return np.asarray(np.sum(driven, axis=0) * regressor.output_gain)

    def _signal(
        self, at: Linearised, regressor: Regressor, window: Window, kind: Kind, channel: int
    ) -> ComplexArray:
        """(kept,) what an output's own residual holds."""
        response = at.cells.response
        kept = response.bins.kept
        if kind == "delay":
            U = unitary(regressor.inputs(window))[:kept]
            change = at.regression.states @ (response.at.A.T - np.eye(response.at.n)) + U @ response.at.B.T
            return np.asarray(-(change @ response.at.C[channel]) * regressor.output_gain[channel])
        reading = window.y[:, channel] if kind == "gain" else np.ones(window.length)
        return -unitary(reading)[:kept]

    def _mended(self, fault: Fault, known: Knowledge, sd: FloatArray, late: Late) -> Explanation | None:
        """Mend readings by a fault's size, then by what is left, until it rests; None where it never does."""
        last = 0.0
        for _ in range(tuning.MENDINGS):
            left = self._left(fault, known, sd, late)
            if left is None:
                return None
            window, step, spread = left
            fault = replace(fault, sd=spread)
            if fault.kind == "delay":
                fault = replace(fault, size=fault.lag)
                if abs(step) < RESTS_SAMPLES:
                    return self._explained(fault.moved(step), window, known, sd)
            if abs(step) < RESTS_SD * spread:
                return self._explained(fault, window, known, sd)
            last = _restrained(step, last)
            fault = fault.moved(last)
        return None

    def _left(
        self, fault: Fault, known: Knowledge, sd: FloatArray, late: Late
    ) -> tuple[Window, float, float] | None:
        """Return a window put right by a fault's size, how much is left, and its sd; None where none is."""
        lag = fault.lag
        whole = late(fault.channel, lag) if 0 <= lag < self._learner.window // 4 else None
        if whole is None:
            return None
        window = _put_right(whole, self._rig, fault)
        at = self._learner.at_point(window, known)
        column = self._column(at, window, known, fault.channel, fault.kind)[..., None]
        (found,) = self._with(at, known, sd, column, [self._scales(fault.channel, fault.kind)])
        return None if found is None else (window, found[1], found[2])

    def _explained(
        self, fault: Fault, window: Window, known: Knowledge, sd: FloatArray
    ) -> Explanation | None:
        """A mended window's evidence: of a gain, with noise behind or before it, whichever is likelier."""
        factor = abs(1 + fault.size) if fault.kind == "gain" else 1.0
        if factor < LEAST_FACTOR:
            return None
        behind = np.zeros(self._learner.p)
        if fault.channel < self._learner.p:
            behind[fault.channel] = np.log(factor)
        shifts = [behind, np.zeros_like(behind)] if abs(behind).max() > 0 else [behind]
        return max((self._under(fault, window, known, sd, s) for s in shifts), key=lambda e: e.evidence)

    def _under(
        self, fault: Fault, window: Window, known: Knowledge, sd: FloatArray, shift: FloatArray
    ) -> Explanation:
        """A mended window's evidence with log σ shifted (p,), as a density of the readings as they came."""
        noise = replace(known.noise, log_sigma=known.noise.log_sigma + shift)
        at = self._learner.at_point(window, replace(known, noise=noise))
        found = self._under_prior(at, known, (at.unit / sd) ** 2, 1)
        stretched = fault.kind == "gain" and fault.channel < self._learner.p
        volume = float(at.cells.weight.sum() * np.log(abs(1 + fault.size))) if stretched else 0.0
        return replace(found, fault=_as_read(fault), evidence=found.evidence + volume / _temper(known))

    def unbelieved(
        self, window: Window, known: Knowledge, sd: FloatArray, number: int, value: float, usual: float
    ) -> Explanation:
        """Evidence of a window whose input is not believed: a white force about as large in its place."""
        at = self._learner.at_point(window, known)
        return max(
            (self._in_its_place(at, known, sd, Fault(self._learner.p + number, "stood", value, share * usual))
             for share in tuning.STOOD_SHARES),
            key=lambda e: e.evidence,
        )  # fmt: skip

    def _in_its_place(self, at: Linearised, known: Knowledge, sd: FloatArray, fault: Fault) -> Explanation:
        """Evidence under a force of intensity fault.sd, white and lasting; its mean and its ends are free."""
        response, kept, W = at.cells.response, at.cells.kept, self._learner.window
        taps = self._rig.taps_of(fault.channel - self._learner.p)
        z = response.z[:kept]
        pole = np.exp(-2 * np.pi / W)
        tapped = [z**shift for shift, _ in zip((0, *self._rig.shifts), taps, strict=False)]
        lasting = (1 - pole**W) / (1 - pole / z) / np.sqrt(W)
        more = [
            np.sum([response.driven(int(j), t * signal) for j, t in zip(taps, tapped, strict=True)], axis=0)
            for signal in (unitary(np.ones(W))[:kept].astype(complex), lasting)
        ]
        h = np.sum([response.HU[:kept, :, j] * t[:, None] for j, t in zip(taps, tapped, strict=True)], axis=0)
        power = fault.sd**2 * (1 + (1 - pole**2) / np.abs(1 - pole / z) ** 2)
        S = np.linalg.inv(at.Si)
        S[:kept] += power[:, None, None] * h[:, :, None] * h[:, None, :].conj()
        unsure = replace(at, Si=np.asarray(np.linalg.inv(S), dtype=complex))
        nb = at.regression.layout.base
        X = np.concatenate(
            [at.regression.X[..., :nb], np.stack(more, axis=2), at.regression.X[..., -1:]], axis=2
        )
        G = at.cells.gram(unsure.Si, X)
        # above the kept bins only the start that a wrong input led to would show: they count as what is
        # expected
        G[-1, -1] += at.cells.weight[kept:].sum() * self._learner.p
        rss, _, _ = _fit(G, self._prior(at, known, (at.unit / sd) ** 2, len(more)))
        return replace(self._explanation(unsure, known, rss, 1 + len(more)), fault=fault)

    # ------------------------------------------------------------------ what all share
    def _under_prior(
        self, at: Linearised, known: Knowledge, precision: FloatArray, count: int
    ) -> Explanation:
        """The evidence of a window with θ ~ N(as known, 1/precision) and so many numbers found from it."""
        columns = [*range(at.regression.layout.base), -1]
        rss, _, _ = _fit(at.G[np.ix_(columns, columns)], self._prior(at, known, precision, 0))
        return self._explanation(at, known, rss, count)

    def _explanation(self, at: Linearised, known: Knowledge, rss: float, count: int) -> Explanation:
        return Explanation(
            None, self._evidence(at, known, rss, count), self._excess(rss, self._dof(at), known)
        )

    def _evidence(self, at: Linearised, known: Knowledge, rss: float, count: int) -> float:
        """Log likelihood, tempered whole, less what `count` numbers found from the window cost."""
        likelihood = -0.5 * rss - self._spread_of_noise(at)
        return likelihood / _temper(known) - 0.5 * count * float(np.log(self._dof(at)))

    def _prior(self, at: Linearised, known: Knowledge, precision: FloatArray, more: int) -> _Prior:
        """Prior with θ ~ N(as known, 1/precision), constants as they stand, and so many more flat columns."""
        layout = at.regression.layout
        k = at.regression.layout.base + more
        R, mean = np.zeros((k, k)), np.zeros(k)
        R[: layout.base, : layout.base] = at.ridge.R
        psi, xi = layout.psi, layout.xi
        R[psi, psi] = np.diag(precision)
        mean[psi] = (known.theta - at.theta) / at.unit
        if len(known.eta):
            centre, P = known.constants.standing
            R[xi, xi] = inverse(P)
            mean[xi] = centre - known.eta
        b = R @ mean
        return _Prior(R, b, float(mean @ b))

    def _dof(self, at: Linearised) -> float:
        layout = at.regression.layout
        return float(at.cells.weight.sum() * self._learner.p - layout.n)

    def _excess(self, rss: float, dof: float, known: Knowledge) -> float:
        return float(np.log(max(rss, 1e-300) / dof) / chance(dof, known.noise.unsure))

    def _spread_of_noise(self, at: Linearised) -> float:
        """Half of log det S: unknown forces show otherwise where the parameters are others."""
        return float(-0.5 * at.cells.weight @ np.linalg.slogdet(at.Si)[1])


def _temper(known: Knowledge) -> float:
    """Scatter beyond the model's tempers the likelihood."""
    return max(1.0, float(known.scatter.within.max()))


def _fit(G: FloatArray, prior: _Prior) -> tuple[float, FloatArray, FloatArray]:
    """Least cost of a Gram whose last column is the residual, where it lies (k,), and covariance (k, k)."""
    V = inverse(G[:-1, :-1] + prior.R)
    score = G[:-1, -1] + prior.b
    fit = V @ score
    return float(G[-1, -1] + prior.constant - score @ fit), fit, V


def _put_right(window: Window, rig: Rig, fault: Fault) -> Window:
    """Return readings without offset or gain: plus, or times 1 +, the fault's size; delays moved before."""
    more, factor = (fault.size, 1.0) if fault.kind == "offset" else (0.0, 1.0 + fault.size)
    if fault.kind == "delay":
        return window
    p = window.y.shape[1]
    y, u, slope = window.y.copy(), window.u.copy(), window.slope.copy()
    if fault.channel < p:
        y[:, fault.channel] = factor * y[:, fault.channel] + more
    else:
        taps = rig.taps_of(fault.channel - p)
        u[:, taps] = factor * u[:, taps] + more
        slope[:, taps] *= factor
    return replace(window, y=y, u=u, slope=slope)


def _restrained(step: float, last: float) -> float:
    """Return a step, halved where it turns back: the columns of the parameters scale with what is mended."""
    return 0.5 * step if step * last < 0 else step


def _as_read(fault: Fault) -> Fault:
    """Turn what mends a channel into what it does wrong: x = reading + size reads −size too much."""
    if fault.kind == "offset":
        return replace(fault, size=-fault.size)
    if fault.kind == "gain":
        factor = 1.0 / (1.0 + fault.size)
        return replace(fault, size=factor - 1.0, sd=fault.sd * abs(factor))
    return fault


def _best_of_each(found: list[Explanation]) -> tuple[Explanation, ...]:
    """The best explanation of each channel, best first."""
    best: dict[int, Explanation] = {}
    for e in sorted(found, key=lambda e: -e.evidence):
        assert e.fault is not None  # noqa: S101 - a channel's
        best.setdefault(e.fault.channel, e)
    return tuple(best.values())
