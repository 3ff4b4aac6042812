"""What is known of the rig's constants: a Gaussian sum over hypotheses, carried from window to window.

Hypotheses: every constant as configured; all within a common factor of their data sheets; one constant, or
one group (all masses, all outputs, all inputs) off, or drifting; two of these off. Each carries mean and
covariance; the window's marginal likelihood weighs them (Alspach & Sorenson, IEEE Trans. Automatic Control 17
(1972) 439).
"""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import combinations

import numpy as np

from agent.numerics.inference import tuning
from agent.numerics.inference.information import Information, Update
from agent.numerics.model.uncertain import Constant, Kind
from agent.types import BoolArray, FloatArray, IntArray

GROUPS: tuple[tuple[Kind, str], ...] = (
    ("mass", "all masses"),
    ("output", "all outputs"),
    ("input", "all inputs"),
)

NONE = np.zeros(0, dtype=np.int64)
APART: tuple[Kind, ...] = ("delay", "cubic")
"""Kinds that are no scales: neither masses nor gains."""


@dataclass(frozen=True, slots=True, eq=False)
class Off:
    """One thing that is off.

    Attributes:
        name: "m1", "all masses", "delay".
        members: (c,) 1 for each constant that is off together, 0 for the others.
        drifts: whether it changes from window to window.
    """

    name: str
    members: FloatArray
    drifts: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """One belief about the constants.

    Attributes:
        level: "as configured" or "within data sheet": all that is not off.
        off: what is.
        covariance, walk: (c, c) prior covariance and random walk a window.
        prior: probability before any data.
        start: (c,) sds of what drifts when it begins, in `covariance` too; 0 of all else.
    """

    level: str
    off: tuple[Off, ...]
    covariance: FloatArray
    walk: FloatArray
    prior: float
    start: FloatArray

    @property
    def name(self) -> str:
        """What is off, or the level of all where nothing is."""
        return " and ".join(f"{o.name} drifts" if o.drifts else o.name for o in self.off) or self.level

    @property
    def drifts(self) -> bool:
        """Whether something changes from window to window."""
        return any(o.drifts for o in self.off)

    def with_off(self, off: Off, spread: FloatArray, odds: float) -> "Hypothesis":
        """Return the same where something else is off besides: its variance (c, c), its prior odds."""
        return replace(
            self, off=(*self.off, off), covariance=self.covariance + spread, prior=odds * self.prior
        )

    def with_drift(self, off: Off, start: FloatArray, step: float, odds: float) -> "Hypothesis":
        """Return the same where a gain drifts besides: sds (c,) when it begins, steps a window, prior odds.

        What is off and drifts is one thing.
        """
        others = tuple(o for o in self.off if o.name != off.name)
        walk = self.walk + step**2 * np.outer(off.members, off.members)
        return replace(
            self, off=(*others, off), covariance=self.covariance + np.outer(start, start), walk=walk,
            prior=odds * self.prior, start=start,
        )  # fmt: skip


def hypotheses_of(constants: tuple[Constant, ...]) -> tuple[Hypothesis, ...]:
    """Return the hypotheses on a rig's constants; those that no data show are within their data sheets.

    When inputs act says nothing of how well masses and gains are known, nor the other way round. What may be
    off stands beside all else as configured, and beside all else within its data sheet; a gain that drifts
    beside these, within three times that, and beside whatever may be off, itself too. That a force is held,
    or that a commanded one acts late, stands beside each of the data sheets, and beside what else may be off.
    Two that may be off stand beside all else as configured. Springs that harden or soften, each alone and all
    of them, stand beside each of the data sheets.
    """
    timed = np.array([c.kind == "delay" for c in constants], dtype=bool)
    apart = np.array([c.apart for c in constants], dtype=bool)
    levels = _levels(constants)
    total = sum(odds for _, odds in levels)
    every = [_healthy(constants, share, tuning.PRIOR_HEALTHY * odds / total) for share, odds in levels]
    factors = [factor for factor, _ in _factors(constants)]
    timely = every[: len(factors)]
    as_stated = factors.index(1.0)
    usual = [timely[0], timely[as_stated]]
    sets = _sets(constants)
    each = (1 - tuning.PRIOR_HEALTHY) / max(len(sets), 1)
    still, lasting, drifting = [], [], []
    for off, kind in sets:
        spread = _spread(constants, off, kind)
        beside = timely if off.members @ apart else usual
        still += _share_out([h.with_off(off, spread, 1.0) for h in beside], each)
        if off.members @ apart:
            lasting.append((off, spread, each))
        if kind in ("output", "input"):
            drifting.append(Off(off.name, off.members, drifts=True))
    stills = [h for h in still if not h.off[0].members @ timed]
    exact = [h for h in stills if h.level == timely[0].level]
    wider = [*usual, timely[as_stated + 1]]
    odds = tuning.PRIOR_DRIFTS * each / sum(h.prior for h in (*wider, *exact))
    drifts = _drifts(constants, drifting, [*wider, *exact], odds)
    alone = [h for h in (*stills, *drifts) if len(h.off) == 1]
    both = [h.with_off(*late) for late in lasting for h in alone]
    two = _two(constants, sets, timely[0], each)
    return tuple(every + still + drifts + both + two + _cubics(constants, timely))


