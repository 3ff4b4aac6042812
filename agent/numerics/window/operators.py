"""All constants of the bank for one model, one noise and one set of window lengths."""

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from agent.numerics.model.riccati import spectral_radius
from agent.numerics.model.statespace import StateSpace
from agent.numerics.window.filtering.basis import balanced_basis
from agent.numerics.window.filtering.filters import Filters, filter_system
from agent.numerics.window.filtering.hops import HopPlan
from agent.numerics.window.filtering.noise import NoiseModel, Push, predictor_of
from agent.numerics.window.filtering.products import row_products
from agent.numerics.window.filtering.summary import Summary
from agent.numerics.window.jump import JumpScan, boundaries, scanned_rows
from agent.numerics.window.solve import WindowSolver
from agent.numerics.window.tuning import CHUNK, ROWS, STABLE
from agent.types import FloatArray


class Operators:
    """What the bank multiplies by.

    Args:
        model: sampled model in shifted-state form; its first `interest` parameters are flat in each window.
        push: how unknown forces enter.
        noise: hyperparameters.
        plan: hop and window.
        longer: whole hops before the head in each further window.
        interest: parameters that a jump may be of.

    Raises:
        NoSteadyStateError: this noise has no stable predictor.
    """

    def __init__(
        self,
        model: StateSpace,
        push: Push,
        noise: NoiseModel,
        plan: HopPlan,
        longer: Sequence[int],
        interest: int,
    ) -> None:
        self.plan = plan
        self.lengths = (plan.fulls, *longer)
        self.longest = max(self.lengths)
        self.real, self.predictor = predictor_of(model, push, noise)
        self.system = system = filter_system(model, self.real, self.predictor)
        self.size = system.size
        self.filters = Filters(system, plan)
        self.basis = balanced_basis(system, self.real, self.predictor, plan, self.longest)
        self.solvers = tuple(
            WindowSolver(self.basis, self.real, self.predictor, fulls) for fulls in self.lengths
        )
        self.rights = boundaries(plan.fulls)
        self.over = {count: self.basis.over(count) for count in (*self.lengths, *self.rights)}
        self.scan = (
            JumpScan(self.basis, self.solvers[0], model, plan.fulls, self.rights, interest)
            if self.rights
            else None
        )
        self.every = scanned_rows(plan.fulls)
        self.decays = spectral_radius(model.A) < 1 - STABLE

    def summarise(self, lengths: Sequence[int], v: FloatArray, states: Sequence[FloatArray]) -> Summary:
        """Return the summaries of N stretches v (N, L, p+m) from the states (N, nz) before their cells."""
        step = max(1, CHUNK // (ROWS * self.plan.hop)) * ROWS
        count = len(v)
        width = 1 + self.size.c
        U = self.basis.U[: v.shape[1] * self.size.p]
        gram, moment = np.empty((count, width, width)), np.empty((count, width, U.shape[1]))
        for start in range(0, count, step):
            part = slice(start, start + step)
            columns = self.filters.outputs(lengths, v[part], [z[part] for z in states])
            np.matmul(columns, columns.transpose(0, 2, 1), out=gram[part])
            moment[part] = row_products(columns, U)
        return Summary(gram, moment)

    @cached_property
    def powers(self) -> FloatArray:
        """Π over 0, 1, .. whole hops, (longest + 2, r, r)."""
        powers = [np.eye(len(self.basis.steps[2]))]
        for _ in range(self.longest + 1):
            powers.append(self.basis.steps[2] @ powers[-1])
        return np.array(powers)

    @cached_property
    def squares(self) -> FloatArray:
        """U'U over 0, 1, .. whole hops and a head, (longest + 1, r, r)."""
        U, step = self.basis.U, self.basis.steps[2]
        head = U[: self.plan.head * self.size.p]
        hop = U.T @ U
        squares = [head.T @ head]
        for _ in range(self.longest):
            squares.append(hop + step.T @ squares[-1] @ step)
        return np.array(squares)

    def columns(self, hop_samples: FloatArray, start: FloatArray) -> FloatArray:
        """Return [e ψ] (1+c, samples p) over a hop or its head v (samples, p+m), from state `start` (nz,)."""
        filters = self.filters
        lengths = filters.head if len(hop_samples) == self.plan.head else (*filters.head, *filters.rest)
        v = hop_samples[None]
        return np.asarray(filters.outputs(lengths, v, filters.through(lengths, v, start[None]))[0])
