"""What one window says of the constants, and hypotheses on them updated by it."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from agent.numerics.inference import tuning
from agent.numerics.inference.spectral.algebra import inverse_root, root
from agent.numerics.inference.tuning import JITTER
from agent.types import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Information:
    """What a window says of the constants, straight about one point.

    Attributes:
        S, g: (c, c) information and (c,) score;  at: (c,) the point.
        cost: twice the negative log likelihood there; from one point to another only differences count.
        curved: (r, c) what deviations of the constants do to all that the window is straight in, as shares;
            tells: (r,) the information on each of these.
    """

    S: FloatArray
    g: FloatArray
    at: FloatArray
    cost: float
    curved: FloatArray
    tells: FloatArray

    def neglected(self, mean: FloatArray) -> FloatArray:
        """Return how much (h,) the terms of second order are that are neglected at means (h, c).

        In variances: half the square of a share is the size of its term.
        """
        return np.asarray((0.5 * ((mean - self.at) @ self.curved.T) ** 2) ** 2 @ self.tells)


@dataclass(frozen=True, slots=True)
class _Components:
    """Hypotheses after what a window says about one point.

    Attributes:
        left: (h,) squared distance of what it asks for, in variances;  price: (h,) of how wide each was.
        mean: (h, c).
    """

    left: FloatArray
    price: FloatArray
    mean: FloatArray


class Update:
    """Hypotheses under a window that is made straight at one or more points.

    Each is updated about the point nearest to where the window puts it: a component of a Gaussian sum is
    linearised where it stands (Alspach & Sorenson, IEEE Trans. Automatic Control 17 (1972) 439). About one
    point for all, what windows ask of constants that none of them tells apart turns with the point, and
    their sum refutes what each alone allows.

    Args:
        weight, mean, covariance: (h,), (h, c), (h, c, c) before the window.
        said: what it says about a first point.
    """

    def __init__(
        self, weight: FloatArray, mean: FloatArray, covariance: FloatArray, said: Information
    ) -> None:
        self.before = (weight, mean, covariance)
        self.said: list[Information] = []
        self._components: list[_Components] = []
        self._asked = np.zeros(len(weight), dtype=int)
        self._places = 0
        self.also(said)

    def also(self, said: Information) -> Self:
        """Add what the window says about another point."""
        _, mean, covariance = self.before
        self.said.append(said)
        self._components.append(_update_about(mean, covariance, said))
        if len(self.said) == 1:
            self.nearest = np.zeros(len(mean), dtype=int)
            self.mean = self._components[0].mean
            self.doubt = said.neglected(self.mean)
            return self
        there = said.neglected(self._components[-1].mean)
        # a point that was made for a hypothesis takes it, though its mean moves farther on from there
        nearer = np.minimum(said.neglected(self.mean), there) < self.doubt
        self.nearest = np.where(nearer, len(self.said) - 1, self.nearest)
        self.mean = np.where(nearer[:, None], self._components[-1].mean, self.mean)
        self.doubt = np.where(nearer, there, self.doubt)
        return self

    def _log_weight(self, doubt: FloatArray | float = 0.0) -> FloatArray:
        """(h,) after the window, which refutes them the less the more is in doubt (h,)."""
        own = np.arange(len(self.nearest))
        left = np.array([one.left for one in self._components])[self.nearest, own]
        price = np.array([one.price for one in self._components])[self.nearest, own]
        before = np.log(np.maximum(self.before[0], 1e-300))
        return np.asarray(before - 0.5 * (left / (1.0 + doubt) + price))

    def farthest(self) -> FloatArray | None:
        """Return where (c,) the window has to be made straight next; None where it is for all that may be.

        A hypothesis whose mean leaves the points that are made for it asks for no third.
        """
        far = (self.doubt > tuning.NEAR) & (self._asked < 2)
        if not far.any() or self._places >= tuning.PLACES:
            return None
        log = self._log_weight()
        far &= self._log_weight(self.doubt) > log.max() + np.log(tuning.POSSIBLE)
        if not far.any():
            return None
        next_one = int(np.argmax(np.where(far, log, -np.inf)))
        place: FloatArray = self.mean[next_one]
        there = replace(self.said[self.nearest[next_one]], at=place)
        self._asked += there.neglected(self.mean) <= tuning.NEAR
        self._places += 1
        return place

    @property
    def weight(self) -> FloatArray:
        """(h,) after the window."""
        log = self._log_weight()
        weight = np.exp(log - log.max())
        return np.asarray(weight / weight.sum())

    def covariance(self, which: IntArray) -> FloatArray:
        """Return the covariances (n, c, c) of some hypotheses after the window."""
        S = np.array([said.S for said in self.said])[self.nearest[which]]
        # in units of the prior every eigenvalue is 1 or more: no precision is lost to an information 1e16
        # times larger
        F = root(self.before[2][which])
        M = np.eye(S.shape[-1]) + F.swapaxes(1, 2) @ S @ F
        half = inverse_root(M) @ F.swapaxes(1, 2)
        return np.asarray(half.swapaxes(1, 2) @ half)


def _update_about(mean: FloatArray, covariance: FloatArray, said: Information) -> _Components:
    # what the window asks for, along the directions of which it says something, of variance 1/values: the
    # difference of quadratic forms in S that evidence also is has no digits left where S is large
    S, g = said.S, said.g
    d = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2).max(axis=0))
    values, vectors = np.linalg.eigh(S * np.outer(d, d))
    kept = values > JITTER * values.max(initial=0.0)
    along = vectors[:, kept].T / d
    score = vectors[:, kept].T @ (d * g)
    asked = score / values[kept]
    left = asked - (mean - said.at) @ along.T
    across = np.tensordot(covariance, along.T, axes=1)
    half = inverse_root(along @ across + np.diag(1.0 / values[kept]))
    whitened = (half @ left[..., None])[..., 0]
    least = said.cost - score @ asked + np.log(values[kept]).sum()
    return _Components(
        (whitened**2).sum(axis=1),
        least - 2 * np.log(np.abs(half.diagonal(axis1=1, axis2=2))).sum(axis=1),
        mean + (across @ (half.swapaxes(1, 2) @ whitened[..., None]))[..., 0],
    )
