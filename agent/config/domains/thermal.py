"""Thermal: heat capacities joined by conductances or resistances; an imposed temperature is a boundary."""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from agent.config.domains.plant import Domain, Fact, Link, Plant, Store, loose, twice
from agent.config.reading.fields import Name, Positive


class Resistance(Link):
    """A thermal resistance, K/W."""

    nominal: Positive


class Thermal(Domain):
    """C_i T_i' = power + sum of G_ij (T_j - T_i): capacities in J/K, conductances in W/K, resistances in K/W.

    boundary: nodes whose temperature a channel measures as an input (a room, a coolant).
    """

    kind: Literal["thermal"]
    capacity: tuple[Store, ...] = ()
    conductance: tuple[Link, ...] = ()
    resistance: tuple[Resistance, ...] = ()
    boundary: Annotated[tuple[Name, ...], Field(strict=False)] = ()

    def facts(self) -> Iterator[Fact]:
        """Yield what is wrong between values."""
        if not self.capacity:
            yield Fact(
                "capacity", "is missing", 'name at least one, such as { name = "core", nominal = 500.0 }'
            )
        yield from twice(
            {"capacity": self.capacity, "conductance": self.conductance, "resistance": self.resistance}
        )
        nodes = [*(store.name for store in self.capacity), *self.boundary]
        yield from loose("conductance", self.conductance, nodes)
        yield from loose("resistance", self.resistance, nodes)

    def plant(self, quantities: frozenset[str]) -> Plant:
        """Return the network."""
        plant = Plant()
        nodes: dict[str, int] = {}
        for store in self.capacity:
            C = plant.part(store.name, store.nominal, "J/K", stores=True)  # noqa: N806 - a letter of the books
            node = nodes[store.name] = plant.state(f"temperature of {C}", "K", {C: 1}, push="W")
            plant.drive(("power", C), node)
            plant.read(("temperature", C), node)
        for links, unit, power in ((self.conductance, "W/K", 1), (self.resistance, "K/W", -1)):
            for link in links:
                powers = {plant.part(link.name, link.nominal, unit): power}
                plant.join(link, nodes, powers, "temperature")
        return plant
