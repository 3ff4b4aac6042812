"""What must hold in a linear model: shapes of its matrices, what parameters change, its rate, its poles."""

from collections.abc import Iterable

from agent.config.draft import Draft
from agent.config.model.linear import ENTRY, MATRICES, LinearModel, LinearParameter
from agent.config.reading.fields import shown
from agent.config.reading.messages import listing
from agent.config.reading.parse import Entry, Faults, readable, unique
from agent.config.tuning import SAME_RATE, UNSTABLE
from agent.text import counted

Matrix = tuple[tuple[float, ...], ...]


def check_linear(draft: Draft, model: LinearModel) -> None:
    """Note the faults of a linear model."""
    _check_time(draft, model)
    _check_skews(draft, model)
    if not readable(model.A) or _complained("model.A", draft.faults):
        return
    n, m, p = len(model.A), len(draft.inputs), len(draft.outputs)
    if not n:
        draft.faults.add("model.A", "has no rows", "give one row and one column a state")
    shapes = {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m)}
    for name, shape in shapes.items():
        _check_shape(f"model.{name}", getattr(model, name), shape, draft.faults)
    _check_states(model, n, draft.faults)
    _check_parameters(model, shapes, draft.faults)
    _check_uncertain(model, draft.faults)
    if not any(fault.path.startswith("model") for fault in draft.faults.found):
        _check_poles(model, draft.faults)


def _check_skews(draft: Draft, model: LinearModel) -> None:
    """Note skews to be measured between sources: they show in how fast outputs change between samples."""
    if model.time != "discrete":
        return
    measured = [path for path, source in draft.sources if source.skew_s == "auto"]
    for path in measured[1:]:
        what = 'is "auto": a model in discrete time says nothing of what lies between its samples'
        draft.faults.add(
            f"{path}.skew_s", what, "state in seconds how much later this source is read, such as 0.0"
        )


def _complained(path: str, faults: Faults) -> bool:
    return any(fault.path.startswith(path) for fault in faults.found)


def _check_time(draft: Draft, model: LinearModel) -> None:
    """Note a rate that is not the rig's: matrices of one rate are not those of another."""
    path, rate = "model.rate_hz", model.rate_hz
    if not readable(model.time) or _complained(path, draft.faults):
        return
    if rate is None:
        if model.time == "discrete":
            advice = "give the rate at which it was sampled, 1 / Ts"
            draft.faults.add(path, 'is missing: time = "discrete" needs it', advice)
    elif model.time == "continuous":
        draft.faults.add(
            path, 'goes with time = "discrete"', "remove it, or say that the model is in discrete time"
        )
    elif draft.rate_hz is not None and abs(rate / draft.rate_hz - 1) > SAME_RATE:
        what = f"{rate:g} Hz is not the rate of the rig, {draft.rate_hz:g} Hz"
        draft.faults.add(path, what, "sample the model at the rig's rate, or give it in continuous time")


def _check_states(model: LinearModel, n: int, faults: Faults) -> None:
    if not model.state:
        return
    unique([(f"model.state[{i}]", state) for i, state in enumerate(model.state)], faults)
    if len(model.state) != n:
        faults.add(
            "model.state",
            f"has {counted(len(model.state), 'name')} for {counted(n, 'state')}",
            "name each row of A, in order",
        )


def _check_parameters(model: LinearModel, shapes: dict[str, tuple[int, int]], faults: Faults) -> None:
    entries = [Entry(f"model.parameter[{i}]", parameter) for i, parameter in enumerate(model.parameter or ())]
    if not entries and not model.uncertain and readable(model.parameter, model.uncertain):
        advice = (
            'name at least one, with its dA, dB, dC or dD: { name = "R", ... }, or uncertain = ["A[0,1]"]'
        )
        faults.add("model.parameter", "is missing", advice)
    unique(entries, faults)
    for path, parameter in entries:
        _check_parameter(path, parameter, shapes, faults)