def _two(
    constants: tuple[Constant, ...], sets: list[tuple[Off, Kind]], exact: Hypothesis, each: float
) -> list[Hypothesis]:
    """Two that are off, neither of them part of the other, where all else is as configured."""
    scales = [(off, _spread(constants, off, kind)) for off, kind in sets if kind != "delay"]
    healthy = replace(exact, prior=1.0)
    return [
        healthy.with_off(*one, each).with_off(*other, each)
        for one, other in combinations(scales, 2)
        if not one[0].members @ other[0].members
    ]


def _cubics(constants: tuple[Constant, ...], beside: list[Hypothesis]) -> list[Hypothesis]:
    """Springs that harden or soften, one of them or all, each by itself, beside hypotheses."""
    unit = np.eye(len(constants))
    each = [(Off(c.name, unit[i]),) for i, c in enumerate(constants) if c.kind == "cubic"]
    sets = [*each, sum(each, ())] if len(each) > 1 else each
    odds = tuning.PRIOR_CUBIC / max(len(sets), 1)
    spread = tuning.OFF_CUBIC**2 * np.array([np.diag(sum(o.members for o in which)) for which in sets])
    return [
        replace(
            h, off=which, covariance=h.covariance + more, walk=h.walk + tuning.QUIET_WALK**2 * more,
            prior=odds * h.prior,
        )
        for which, more in zip(sets, spread, strict=True)
        for h in beside
    ]  # fmt: skip


def _drifts(
    constants: tuple[Constant, ...], drifting: list[Off], beside: list[Hypothesis], odds: float
) -> list[Hypothesis]:
    """Gains that drift beside hypotheses; where one begins it is within its data sheet beyond these."""
    sheet = np.array([c.sheet for c in constants])
    each = odds / len(tuning.DRIFT_WALKS)
    return [
        h.with_drift(off, off.members * sheet, walk, each)
        for off in drifting
        for walk in tuning.DRIFT_WALKS
        for h in beside
    ]


def _share_out(hypotheses: list[Hypothesis], probability: float) -> list[Hypothesis]:
    """Return hypotheses that share a probability alike."""
    return [replace(h, prior=probability / len(hypotheses)) for h in hypotheses]


def _levels(constants: tuple[Constant, ...]) -> list[tuple[FloatArray, float]]:
    """Shares (c,) of their data sheets within which constants may be, and prior odds; inputs in time first.

    What is so or not of a force is a hypothesis of its own: in these it runs as configured.
    """
    timed = np.array([c.kind in {"delay", "cubic"} for c in constants], dtype=bool)
    binary = np.array([c.is_binary for c in constants], dtype=bool)
    late = any(c.kind == "delay" and c.shows and not c.is_binary and c.sheet > 0 for c in constants)
    # inputs are in time, outputs are read at one instant, and springs are straight
    closed = np.array([c.kind == "cubic" for c in constants], dtype=bool)
    lags = np.array([c.is_lag for c in constants], dtype=bool)
    in_time = np.where(lags, tuning.AT_ONCE, np.where(closed, tuning.STRAIGHT, tuning.AS_CONFIGURED))
    as_late = np.where(closed, tuning.STRAIGHT, 1.0)
    times = ((in_time, 0.0, 1.0), (as_late, 1.0, tuning.PRIOR_LATE))
    # what comes along with a delay is open as wide where inputs may be late as where they are
    along = np.array([tuning.OFF_DELAY / max(c.sheet, 1e-9) * _comes_along(c) for c in constants])
    return [
        (
            np.where(
                binary,
                np.maximum(tuning.AS_CONFIGURED, along * is_late),
                np.where(timed, time, factor),
            ),
            odds * likely,
        )
        for time, is_late, odds in times[: 1 + late]
        for factor, likely in _factors(constants)
    ]


