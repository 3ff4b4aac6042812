"""From a checked configuration to the mathematics: the parametric model, its windows, noise and gains."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from agent.blocks.tuning import AUTOMATIC_WINDOWS, STANDS, STRICTLY_STABLE
from agent.config import RigConfig
from agent.config.domains.plant import Domain, Term
from agent.config.model.linear import LinearModel
from agent.config.model.parameters import Parameter
from agent.config.model.tables import Channel, MechanicsModel
from agent.numerics.model.elements.descriptor import LETTERS, DescriptorModel, Size, Terms, with_forces
from agent.numerics.model.mechanics import Element, Mass, MassSpringDamper, Output, Structure
from agent.numerics.model.observer import matched_gain, poles_gain, start_gain
from agent.numerics.model.riccati import spectral_radius
from agent.numerics.model.sensors import Nuisance, SensedModel
from agent.numerics.model.statespace import AffineModel, Discrete, Model, StateSpace, modes, stacked
from agent.numerics.preprocessing.wire import Wire
from agent.numerics.window.filtering.hops import HopPlan
from agent.types import FloatArray, IntArray

SENSOR_KINDS = ("bias", "gain")


@dataclass(frozen=True, slots=True)
class RigModel:
    """What the estimator of one rig needs.

    Attributes:
        model: the parametric model; its inputs are the configuration's inputs, in order.
        parameters: the estimated parameters, in the order of theta.
        limits: (q,) alarm limit of each, 10 % of |nominal| where there is none.
        disturbance: (n, d) directions in which unknown forces push the state, at nominal.
    """

    model: Model
    parameters: tuple[Parameter, ...]
    limits: FloatArray
    disturbance: FloatArray


def rig_model(config: RigConfig) -> RigModel:
    """Build the model of a configuration."""
    known = config.parameters
    names = estimated(config)
    parameters = tuple(known[name] for name in names)
    physical = tuple(p.name for p in parameters if p.kind not in SENSOR_KINDS)
    model = _physical(config, physical)
    constants = tuple(_nuisance(config, p) for p in parameters if p.kind in SENSOR_KINDS)
    if constants:
        model = SensedModel(model, constants)
    limits = np.array([_limit(config, parameter) for parameter in parameters])
    return RigModel(model, parameters, limits, _disturbance(model))


def _physical(config: RigConfig, names: tuple[str, ...]) -> Model:
    """Return the model without the constants of its sensors."""
    if isinstance(config.model, Domain):
        return _descriptor(config, config.model, names)
    return _mechanics(config, names) if isinstance(config.model, MechanicsModel) else _linear(config, names)


def estimated(config: RigConfig) -> tuple[str, ...]:
    """Return estimated parameters in theta's order: physical ones as configured, then sensor constants."""
    wanted = [f"{c.name}.{kind}" for c in config.channel for kind in SENSOR_KINDS if getattr(c, kind)]
    names = dict.fromkeys([*config.estimator.estimate, *wanted])
    sensed = [name for name in names if config.parameters[name].kind in SENSOR_KINDS]
    return tuple(name for name in names if name not in sensed) + tuple(sensed)


def _nuisance(config: RigConfig, parameter: Parameter) -> Nuisance:
    channel, kind = parameter.name.rsplit(".", 1)
    for side, channels in (("input", config.inputs), ("output", config.outputs)):
        for number, candidate in enumerate(channels):
            if candidate.name == channel:
                return Nuisance(parameter.name, kind, side, number)  # type: ignore[arg-type]
    raise ValueError(f"no channel is called {channel}")


def _limit(config: RigConfig, parameter: Parameter) -> float:
    for alarm in config.limits:
        if alarm.parameter == parameter.name:
            percent = alarm.limit_percent
            return (
                alarm.limit if alarm.limit is not None else abs(parameter.nominal) * (percent or 10.0) / 100
            )
    return 0.1 * abs(parameter.nominal)


def _mechanics(config: RigConfig, names: tuple[str, ...]) -> MassSpringDamper:
    table = config.model
    if not isinstance(table, MechanicsModel):
        raise TypeError("not a mass-spring-damper model")

    def elements(rows: tuple[object, ...]) -> tuple[Element, ...]:
        return tuple(Element(e.name, e.between, e.nominal) for e in rows)  # type: ignore[attr-defined]

    structure = Structure(
        tuple(Mass(m.name, m.value) for m in table.mass),
        elements(table.spring),
        elements(table.damper),
        elements(table.friction),
    )
    outputs = tuple(Output(c.quantity, c.at) for c in config.outputs)  # type: ignore[arg-type]
    return MassSpringDamper(structure, names, tuple(c.at for c in config.inputs), outputs)


