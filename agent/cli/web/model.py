"""A rig's model as places on a line: what the page needs to draw its elements and what lies between them."""

from collections.abc import Iterable, Iterator
from itertools import count
from typing import TYPE_CHECKING, Any, NamedTuple

from agent.cli.tuning import DRAWN_ELEMENTS
from agent.config.domains.plant import GROUND, Domain, Link

if TYPE_CHECKING:
    from agent.config.domains.plant import Plant, Term
    from agent.config.model.linear import LinearModel, LinearParameter
    from agent.config.model.tables import MechanicsModel
    from agent.config.tables import RigConfig

_KINDS = ("spring", "damper", "friction")


class _Between(NamedTuple):
    """An element between two places; kind "wire" has no name."""

    name: str
    kind: str
    between: tuple[str, str]


class _Graph(NamedTuple):
    """What is drawn as a box, with its value, and what lies between boxes or a box and the ground.

    is_chain: boxes stand in their own order, not in that of how far they are from the ground.
    """

    boxes: dict[str, float]
    elements: list[_Between]
    is_chain: bool = False


def drawing(config: "RigConfig") -> dict[str, Any]:
    """Return {"kind", "masses": [{name, value, place}], "elements": [{name, kind, from, to, row}]}.

    Masses or nodes stand on a line in the order of how far they are from the ground, what keeps energy and
    states in their own; elements that pass the same gap between places have rows of their own.
    """
    graph = _graph(config)
    pairs = [] if graph.is_chain else [element.between for element in graph.elements]
    places = _places(list(graph.boxes), pairs)
    taken: set[tuple[int, int]] = set()
    drawn = []
    for name, kind, between in graph.elements[:DRAWN_ELEMENTS]:
        first, last = sorted(places[end] for end in between)
        gaps = range(first, max(last, first + 1))
        row = next(row for row in count() if not any((gap, row) in taken for gap in gaps))
        taken |= {(gap, row) for gap in gaps}
        drawn.append({"name": name, "kind": kind, "from": first, "to": last, "row": row})
    masses = [{"name": name, "value": value, "place": places[name]} for name, value in graph.boxes.items()]
    return {"kind": config.model.kind, "masses": masses, "elements": drawn}


def _graph(config: "RigConfig") -> _Graph:
    model = config.model
    if isinstance(model, Domain):
        return _of_template(model)
    return _of_masses(model) if model.kind == "mass-spring-damper" else _of_matrices(model, config)


def _of_masses(model: "MechanicsModel") -> _Graph:
    elements = [_Between(e.name, kind, e.between) for kind in _KINDS for e in getattr(model, kind)]
    return _Graph({mass.name: mass.value for mass in model.mass}, elements)


def _of_template(model: Domain) -> _Graph:
    """Draw nodes and the rows between them; without such rows what keeps energy, exchanges or loses it."""
    plant = model.plant(frozenset())
    known = {part.name: part.nominal for part in plant.parts}
    links = [
        (key, row) for key, rows in model if isinstance(rows, tuple) for row in rows if isinstance(row, Link)
    ]
    if not links:
        stored = dict(_stored(plant))
        return _Graph(
            {name: known[name] for name in stored.values()}, list(_exchanged(plant, stored)), is_chain=True
        )
    elements = [_Between(row.name, key, row.between) for key, row in links]
    ends = dict.fromkeys(end for element in elements for end in element.between if end != GROUND)
    return _Graph({end: known.get(end, 0.0) for end in ends}, elements)


def _stored(plant: "Plant") -> Iterator[tuple[int, str]]:
    """Yield the states that keep energy, each with the element that it is kept in."""
    for term in plant.moving:
        if term.matrix == "E" and term.row == term.column and term.powers:
            yield term.row, term.powers[0][0]


def _exchanged(plant: "Plant", stored: dict[int, str]) -> Iterator[_Between]:
    """Yield each element once, between the stores that it acts on, else to the ground; then bare joints."""
    boxes = set(stored.values())
    for part in plant.parts:
        if part.name not in boxes:
            terms = [term for term in plant.moving if any(name == part.name for name, _ in term.powers)]
            yield _Between(part.name, "element", _ends(terms, stored))
    joints = [term for term in plant.moving if term.matrix == "F" and not term.powers]
    pairs = dict.fromkeys(
        tuple(sorted((t.row, t.column))) for t in joints if {t.row, t.column} <= set(stored)
    )
    yield from (_Between("", "wire", (stored[a], stored[b])) for a, b in pairs)


def _ends(terms: "Iterable[Term]", stored: dict[int, str]) -> tuple[str, str]:
    touched = [stored[state] for t in terms for state in (t.row, t.column) if state in stored]
    return _pair(touched)


def _pair(touched: Iterable[str]) -> tuple[str, str]:
    """Return the first two places that are touched; with one the ground, with none only that."""
    first, last, *_ = [*dict.fromkeys(touched), GROUND, GROUND]
    return first, last


def _of_matrices(model: "LinearModel", config: "RigConfig") -> _Graph:
    """Draw the states, and between them the parameters by what they change."""
    names = [f"x{name[6:]}" if name.startswith("state ") else name for name in model.state_names]
    wanted = set(config.estimator.estimate)
    chosen = [parameter for parameter in model.parameters if parameter.name in wanted]
    elements = [_Between(p.name, "element", _pair(_touched(p, names))) for p in chosen]
    return _Graph(dict.fromkeys(names, 0.0), elements, is_chain=True)


def _touched(parameter: "LinearParameter", names: list[str]) -> Iterator[str]:
    """Yield the states in whose rows of A and B, or columns of A and C, a parameter stands."""
    for matrix, rows in parameter.derivatives.items():
        for i, row in enumerate(rows):
            for j, slope in enumerate(row):
                if slope != 0:
                    yield from [names[i]] * (matrix in "AB") + [names[j]] * (matrix in "AC")


def _places(masses: list[str], pairs: list[tuple[str, str]]) -> dict[str, int]:
    """Return the place of the ground, 0, and of each mass, by distance from the ground (breadth first)."""
    found, order = {"ground": 0}, ["ground"]
    for here in order:
        neighbours = {end for pair in pairs if here in pair for end in pair}
        order += [mass for mass in masses if mass in neighbours and mass not in order]
    for name in [*order[1:], *(mass for mass in masses if mass not in order)]:
        found[name] = len(found)
    return found
