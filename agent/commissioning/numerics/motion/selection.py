"""Which elements a rig has: dropped and proposed one by one, by what windows say and how much they differ.

All elements that could be are estimated together. Each window's cost is a quadratic (see `pooled`), so the
estimates of any choice of elements follow by linear algebra, the others held at 0. Samples within a window
depend on one another and count for what the likelihood of the window says; windows count as many as there
are: the variance of an estimate is that of the likelihood, or, where more, that of leaving out one window at
a time (block jackknife; Kunsch, Ann. Statist. 17 (1989) 1217), and a quantile of Student's t with as many
degrees of freedom as windows less one decides.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from agent.commissioning.numerics.motion.pooled import Costs
from agent.commissioning.tuning import LEVEL, RIDGE
from agent.types import BoolArray, FloatArray


@dataclass(frozen=True)
class Choice:
    """One choice of elements.

    Attributes:
        kept: (q,) the parameters that are free; the others are 0.
        theta, sd: (q,) estimates and their standard deviations, data sheets included.
        score: log likelihood against that of everything free, counted once for dependent data, less what each
            element costs.
    """

    kept: BoolArray
    theta: FloatArray
    sd: FloatArray
    score: float

    @property
    def z(self) -> FloatArray:
        """(q,) estimates in their standard deviations."""
        return np.asarray(self.theta / np.maximum(self.sd, 1e-300))


class Selector:
    """Chooses among the elements of one rig.

    Args:
        costs: what the windows say with every element free.
        elective: (q,) parameters that may be dropped; the others stay.
        scatter: how many times more windows differ than they should, as a variance.
    """

    def __init__(self, costs: Costs, elective: BoolArray, scatter: float) -> None:
        self.elective = elective
        self._costs, self._scatter = costs, scatter
        self._H, self._h = np.array(costs.H), np.array(costs.h)
        self._known: dict[bytes, Choice] = {}
        windows = len(costs.H)
        self.needed = float(stdtrit(windows - 1, 1.0 - LEVEL / max(1, int(elective.sum()))))
        self._least = self._minimum(np.ones(len(elective), dtype=bool))[1]

    def choice(self, kept: BoolArray) -> Choice:
        """Return the estimates of a choice of elements."""
        key = kept.tobytes()
        if key not in self._known:
            self._known[key] = self._fitted(kept)
        return self._known[key]

    def best(self) -> Choice:
        """Drop elements from all, least certain first, until each is certain; then re-add what is certain."""
        kept = np.ones(len(self.elective), dtype=bool)
        while (weakest := self._weakest(kept)) is not None:
            kept[weakest] = False
        for _ in range(len(kept)):
            proposed = self._strongest(kept)
            if proposed is None:
                break
            kept[proposed] = True
        return self.choice(kept)

    def neighbours(self, choice: Choice) -> list[Choice]:
        """Return the choices with one element more or one less, the best first."""
        found = []
        for i in np.flatnonzero(self.elective).tolist():
            kept = choice.kept.copy()
            kept[i] = not kept[i]
            found.append(self.choice(kept))
        return sorted(found, key=lambda other: -other.score)

    def _weakest(self, kept: BoolArray) -> int | None:
        z = np.where(kept & self.elective, self.choice(kept).z, np.inf)
        return int(np.argmin(z)) if z.min(initial=np.inf) < self.needed else None

    def _strongest(self, kept: BoolArray) -> int | None:
        gains = []
        for i in np.flatnonzero(self.elective & ~kept).tolist():
            more = kept.copy()
            more[i] = True
            gains.append((float(self.choice(more).z[i]), i))
        z, i = max(gains, default=(-np.inf, 0))
        return i if z >= self.needed else None

    def _at(self, kept: BoolArray) -> tuple[BoolArray, FloatArray]:
        """Return which deviations are free (q + c,), and all with the others where the elements are 0."""
        constants = len(self._costs.offset) - len(kept)
        free = np.concatenate([kept, np.ones(constants, dtype=bool)])
        return free, np.concatenate([-self._costs.theta / self._costs.unit, np.zeros(constants)])

    def _apart(self, kept: BoolArray) -> FloatArray:
        """Return (K, q) the deviations with each window left out in turn."""
        free, d = self._at(kept)
        H = self._costs.prior + self._H.sum(axis=0) - self._H
        h = self._costs.offset + self._h.sum(axis=0) - self._h
        solved = _solved(H[:, free][:, :, free], h[:, free] - H[:, free][:, :, ~free] @ d[~free])
        found = np.tile(d, (len(H), 1))
        found[:, free] = solved
        return found[:, : len(kept)]

    def _minimum(self, kept: BoolArray) -> tuple[FloatArray, float]:
        """Return the deviations (q + c,) at which a choice costs least, and that cost."""
        H, h = self._costs.prior + self._H.sum(axis=0), self._costs.offset + self._h.sum(axis=0)
        free, d = self._at(kept)
        d[free] = _solved(H[np.ix_(free, free)], h[free] - H[np.ix_(free, ~free)] @ d[~free])
        return d, float(d @ H @ d - 2 * h @ d)

    def _fitted(self, kept: BoolArray) -> Choice:
        costs = self._costs
        q, count = len(kept), len(self._H)
        d, cost = self._minimum(kept)
        H = costs.prior + self._H.sum(axis=0)
        free = np.concatenate([kept, np.ones(len(H) - q, dtype=bool)])
        variance, given = np.zeros(q), np.zeros(q)
        variance[kept] = _variances(H[np.ix_(free, free)])[: int(kept.sum())]
        given[kept] = _variances(H[:q, :q][np.ix_(kept, kept)])
        apart = self._apart(kept)
        jackknife = (count - 1) / count * np.sum((apart - apart.mean(axis=0)) ** 2, axis=0)
        # what data sheets leave open is the same in all windows, and no jackknife shows it
        sd = costs.unit * np.sqrt(variance + np.maximum(jackknife - given, 0.0))
        theta = np.where(kept, costs.theta + costs.unit * d[:q], 0.0)
        dropped = int((self.elective & ~kept).sum())
        score = -0.5 * (cost - self._least) / self._scatter + 0.5 * dropped * self.needed**2
        return Choice(kept.copy(), theta, sd, score)


def _solved(H: FloatArray, h: FloatArray) -> FloatArray:
    """Return H⁻¹ h of (..., n, n) and (..., n); what nothing is known of stays where it is."""
    size = np.sqrt(np.maximum(np.diagonal(H, axis1=-2, axis2=-1), 1e-300))
    scaled = H / size[..., :, None] / size[..., None, :] + RIDGE * np.eye(H.shape[-1])
    return np.asarray(np.linalg.solve(scaled, (h / size)[..., None])[..., 0] / size)


def _variances(H: FloatArray) -> FloatArray:
    """Return the diagonal of H⁻¹ (n, n): columns differ in units, so a pseudo-inverse drops small ones."""
    return np.diagonal(_solved(np.broadcast_to(H, (len(H), *H.shape)), np.eye(len(H)))).copy()
