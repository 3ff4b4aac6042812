"""The graph of a rig as places on a line: what the page needs to draw masses, springs and dampers."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from agent.config.tables import RigConfig

_KINDS = ("spring", "damper", "friction")


def drawing(config: "RigConfig") -> dict[str, Any]:
    """Return {"kind", "masses": [{name, value, place}], "elements": [{name, kind, from, to, row}]}.

    Masses stand on a line in the order of how far they are from the ground; elements between the same two
    places have rows of their own. A model that is no graph has neither.
    """
    model = config.model
    if model.kind != "mass-spring-damper":
        return {"kind": model.kind, "masses": [], "elements": []}
    elements = [(kind, element) for kind in _KINDS for element in getattr(model, kind)]
    places = _places([mass.name for mass in model.mass], [element.between for _, element in elements])
    rows: dict[tuple[int, int], int] = {}
    drawn = []
    for kind, element in elements:
        first, last = sorted(places[name] for name in element.between)
        row = rows[first, last] = rows.get((first, last), -1) + 1
        drawn.append({"name": element.name, "kind": kind, "from": first, "to": last, "row": row})
    masses = [{"name": mass.name, "value": mass.value, "place": places[mass.name]} for mass in model.mass]
    return {"kind": model.kind, "masses": masses, "elements": drawn}


def _places(masses: list[str], pairs: list[tuple[str, str]]) -> dict[str, int]:
    """Return the place of the ground, 0, and of each mass, by distance from the ground (breadth first)."""
    found, order = {"ground": 0}, ["ground"]
    for here in order:
        neighbours = {end for pair in pairs if here in pair for end in pair}
        order += [mass for mass in masses if mass in neighbours and mass not in order]
    for name in [*order[1:], *(mass for mass in masses if mass not in order)]:
        found[name] = len(found)
    return found
