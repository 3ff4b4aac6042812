"""Is the scatter of the data that of the model? A delete-a-block jackknife, divided by its own expectation.

With block Grams G_j of the whitened columns and M = Σ G_j + R, leaving block j out moves the estimate by
d_j = M_−j⁻¹ g_−j − M⁻¹ g; under the model its covariance is

    E_j = (M_−j⁻¹ − M⁻¹) G_−j (M_−j⁻¹ − M⁻¹)ᵀ + M⁻¹ G_j M⁻¹

so r = Σ diag d_j d_jᵀ / Σ diag E_j is 1 in expectation whatever leverage or prior a block has (Shao & Wu,
Ann. Stat. 17 (1989) 1176, gives the plain form). With all its digits d_j is M_−j⁻¹ times the score of block j
on what the window's estimate leaves. Constants stay where the whole window has them: they are nearly alike
with the parameters, and beside what they leave open the moves of blocks have no digits. What they take of a
score, z_j C z_jᵀ with z_j = X_jᵀ (X_η − X Z)_j and C their covariance, is no part of E_j.

r is pooled over disjoint windows; the scatter between windows is judged by second differences, in which a
slow change of the parameters cancels. Either is 1 by the model, or anything: a few windows say little of it,
so its expectation weighs both (a spike at 1 and a scaled inverse χ² slab).
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.special import expit, gammaln

from agent.numerics.inference import tuning
from agent.numerics.inference.spectral.algebra import inverse
from agent.types import ComplexArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Estimate:
    """What one window says of the parameters with the constants given.

    Attributes:
        theta, covariance: (q,), (q, q) at constants eta (c,).
        sensitivity: (q, c) dθ/dη.
    """

    theta: FloatArray
    covariance: FloatArray
    sensitivity: FloatArray
    eta: FloatArray

    def given(self, eta: FloatArray) -> FloatArray:
        """Return the estimate (q,) with other constants (c,)."""
        return np.asarray(self.theta + self.sensitivity @ (eta - self.eta))

    def at(self, eta: FloatArray) -> "Estimate":
        """Return the same with other constants (c,)."""
        return replace(self, theta=self.given(eta), eta=eta)


@dataclass(frozen=True, slots=True)
class Scatter:
    """Carried belief about the scatter, in units of the model's variance.

    Attributes:
        within: (q,) c, pooled ratio of the jackknife's variance to the model's; dof: behind it.
        between: (q,) c_b, the same for differences between windows.
        compared: how many differences between windows there were.
        last: the two newest disjoint windows.
    """

    within: FloatArray
    between: FloatArray
    dof: float = tuning.SCATTER_PRIOR_DOF
    compared: int = 0
    last: tuple[Estimate, ...] = ()

    @classmethod
    def prior(cls, q: int) -> "Scatter":
        """Return the belief before any window: the model's."""
        return cls(np.ones(q), np.ones(q))

    def pooled(self, ratio: FloatArray) -> FloatArray:
        """Return c (q,) with one more window's ratio; an odd window counts for three usual ones at most."""
        finite = np.where(np.isfinite(ratio), ratio, 1.0)
        most = 3 * np.maximum(self.within, 1) if self.dof > 20 else np.full_like(finite, 1e4)
        fresh = tuning.JACKKNIFE_BLOCKS - 1
        return np.asarray((self.dof * self.within + fresh * np.minimum(finite, most)) / (self.dof + fresh))

    def after(self, ratio: FloatArray, found: Estimate) -> "Scatter":
        """Return the belief after one more disjoint window."""
        within = self.pooled(ratio)
        dof = min(self.dof + tuning.JACKKNIFE_BLOCKS - 1, tuning.SCATTER_MOST_DOF)
        between = self._between(found, np.maximum(within, 1.0))
        compared = self.compared + (len(self.last) == 2)
        return Scatter(within, between, dof, compared, (*self.last, found)[-2:])

    def steady(self, found: Estimate) -> Estimate | None:
        """Return what the newest windows say together, at found.eta; None if there are none or it differs."""
        if not self.last:
            return None
        mean = np.mean([one.given(found.eta) for one in self.last], axis=0)
        spread = np.sum([one.covariance for one in self.last], axis=0) / len(self.last) ** 2
        spread = spread + tuning.STEADY_WALK * found.covariance
        far = np.abs(found.theta - mean) > tuning.AGREE_SD * np.sqrt(np.diag(spread + found.covariance))
        sensitivity = np.mean([one.sensitivity for one in self.last], axis=0)
        return None if far.any() else Estimate(mean, spread, sensitivity, found.eta)

    def _between(self, found: Estimate, within: FloatArray) -> FloatArray:
        """Second differences of disjoint windows against their variances, each capped at 9 times usual."""
        if len(self.last) < 2:
            return self.between
        first, second = self.last
        difference = found.theta - 2 * second.given(found.eta) + first.given(found.eta)
        variance = np.diag(first.covariance + 4 * second.covariance) + np.diag(found.covariance) * within
        usual = np.maximum(self.between, 1.0)
        memory = min(self.compared + tuning.SCATTER_PRIOR_DOF, tuning.BETWEEN_DOF)
        return np.asarray(
            self.between + (np.minimum(difference**2 / variance, 9 * usual) - self.between) / memory
        )

    @property
    def factor(self) -> FloatArray:
        """(q,) factor on the model's variance; never below 1: noise as small as the model's is no luck."""
        differences = min(self.compared, tuning.BETWEEN_DOF - tuning.SCATTER_PRIOR_DOF)
        return expected(self.within, self.dof - tuning.SCATTER_PRIOR_DOF) * expected(
            self.between, differences
        )

    def rescaled(self, factor: FloatArray) -> "Scatter":
        """Return the same in other units of the constants, which count `factor` (c,) as much in them."""
        last = tuple(
            replace(one, sensitivity=one.sensitivity / factor, eta=one.eta * factor) for one in self.last
        )
        return replace(self, last=last)

    def interrupted(self) -> "Scatter":
        """Return the belief after a change or a gap: the windows before it do not compare."""
        return replace(self, last=())


