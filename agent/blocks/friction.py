"""Data manipulation: rigs with dry friction get the sign of each friction's velocity as a further input."""

from dataclasses import dataclass

from agent.blocks.rig_model import known_noise, rig_model
from agent.config import RigConfig
from agent.config.model.tables import MechanicsModel
from agent.numerics.model.holds import straight
from agent.numerics.model.mechanics import MassSpringDamper
from agent.numerics.model.sensors import SensedModel
from agent.numerics.model.statespace import Model
from agent.numerics.model.stick_slip import FrictionInputs, friction_observer
from agent.types import Aligned, FloatArray, Samples


@dataclass(slots=True)
class DryFriction:
    """Completes the inputs of one rig; without friction elements they pass as they are."""

    inputs: FrictionInputs | None = None
    _segment: int | None = None

    def step(self, samples: Aligned | Samples) -> FloatArray:
        """Return the model's inputs (n, m + frictions) for samples of one segment."""
        if self.inputs is None:
            return samples.u
        if self._segment != samples.segment:
            self._segment = samples.segment
            self.inputs.start_segment()
        return self.inputs.beside(samples.y, samples.u)


def dry_friction(config: RigConfig, resolution: FloatArray) -> DryFriction:
    """Build the block of a rig; resolution (p,) is the wire's smallest step of each output, SI."""
    return DryFriction(friction_inputs(config, resolution))


def friction_inputs(config: RigConfig, resolution: FloatArray) -> FrictionInputs | None:
    """Return what puts the signs beside a rig's inputs; None without friction elements."""
    model = mechanics_of(rig_model(config).model)
    if model is None or not model.structure.frictions:
        return None
    known = known_noise(config, resolution)
    period_s = 1.0 / config.rig.sample_rate_hz
    return FrictionInputs(friction_observer(model, period_s, straight(config.estimator.hold), known))


def signals(config: RigConfig) -> int:
    """Return how many of the model's inputs differ from sample to sample: those measured and the signs."""
    return len(config.inputs) + (
        len(config.model.friction) if isinstance(config.model, MechanicsModel) else 0
    )


def mechanics_of(model: Model) -> MassSpringDamper | None:
    """Return masses, springs and dampers of a rig's model, no sensor constants; None for a linear one."""
    inner = model.model if isinstance(model, SensedModel) else model
    return inner if isinstance(inner, MassSpringDamper) else None
