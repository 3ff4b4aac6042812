"""The equations of a plant as they are assembled: states, elements, what drives it and what can be read."""

from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Final, Literal, NamedTuple

from pydantic import Field

from agent.config.reading.fields import Name, NotNegative, Positive, Table, shown
from agent.config.reading.messages import listing

Powers = Mapping[str, int]
GROUND: Final = "ground"


class Fact(NamedTuple):
    """What is wrong with a template: the key under [model], what, and what to do."""

    key: str
    what: str
    advice: str


class Term(NamedTuple):
    """c times powers of elements, added to an entry of one of E, F, G, H, J."""

    matrix: str
    row: int
    column: int
    coefficient: float
    powers: tuple[tuple[str, int], ...]


class Part(NamedTuple):
    """An element of a plant; kind "storage" keeps energy, and is estimated only where that is asked for."""

    name: str
    kind: Literal["element", "storage"]
    nominal: float
    unit: str


class State(NamedTuple):
    """A state and its unit; push: the unit of an unknown effort in its equation, "" where none can act."""

    name: str
    unit: str
    push: str


class Entry(NamedTuple):
    """A term of an input's column or an output's row: at which state, how much, times which powers."""

    state: int
    coefficient: float
    powers: tuple[tuple[str, int], ...] = ()


Place = tuple[str, str]
"""A quantity and where: ("voltage", "source")."""


@dataclass
class Plant:
    """E x' = F x + G u with every place where a channel may drive or read.

    Attributes:
        parts: the elements, in the file's order.
        states: the states, in order.
        moving: the terms of E and F.
        drives, reads: by place, the terms of an input's column of G and of an output's row of H.
    """

    parts: list[Part] = field(default_factory=list)
    states: list[State] = field(default_factory=list)
    moving: list[Term] = field(default_factory=list)
    drives: dict[Place, list[Entry]] = field(default_factory=dict)
    reads: dict[Place, list[Entry]] = field(default_factory=dict)

    def part(self, name: str, nominal: float, unit: str, *, stores: bool = False) -> str:
        """Add an element; return its name."""
        self.parts.append(Part(name, "storage" if stores else "element", nominal, unit))
        return name

    def state(
        self, name: str, unit: str, stored: Powers | None = None, push: str = "", factor: float = 1.0
    ) -> int:
        """Add a state with factor · stored · x' on the left of its equation; return its number."""
        number = len(self.states)
        self.states.append(State(name, unit, push))
        if stored is not None:
            self.inert(number, number, factor, stored)
        return number

    def inert(self, row: int, column: int, factor: float, powers: Powers) -> None:
        """Add to the left side, to what x' of `column` is multiplied by."""
        self.moving.append(Term("E", row, column, factor, tuple(powers.items())))

    def flow(self, row: int, column: int, factor: float, powers: Powers | None = None) -> None:
        """Add to the right side of an equation: factor · powers · x of `column`."""
        self.moving.append(Term("F", row, column, factor, tuple((powers or {}).items())))

    def drive(self, place: Place, state: int, factor: float = 1.0, powers: Powers | None = None) -> None:
        """Let an input at a place act in the equation of a state."""
        self.drives.setdefault(place, []).append(Entry(state, factor, tuple((powers or {}).items())))

    def read(self, place: Place, state: int, factor: float = 1.0, powers: Powers | None = None) -> None:
        """Let an output at a place read a state."""
        self.reads.setdefault(place, []).append(Entry(state, factor, tuple((powers or {}).items())))

    def across(self, one: int | None, other: int | None, powers: Powers, ratio: float = 1.0) -> None:
        """Add a two-terminal element between `one` and `other`.

        The flow, powers · (x_one - ratio x_other), leaves `one` and enters `other`, ratio times.

        None is ground.
        """
        for row, into in ((one, -1.0), (other, ratio)):
            for column, seen in ((one, 1.0), (other, -ratio)):
                if row is not None and column is not None:
                    self.flow(row, column, into * seen, powers)

    def join(self, link: "Link", nodes: Mapping[str, int | None], powers: Powers, imposed: str) -> None:
        """Put a two-terminal element between nodes, None for ground; an end that is none is imposed on it."""
        one, other = (nodes.get(end) for end in link.between)
        self.across(one, other, powers)
        for inner, outer in ((one, link.between[1]), (other, link.between[0])):
            if inner is not None and outer not in nodes:
                self.drive((imposed, outer), inner, 1.0, powers)

    def place(self, quantity: str, at: str) -> Place | None:
        """Return the place of a channel; without `at` the only one of its quantity; None if there is none."""
        places = [place for place in (*self.drives, *self.reads) if place[0] == quantity]
        if at == "" and len(set(places)) == 1:
            return places[0]
        return (quantity, at) if (quantity, at) in places else None

    def terms(self, inputs: Iterable[Place], outputs: Iterable[Place]) -> Iterator[Term]:
        """Yield all terms, with the columns and rows of these inputs and outputs."""
        yield from self.moving
        for number, place in enumerate(inputs):
            yield from (Term("G", e.state, number, e.coefficient, e.powers) for e in self.drives[place])
        for number, place in enumerate(outputs):
            yield from (Term("H", number, e.state, e.coefficient, e.powers) for e in self.reads[place])

    @property
    def pushed(self) -> tuple[int, ...]:
        """The equations in which an unknown effort may act."""
        return tuple(number for number, state in enumerate(self.states) if state.push)