def expected(pooled: FloatArray, seen: float) -> FloatArray:
    """Return the expectation (q,) of a factor on the variance: 1 by the model, or what was pooled.

    pooled (q,): mean of `seen` ratios and of SCATTER_PRIOR_DOF ones. Neighbouring second differences, and
    leverages that differ from block to block, leave half of them independent.
    """
    prior = tuning.SCATTER_PRIOR_DOF
    half = 0.5 * seen
    power = np.maximum(0.5 * ((seen + prior) * pooled - prior), 0.0)  # Σ z² of the independent ones
    after = 0.5 * (prior + half)
    slab = gammaln(after) - gammaln(0.5 * prior) + 0.5 * prior * np.log(0.5 * prior)
    odds = slab - after * np.log(0.5 * (prior + power)) + 0.5 * power  # log Bayes factor against the model
    return np.asarray(1 + expit(odds) * (np.maximum(pooled, 1.0) - 1))


def by_repeats(changes: IntArray | int, samples: int) -> FloatArray:
    """Return factors (N,) on the model's variance of windows in whose samples outputs change code so often.

    A reading that repeats the one before it, to the last bit, is no second one: rounding has no other value
    for it, so the error is the same. White noise that spans codes changes them at half of the samples or
    more, which leaves 1.
    """
    return np.asarray(np.maximum(1.0, samples / (2.0 * (changes + 1.0))))


def widened(factor: FloatArray, repeats: FloatArray | float) -> FloatArray:
    """Return a factor on the variance, no less than that by repeated codes where there is one.

    Both tell how many readings there truly are, so they do not multiply.
    """
    return np.where(np.greater(repeats, 1.0), np.maximum(factor, repeats), factor)


def block_ratio(blocks: FloatArray, R: FloatArray, C: FloatArray, psi: slice) -> FloatArray:
    """Return r (q,) of some columns, the constants as the whole window has them.

    blocks: (J, k+c+1, k+c+1) Grams of [columns, what these leave of the constants', what all leave of the
    readings];  R: (k, k) prior of the columns;  C: (c, c) covariance of the constants.
    """
    k = len(R)
    own, across, score = blocks[:, :k, :k], blocks[:, :k, k:-1], blocks[:, :k, -1]
    V = inverse(own.sum(axis=0) + R)[psi]
    # added up, not taken away: of a first state the others' share is less than the digits of all
    rest = np.tensordot(1.0 - np.eye(len(own)), own, axes=1)
    without = inverse(rest + R)[:, psi]
    moved = (without @ score[..., None])[..., 0]
    apart, shared = without - V, without @ across
    expected = ((apart @ rest) * apart + (V @ own) * V).sum(axis=(0, 2))
    expected -= ((shared @ C) * shared).sum(axis=(0, 2))
    return np.asarray((moved**2).sum(axis=0) / np.maximum(expected, 1e-300))


def block_grams(whitened: ComplexArray, window: int) -> FloatArray:
    """Return Grams (J, c, c) of consecutive blocks from whitened columns (kept, p, c) on the lowest bins.

    Back in time the columns of the lowest bins are sampled at 2·kept points or more; Parseval makes the
    blocks' sum the window's Gram.
    """
    kept = len(whitened)
    length = window if kept == window // 2 + 1 else 2 * kept
    samples = np.fft.irfft(whitened, length, axis=0) * np.sqrt(length)
    edges = np.linspace(0, length, tuning.JACKKNIFE_BLOCKS + 1).astype(int)
    parts = [samples[a:b].reshape(-1, whitened.shape[-1]) for a, b in pairwise(edges.tolist())]
    return np.array([part.T @ part for part in parts])
