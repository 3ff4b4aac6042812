"""What a model and its channels offer for estimation, and the unit of each."""

from typing import Literal, NamedTuple

from agent.config.domains.plant import Domain
from agent.config.model.linear import ENTRY, LinearModel, LinearParameter
from agent.config.model.tables import Channel, MechanicsModel, Model
from agent.config.reading.units import base_length, element_units


class Parameter(NamedTuple):
    """Something that can be estimated."""

    name: str
    kind: Literal["mass", "spring", "damper", "friction", "linear", "element", "storage", "bias", "gain"]
    nominal: float
    unit: str


def parameters_of(model: Model, channels: tuple[Channel, ...]) -> dict[str, Parameter]:
    """Return everything that a model and its channels offer for estimation, by name."""
    if isinstance(model, Domain):
        found = [Parameter(p.name, p.kind, p.nominal, p.unit) for p in model.parts]
    else:
        found = _linear(model, channels) if isinstance(model, LinearModel) else _mechanical(model, channels)
    for channel in channels:
        found.append(Parameter(f"{channel.name}.bias", "bias", 0.0, channel.si_unit))
        found.append(Parameter(f"{channel.name}.gain", "gain", 1.0, "1"))
    return {parameter.name: parameter for parameter in found}


def _linear(model: LinearModel, channels: tuple[Channel, ...]) -> list[Parameter]:
    named = [p for p in model.parameters if p.name]  # in a draft a name may be one that could not be read
    return [Parameter(p.name, "linear", p.nominal, p.unit or _unit(p, model, channels)) for p in named]


def _unit(parameter: LinearParameter, model: LinearModel, channels: tuple[Channel, ...]) -> str:
    """Return the unit of an uncertain entry from those of its row and column; "" where these have none."""
    entry = ENTRY.fullmatch(parameter.name)
    if entry is None:
        return ""
    states = [state.unit for state in model.state or ()]
    inputs = [channel.unit for channel in channels if channel.is_input]
    outputs = [channel.unit for channel in channels if not channel.is_input]
    rows, columns = {
        "A": (states, states),
        "B": (states, inputs),
        "C": (outputs, states),
        "D": (outputs, inputs),
    }[entry["matrix"]]
    row, column = int(entry["row"]), int(entry["column"])
    units = rows[row : row + 1] + columns[column : column + 1]
    if len(units) < 2 or not all(units):
        return ""
    by_time = " s" if entry["matrix"] in "AB" and model.time == "continuous" else ""
    return _quotient(units[0], units[1], by_time)


def _quotient(unit: str, by: str, by_time: str) -> str:
    """Return unit/(by s), or unit/by without a time."""
    if unit == by:
        return f"1/{by_time.strip()}" if by_time else "1"
    joined = any(mark in unit for mark in " /")
    top = f"({unit})" if joined else unit
    return f"{top}/({by}{by_time})" if by_time or any(mark in by for mark in " /") else f"{top}/{by}"


def _mechanical(model: MechanicsModel, channels: tuple[Channel, ...]) -> list[Parameter]:
    units = _units(channels)
    found = [Parameter(m.name, "mass", m.value, units["mass"]) for m in model.mass]
    found += [Parameter(e.name, "spring", e.nominal, units["spring"]) for e in model.spring]
    found += [Parameter(e.name, "damper", e.nominal, units["damper"]) for e in model.damper]
    return found + [Parameter(e.name, "friction", e.nominal, units["friction"]) for e in model.friction]


def _units(channels: tuple[Channel, ...]) -> dict[str, str]:
    first = {channel.quantity: channel.si_unit for channel in reversed(channels)}
    length = base_length(first.get("displacement"), first.get("velocity"), first.get("acceleration"))
    return element_units(first.get("force", "N"), length)
