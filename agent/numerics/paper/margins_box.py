"""The largest box of parameters about the nominal ones that one quadratic Lyapunov function serves.

Condition (8) bounds a norm of sampled matrices and is very conservative; this margin is in N/m and N s/m. It
needs a solver of linear matrix inequalities: cvxpy and Clarabel, the optional extra `design`, imported only
when it is asked.
"""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from types import ModuleType
from typing import Any

import numpy as np

from agent.numerics.model.observer import balanced
from agent.numerics.model.statespace import Model
from agent.numerics.paper.tuning import MOST_PARAMETERS
from agent.types import FloatArray


class DesignToolsMissingError(RuntimeError):
    """The optional extra `design` (cvxpy, Clarabel) is not installed."""

    def __init__(self) -> None:
        advice = "install them with: pip install 'deltak[design]'"
        super().__init__(f"the polytopic margin needs cvxpy and Clarabel; {advice}")


@dataclass(frozen=True, slots=True)
class PolytopicMargin:
    """The largest box about the nominal parameters that one quadratic Lyapunov function serves.

    Attributes:
        share: the box is nominal -+ share * limit.
        reach: share * limit of each parameter, in its unit.
        lyapunov: (n, n) P with A'P + P A < 0 at every vertex, checked by eigenvalues; None where there is
            none.
    """

    share: float
    reach: Mapping[str, float]
    lyapunov: FloatArray | None


def vertices(model: Model, limits: FloatArray) -> list[FloatArray]:
    """Return the parameter vectors nominal -+ limit (q,); 2 to the number of limits that are not zero."""
    ranges = [(-limit, limit) if limit > 0 else (0.0,) for limit in limits.tolist()]
    return [model.nominal + np.array(corner) for corner in product(*ranges)]


def polytopic_margin(model: Model, limits: FloatArray, accuracy: float = 1e-3) -> PolytopicMargin:
    """Return the largest share s for which one quadratic Lyapunov function serves all of nominal -+ s limit.

    Args:
        model: affine in its parameters between the vertices (springs and dampers are; masses are not).
        limits: (q,) half the sides of the box at s = 1, in the parameters' units; 0 leaves a parameter out.
        accuracy: relative accuracy of s.

    A'P + P A < 0 is asked of the continuous-time matrices: these are affine, so the vertices answer for the
    whole box and for any course in time inside it, also between samples, which sampled matrices would not.
    The observer adds nothing to ask: in (4) its error is driven by the states but does not drive them, and a
    block triangular system has a quadratic Lyapunov function whenever its diagonal blocks have. Of a model in
    discrete time A'P A - P < 0 is asked, as [[P, A'P], [P A, P]] > 0, which is straight in A as well.

    Raises ValueError where the model is not affine or has too many parameters, DesignToolsMissingError
    without cvxpy.
    """
    limits = np.asarray(limits, dtype=float)
    base, directions = _polytope(model, limits)
    sampled = model.continuous(model.nominal).is_sampled
    feasible = _SampledFeasibility(base, directions) if sampled else _Feasibility(base, directions)
    low = 0.0
    high = 1.0
    P = feasible.solve(0.0)
    if P is None:
        return _margin(model, limits, 0.0, None)
    while (found := feasible.solve(high)) is not None and high < 1e6:
        low, high, P = high, 2.0 * high, found
    while high - low > accuracy * high and high > 1e-9:
        middle = 0.5 * (low + high)
        found = feasible.solve(middle)
        low, high, P = (low, middle, P) if found is None else (middle, high, found)
    return _margin(model, limits, low, P)


def _margin(model: Model, limits: FloatArray, share: float, P: FloatArray | None) -> PolytopicMargin:
    reach = dict(zip(model.parameters, (share * limits).tolist(), strict=True))
    return PolytopicMargin(share, reach, P)


