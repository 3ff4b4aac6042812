"""What must hold in the model: names, nodes, massless nodes, parts that something measures, shapes of matrices."""

from collections.abc import Iterable, Iterator

from agent.config.draft import Draft
from agent.config.fields import shown
from agent.config.messages import listing
from agent.config.parse import Entry, Faults, readable
from agent.config.tables import GROUND, Element, LinearModel, LinearParameter, Mass, MechanicsModel


def check_model(draft: Draft) -> None:
    """Note the faults of the model."""
    if isinstance(draft.model, LinearModel):
        _check_linear(draft, draft.model)
    elif draft.model is not None:
        _check_mechanics(draft, draft.model)


def unique(entries: Iterable[Entry[Mass] | Entry[Element] | Entry[LinearParameter]], faults: Faults) -> None:
    """Note each name that an earlier table has already."""
    owner: dict[str, str] = {}
    for path, table in entries:
        if table.name in owner:
            faults.add(f"{path}.name", f"{shown(table.name)} is the name of {owner[table.name]}", "names must differ")
        elif readable(table.name):
            owner[table.name] = path


def _elements(model: MechanicsModel) -> Iterator[Entry[Element]]:
    kinds = (("spring", model.spring), ("damper", model.damper), ("friction", model.friction))
    for kind, elements in kinds:
        for i, element in enumerate(elements or ()):
            yield Entry(f"model.{kind}[{i}]", element)


def _check_mechanics(draft: Draft, model: MechanicsModel) -> None:
    if not model.mass and not any(fault.path == "model.mass" for fault in draft.faults.found):
        draft.faults.add("model.mass", "is missing", 'name at least one, such as { name = "m1", value = 5.0 }')
    masses = [Entry(f"model.mass[{i}]", mass) for i, mass in enumerate(model.mass)]
    elements = list(_elements(model))
    unique([*masses, *elements], draft.faults)
    for path, mass in masses:
        if mass.name == GROUND:
            draft.faults.add(f"{path}.name", f'"{GROUND}" is reserved', "it is the fixed node; use another name")
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
            faults.add(f"{path}.between[{i}]", f"no mass is called {shown(node)}", f"masses are {listing(masses)}")
    if element.between[0] == element.between[1]:
        faults.add(f"{path}.between", f"both ends are {shown(element.between[0])}", "name two different nodes")


def reachable(starts: Iterable[str], edges: Iterable[tuple[str, str]]) -> set[str]:
    """Return the nodes that lead to one of `starts` over edges; ground passes nothing on."""
    found, edges = set(starts), list(edges)
    grew = True
    while grew:
        new = {b for edge in edges for a, b in (edge, edge[::-1]) if a in found and a != GROUND and b not in found}
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
            draft.faults.add(path, what, "add a displacement, velocity or acceleration there, or remove the mass")


def _check_linear(draft: Draft, model: LinearModel) -> None:
    if not readable(model.A):
        return
    n, m, p = len(model.A), len(draft.inputs), len(draft.outputs)
    if not n:
        draft.faults.add("model.A", "has no rows", "give one row and one column a state")
    _check_shape("model.A", model.A, (n, n), draft.faults)
    _check_shape("model.B", model.B, (n, m), draft.faults)
    _check_shape("model.C", model.C, (p, n), draft.faults)
    entries = [Entry(f"model.parameter[{i}]", parameter) for i, parameter in enumerate(model.parameter or ())]
    if not entries and readable(model.parameter):
        draft.faults.add("model.parameter", "is missing", 'name at least one, with its dA or dB: { name = "R", ... }')
    unique(entries, draft.faults)
    for path, parameter in entries:
        _check_parameter(path, parameter, (n, m), draft.faults)


def _check_parameter(path: str, parameter: LinearParameter, shape: tuple[int, int], faults: Faults) -> None:
    n, m = shape
    if parameter.dA:
        _check_shape(f"{path}.dA", parameter.dA, (n, n), faults)
    if parameter.dB:
        _check_shape(f"{path}.dB", parameter.dB, (n, m), faults)
    if readable(parameter.dA, parameter.dB) and not _any(parameter.dA) and not _any(parameter.dB):
        faults.add(path, "has neither dA nor dB: it changes nothing", "give the derivatives of A and B by it")


def _any(matrix: Iterable[Iterable[float]]) -> bool:
    return any(value for row in matrix for value in row)


def _check_shape(
    path: str, matrix: tuple[tuple[float, ...], ...] | None, shape: tuple[int, int], faults: Faults
) -> None:
    """Note a matrix that has not the rows and columns that states, inputs and outputs give it."""
    if matrix is None or (not matrix and 0 in shape):
        return
    lengths = sorted({len(row) for row in matrix})
    columns = f"{lengths[0]}" if len(lengths) == 1 else "uneven"
    if (len(matrix), lengths) != (shape[0], [shape[1]]):
        found = f"has {len(matrix)} rows of {columns if matrix else 0} columns"
        wanted = f"{shape[0]} rows of {shape[1]} columns fit"
        faults.add(path, found, f"{wanted}: states {_count(path, shape)}")


def _count(path: str, shape: tuple[int, int]) -> str:
    rows, columns = shape
    letter = path[-1]
    other = {"B": f"{rows}, input channels {columns}", "C": f"{columns}, output channels {rows}"}
    return other.get(letter, str(rows))
