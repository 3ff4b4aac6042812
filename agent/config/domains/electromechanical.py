"""Electromechanical: a voltage moves a rotor or a coil; what lies between the two need not be measured."""

from typing import Final, Literal, NamedTuple

from agent.config.domains.plant import Domain, Plant, State
from agent.config.reading.fields import NotNegative, Positive


class _Mover(NamedTuple):
    """What the winding moves: its state, the units of K, its inertia and b, and what acts on it where."""

    state: State
    units: tuple[str, str, str]
    inertia: str
    effort: str
    place: str
    winding: str


_ROTOR: Final = _Mover(
    State("speed", "rad/s", "N m"), ("V s/rad", "kg m2", "N m s/rad"), "J", "torque", "shaft", "armature"
)
_COIL: Final = _Mover(State("velocity", "m/s", "N"), ("N/A", "kg", "N s/m"), "m", "force", "coil", "winding")


class _Winding(Domain):
    """R, Ohm, and L, H, of a winding whose current moves an inertia by K against a damping b."""

    R: NotNegative
    L: Positive
    K: Positive
    b: NotNegative

    def _moving(self, mover: _Mover) -> tuple[Plant, int]:
        """Return the winding with what it moves, and that motion's state."""
        plant = Plant()
        of_constant, of_inertia, of_damping = mover.units
        plant.part("R", self.R, "Ohm")
        plant.part("L", self.L, "H", stores=True)
        plant.part("K", self.K, of_constant)
        plant.part(mover.inertia, float(getattr(self, mover.inertia)), of_inertia, stores=True)
        plant.part("b", self.b, of_damping)
        current = plant.state("current", "A", {"L": 1}, push="V")
        moving = plant.state(mover.state.name, mover.state.unit, {mover.inertia: 1}, push=mover.state.push)
        plant.flow(current, current, -1.0, {"R": 1})
        plant.flow(current, moving, -1.0, {"K": 1})
        plant.flow(moving, current, 1.0, {"K": 1})
        plant.flow(moving, moving, -1.0, {"b": 1})
        plant.drive(("voltage", "winding"), current)
        plant.drive((mover.effort, mover.place), moving)
        plant.read(("current", mover.winding), current)
        plant.read((mover.state.name, mover.place), moving)
        return plant, moving


class DcMotor(_Winding):
    """A direct-current motor with its load: L i' = u - R i - K w, J w' = K i - b w + torque.

    R: Ohm, of the armature. L: H. K: V s/rad, which is N m/A. J: kg m2, with the load's. b: N m s/rad.
    """

    kind: Literal["dc-motor"]
    J: Positive

    def plant(self, quantities: frozenset[str]) -> Plant:
        """Return the motor; its angle is a state only where a channel measures it."""
        plant, speed = self._moving(_ROTOR)
        if "angle" in quantities:
            angle = plant.state("angle", "rad", {})
            plant.flow(angle, speed, 1.0)
            plant.read(("angle", "shaft"), angle)
        return plant


class VoiceCoil(_Winding):
    """A moving coil on a spring: L i' = u - R i - K v, m v' = K i - b v - k x + force, x' = v.

    R: Ohm. L: H. K: N/A, which is V s/m. m: kg. b: N s/m. k: N/m.
    """

    kind: Literal["voice-coil"]
    m: Positive
    k: NotNegative

    def plant(self, quantities: frozenset[str]) -> Plant:
        """Return the coil and its suspension."""
        plant, velocity = self._moving(_COIL)
        plant.part("k", self.k, "N/m")
        position = plant.state("position", "m", {})
        plant.flow(velocity, position, -1.0, {"k": 1})
        plant.flow(position, velocity, 1.0)
        plant.read(("displacement", "coil"), position)
        return plant