def _polytope(model: Model, limits: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return A at the nominal parameters (n, n) and how each vertex differs from it (V, n, n)."""
    if np.count_nonzero(limits) > MOST_PARAMETERS:
        raise ValueError(
            f"{np.count_nonzero(limits)} parameters have a limit; at most {MOST_PARAMETERS} can be tried"
        )
    at_nominal = model.continuous(model.nominal)
    corners = vertices(model, limits)
    directions = np.array([model.continuous(corner).A - at_nominal.A for corner in corners])
    straight = np.array([np.tensordot(corner - model.nominal, at_nominal.dA, axes=1) for corner in corners])
    if not np.allclose(directions, straight, rtol=1e-9, atol=1e-9 * float(np.abs(at_nominal.A).max())):
        raise ValueError(
            "the model is not affine in these parameters: its vertices do not answer for the box"
        )
    return at_nominal.A, directions


class _Feasibility:
    """Is there one P for all vertices at a share s? States and time are scaled to near 1 for the solver."""

    def __init__(self, base: FloatArray, directions: FloatArray) -> None:
        _, self.scale = balanced(base)
        similarity = self.scale[None, :] / self.scale[:, None]
        speed = self._speed(base)
        self.base, self.directions = base * similarity / speed, directions * similarity / speed
        self.cvxpy = _cvxpy()
        self.share: Any = self.cvxpy.Parameter(nonneg=True)
        self.P: Any = self.cvxpy.Variable((len(base), len(base)), PSD=True)
        self.problem: Any = self._problem()

    def _speed(self, base: FloatArray) -> float:
        return max(float(np.max(np.abs(np.linalg.eigvals(base)))), 1e-300)

    def _problem(self) -> Any:
        cp = self.cvxpy
        n = len(self.base)
        worst = cp.Variable()
        constraints = [cp.trace(self.P) == n]
        for direction in self.directions:
            half = self.P @ self.base + self.share * (self.P @ direction)
            constraints.append(half + half.T << worst * np.eye(n))
        return cp.Problem(cp.Minimize(worst), constraints)

    def solve(self, share: float) -> FloatArray | None:
        """Return P in the model's units where the vertices at `share` have one, checked by eigenvalues."""
        self.share.value = share
        with warnings.catch_warnings():
            # what the solver calls inaccurate is judged below, by eigenvalues
            warnings.simplefilter("ignore", UserWarning)
            try:
                self.problem.solve(solver=self.cvxpy.CLARABEL)
            except self.cvxpy.SolverError:
                return None
        if self.P.value is None or not self._serves(np.asarray(self.P.value), share):
            return None
        return np.asarray(self.P.value) / np.outer(self.scale, self.scale)

    def _serves(self, P: FloatArray, share: float) -> bool:
        if np.linalg.eigvalsh(P)[0] <= 0:
            return False
        half = P @ (self.base + share * self.directions)
        return bool(np.linalg.eigvalsh(half + half.transpose(0, 2, 1)).max() < 0)


class _SampledFeasibility(_Feasibility):
    """The same for matrices in discrete time."""

    def _speed(self, base: FloatArray) -> float:
        return 1.0

    def _problem(self) -> Any:
        cp = self.cvxpy
        n = len(self.base)
        least = cp.Variable()
        constraints = [cp.trace(self.P) == n]
        for direction in self.directions:
            moved = self.P @ self.base + self.share * (self.P @ direction)
            constraints.append(cp.bmat([[self.P, moved.T], [moved, self.P]]) >> least * np.eye(2 * n))
        return cp.Problem(cp.Maximize(least), constraints)

    def _serves(self, P: FloatArray, share: float) -> bool:
        if np.linalg.eigvalsh(P)[0] <= 0:
            return False
        moved = self.base + share * self.directions
        return bool(np.linalg.eigvalsh(moved.transpose(0, 2, 1) @ P @ moved - P).max() < 0)


def _cvxpy() -> ModuleType:
    try:
        import clarabel  # noqa: F401 - cvxpy finds it by itself; without it there is no solver that is good enough
        import cvxpy
    except ImportError as error:
        raise DesignToolsMissingError from error
    return cvxpy
