"""Rotating: a chain of inertias joined by shafts, gears and bearings."""

from collections.abc import Iterator
from typing import Literal

from agent.config.domains.plant import GROUND, Domain, Fact, Link, Plant, Store, loose, twice
from agent.config.reading.fields import Positive


class Turning(Link):
    """A shaft (N m/rad) or a bearing (N m s/rad) between two inertias.

    ratio: turns of the first a turn of the second, of a gear; the value is as seen from the first.
    """

    ratio: Positive = 1.0


class Torsional(Domain):
    """J_i w_i' = torque - sum of ratios times k (a_i - ratio a_j) and c (w_i - ratio w_j); ground at rest."""

    kind: Literal["torsional"]
    inertia: tuple[Store, ...] = ()
    shaft: tuple[Turning, ...] = ()
    bearing: tuple[Turning, ...] = ()

    def facts(self) -> Iterator[Fact]:
        """Yield what is wrong between values."""
        if not self.inertia:
            yield Fact("inertia", "is missing", 'name at least one, such as { name = "J1", nominal = 0.01 }')
        yield from twice({"inertia": self.inertia, "shaft": self.shaft, "bearing": self.bearing})
        nodes = [*(store.name for store in self.inertia), GROUND]
        yield from loose("shaft", self.shaft, nodes)
        yield from loose("bearing", self.bearing, nodes)

    def plant(self, quantities: frozenset[str]) -> Plant:
        """Return the chain: speeds, then angles where a channel measures one, else the shafts' twists."""
        plant = Plant()
        speeds = {}
        for store in self.inertia:
            plant.part(store.name, store.nominal, "kg m2", stores=True)
            speed = speeds[store.name] = plant.state(
                f"speed of {store.name}", "rad/s", {store.name: 1}, push="N m"
            )
            plant.drive(("torque", store.name), speed)
            plant.read(("speed", store.name), speed)
        for bearing in self.bearing:
            one, other = (speeds.get(end) for end in bearing.between)
            plant.across(
                one, other, {plant.part(bearing.name, bearing.nominal, "N m s/rad"): 1}, bearing.ratio
            )
        angles = _angles(plant, speeds) if "angle" in quantities else {}
        for shaft in self.shaft:
            plant.part(shaft.name, shaft.nominal, "N m/rad")
            _join(plant, shaft, speeds, angles or {f"twist of {shaft.name}": _twist(plant, shaft, speeds)})
        return plant


def _angles(plant: Plant, speeds: dict[str, int]) -> dict[str, int]:
    """Add an angle for each inertia; return them by the inertia's name."""
    angles = {}
    for name, speed in speeds.items():
        angles[name] = plant.state(f"angle of {name}", "rad", {})
        plant.flow(angles[name], speed, 1.0)
        plant.read(("angle", name), angles[name])
    return angles


def _twist(plant: Plant, shaft: Turning, speeds: dict[str, int]) -> int:
    """Add how far a shaft is twisted; return that state."""
    twist = plant.state(f"twist of {shaft.name}", "rad", {})
    for end, seen in zip(shaft.between, (1.0, -shaft.ratio), strict=True):
        if end in speeds:
            plant.flow(twist, speeds[end], seen)
    return twist


def _join(plant: Plant, shaft: Turning, speeds: dict[str, int], places: dict[str, int]) -> None:
    """Let a shaft's torque, which a channel may read, act on both its ends."""
    ends = list(zip(shaft.between, (1.0, -shaft.ratio), strict=True))
    twists = [(places[end], seen) for end, seen in ends if end in places]
    twists = twists or [(place, 1.0) for place in places.values()]
    for place, seen in twists:
        plant.read(("torque", shaft.name), place, seen, {shaft.name: 1})
        for end, into in ends:
            if end in speeds:
                plant.flow(speeds[end], place, -into * seen, {shaft.name: 1})
