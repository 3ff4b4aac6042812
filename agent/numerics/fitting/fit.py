"""One window, fitted alone: Gauss-Newton by output error, begun with unknown forces that may explain all.

With forces on every mass the problem is nearly the equation error's, which is linear in springs and dampers,
so that a start far away does no harm; without them it is the maximum likelihood under white sensor noise
(Ljung, System Identification, 2nd ed. 1999, section 7.4). Nothing is carried from window to window.
"""

from dataclasses import dataclass, replace

import numpy as np

from agent.numerics.fitting.tuning import EVALUATION, FARTHEST, GREATEST, HALVINGS, PUSHED_STEPS
from agent.numerics.inference.spectral.algebra import inverse
from agent.numerics.inference.spectral.bins import Bins
from agent.numerics.inference.spectral.columns import Regressor, Window
from agent.numerics.inference.spectral.covariance import Cells, inverse_of
from agent.numerics.inference.spectral.response import Response
from agent.numerics.model.statespace import Hold, Model
from agent.numerics.model.uncertain import Rig, sampled
from agent.types import ComplexArray, FloatArray, IntArray


@dataclass(frozen=True)
class FittedModel:
    """A rig's model as windows are fitted with it.

    Attributes:
        model: parametric model; its inputs are the windows' inputs.
        period_s, hold: of the sampled model.
        push: (n, d) directions in which unknown forces push the state.
        sigma: (p,) sd of each output's noise, NaN where it is not known.
        scale, lower: (q,) size and lower bound of each parameter; an offset's size, NaN, is that of a column
            of outputs and inputs, `scale_column` (q,).
    """

    model: Model
    period_s: float
    hold: Hold
    push: FloatArray
    sigma: FloatArray
    scale: FloatArray
    lower: FloatArray
    scale_column: IntArray | None = None

    @property
    def rig(self) -> Rig:
        """The rig without constants to be uncertain of."""
        inputs = self.model.continuous(self.model.nominal).m
        every = np.arange(inputs, dtype=np.int64)
        none = np.zeros(0, dtype=np.int64)
        driven = np.ones(inputs, dtype=bool)
        q = len(self.model.parameters)
        return Rig(self.model, q, every, driven, none, (), self.period_s, self.hold, self.scale, self.lower)

    def with_more(self, model: Model, scale: FloatArray, lower: FloatArray) -> "FittedModel":
        """Return this of a model with k further parameters, of sizes and bounds (k,)."""
        column = self.scale_column
        if column is not None:
            column = np.append(column, np.zeros(len(scale), dtype=np.int64))
        return replace(
            self, model=model, scale=np.append(self.scale, scale), lower=np.append(self.lower, lower),
            scale_column=column,
        )  # fmt: skip

    def of(self, sigma: FloatArray, columns: FloatArray) -> "FittedModel":
        """Return this with sensor sds (p,), and offsets of the size of columns (N, p + m), outputs first."""
        return replace(self, sigma=sigma, scale=_sizes(self.scale, self.scale_column, columns))


@dataclass(frozen=True, slots=True)
class WindowFit:
    """What a window says alone.

    Attributes:
        theta: (q,) where the fit came to rest;  covariance: (q, q) there.
        left: (p,) sum of the squared residuals of each output, SI.
        cost: sum of the squared residuals, each in its noise's sd.
        converged: it came to rest.
    """

    theta: FloatArray
    covariance: FloatArray
    left: FloatArray
    cost: float
    converged: bool


@dataclass(frozen=True, slots=True)
class _Point:
    """A window linearised at theta: step and covariance in units of `unit`, cost and what is left there."""

    theta: FloatArray
    unit: FloatArray
    step: FloatArray
    covariance: FloatArray
    cost: float
    left: FloatArray


@dataclass(slots=True)
class Work:
    """Work done so far in this process, in samples of normal work; its growth is what was done meanwhile."""

    done: int = 0

    def evaluate(self, samples: int) -> None:
        """Count an evaluation of observer and sensitivities over a window of so many samples."""
        self.done += EVALUATION + samples


WORK = Work()
"""Global, so that what counts it need not be handed through every fit."""


def fit_window(
    fitted: FittedModel, window: Window, theta: FloatArray, max_steps: int = 20, tolerance: float = 1e-4
) -> WindowFit:
    """Fit a window from theta (q,); tolerance: step, in sds, below which it has come to rest.

    Raises ValueError or LinAlgError where the model is no number at theta, or grows beyond all bounds.
    """
    near = theta
    if fitted.push.size:
        near, _ = _descended(fitted, window, theta, PUSHED_STEPS, 1.0, pushed=True)
    found, converged = _descended(fitted, window, near, max_steps, tolerance, pushed=False)
    at = _linearised(fitted, window, found, pushed=False)
    covariance = at.covariance * np.outer(at.unit, at.unit)
    return WindowFit(found, covariance, at.left, at.cost, converged)