def _linear(config: RigConfig, names: tuple[str, ...]) -> AffineModel:
    table = config.model
    if not isinstance(table, LinearModel):
        raise TypeError("not a linear model")
    n, m, p = len(table.A), len(config.inputs), len(config.outputs)
    shapes = {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m)}
    rows = {parameter.name: parameter for parameter in table.parameters}
    chosen = [rows[name] for name in names]
    matrices = {name: _filled(getattr(table, name), shape) for name, shape in shapes.items()}
    changes = {
        f"d{name}": stacked(shape, [_filled(row.derivatives[name], shape) for row in chosen])
        for name, shape in shapes.items()
    }
    at_nominal = StateSpace(**matrices, **changes, is_sampled=table.time == "discrete")
    nominal = np.array([row.nominal for row in chosen], dtype=float)
    return AffineModel(names, nominal, at_nominal, table.state_names)


def _descriptor(config: RigConfig, table: Domain, names: tuple[str, ...]) -> DescriptorModel:
    """Build the model of a template of another domain between the rig's channels."""
    plant = table.plant(frozenset(channel.quantity for channel in config.channel))
    constants = tuple(part.name for part in plant.parts)
    chosen = [_term(term, constants) for term in plant.terms(_places(config.inputs), _places(config.outputs))]
    matrix, row, column, coefficient, powers = (np.array(cells) for cells in zip(*chosen, strict=True))
    return DescriptorModel(
        constants=constants,
        values=np.array([part.nominal for part in plant.parts], dtype=float),
        parameters=names,
        terms=Terms(matrix, row, column, coefficient, powers.astype(float)),
        size=Size(len(plant.states), len(config.inputs), len(config.outputs)),
        state_names=tuple(state.name for state in plant.states),
        pushes=tuple((plant.states[i].name, plant.states[i].push) for i in plant.pushed),
        places=plant.pushed,
    )


def _places(channels: tuple[Channel, ...]) -> list[tuple[str, str]]:
    return [(channel.quantity, channel.at) for channel in channels]


def _term(term: Term, constants: tuple[str, ...]) -> tuple[int, int, int, float, list[int]]:
    powers = [0] * len(constants)
    for name, power in term.powers:
        powers[constants.index(name)] += power
    return LETTERS.index(term.matrix), term.row, term.column, term.coefficient, powers


def _filled(matrix: tuple[tuple[float, ...], ...], shape: tuple[int, int]) -> FloatArray:
    """Return a matrix of the configuration; one that is left out is zero."""
    return np.array(matrix, dtype=float).reshape(shape) if matrix else np.zeros(shape)


def pushed(model: Model) -> tuple[tuple[str, str], ...]:
    """Return name and unit of what an unknown force in each direction acts on: masses in N, else states."""
    inner = model.model if isinstance(model, SensedModel) else model
    if isinstance(inner, DescriptorModel):
        return inner.pushes
    if not isinstance(inner, MassSpringDamper):
        return tuple((name, "") for name in inner.state_names)
    nodes = inner.structure.masses
    names = tuple(m.name for m in nodes if m.value > 0) or tuple(m.name for m in nodes)
    return tuple((name, "N") for name in names)


def _disturbance(model: Model) -> FloatArray:
    """A force on each mass (each node where none has mass), or anything on each state of a linear model."""
    if isinstance(model, SensedModel):
        model = model.model
    if isinstance(model, DescriptorModel):
        return with_forces(model).continuous(model.nominal).B[:, model.size.m :]
    if not isinstance(model, MassSpringDamper):
        return np.eye(len(model.state_names))
    nodes = model.structure.masses
    pushed = tuple(m.name for m in nodes if m.value > 0) or tuple(m.name for m in nodes)
    return replace(model, forces=pushed).continuous(model.nominal).B[:, : len(pushed)]


