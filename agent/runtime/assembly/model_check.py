"""Whether a rig's channels show its states and tell its parameters apart; what `run` and `replay` require."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from agent.blocks.friction import mechanics_of, signals
from agent.blocks.rig_model import SENSOR_KINDS, RigModel
from agent.config import RigConfig
from agent.config.model.parameters import Parameter
from agent.errors import Fault, ModelError
from agent.numerics.model.elements.descriptor import DescriptorModel, is_read, with_reading
from agent.numerics.model.identifiability import Identifiability, identifiability
from agent.numerics.model.mechanics import MassSpringDamper, Output
from agent.numerics.model.observer import unobservable_states
from agent.numerics.model.sensors import SensedModel
from agent.numerics.model.statespace import AffineModel, Model
from agent.runtime.assembly.number_checks import number_faults, observer_faults
from agent.text import behind
from agent.types import FloatArray

ESTIMATE = "estimator.estimate"


def require_observable(config: RigConfig, rig: RigModel) -> None:
    """Raise ModelError with every fault unless states are observable and parameters can be told apart."""
    faults = model_faults(config, rig)
    if faults:
        raise ModelError(faults)


def model_faults(config: RigConfig, rig: RigModel) -> list[Fault]:
    """Return what the structure of the model makes impossible, each with what would help."""
    if faults := number_faults(config, rig):
        return faults
    hidden = hidden_states(rig.model)
    faults = [_hidden_fault(hidden, rig)] if hidden else []
    return faults + list(_parameter_faults(config, rig)) or observer_faults(config, rig)


def hidden_states(model: Model) -> list[str]:
    """Return the names of the states that no channel shows."""
    return unobservable_states(model.continuous(model.nominal), model.state_names)


def _hidden_fault(hidden: list[str], rig: RigModel) -> Fault:
    places = [name.removeprefix("displacement of ") for name in hidden if name.startswith("displacement of ")]
    advice = (
        f"measure the displacement of {_listed(places)}"
        if places
        else "measure where these move, or leave them out"
    )
    advice = _measuring(rig, lambda model: not hidden_states(model)) or advice
    return Fault("model", f"no channel shows the {_listed(hidden)}", advice)


def _parameter_faults(config: RigConfig, rig: RigModel) -> Iterator[Fault]:
    measured = signals(config)
    scale = _scale(rig)
    found = identifiability(rig.model, measured, scale)
    for number in found.silent:
        name = rig.parameters[number].name
        what = f'"{name}" leaves no trace: however it changes, the channels read the same'
        yield Fault(ESTIMATE, what, _silent_advice(rig, measured, number))
    for blend in found.blends:
        what = (
            f"{blend_named(rig, blend)} cannot be told apart: {blend_in_words(rig, blend)} changes no reading"
        )
        yield Fault(ESTIMATE, what, _blend_advice(config, rig, blend, found))


def _scale(rig: RigModel) -> FloatArray:
    nominal = np.abs(rig.model.nominal)
    return np.where(nominal > 0, nominal, np.maximum(rig.limits, 0.0))


def blend_named(rig: RigModel, blend: FloatArray) -> str:
    """Name the parameters that a change (q,) moves."""
    return _listed([f'"{p.name}"' for p, change in zip(rig.parameters, blend, strict=True) if change])


def blend_in_words(rig: RigModel, blend: FloatArray) -> str:
    """Write a change that leaves no trace: "k1 by +1 % with k3 by -0.62 %", offsets in their own units."""
    sized = [abs(p.nominal) for p, change in zip(rig.parameters, blend, strict=True) if change]
    if not any(sized):
        blend = blend / blend[np.flatnonzero(blend)[0]]
    pairs = zip(rig.parameters, blend.tolist(), strict=True)
    return " with ".join(
        _change(parameter, change, share=any(sized)) for parameter, change in pairs if change
    )


def _change(parameter: Parameter, change: float, *, share: bool) -> str:
    if parameter.nominal:
        return f"{parameter.name} by {change / abs(parameter.nominal):+.2g} %"
    return f"{parameter.name} by {change / 100 if share else change:+.2g}{behind(parameter.unit)}"


def _silent_advice(rig: RigModel, measured: int, number: int) -> str:
    way = _measuring(rig, lambda model: number not in identifiability(model, measured, _scale(rig)).silent)
    leave = f'leave "{rig.parameters[number].name}" out of estimator.estimate'
    return f"{way}, or {leave}" if way else leave


def _blend_advice(config: RigConfig, rig: RigModel, blend: FloatArray, found: Identifiability) -> str:
    """Say what would separate a blend: another measurement, a known load or length, or fixing a parameter."""
    chosen = [p for p, change in zip(rig.parameters, blend, strict=True) if change]
    ways = []

    def fewer(model: Model, measured: int) -> bool:
        return len(identifiability(model, measured, _scale(rig)).blends) < len(found.blends)

    if not config.inputs and (forced := _with_force(rig)) is not None and fewer(forced, 1):
        ways.append("measure a force that moves it")
    if way := _measuring(rig, lambda model: fewer(model, signals(config))):
        ways.append(way)
    if any(p.kind == "bias" for p in chosen):
        ways.append("measure the rest position or the unloaded force")
    if any(p.kind == "gain" for p in chosen):
        ways.append("check one of these sensors against a load or a length that is known")
    if _side_by_side(rig, {p.name for p in chosen}):
        ways.append("measure the force that one of them carries and enter what that makes of it")
    return ", ".join([*ways, ""]) + f"{'or ' if ways else ''}leave {_out(chosen)} out of the estimate"


def _side_by_side(rig: RigModel, names: set[str]) -> bool:
    """Tell whether springs, or dampers, of these names join the same two nodes: they always move alike."""
    mechanics = mechanics_of(rig.model)
    if mechanics is None:
        return False
    structure = mechanics.structure
    for elements in (structure.springs, structure.dampers, structure.frictions):
        joined = [frozenset(e.between) for e in elements if e.name in names]
        if len(set(joined)) < len(joined):
            return True
    return False


def _out(chosen: list[Parameter]) -> str:
    """One parameter to give up: a sensor constant before a physical one."""
    constants = [p.name for p in chosen if p.kind in SENSOR_KINDS]
    return f'"{constants[-1]}"' if constants else "one of them"


def _measuring(rig: RigModel, helped: Callable[[Model], bool]) -> str:
    """Return in words which of the outputs that there are not would help; "" where none does."""
    what = "the displacement of " if mechanics_of(rig.model) is not None else ""
    found = [place for place, model in further_outputs(rig) if helped(model)]
    return f"measure {what}{_either(found)}" if found else ""


def further_outputs(rig: RigModel) -> list[tuple[str, Model]]:
    """Return masses whose displacement, or states that, could also be measured, each with that model."""
    inner = rig.model.model if isinstance(rig.model, SensedModel) else rig.model
    if isinstance(inner, AffineModel):
        states = enumerate(inner.state_names)
        return [(name, _put(rig.model, _reading(inner, i))) for i, name in states if not _is_read(inner, i)]
    if isinstance(inner, DescriptorModel):
        states = enumerate(inner.state_names)
        return [
            (name, _put(rig.model, with_reading(inner, i))) for i, name in states if not is_read(inner, i)
        ]
    if not isinstance(inner, MassSpringDamper):
        return []
    known = {output.at for output in inner.outputs if output.quantity == "displacement"}
    nodes = [m.name for m in inner.structure.masses if m.name not in known]
    return [
        (n, _put(rig.model, replace(inner, outputs=(*inner.outputs, Output("displacement", n)))))
        for n in nodes
    ]


def _is_read(model: AffineModel, state: int) -> bool:
    """Whether some output is this state and nothing else, whatever the parameters."""
    at = model.at_nominal
    alone = (np.count_nonzero(at.C, axis=1) == 1) & (at.C[:, state] != 0) & ~at.D.any(axis=1)
    return bool(np.any(alone & ~at.dC.any(axis=(0, 2)) & ~at.dD.any(axis=(0, 2))))


def _reading(model: AffineModel, state: int) -> AffineModel:
    """Return the model with one more output that is a state."""
    at = model.at_nominal
    row = np.eye(at.n)[state : state + 1]
    more = replace(
        at, C=np.vstack([at.C, row]), D=np.vstack([at.D, np.zeros((1, at.m))]),
        dC=np.concatenate([at.dC, np.zeros((at.q, 1, at.n))], axis=1),
        dD=np.concatenate([at.dD, np.zeros((at.q, 1, at.m))], axis=1),
    )  # fmt: skip
    return replace(model, at_nominal=more)


def _put(model: Model, inner: Model) -> Model:
    return replace(model, model=inner) if isinstance(model, SensedModel) else inner


def _with_force(rig: RigModel) -> Model | None:
    """Return the model with a measured force on its last mass."""
    mechanics = mechanics_of(rig.model)
    if mechanics is None:
        return None
    return _put(rig.model, replace(mechanics, forces=(mechanics.structure.masses[-1].name,)))


def _listed(words: list[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def _either(words: list[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"