def _descended(
    fitted: FittedModel, window: Window, theta: FloatArray, steps: int, tolerance: float, *, pushed: bool
) -> tuple[FloatArray, bool]:
    """Return where Gauss-Newton ends, and whether it came to rest there."""
    at = _linearised(fitted, window, theta, pushed=pushed)
    for _ in range(steps):
        at = _anchored(at, theta) if pushed else at
        sd = np.sqrt(np.maximum(np.diag(at.covariance), 0.0))
        if np.all(np.abs(at.step) <= tolerance * sd):
            return at.theta, True
        better = _better(fitted, window, at, pushed=pushed)
        if better is None:
            # no step leaves less: round-off, or as near as the linearisation can tell
            return at.theta, bool(np.all(np.abs(at.step) <= np.maximum(sd, 1e-9)))
        at = better
    sd = np.sqrt(np.maximum(np.diag(at.covariance), 0.0))
    return at.theta, bool(np.all(np.abs(at.step) <= sd))


def _anchored(at: _Point, anchor: FloatArray) -> _Point:
    """Return a point whose step knows parameters lie near the fit's start, delays and offsets of 0 aside."""
    precision = inverse(at.covariance)
    held = np.diag(np.where(anchor != 0, FARTHEST**-2, 0.0))
    covariance = inverse(precision + held)
    step = covariance @ (precision @ at.step + held @ ((anchor - at.theta) / at.unit))
    return replace(at, step=step, covariance=covariance)


def _better(fitted: FittedModel, window: Window, at: _Point, *, pushed: bool) -> _Point | None:
    """Return the point after a step, halved until it leaves less; None where none does."""
    step = at.step / max(1.0, float(np.max(-at.step / FARTHEST)), float(np.max(at.step / (2 * FARTHEST))))
    for _ in range(HALVINGS):
        moved = np.maximum(at.theta + at.unit * step, fitted.lower)
        there = _attempted(fitted, window, moved, pushed=pushed)
        # the forces' share of what is left depends on theta: steps are not compared by it
        if there is not None and (pushed or there.cost < at.cost):
            return there
        step = 0.5 * step
    return None


def _attempted(fitted: FittedModel, window: Window, theta: FloatArray, *, pushed: bool) -> _Point | None:
    """Return the point at theta; None where the model is no number there."""
    try:
        return _linearised(fitted, window, theta, pushed=pushed)
    except (ValueError, np.linalg.LinAlgError):
        return None


def _linearised(fitted: FittedModel, window: Window, theta: FloatArray, *, pushed: bool) -> _Point:
    WORK.evaluate(window.length)
    rig = fitted.rig
    response = _response(rig, window, theta)
    cells = Cells(response, _directions(fitted, response, window, pushed=pushed), np.ones((0, 0)))
    Si = inverse_of(_covariance(fitted, cells))
    regressor = Regressor(rig, response, (), np.zeros(0))
    regression = regressor.build(window, lambda X: cells.gram(Si, X), np.zeros(0, dtype=np.int64))
    G = cells.gram(Si, regression.X)
    if not np.all(np.isfinite(G)) or G[-1, -1] > GREATEST**2:
        raise ValueError("the window is no number")
    V = inverse(G[:-1, :-1])
    psi = regression.layout.psi
    left = cells.weight @ np.abs(regression.X[..., -1]) ** 2
    return _Point(theta, response.at.unit, (V @ G[:-1, -1])[psi], V[psi, psi], float(G[-1, -1]), left)


def _response(rig: Rig, window: Window, theta: FloatArray) -> Response:
    if not np.all(np.isfinite(theta)):
        raise ValueError("the fit left the numbers")
    model = sampled(rig, theta, np.zeros(0))
    radius = float(np.abs(np.linalg.eigvals(model.A)).max(initial=0.0))
    if window.length * np.log10(max(radius, 1.0)) > np.log10(GREATEST) / 2:
        raise ValueError("the model grows beyond all bounds")
    return Response(model, Bins(window.length, window.length // 2 + 1))


def _covariance(fitted: FittedModel, cells: Cells) -> ComplexArray:
    """Return S (C, p, p): sensor noise and what forces add."""
    S = cells.D @ cells.D.conj().transpose(0, 2, 1)
    every = range(len(fitted.sigma))
    S[:, every, every] += fitted.sigma**2
    return np.asarray(S)


def _directions(fitted: FittedModel, response: Response, window: Window, *, pushed: bool) -> ComplexArray:
    """Return (C, p, d) what forces add to the outputs, each as much as these hold; nothing if not pushed."""
    if not pushed:
        return np.zeros((len(response.z), len(fitted.sigma), 0), dtype=complex)
    H = response.CR @ (fitted.period_s * fitted.push)
    seen = float(np.sum((window.y / fitted.sigma) ** 2))
    each = np.einsum("k,kpd,p->d", response.weight, np.abs(H) ** 2, fitted.sigma**-2.0)
    return np.asarray(H * np.sqrt(seen / np.maximum(each, 1e-300)))


def _sizes(scale: FloatArray, column: IntArray | None, v: FloatArray) -> FloatArray:
    """Return sizes (q,) of parameters; offsets, with scale NaN, have that of their column of v (N, p + m)."""
    rms = np.sqrt(np.mean(v**2, axis=0))
    own = rms[np.zeros(len(scale), dtype=np.int64) if column is None else np.minimum(column, len(rms) - 1)]
    return np.where(np.isfinite(scale), scale, np.where(own > 0, own, 1.0))