def output_noise(config: RigConfig, resolution: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return sigma (p,), NaN where the configuration does not say, and the floor (p,) that the wire sets, SI.

    resolution (p,) is the wire's smallest step of each output, SI; it is uniform noise of resolution /
    sqrt(12).
    """
    floor = resolution / np.sqrt(12.0)
    stated = np.array([np.nan if c.noise_sd is None else c.noise_sd * c.si_factor for c in config.outputs])
    return np.hypot(stated, floor), floor


def wire_of(channels: Sequence[Channel]) -> Wire:
    """Return what channels come in."""
    unit = [abs(c.scale) * c.si_factor for c in channels]
    return Wire(np.array(unit), np.array([c.offset * c.si_factor for c in channels]))


def known_noise(config: RigConfig, resolution: FloatArray) -> FloatArray:
    """Return the noise sd (p,) of each output: as stated, else as the wire's steps make it, else NaN."""
    sigma, floor = output_noise(config, resolution)
    return np.where(np.isfinite(sigma), sigma, np.where(floor > 0, floor, np.nan))


def windows_s(config: RigConfig) -> tuple[float, ...]:
    """Return the windows' lengths, s, shortest first; "auto" begins at a quarter of the slowest period."""
    if config.estimator.windows_s:
        return config.estimator.windows_s
    model = rig_model(config).model
    poles = modes(model.continuous(model.nominal), 1.0 / config.rig.sample_rate_hz)
    speeds = np.abs(poles)
    slowest = float(np.min(speeds[speeds > STANDS * speeds.max()], initial=speeds.max())) or 1.0
    readings = (len(poles) + len(model.parameters)) / max(len(config.outputs), 1)
    shortest = max(0.5 * np.pi / slowest, 10 * readings / config.rig.sample_rate_hz, config.estimator.hop_s)
    return tuple(shortest * 2.0**i for i in range(AUTOMATIC_WINDOWS))


def hop_plan(config: RigConfig) -> HopPlan:
    """Return the shortest window and the hop in samples."""
    rate = config.rig.sample_rate_hz
    return HopPlan(max(1, round(windows_s(config)[0] * rate)), max(1, round(config.estimator.hop_s * rate)))


def longer_windows(config: RigConfig, plan: HopPlan) -> tuple[int, ...]:
    """Return further windows in samples, each whole hops longer than the plan's so that all end together."""
    wanted = [round(length * config.rig.sample_rate_hz) for length in windows_s(config)[1:]]
    hops = [max(1, round((samples - plan.window) / plan.hop)) for samples in wanted]
    return tuple(dict.fromkeys(plan.window + count * plan.hop for count in hops))


def longest_bridge(model: Model, rate_hz: float) -> int:
    """Return the longest gap to bridge, samples: 5, or a twentieth of the fastest period, at most 20."""
    speeds = np.abs(modes(model.continuous(model.nominal), 1.0 / rate_hz))
    fastest = float(speeds.max(initial=0.0))
    return 5 if fastest == 0 else int(np.clip(2 * np.pi / fastest * rate_hz / 20, 5, 20))


def scale_columns(config: RigConfig, rig: RigModel) -> IntArray:
    """The channel that gives an offset its size; 0 for parameters that have a size of their own."""
    channels = [c.name for c in (*config.outputs, *config.inputs)]
    owners = [p.name.rsplit(".", 1)[0] if p.kind in SENSOR_KINDS else channels[0] for p in rig.parameters]
    return np.array([channels.index(owner) for owner in owners], dtype=np.int64)


def _leant(config: RigConfig) -> tuple[int, ...] | None:
    """Return the outputs the paper's observer leans on: it would hide a gain it corrects itself by."""
    if config.estimator.method != "seed":
        return None
    wanted = set(estimated(config))
    return tuple(i for i, c in enumerate(config.outputs) if f"{c.name}.gain" not in wanted)


def observer_gain(config: RigConfig, rig: RigModel, discrete: Discrete, resolution: FloatArray) -> FloatArray:
    """Return the observer's gain (n, p) as configured; else one that forgets a wrong model within a window.

    Raises ValueError where no gain gives a stable observer.
    """
    observer = config.estimator.observer
    noise = known_noise(config, resolution)
    sigma = np.where(np.isfinite(noise), noise, 1.0)
    if observer.gain == "poles":
        return poles_gain(discrete.model, observer.poles, discrete.period_s, _leant(config))
    if _is_pushed(config):
        process = np.broadcast_to(np.asarray(observer.process_sd, dtype=float), (rig.disturbance.shape[1],))
        return matched_gain(discrete, rig.disturbance, sigma, process)
    return start_gain(discrete, rig.disturbance, sigma, hop_plan(config).window)


def settled_gain(config: RigConfig, discrete: Discrete, gain: FloatArray) -> FloatArray:
    """Return the gain about a fitted model, where `gain` is the one to start with.

    With sensor noise alone any correction loses information; but a model that is not strictly stable needs
    one.
    """
    is_free = config.estimator.observer.gain != "poles" and not _is_pushed(config)
    return np.zeros_like(gain) if is_free and spectral_radius(discrete.model.A) < STRICTLY_STABLE else gain


def _is_pushed(config: RigConfig) -> bool:
    """Whether unknown forces are configured that the observer is to follow."""
    observer = config.estimator.observer
    return observer.gain == "kalman" and observer.process_sd is not None and bool(np.any(observer.process_sd))