def _factors(constants: tuple[Constant, ...]) -> list[tuple[float, float]]:
    """Shares of all data sheets within which constants may be, and prior odds.

    Ten times as wide they stand for two that are far off at once, which no window of a single mass tells from
    one.
    """
    masses = sum(c.kind == "mass" and c.shows and c.sheet > 0 for c in constants)
    sheets = tuning.SHEET_FACTORS if masses > 1 else tuning.SHEET_FACTORS[:-1]
    wider = np.cumsum(np.array(sheets) > 1).tolist()
    odds = [1.0, *(tuning.PRIOR_WIDER**k for k in wider)]
    return list(zip((tuning.AS_CONFIGURED, *sheets), odds, strict=True))


def _healthy(constants: tuple[Constant, ...], share: FloatArray, prior: float) -> Hypothesis:
    """All constants within shares (c,) of their data sheets; those no data show are at theirs."""
    sheet = np.array([c.sheet for c in constants])
    shows = np.array([c.shows for c in constants], dtype=bool)
    name = "as configured" if share.max(initial=0.0) <= tuning.AS_CONFIGURED else "within data sheet"
    covariance = np.diag((np.where(shows, share, 1.0) * sheet) ** 2) + _least(sheet)
    closed = np.array([c.kind == "cubic" for c in constants], dtype=bool)
    walk = np.diag((tuning.QUIET_WALK * np.where(closed, tuning.STRAIGHT, 1.0) * sheet) ** 2)
    return Hypothesis(name, (), covariance, walk, prior, np.zeros(len(sheet)))


def _least(sheet: FloatArray) -> FloatArray:
    """A variance that keeps exactly known constants (sheet 0) invertible."""
    return np.diag(np.where(sheet > 0, 0.0, 1e-12))


def _spread(constants: tuple[Constant, ...], off: Off, kind: Kind) -> FloatArray:
    """Prior covariance (c, c) of what is off."""
    if kind != "delay":
        return np.asarray(tuning.OFF_RELATIVE**2 * np.outer(off.members, off.members))
    along = np.diag([float(_comes_along(c)) for c in constants])
    return np.asarray(tuning.OFF_DELAY**2 * (np.outer(off.members, off.members) + along))


def apart_of(constants: tuple[Constant, ...]) -> FloatArray:
    """Return the matrix (c, c) that takes from deviations the mean of those of their kind; delays stay."""
    kinds = np.array([c.kind for c in constants])
    alike = (kinds[:, None] == kinds) & ~np.isin(kinds, APART)
    return np.asarray(np.eye(len(constants)) - alike / np.maximum(alike.sum(axis=1), 1)[:, None])


def farthest(constants: tuple[Constant, ...], moved: FloatArray) -> FloatArray:
    """Largest share (h,) by which masses and gains moved (h, c), beyond what all of their kind did."""
    scales = np.array([c.kind not in APART for c in constants], dtype=bool)
    return np.asarray(np.abs((moved @ apart_of(constants))[:, scales]).max(axis=1, initial=0.0))


def _sets(constants: tuple[Constant, ...]) -> list[tuple[Off, Kind]]:
    """Each constant that may be off by itself, with its kind, then groups that may together."""
    can = np.array([c.sheet > 0 and c.shows and c.kind != "cubic" for c in constants], dtype=bool)
    unit = np.eye(len(constants))
    sets = [(Off(c.name, unit[i]), c.kind) for i, c in enumerate(constants) if can[i] and not _comes_along(c)]
    for kind, name in GROUPS:
        alike = np.array([c.kind == kind for c in constants], dtype=bool)
        together = (can & alike).astype(float)
        if together.sum() > 1:
            sets.append((Off(name, together), kind))
    return sets


def _comes_along(constant: Constant) -> bool:
    """Whether it is open wherever inputs are late, and nowhere else: when a step is seen that comes late."""
    return constant.is_binary and not constant.apart


