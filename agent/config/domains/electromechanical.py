"""Electromechanical: a voltage moves a rotor or a coil; what lies between the two need not be measured."""

from typing import Literal

from agent.config.domains.plant import Domain, Plant
from agent.config.reading.fields import NotNegative, Positive


class DcMotor(Domain):
    """A direct-current motor with its load: L i' = u - R i - K w, J w' = K i - b w + torque.

    R: Ohm, of the armature. L: H. K: V s/rad, which is N m/A. J: kg m2, with the load's. b: N m s/rad.
    """

    kind: Literal["dc-motor"]
    R: NotNegative
    L: Positive
    K: Positive
    J: Positive
    b: NotNegative

    def plant(self, quantities: frozenset[str]) -> Plant:
        """Return the motor; its angle is a state only where a channel measures it."""
        plant = Plant()
        current, speed = _winding_and_mover(
            plant, self.R, self.L, self.K, "V s/rad", ("speed", "rad/s", "N m")
        )
        plant.part("J", self.J, "kg m2", stores=True)
        plant.part("b", self.b, "N m s/rad")
        plant.inert(speed, speed, 1.0, {"J": 1})
        plant.flow(speed, speed, -1.0, {"b": 1})
        plant.drive(("torque", "shaft"), speed)
        plant.read(("current", "armature"), current)
        plant.read(("speed", "shaft"), speed)
        if "angle" in quantities:
            angle = plant.state("angle", "rad", {})
            plant.flow(angle, speed, 1.0)
            plant.read(("angle", "shaft"), angle)
        return plant


class VoiceCoil(Domain):
    """A moving coil on a spring: L i' = u - R i - K v, m v' = K i - b v - k x + force, x' = v.

    R: Ohm. L: H. K: N/A, which is V s/m. m: kg. b: N s/m. k: N/m.
    """

    kind: Literal["voice-coil"]
    R: NotNegative
    L: Positive
    K: Positive
    m: Positive
    b: NotNegative
    k: NotNegative

    def plant(self, quantities: frozenset[str]) -> Plant:
        """Return the coil and its suspension."""
        plant = Plant()
        current, velocity = _winding_and_mover(plant, self.R, self.L, self.K, "N/A", ("velocity", "m/s", "N"))
        plant.part("m", self.m, "kg", stores=True)
        plant.part("b", self.b, "N s/m")
        plant.part("k", self.k, "N/m")
        plant.inert(velocity, velocity, 1.0, {"m": 1})
        position = plant.state("position", "m", {})
        plant.flow(velocity, velocity, -1.0, {"b": 1})
        plant.flow(velocity, position, -1.0, {"k": 1})
        plant.flow(position, velocity, 1.0)
        plant.drive(("force", "coil"), velocity)
        plant.read(("current", "winding"), current)
        plant.read(("velocity", "coil"), velocity)
        plant.read(("displacement", "coil"), position)
        return plant


def _winding_and_mover(
    plant: Plant,
    resistance: float,
    inductance: float,
    constant: float,
    unit: str,
    mover: tuple[str, str, str],
) -> tuple[int, int]:
    """Add R, L and K with the current and what moves (its name, unit and effort); return both states."""
    plant.part("R", resistance, "Ohm")
    plant.part("L", inductance, "H", stores=True)
    plant.part("K", constant, unit)
    current = plant.state("current", "A", {"L": 1}, push="V")
    name, unit_of_motion, effort = mover
    moving = plant.state(name, unit_of_motion, push=effort)
    plant.flow(current, current, -1.0, {"R": 1})
    plant.flow(current, moving, -1.0, {"K": 1})
    plant.flow(moving, current, 1.0, {"K": 1})
    plant.drive(("voltage", "winding"), current)
    return current, moving
