"""What must hold in the model: names, nodes, massless nodes, parts that something measures."""

from collections.abc import Iterable, Iterator

from agent.config.domains.plant import Domain
from agent.config.domains.rules import check_template, placed
from agent.config.draft import Draft
from agent.config.model.linear import LinearModel
from agent.config.model.tables import GROUND, Element, Mass, MechanicsModel
from agent.config.reading.fields import shown
from agent.config.reading.messages import listing
from agent.config.reading.parse import Entry, Faults, readable, unique
from agent.config.rules_linear import check_linear


def check_model(draft: Draft) -> None:
    """Note the faults of the model."""
    if isinstance(draft.model, LinearModel):
        check_linear(draft, draft.model)
    elif isinstance(draft.model, Domain):
        _check_domain(draft, draft.model)
    elif isinstance(draft.model, MechanicsModel):
        _check_mechanics(draft, draft.model)


def _check_domain(draft: Draft, model: Domain) -> None:
    """Note the faults of a template, and put its channels at their places."""
    if not any(fault.path.startswith("model") for fault in draft.faults.found):
        check_template(model, draft.estimator.estimate or (), draft.faults)
    plant = draft.plant
    if plant is None:
        return
    places = [placed(path, channel, plant, draft.faults) for path, channel in draft.channels]
    draft.channels = [
        Entry(entry.path, entry.table.placed(at=place.at, drives=place.drives)) if place else entry
        for entry, place in zip(draft.channels, places, strict=True)
    ]


def _elements(model: MechanicsModel) -> Iterator[Entry[Element]]:
    kinds = (("spring", model.spring), ("damper", model.damper), ("friction", model.friction))
    for kind, elements in kinds:
        for i, element in enumerate(elements or ()):
            yield Entry(f"model.{kind}[{i}]", element)


def _check_mechanics(draft: Draft, model: MechanicsModel) -> None:
    if not model.mass and not any(fault.path == "model.mass" for fault in draft.faults.found):
        draft.faults.add(
            "model.mass", "is missing", 'name at least one, such as { name = "m1", value = 5.0 }'
        )
    masses = [Entry(f"model.mass[{i}]", mass) for i, mass in enumerate(model.mass)]
    elements = list(_elements(model))
    unique([*masses, *elements], draft.faults)
    for path, mass in masses:
        if mass.name == GROUND:
            draft.faults.add(
                f"{path}.name", f'"{GROUND}" is reserved', "it is the fixed node; use another name"
            )
    for entry in elements:
        _check_element(entry, [mass.name for mass in model.mass], draft.faults)
    for entry in elements:
        _check_nominal(entry, draft)
    if not any(fault.path.startswith("model.") for fault in draft.faults.found):
        _check_massless(masses, model, draft.faults)
        _check_measured(masses, elements, draft)


def _check_nominal(entry: Entry[Element], draft: Draft) -> None:
    """Note an element without a nominal: where one is needed, and where nothing would find it."""
    path, element = entry
    if not readable(element.nominal, element.name) or element.is_known:
        return
    if not draft.identified:
        advice = "give its healthy value, or let `deltak identify CONFIG RECORDING --write` find it"
        draft.faults.add(f"{path}.nominal", "is missing", advice)
    elif element.name not in draft.estimated:
        what = f"is missing, and estimator.estimate leaves {shown(element.name)} out"
        draft.faults.add(f"{path}.nominal", what, "name it there, or give its value")


def _check_element(entry: Entry[Element], masses: list[str], faults: Faults) -> None:
    path, element = entry
    if element.name == GROUND:
        faults.add(f"{path}.name", f'"{GROUND}" is reserved', "it is the fixed node; use another name")
    if not readable(element.between, *masses):
        return
    for i, node in enumerate(element.between):
        if node not in masses and node != GROUND:
            faults.add(
                f"{path}.between[{i}]", f"no mass is called {shown(node)}", f"masses are {listing(masses)}"
            )
    if element.between[0] == element.between[1]:
        faults.add(
            f"{path}.between", f"both ends are {shown(element.between[0])}", "name two different nodes"
        )


def reachable(starts: Iterable[str], edges: Iterable[tuple[str, str]]) -> set[str]:
    """Return the nodes that lead to one of `starts` over edges; ground passes nothing on."""
    found, edges = set(starts), list(edges)
    grew = True
    while grew:
        new = {
            b
            for edge in edges
            for a, b in (edge, edge[::-1])
            if a in found and a != GROUND and b not in found
        }
        found |= new
        grew = bool(new)
    return found


def _check_massless(masses: list[Entry[Mass]], model: MechanicsModel, faults: Faults) -> None:
    """A node without mass moves as dampers let it: a chain of them must lead to a mass or to ground."""
    edges = [damper.between for damper in model.damper if damper.nominal > 0 or not damper.is_known]
    on_ground = {node for edge in edges if GROUND in edge for node in edge if node != GROUND}
    held = reachable({mass.name for _, mass in masses if mass.value > 0} | on_ground, edges)
    for path, mass in masses:
        if mass.value == 0 and mass.name not in held:
            what = f'the massless node "{mass.name}" has no damper that holds it'
            faults.add(f"{path}.value", what, "add one with a nominal above 0, or give the node a mass")


def _check_measured(masses: list[Entry[Mass]], elements: list[Entry[Element]], draft: Draft) -> None:
    """A part of the structure that nothing measures tells nothing."""
    measured, names = {channel.at for _, channel in draft.outputs}, {mass.name for _, mass in masses}
    if not measured or not measured <= names:
        return
    seen = reachable(measured, [element.between for _, element in elements])
    for path, mass in masses:
        if mass.name not in seen:
            what = f'no channel measures "{mass.name}" or anything that it is connected to'
            draft.faults.add(
                path, what, "add a displacement, velocity or acceleration there, or remove the mass"
            )
