"""Dry friction as a model input: how much acted in each sample, from an observer that slides and sticks.

The sign of a velocity is not enough. A reversal falls between two samples, and to have the whole friction
wrong for a part of one sample is far more than a good displacement sensor's noise; and a mass that sticks is
held by whatever balances it. So a Kalman filter of the nominal model runs beside the estimator, with the
nominal friction in it and one slowly varying unknown force along each friction element, which takes what
nominal values get wrong (without it the velocity lags, and a reversal is seen samples too late). Over a
sample it lets each element slide, reverse where the straight line of its velocity crosses zero, or stick
where the friction can hold it, and gives the mean of that: 1 or -1 while it slides, between them in a sample
with a reversal, the share of the friction that holds it while it sticks.

It is causal, and the nominal values matter only where it sticks: there the share is what they would need.
Windows that hold much sticking tell little and are said to (`Sticking`). The means are put into the model's
inputs so that their integral is right under the model's hold. (Karnopp, ASME J. Dyn. Sys. 107 (1985) 100, for
sticking as a state of its own; Armstrong-Helouvry et al., Automatica 30 (1994) 1083.)
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from agent.numerics.model.mechanics import GROUND, MassSpringDamper
from agent.numerics.model.observer import start_gain, unobservable_states
from agent.numerics.model.statespace import Discrete, Hold, StateSpace, discretise
from agent.numerics.model.tuning import DEVIATIONS, FASTEST, REST, SLOWEST, SPEED, STILL
from agent.types import FloatArray


@dataclass(frozen=True, slots=True)
class FrictionObserver:
    """A sample of the observer: free motion z' = M (z, w, y, u, u'), and z' + G w' with the friction.

    Attributes:
        M: (n, n + r + p + 2 m) of the state, of friction and readings before, and of the forces before and
            now.
        W: (r, n + m) relative velocities of the state and of the forces now.
        G: (n, r) what the whole friction of each element does in a sample.
        first: (n, p + m) the state to begin with from the first sample.
        straight: the model runs its inputs on straight lines between samples.
        noise: (r,) standard deviation that the sensors' noise leaves in the relative velocities.
        rest: samples of little velocity after which it rests.
    """

    M: FloatArray
    W: FloatArray
    G: FloatArray
    first: FloatArray
    straight: bool
    noise: FloatArray
    rest: int

    @property
    def takes(self) -> FloatArray:
        """(r,) the relative velocity that the whole friction of each element takes in a sample."""
        return np.asarray(-np.einsum("rn,nr->r", self.W[:, : len(self.G)], self.G))


def friction_observer(
    model: MassSpringDamper, period_s: float, hold: Hold, sigma: FloatArray
) -> FrictionObserver:
    """Build the observer of a rig with dry friction from its nominal values.

    sigma (p,) is the standard deviation of each output's noise, NaN where it is not known.

    Raises ValueError when no gain gives a stable observer.
    """
    plain = replace(model, parameters=())
    rubbing = model.structure.frictions
    m = len(model.forces)
    continuous = plain.continuous(plain.nominal)
    held = continuous.n
    difference = _differences(plain, [element.between for element in rubbing])
    continuous = _drifting(continuous, model)
    discrete = discretise(continuous, period_s, hold)
    d, B1 = discrete.model, discrete.B1
    B0, D = d.B - d.A @ B1, d.D - d.C @ B1
    L = _correction(discrete, held, sigma, period_s)
    W = np.hstack([difference @ continuous.A[:held], difference @ continuous.B[:held, :m]])
    M = np.hstack([d.A - L @ d.C, -L @ D[:, m:], L, (B0 - L @ D)[:, :m], B1[:, :m]])
    seen = np.linalg.pinv(continuous.C[:, :held])
    first = np.zeros((d.n, d.p + m))
    first[:held] = np.hstack([seen, -seen @ D[:, :m]])
    known = np.where(np.isfinite(sigma), sigma, 0.0)
    noise = _noise(d.A - L @ d.C, L * known, W[:, : d.n])
    return FrictionObserver(
        M, W, (B0 + B1)[:, m:], first, hold == "first", noise, round(REST / (SPEED * period_s))
    )


def _differences(model: MassSpringDamper, pairs: Sequence[tuple[str, str]]) -> FloatArray:
    """Return (r, n) rows that take the relative displacement of each pair from the states."""
    names = model.state_names
    difference = np.zeros((len(pairs), len(names)))
    for row, pair in zip(difference, pairs, strict=True):
        for node, sign in zip(pair, (1.0, -1.0), strict=True):
            if node != GROUND:
                row[names.index(f"displacement of {node}")] += sign
    return difference


def _noise(Phi: FloatArray, push: FloatArray, W: FloatArray) -> FloatArray:
    """Return the sd (r,) that white noise pushing by push (n, p) leaves in W z."""
    total = np.zeros(len(W))
    for _ in range(round(12.0 / SLOWEST)):
        total += np.sum((W @ push) ** 2, axis=1)
        push = Phi @ push
    return np.asarray(np.sqrt(total))


def _drifting(continuous: StateSpace, model: MassSpringDamper) -> StateSpace:
    """Put a lasting force along each friction element behind the states, where the outputs show them all."""
    n = continuous.n
    r = len(model.structure.frictions)
    nominal = np.array([element.nominal or 1.0 for element in model.structure.frictions])
    m = continuous.m - r
    A = np.zeros((n + r, n + r))
    A[:n] = np.hstack([continuous.A, continuous.B[:, m:] / nominal])
    B = np.vstack([continuous.B, np.zeros((r, continuous.m))])
    C = np.hstack([continuous.C, continuous.D[:, m:] / nominal])
    dA, dB, dC, dD = (np.zeros((0, *part.shape)) for part in (A, B, C, continuous.D))
    drifting = StateSpace(A, B, C, continuous.D, dA, dB, dC, dD)
    names = [str(i) for i in range(n + r)]
    return continuous if unobservable_states(drifting, names) else drifting


def _correction(discrete: Discrete, held: int, sigma: FloatArray, period_s: float) -> FloatArray:
    """Return the gain (n, p) whose slowest pole is at SPEED; what drifts, drifts as fast as that asks for."""
    n = discrete.model.n
    pushes = np.eye(n)[:, held:] if n > held else np.eye(n)
    weights = np.where(np.isfinite(sigma), sigma, np.nanmean(sigma) if np.isfinite(sigma).any() else 1.0)
    window = max(1, round(6.0 / min(max(SPEED * period_s, SLOWEST), FASTEST)))
    return start_gain(discrete, pushes, weights, window)


@dataclass(slots=True)
class FrictionInputs:
    """Puts the share of each friction that acts beside the inputs of a stream, sample by sample.

    Deterministic to the last bit however the stream is cut.
    """

    observer: FrictionObserver
    _z: FloatArray = field(default_factory=lambda: np.zeros(0))
    _calm: list[int] = field(default_factory=list)

    def start_segment(self) -> None:
        """Forget the samples before a gap."""
        self._z = np.zeros(0)

    def beside(self, y: FloatArray, u: FloatArray) -> FloatArray:
        """Return inputs (N, m + r): u (N, m), then of each friction the share that acts, seen in y (N, p)."""
        M, W, G = self.observer.M, self.observer.W, self.observer.G
        n, r = G.shape
        behind, now = n + r + y.shape[1], M.shape[1] - u.shape[1]
        takes, least = self.observer.takes.tolist(), (DEVIATIONS * self.observer.noise).tolist()
        found = np.zeros((len(y), r))
        first = 0
        if not self._z.size:
            z = np.zeros(M.shape[1])
            z[:n] = self.observer.first @ np.concatenate([y[0], u[0]])
            z[now:] = z[behind:now] = u[0]
            z[n + r : behind] = y[0]
            self._calm = [0] * r
            self._z, first = z, 1
        z = self._z
        for k in range(first, len(y)):
            z[now:] = u[k]
            seen = np.concatenate([z[:n], z[behind:now]])
            speeds, before = (W @ seen).tolist(), z[n : n + r].tolist()
            z[:n] = M @ z
            free = (W @ np.concatenate([z[:n], u[k]])).tolist()
            for j in range(r):
                mean, last = self._share(j, speeds[j], free[j], takes[j], least[j])
                z[:n] += mean * G[:, j]
                z[n + j] = last
                # what the hold makes of the values at both ends, and what is missing to the mean
                made = 0.5 * (before[j] + last) if self.observer.straight else before[j]
                found[k, j] = last + mean - made
                if r > 1:
                    free = (W @ np.concatenate([z[:n], u[k]])).tolist()
            z[n + r : behind], z[behind:now] = y[k], u[k]
        return np.hstack([u, found])

    def _share(self, j: int, speed: float, free: float, takes: float, least: float) -> tuple[float, float]:
        """Return the share of friction j over a sample and at its end; none of one weaker than the noise."""
        self._calm[j] = self._calm[j] + 1 if abs(speed) < least else 0
        if takes < least and self._calm[j] > self.observer.rest:
            return 0.0, 0.0
        return acting(speed, free, takes)


def acting(speed: float, free: float, takes: float) -> tuple[float, float]:
    """Return the share of a friction that acts over a sample, its mean and what it is at the end.

    Args:
        speed: relative velocity at the sample before.
        free: at the end, without this friction.
        takes: what the whole of it takes in a sample.
    """
    needed = max(-1.0, min(1.0, (free - speed) / takes)) if takes > 0 else _sign(free - speed)
    still = STILL * takes
    mean = needed
    if abs(speed) > still:
        way = _sign(speed)
        end = free - way * takes
        if end * way > 0:
            return way, way
        # it stops within the sample, where a straight line crosses zero, and then sticks or turns round
        part = abs(speed) / (abs(speed) + abs(end))
        mean = part * way + (1.0 - part) * needed
    end = free - mean * takes
    return mean, _sign(end) if abs(end) > still else needed


def _sign(x: float) -> float:
    return 1.0 if x > 0 else -1.0