@dataclass(frozen=True, slots=True)
class _Arrays:
    """Hypotheses as arrays: prior weight (h,), covariance, walk (h, c, c), start (h, c)."""

    weight: FloatArray
    covariance: FloatArray
    walk: FloatArray
    start: FloatArray

    @property
    def drifts(self) -> BoolArray:
        """(h,) whether something drifts."""
        return np.asarray(self.start.any(axis=1))


def _squares(rows: FloatArray) -> FloatArray:
    """Return (h, c, c) products of each row (h, c) with itself."""
    return np.asarray(rows[:, :, None] * rows[:, None, :])


@lru_cache(maxsize=128)
def _arrays(hypotheses: tuple[Hypothesis, ...]) -> _Arrays:
    """Return hypotheses as arrays, those of each rig made once."""
    weight = np.array([h.prior for h in hypotheses])
    return _Arrays(
        weight / weight.sum(), np.array([h.covariance for h in hypotheses]),
        np.array([h.walk for h in hypotheses]), np.array([h.start for h in hypotheses]),
    )  # fmt: skip


@lru_cache(maxsize=128)
def _off(hypotheses: tuple[Hypothesis, ...], which: tuple[int, ...]) -> BoolArray:
    """(h,) hypotheses that have any of some constants off, worked out once for each rig."""
    return np.array([any(o.members[list(which)].any() for o in h.off) for h in hypotheses], dtype=bool)