class Row(Table):
    """A row that is an element, or several.

    KEYS: the key of the value that is called like the row with so much behind its name.
    """

    KEYS: ClassVar[Mapping[str, str]] = {"": "nominal"}

    name: Name


class Store(Row):
    """An element that keeps energy, and the node that it is."""

    nominal: Positive


class Link(Row):
    """An element between two nodes."""

    between: Annotated[tuple[Name, Name], Field(strict=False)]
    nominal: NotNegative


class Domain(Table):
    """A template: what its own keys say, as a plant.

    sd_percent: how well elements that are not estimated are known, by name; what is not named is exact.
    """

    kind: str
    sd_percent: dict[str, NotNegative] = Field(default_factory=dict)

    @abstractmethod
    def plant(self, quantities: frozenset[str]) -> Plant:
        """Return the plant; quantities: those that channels have, for states that only these can tell."""

    def facts(self) -> Iterator[Fact]:
        """Yield what is wrong between values."""
        yield from ()

    def place_of(self, name: str) -> tuple[str | int, ...]:
        """Return where an element's value stands: its key, or the table's with the row's number and key."""
        for key, rows in self:
            for number, row in enumerate(rows if isinstance(rows, tuple) else ()):
                if isinstance(row, Row) and (own := _key_of(row, name)):
                    return key, number, own
        return (name,)

    @property
    def parts(self) -> list[Part]:
        """The elements."""
        return self.plant(frozenset()).parts


def _key_of(row: Row, name: str) -> str | None:
    return row.KEYS.get(name.removeprefix(row.name)) if name.startswith(row.name) else None


def twice(rows: Mapping[str, Iterable[Any]]) -> Iterator[Fact]:
    """Yield a fact for each name that an earlier row has already; rows by their key."""
    owner: dict[str, str] = {}
    for key, table in rows.items():
        for i, row in enumerate(table):
            path = f"{key}[{i}]"
            if row.name in owner:
                yield Fact(
                    f"{path}.name", f"{shown(row.name)} is the name of {owner[row.name]}", "names must differ"
                )
            owner.setdefault(row.name, path)


def loose(key: str, links: Iterable[Any], nodes: Iterable[str]) -> Iterator[Fact]:
    """Yield a fact for each end of a link that is no node, and each link that ends where it begins."""
    known = list(nodes)
    for i, link in enumerate(links):
        for j, end in enumerate(link.between):
            if end not in known:
                yield Fact(
                    f"{key}[{i}].between[{j}]",
                    f"no node is called {shown(end)}",
                    f"nodes are {listing(known)}",
                )
        if link.between[0] == link.between[1]:
            yield Fact(
                f"{key}[{i}].between", f"both ends are {shown(link.between[0])}", "name two different nodes"
            )
