"""The graph of a configuration: its elements, its parametric model, what can be begun at all."""

from typing import Any

from agent.blocks.friction import mechanics_of
from agent.blocks.rig_model import rig_model
from agent.commissioning.nominals import with_nominals
from agent.commissioning.numerics.motion.start import hidden
from agent.config import MechanicsModel, RigConfig
from agent.errors import ModelError
from agent.numerics.model.mechanics import MassSpringDamper


def with_blanks(rig: RigConfig) -> RigConfig:
    """Return a configuration with 1 for every nominal that is to be found."""
    return with_nominals(
        rig, {e.name: 1.0 for e in elements_of(rig.model) if e.name in rig.estimator.estimate}
    )


def elements_of(model: object) -> tuple[Any, ...]:
    """Return the springs, dampers and frictions of a graph; nothing of other models."""
    if not isinstance(model, MechanicsModel):
        return ()
    return (*model.spring, *model.damper, *model.friction)


def mechanics(config: RigConfig) -> MassSpringDamper:
    """Return the parametric model of a graph."""
    found = mechanics_of(rig_model(config).model)
    if found is None:
        raise TypeError("not a mass-spring-damper model")
    return found


def require_motion_sensors(config: RigConfig) -> None:
    """Refuse what nothing can begin with: without a force, a motion that is missing."""
    model = mechanics(config)
    names, nodes = hidden(model)
    if names and not model.forces:
        what = (
            f"{', '.join(names)} cannot be started: "
            f"no displacement or velocity of {', '.join(nodes)} is measured, and no force"
        )
        advice = f"measure the displacement of {', '.join(nodes)}, or a force, or state these nominals"
        raise ModelError.at("channel", what, advice)