def _check_parameter(
    path: str, parameter: LinearParameter, shapes: dict[str, tuple[int, int]], faults: Faults
) -> None:
    if readable(parameter.name) and ENTRY.fullmatch(parameter.name):
        what = f"{shown(parameter.name)} is the name of a matrix's entry"
        faults.add(
            f"{path}.name", what, f"list it as uncertain = [{shown(parameter.name)}], or take another name"
        )
    changes = parameter.derivatives
    for matrix, derivative in changes.items():
        if derivative:
            _check_shape(f"{path}.d{matrix}", derivative, shapes[matrix], faults)
    if _complained(path, faults) or not readable(*changes.values()):
        return
    if not any(_any(derivative) for derivative in changes.values()):
        advice = "give the derivatives of A, B, C and D by it"
        faults.add(path, "appears nowhere in dA, dB, dC or dD: it changes nothing", advice)


def _any(matrix: Iterable[Iterable[float]]) -> bool:
    return any(value for row in matrix for value in row)


def _check_uncertain(model: LinearModel, faults: Faults) -> None:
    for i, text in enumerate(model.uncertain or ()):
        path = f"model.uncertain[{i}]"
        if text in model.uncertain[:i]:
            faults.add(path, f"{shown(text)} is named twice", "name each entry once")
        elif not any(model.entries(text)):
            _check_entry(path, text, model, faults)


def _check_entry(path: str, text: str, model: LinearModel, faults: Faults) -> None:
    match = ENTRY.fullmatch(text)
    if match is None and text not in MATRICES:
        advice = f'write "A[0,1]", counted from zero, or a whole matrix: {listing(MATRICES)}'
        faults.add(path, f"{shown(text)} names no entry", advice)
        return
    name = match["matrix"] if match else text
    rows: Matrix = getattr(model, name) or ()
    if _complained(f"model.{name}", faults):
        return
    if not rows:
        faults.add(
            path,
            f"{shown(text)}: {name} is not given",
            f"give {name} at nominal, zeros where there is nothing",
        )
        return
    what = f"{shown(text)}: {name} has {counted(len(rows), 'row')} of {counted(len(rows[0]), 'column')}"
    faults.add(path, what, "rows and columns are counted from zero")


def _check_shape(path: str, matrix: Matrix | None, shape: tuple[int, int], faults: Faults) -> None:
    """Note a matrix that has not the rows and columns that states, inputs and outputs give it."""
    optional = path in ("model.B", "model.D") or 0 in shape
    if matrix is None or (not matrix and optional) or _complained(path, faults):
        return
    if (len(matrix), {len(row) for row in matrix}) != (shape[0], {shape[1]}):
        wanted = f"{shape[0]} rows of {shape[1]} columns fit"
        faults.add(path, f"has {_rows_and_columns(matrix)}", f"{wanted}: {_count(path[-1], shape)}")


def _rows_and_columns(matrix: Matrix) -> str:
    lengths = {len(row) for row in matrix} or {0}
    columns = f"{lengths.pop()}" if len(lengths) == 1 else "uneven"
    return f"{counted(len(matrix), 'row')} of {columns} columns"


def _count(letter: str, shape: tuple[int, int]) -> str:
    rows, columns = shape
    return {
        "B": f"states {rows}, input channels {columns}",
        "C": f"states {columns}, output channels {rows}",
        "D": f"output channels {rows}, input channels {columns}",
    }.get(letter, f"states {rows}")


def _check_poles(model: LinearModel, faults: Faults) -> None:
    """Note poles outside the unit circle: most often A is that of a model in continuous time."""
    if model.time != "discrete":
        return
    import numpy as np

    radius = float(np.abs(np.linalg.eigvals(np.array(model.A))).max(initial=0.0))
    if radius > UNSTABLE:
        what = f"has a pole outside the unit circle, of radius {radius:.6g}: every motion would grow"
        advice = "look at its values; if A is that of x' = A x + B u, leave time and rate_hz out"
        faults.add("model.A", what, advice)
