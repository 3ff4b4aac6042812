"""Whether a mass that the model takes as known is wrong: records fitted once more with it free.

A wrong mass leaves a smooth residual, which unknown forces would explain away at the price of bent springs. A single
number more that explains a record as well is the simpler story, and it is looked at first.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from agent.numerics.fitting.colour import coloured_likelihood
from agent.numerics.fitting.fit import Fit, Problem, fit_window
from agent.numerics.model.mechanics import MassSpringDamper
from agent.numerics.model.observer import Gain
from agent.numerics.model.sensors import SensedModel
from agent.numerics.model.statespace import Discrete, Hold, Model, discretise

FloatArray = NDArray[np.float64]
Stages = Sequence[Callable[[Discrete], Gain]]
LEAST = 0.05
"""A mass nearer than this share to what the model has is not called wrong: few are known better."""
SURE = 6.0
"""Nor one that is not off by this many standard deviations, however coloured the residual."""


@dataclass(frozen=True, slots=True)
class MassError:
    """A mass that explains a record when it is free.

    Attributes:
        name: of the mass.
        change: what it would be over what the model has, less one.
        sd: of that.
        likelihood: log likelihood of the record with it, the residual taken as coloured noise.
    """

    name: str
    change: float
    sd: float
    likelihood: float


@dataclass(frozen=True, slots=True)
class Masses:
    """The masses of a rig that are not estimated.

    Attributes:
        names, values: k of them, kg.
        models: (k,) the rig's model with one of them as a further parameter.
        place: where that parameter stands in theta.
        period_s, hold: of the sampled model.
    """

    names: tuple[str, ...]
    values: tuple[float, ...]
    models: tuple[Model, ...]
    place: int
    period_s: float
    hold: Hold

    def wrong(self, problem: Problem, start: Fit, stages: Stages, sigma: FloatArray) -> MassError | None:
        """Return the mass that explains a record best when it is free; None where none is surely wrong.

        Args:
            problem: the record.
            start: its fit with the masses as they are.
            stages: the observer's gains, as for `fit_window`.
            sigma: (p,) unit of the residuals.
        """
        found = [error for i in range(len(self.names)) if (error := self._freed(i, problem, start, stages, sigma))]
        return max(found, key=lambda error: error.likelihood, default=None)

    def _freed(self, i: int, problem: Problem, start: Fit, stages: Stages, sigma: FloatArray) -> MassError | None:
        value, model = self.values[i], self.models[i]

        def sample(theta: FloatArray) -> Discrete:
            return discretise(model.continuous(theta), self.period_s, self.hold)

        def with_mass(values: FloatArray, of_mass: float) -> FloatArray:
            return np.insert(values, self.place, of_mass)

        lower = with_mass(problem.lower, 0.02 * value)
        freed = replace(problem, sample=sample, scale=with_mass(problem.scale, value), lower=lower)
        try:
            fit = fit_window(freed, with_mass(start.theta, value), start.x0, stages)
        except ValueError:
            return None  # with that mass free the fit left the numbers
        variance = fit.covariance[self.place, self.place]
        if not (fit.converged and np.isfinite(variance)):
            return None
        sd = float(np.sqrt(variance * np.mean(fit.residual**2))) / value
        change = float(fit.theta[self.place]) / value - 1.0
        # a mass that might as well be infinite explains a rig that does not move, which is no size of a mass
        if abs(change) < max(LEAST, SURE * sd) or 1.0 + change < SURE * sd:
            return None
        return MassError(self.names[i], change, sd, coloured_likelihood(fit.residual, sigma))


def masses_of(model: Model, period_s: float, hold: Hold) -> Masses | None:
    """Return the masses of a rig that its model takes as known; None where there are none."""
    inner = model.model if isinstance(model, SensedModel) else model
    if not isinstance(inner, MassSpringDamper) or not inner.forces:
        return None
    known = [m for m in inner.structure.masses if m.value > 0 and m.name not in inner.parameters]
    if not known:
        return None
    models = tuple(_with(model, inner, mass.name) for mass in known)
    names, values = tuple(m.name for m in known), tuple(m.value for m in known)
    return Masses(names, values, models, len(inner.parameters), period_s, hold)


def _with(model: Model, inner: MassSpringDamper, name: str) -> Model:
    freed = replace(inner, parameters=(*inner.parameters, name))
    return replace(model, model=freed) if isinstance(model, SensedModel) else freed
