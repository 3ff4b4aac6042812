"""Electrical: a ladder of coils and capacitors, fed by a voltage.

Between source and load each stage has R and L in series, then C to the return.
"""

from collections.abc import Iterator
from typing import Literal

from agent.config.domains.plant import Domain, Fact, Plant
from agent.config.reading.fields import NotNegative, Positive, Table


class Stage(Table):
    """R and L in series, then C to the return; without L the resistor alone."""

    R: NotNegative
    L: Positive | None = None
    C: Positive


class RlcLadder(Domain):
    """A filter or a cable: elements are called R1, L1, C1, R2 ... and load.

    States are the coils' currents and the capacitors' voltages: L i' = v_before - v - R i, C v' = i -
    i_after.
    """

    kind: Literal["rlc-ladder"]
    stage: tuple[Stage, ...] = ()
    load: Positive | None = None

    def facts(self) -> Iterator[Fact]:
        """Yield what is wrong between values."""
        if not self.stage:
            yield Fact("stage", "is missing", "name at least one, such as { R = 1.0, L = 1e-3, C = 1e-6 }")
        for i, stage in enumerate(self.stage):
            if stage.R == 0 and stage.L is None:
                yield Fact(f"stage[{i}].R", "must be greater than 0 where there is no L", "give R or L")

    def place_of(self, name: str) -> tuple[str | int, ...]:
        """Return where an element's value stands."""
        return super().place_of(name) if name == "load" else ("stage", int(name[1:]) - 1, name[0])

    def plant(self, quantities: frozenset[str]) -> Plant:
        """Return the ladder from its source on."""
        plant = Plant()
        before: int | None = None
        for number, stage in enumerate(self.stage, 1):
            before = _add(plant, stage, number, before)
        if self.load is not None and before is not None:
            plant.flow(before, before, -1.0, {plant.part("load", self.load, "Ohm"): -1})
        return plant


def _add(plant: Plant, stage: Stage, number: int, before: int | None) -> int:
    """Add a stage behind the capacitor `before`, None for the source; return its capacitor."""
    R = plant.part(f"R{number}", stage.R, "Ohm")  # noqa: N806 - a letter of the books
    coil = None
    if stage.L is not None:
        L = plant.part(f"L{number}", stage.L, "H", stores=True)  # noqa: N806 - a letter of the books
        coil = plant.state(f"current of {L}", "A", {L: 1}, push="V")
        plant.read(("current", L), coil)
    C = plant.part(f"C{number}", stage.C, "F")  # noqa: N806 - a letter of the books
    shunt = plant.state(f"voltage of {C}", "V", {C: 1}, push="A")
    plant.read(("voltage", C), shunt)
    if coil is None:
        plant.across(before, shunt, {R: -1})
    else:
        _chain(plant, before, coil, shunt, R)
    if before is None:
        plant.drive(("voltage", "source"), *((shunt, 1.0, {R: -1}) if coil is None else (coil,)))
    return shunt


def _chain(plant: Plant, before: int | None, coil: int, shunt: int, resistance: str) -> None:
    """Put a coil with its resistance between two capacitors."""
    plant.flow(coil, coil, -1.0, {resistance: 1})
    plant.flow(coil, shunt, -1.0)
    plant.flow(shunt, coil, 1.0)
    if before is not None:
        plant.flow(coil, before, 1.0)
        plant.flow(before, coil, -1.0)