@dataclass(frozen=True)
class Constants:
    """The Gaussian sum.

    Attributes:
        hypotheses: what they are.
        weight: (h,);  mean: (h, c);  covariance: (h, c, c).
    """

    hypotheses: tuple[Hypothesis, ...]
    weight: FloatArray
    mean: FloatArray
    covariance: FloatArray

    @classmethod
    def prior(cls, hypotheses: tuple[Hypothesis, ...]) -> "Constants":
        """Return what is known before the first window."""
        first = _arrays(hypotheses)
        return cls(hypotheses, first.weight, np.zeros(first.covariance.shape[:2]), first.covariance)

    @cached_property
    def expected(self) -> FloatArray:
        """(c,) mean of the mixture."""
        return np.asarray(self.weight @ self.mean)

    @cached_property
    def total(self) -> FloatArray:
        """(c, c) covariance of the mixture."""
        apart = self.mean - self.expected
        within = np.einsum("h,hij->ij", self.weight, self.covariance)
        return np.asarray(within + (self.weight[:, None] * apart).T @ apart)

    @cached_property
    def stands(self) -> BoolArray:
        """(h,) hypotheses that stand: all but those that are unlikely beside the likeliest."""
        return np.asarray(self.weight >= tuning.STANDING_WEIGHT * self.weight.max())

    def believes(self, which: IntArray) -> bool:
        """Whether a hypothesis stands that has any of some constants, by their numbers, off."""
        return bool((self.stands & self._off(which)).any())

    @cached_property
    def standing(self) -> tuple[FloatArray, FloatArray]:
        """Mean (c,) and covariance (c, c) of the hypotheses that stand: what is unlikely moves no estimate.

        One Gaussian with the whole mixture's covariance would let the noise of a window pull the constants as
        far as an explanation of 1 % weight allows.
        """
        kept = self.stands
        weight = self.weight[kept] / self.weight[kept].sum()
        mean = weight @ self.mean[kept]
        apart = self.mean[kept] - mean
        return mean, np.einsum("h,hij->ij", weight, self.covariance[kept]) + (
            weight[:, None] * apart
        ).T @ apart

    def after(self, windows: float) -> "Constants":
        """Return what is known so many windows later where no hypothesis switches."""
        return replace(self, covariance=self.covariance + windows * _arrays(self.hypotheses).walk)

    def predicted(self, windows: float = 1.0) -> "Constants":
        """Return what is known so many windows later: constants walk, hypotheses switch."""
        stays = (1 - tuning.SWITCH) ** windows
        first = Constants.prior(self.hypotheses)
        return replace(self.after(windows), weight=stays * self.weight + (1 - stays) * first.weight)

    def switching(self, windows: float, said: Information, shut: IntArray = NONE) -> Update:
        """Return the update by a window so many after the last, over which hypotheses may switch.

        Each is weighed as it stayed and as it was switched to: it begins with its prior, and pays for how
        wide that is before its odds count. shut: constants, by their numbers, that do not begin to be off.
        """
        stays = (1 - tuning.SWITCH) ** windows
        stayed = self.after(windows)
        begun = self._begun
        return Update(
            np.concatenate([stays * stayed.weight, (1 - stays) * begun.weight * ~self._off(shut)]),
            np.concatenate([stayed.mean, begun.mean]),
            np.concatenate([stayed.covariance, begun.covariance]),
            said,
        )

    def switched(self, update: Update) -> "Constants":
        """Return what is known after `switching`: each hypothesis goes on as it is likelier.

        A Gaussian about both would let all constants go.
        """
        count = len(self.hypotheses)
        both = update.weight.reshape(2, count)
        way = np.arange(count) + count * (both[1] > both[0])
        return Constants(self.hypotheses, both.sum(axis=0), update.mean[way], update.covariance(way))

    def rescaled(self, factor: FloatArray) -> "Constants":
        """Return the same in other units of the constants, which count `factor` (c,) as much in them.

        What data say little of is no wider there than it was before any.
        """
        prior = np.sqrt(np.diagonal(_arrays(self.hypotheses).covariance, axis1=1, axis2=2))
        sd = np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))
        by = np.minimum(factor, np.maximum(prior / sd, 1.0))
        return replace(
            self, mean=self.mean * by, covariance=self.covariance * by[:, :, None] * by[:, None, :]
        )

    @property
    def _begun(self) -> "Constants":
        """Each hypothesis where it becomes true now: as before any data, but what drifts from where it is.

        One that was refuted begins with its prior, as its odds do: where it stood when it was refuted, it
        would have paid nothing for how far that is. A gain that begins to drift has not moved yet (as modes
        interact: Blom & Bar-Shalom, IEEE Trans. Automatic Control 33 (1988) 780).
        """
        first = Constants.prior(self.hypotheses)
        start = _arrays(self.hypotheses).start
        drifting = (start > 0).astype(float)
        mean, total = self.standing
        share = drifting / np.maximum(drifting.sum(axis=1), 1.0)[:, None]
        variance = np.einsum("hi,ij,hj->h", share, total, share)[:, None, None]
        moved = variance * _squares(drifting) - _squares(start)
        return replace(first, mean=(share @ mean)[:, None] * drifting, covariance=first.covariance + moved)

    def _off(self, which: IntArray) -> BoolArray:
        """(h,) hypotheses that have any of some constants, by their numbers, off."""
        return _off(self.hypotheses, tuple(which.tolist()))

    def refused(self, which: IntArray) -> "Constants":
        """Return the same where nothing by which any of some constants is off is likelier than at first.

        What was begins anew.
        """
        first = Constants.prior(self.hypotheses)
        off = self._off(which)
        anew = off & (self.weight > first.weight)
        if not anew.any() or off.all():
            return self
        left = self.weight[~anew].sum()
        if not left > 0:  # so sure of them that the others have no digits: it says nothing of those either
            return first
        share = (1 - first.weight[anew].sum()) / left
        return Constants(
            self.hypotheses,
            np.where(anew, first.weight, share * self.weight),
            np.where(anew[:, None], first.mean, self.mean),
            np.where(anew[:, None, None], first.covariance, self.covariance),
        )

    def updated(self, said: Information) -> "Constants":
        """Return what is known after a window that is straight about one point."""
        update = Update(self.weight, self.mean, self.covariance, said)
        every = np.arange(len(self.hypotheses))
        return Constants(self.hypotheses, update.weight, update.mean, update.covariance(every))

    @property
    def drift_probability(self) -> float:
        """Probability that some constant changes from window to window."""
        return float(self.weight[_arrays(self.hypotheses).drifts].sum())

    @property
    def slide(self) -> tuple[int, float]:
        """The constant that changes most from window to window, and by how much (sd); 0 where none does."""
        if self.drift_probability <= tuning.DRIFT_FOLLOWED:
            return 0, 0.0
        every = _arrays(self.hypotheses)
        variance = self.weight[every.drifts] @ np.diagonal(every.walk[every.drifts], axis1=1, axis2=2)
        most = int(np.argmax(variance))
        return most, float(np.sqrt(variance[most]))

    def probability(self, name: str) -> float:
        """Return the probability that what is called `name` is off or drifts."""
        return float(
            sum(
                w
                for w, h in zip(self.weight, self.hypotheses, strict=True)
                if name in {off.name for off in h.off}
            )
        )
