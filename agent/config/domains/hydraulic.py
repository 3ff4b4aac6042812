"""Hydraulic: tanks and vessels joined by restrictions and lines; an imposed pressure is a boundary."""

from collections.abc import Iterator, Mapping
from typing import Annotated, ClassVar, Final, Literal

from pydantic import Field

from agent.config.domains.plant import GROUND, Domain, Fact, Link, Plant, Store, loose, twice
from agent.config.reading.fields import Name, NotNegative, Positive

GRAVITY: Final = 9.80665  # fixed by ISO 80000-3, m/s^2


class Restriction(Link):
    """What a flow loses pressure in, Pa s/m3."""

    nominal: Positive


class Line(Link):
    """A pipe that is long: its inertance, kg/m4, with a resistance of its own, Pa s/m3, called <name>.R."""

    KEYS: ClassVar[Mapping[str, str]] = {"": "nominal", ".R": "resistance"}

    nominal: Positive
    resistance: NotNegative = 0.0


class Hydraulic(Domain):
    """Tanks of area (m2) and closed vessels of capacity (m3/Pa), in small changes around the working point.

    capacity p' = flow + sum of (p_j - p_i) / R_ij; of a line inertance q' = p_i - p_j - R q. "ground" is the
    open air or the return. A level is p / (density · g).
    """

    kind: Literal["hydraulic"]
    density: Positive = 1000.0
    tank: tuple[Store, ...] = ()
    vessel: tuple[Store, ...] = ()
    restriction: tuple[Restriction, ...] = ()
    line: tuple[Line, ...] = ()
    boundary: Annotated[tuple[Name, ...], Field(strict=False)] = ()

    def facts(self) -> Iterator[Fact]:
        """Yield what is wrong between values."""
        rows = {"tank": self.tank, "vessel": self.vessel, "restriction": self.restriction, "line": self.line}
        if not (self.tank or self.vessel or self.line):
            yield Fact(
                "tank", "is missing: nothing keeps a volume", 'name one: { name = "T1", nominal = 0.05 }'
            )
        yield from twice(rows)
        nodes = [*(store.name for store in (*self.tank, *self.vessel)), *self.boundary, GROUND]
        yield from loose("restriction", self.restriction, nodes)
        yield from loose("line", self.line, nodes)

    def plant(self, quantities: frozenset[str]) -> Plant:
        """Return the network; its states are pressures, then the flows in lines."""
        plant = Plant()
        head = self.density * GRAVITY
        nodes = {row.name: _store(plant, row, "m2", 1.0 / head) for row in self.tank}
        for row in self.tank:
            plant.read(("level", row.name), nodes[row.name], 1.0 / head)
        nodes |= {row.name: _store(plant, row, "m3/Pa", 1.0) for row in self.vessel}
        for link in self.restriction:
            powers = {plant.part(link.name, link.nominal, "Pa s/m3"): -1}
            plant.join(link, nodes | {GROUND: None}, powers, "pressure")
        for line in self.line:
            _lay(plant, line, nodes)
        return plant


def _store(plant: Plant, row: Store, unit: str, factor: float) -> int:
    plant.part(row.name, row.nominal, unit, stores=True)
    node = plant.state(f"pressure of {row.name}", "Pa", {row.name: 1}, push="m3/s", factor=factor)
    plant.drive(("flow", row.name), node)
    plant.read(("pressure", row.name), node)
    return node


def _lay(plant: Plant, line: Line, nodes: dict[str, int]) -> None:
    """Put a line between two nodes: its flow is a state that leaves one and enters the other."""
    plant.part(line.name, line.nominal, "kg/m4", stores=True)
    flow = plant.state(f"flow in {line.name}", "m3/s", {line.name: 1}, push="Pa")
    plant.read(("flow", line.name), flow)
    if line.resistance > 0:
        plant.flow(flow, flow, -1.0, {plant.part(f"{line.name}.R", line.resistance, "Pa s/m3"): 1})
    for end, sign in zip(line.between, (1.0, -1.0), strict=True):
        if end in nodes:
            plant.flow(flow, nodes[end], sign)
            plant.flow(nodes[end], flow, -sign)
        elif end != GROUND:
            plant.drive(("pressure", end), flow, sign)
