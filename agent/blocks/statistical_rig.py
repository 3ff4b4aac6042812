"""From a checked configuration to the statistical model: parameters, unknown forces, constants."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from agent.blocks.rig_model import (
    RigModel,
    estimated,
    hop_plan,
    longer_windows,
    output_noise,
    rig_model,
    wire_of,
)
from agent.blocks.tuning import SHARE_OF_MATRIX
from agent.config import RigConfig
from agent.config.domains.plant import Domain
from agent.config.model.tables import MechanicsModel
from agent.numerics.estimator.settings import EstimatorSettings
from agent.numerics.inference.tuning import CURVE_SHEET, CURVED_A_PERIOD, DELAY_SHEET, OFF_CUBIC
from agent.numerics.model.cubic import Cubic, WithCubics
from agent.numerics.model.elements.descriptor import DescriptorModel, with_forces
from agent.numerics.model.identifiability import identifiability
from agent.numerics.model.mechanics import GROUND, MassSpringDamper, Quantity
from agent.numerics.model.sensors import Nuisance, SensedModel, Side
from agent.numerics.model.statespace import AffineModel, Model, StateSpace, modes
from agent.numerics.model.uncertain import CURVED, LAG, Constant, Rig, Rubbing
from agent.numerics.window.filtering.hops import HopPlan
from agent.types import FloatArray, IntArray

PHYSICAL = ("mass", "spring", "damper", "friction", "element", "storage")
NEEDED = ("mass", "element", "storage")
"""Kinds of parameters that stay above 0: equations are divided by them."""
SHOWN = 1e-9
"""Fixed by rounding: share of an extension that outputs may miss."""


@dataclass(frozen=True)
class Reordered:
    """A model whose parameters stand in another order.

    Attributes:
        model: the model.
        order: (q,) which of its parameters stands at each place.
    """

    model: Model
    order: IntArray

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names in the new order."""
        return tuple(self.model.parameters[i] for i in self.order)

    @property
    def nominal(self) -> FloatArray:
        """(q,) nominal values in the new order."""
        return self.model.nominal[self.order]

    @property
    def state_names(self) -> tuple[str, ...]:
        """The model's states."""
        return self.model.state_names

    def continuous(self, theta: FloatArray) -> StateSpace:
        """Return the model at theta (q,) in the new order."""
        inner = np.empty(len(theta))
        inner[self.order] = theta
        found = self.model.continuous(inner)
        o = self.order
        return replace(found, dA=found.dA[o], dB=found.dB[o], dC=found.dC[o], dD=found.dD[o])


@dataclass(frozen=True)
class _Pushed:
    """A model with unknown forces as further inputs, and masses that are constants as further parameters."""

    model: Model
    forces: int
    masses: tuple[str, ...]
    pushes: tuple[str, ...] = ()


def statistical_rig(config: RigConfig) -> Rig:
    """Build the statistical model of a configuration."""
    built = rig_model(config)
    q, measured = len(built.parameters), len(config.inputs)
    pushed = _pushed(config, built.model)
    model = pushed.model
    m = measured + pushed.forces
    total = model.continuous(model.nominal).m
    others = np.arange(m, total)
    columns = np.concatenate([np.arange(measured), others]).astype(np.int64)
    driven = np.arange(len(columns)) < measured
    nominal = model.nominal[:q]
    limits = np.where(built.limits > 0, built.limits, np.nan)
    scale = np.where(
        nominal != 0, np.abs(nominal), np.where(np.isfinite(limits), limits, _sizes(built.model)[:q])
    )
    physical = np.array([p.kind in PHYSICAL for p in built.parameters], dtype=bool)
    needed = np.array([p.kind in NEEDED or p.name in _holding(config) for p in built.parameters], dtype=bool)
    lower = np.where(physical & (nominal > 0), np.where(needed, 0.02 * scale, 0.0), -np.inf)
    return Rig(
        model, q, columns, driven, np.arange(measured, m), _constants(config, built, pushed.masses),
        1.0 / config.rig.sample_rate_hz, config.estimator.hold, scale, lower,
        slow_forces=not _has_friction(config), white=_is_white(config), rubbings=_rubbings(config, pushed),
    )  # fmt: skip


def _pushed(config: RigConfig, model: Model) -> _Pushed:
    """Put unknown forces beside the measured inputs, and masses that are constants behind the parameters."""
    if not isinstance(model, SensedModel):
        return _pushed_alone(config, model)
    inner = model.model
    pushed = _pushed_alone(config, inner)
    physical, constants, masses = len(inner.parameters), len(model.nuisances), len(pushed.masses)
    first = np.arange(physical)
    order = np.concatenate([first, physical + masses + np.arange(constants), physical + np.arange(masses)])
    sensed = SensedModel(pushed.model, model.nuisances)
    return replace(pushed, model=Reordered(sensed, order.astype(np.int64)))


def _pushed_alone(config: RigConfig, model: Model) -> _Pushed:
    """Put unknown forces and masses into a model without constants of sensors."""
    if isinstance(model, AffineModel):
        return _Pushed(_with_state_forces(model), len(model.state_names), ())
    if isinstance(model, DescriptorModel):
        return _pushed_elements(config, model)
    if not isinstance(model, MassSpringDamper):
        raise TypeError(f"no statistical model of a {type(model).__name__}")
    weighing = tuple(m.name for m in model.structure.masses if m.value > 0)
    forced = weighing or tuple(m.name for m in model.structure.masses)
    if _is_white(config):
        forced, weighing = (), ()
    masses = _uncertain_masses(config, model)
    whole = replace(model, parameters=(*model.parameters, *masses), forces=(*model.forces, *forced))
    return _Pushed(whole, len(forced), masses, weighing)


def _pushed_elements(config: RigConfig, model: DescriptorModel) -> _Pushed:
    """Put unknown efforts, and what keeps energy, known as well as its data sheet says, into a template."""
    known = sheets_of(config)
    stores = tuple(n for n in model.constants if known.get(n, 0.0) > 0 and n not in model.parameters)
    pushed = model if _is_white(config) else with_forces(model)
    return _Pushed(replace(pushed, parameters=(*model.parameters, *stores)), len(pushed.forces), stores)


def _uncertain_masses(config: RigConfig, model: MassSpringDamper) -> tuple[str, ...]:
    """Masses that are known as well as their data sheet says, and not estimated."""
    if not isinstance(config.model, MechanicsModel):
        return ()
    known = {m.name for m in config.model.mass if m.value > 0 and m.sd_percent > 0}
    return tuple(m.name for m in model.structure.masses if m.name in known and m.name not in model.parameters)


def _with_state_forces(model: AffineModel) -> AffineModel:
    """Let anything act on each state."""
    at = model.at_nominal
    n = len(model.state_names)
    no_slope, no_reading = np.zeros((at.q, n, n)), np.zeros((at.q, at.p, n))
    pushed = replace(
        at, B=np.hstack([at.B, np.eye(n)]), D=np.hstack([at.D, np.zeros((at.p, n))]),
        dB=np.concatenate([at.dB, no_slope], axis=2), dD=np.concatenate([at.dD, no_reading], axis=2),
    )  # fmt: skip
    return replace(model, at_nominal=pushed)


def _sizes(model: Model) -> FloatArray:
    """Return sizes (q,) to take for parameters of 0 without a limit: 1, or a share of their matrices."""
    if isinstance(model, SensedModel):
        return np.concatenate([_sizes(model.model), np.ones(len(model.nuisances))])
    if not isinstance(model, AffineModel):
        return np.ones(len(model.parameters))
    at = model.at_nominal
    sizes = np.full(at.q, np.inf)
    for whole, slope in ((at.A, at.dA), (at.B, at.dB), (at.C, at.dC), (at.D, at.dD)):
        moved = np.linalg.norm(slope.reshape(at.q, -1), axis=1)
        size = float(np.linalg.norm(whole))
        some = (moved > 0) & (size > 0)
        sizes[some] = np.minimum(sizes[some], SHARE_OF_MATRIX * size / moved[some])
    return np.where(np.isfinite(sizes), sizes, 1.0)


def _constants(config: RigConfig, built: RigModel, masses: tuple[str, ...]) -> tuple[Constant, ...]:
    """Return the constants; of a linear model a gain that its parameters can do in its place never shows."""
    curved = _is_curved(config, built)
    constants = constants_of(config, masses, direct=_is_direct(config, built), curved=curved)
    sensed = built.model if isinstance(built.model, SensedModel) else SensedModel(built.model, ())
    if not isinstance(sensed.model, (AffineModel, DescriptorModel)):
        return constants
    return tuple(replace(c, shows=c.shows and _is_separable(config, sensed, c)) for c in constants)


def _is_separable(config: RigConfig, model: SensedModel, constant: Constant) -> bool:
    """Whether a gain can be told from the estimated parameters."""
    if constant.kind == "delay":
        return True
    side: Side = "input" if constant.kind == "input" else "output"
    gain = Nuisance(f"{constant.name}.gain", "gain", side, constant.number)
    sensed = replace(model, nuisances=(*model.nuisances, gain))
    found = identifiability(sensed, len(config.inputs), np.abs(sensed.nominal))
    mixed = bool(len(found.blends)) and bool(np.any(found.blends[:, -1]))
    return not mixed and len(sensed.parameters) - 1 not in found.silent


def sheets_of(config: RigConfig) -> dict[str, float]:
    """Return the sds of the logarithms of masses, or of what keeps energy, by their data sheets."""
    if isinstance(config.model, Domain):
        return {name: percent / 100 for name, percent in config.model.sd_percent.items()}
    if isinstance(config.model, MechanicsModel):
        return {m.name: m.sd_percent / 100 for m in config.model.mass}
    return {}


def constants_of(
    config: RigConfig, masses: tuple[str, ...], direct: bool = False, curved: bool = False
) -> tuple[Constant, ...]:
    """Return the constants the data sheets leave open: masses, output and input gains, the inputs' delay.

    direct: whether an output sees an input directly; curved: whether straight lines between samples may not
    be what an input did.
    """
    sheets = sheets_of(config)
    wanted = set(estimated(config))
    # masses and forces times c, motions by c, are the same readings where no motion's gain is known
    measured = not {f"{c.name}.gain" for c in config.outputs} <= wanted
    out = [Constant(name, "mass", i, sheets[name], measured) for i, name in enumerate(masses)]
    scaled = _has_known_mass(config) and measured
    for kind, channels in (("output", config.outputs), ("input", config.inputs)):
        out += [
            Constant(c.name, kind, i, c.gain_sd_percent / 100, scaled)  # type: ignore[arg-type]
            for i, c in enumerate(channels)
            if c.gain_sd_percent > 0 and f"{c.name}.gain" not in wanted
        ]
    return (*out, *_timing(config, direct, curved))


def _timing(config: RigConfig, direct: bool, curved: bool) -> list[Constant]:
    """Return how late inputs and outputs may be, and whether inputs are smooth between samples."""
    out = []
    delay = _delay_samples(config)
    is_held = config.estimator.hold == "zero"
    if delay > 0:
        out.append(Constant("delay", "delay", 0, delay, apart=is_held))
        if direct or not is_held:
            out.append(Constant("delay", "delay", 1, delay, apart=not is_held))
        if curved:
            out.append(Constant("curve", "delay", CURVED, CURVE_SHEET, shows=False))
    # open where it is stated only: under coloured noise and forces it explains what other things do
    rate = config.rig.sample_rate_hz
    late = [(i, c.name, c.delay_sd_s) for i, c in enumerate(config.outputs) if c.delay_sd_s]
    return [*out, *(Constant(f"{name} late", "delay", LAG + i, sd_s * rate) for i, name, sd_s in late)]


def _is_direct(config: RigConfig, built: RigModel) -> bool:
    """Whether an output sees an input directly, as an accelerometer sees the force on its own mass."""
    return bool(built.model.continuous(built.model.nominal).D[:, : len(config.inputs)].any())


def _is_curved(config: RigConfig, built: RigModel) -> bool:
    """Whether straight lines between samples are not what a smooth force did, as the fastest mode shows it.

    None beside velocities, for which the force's own slope, known from one side only, counts as much as the
    motion's. None beside dry friction, which is no smooth input.
    """
    follows = config.estimator.hold == "first" and config.inputs and not _has_friction(config)
    if not (follows and isinstance(config.model, MechanicsModel)):
        return False
    if any(c.quantity == "velocity" for c in config.channel):
        return False
    rate = config.rig.sample_rate_hz
    poles = modes(built.model.continuous(built.model.nominal), 1.0 / rate)
    return bool(poles.imag.max(initial=0.0) / (2 * np.pi) > rate / CURVED_A_PERIOD)


def _rubbings(config: RigConfig, pushed: _Pushed) -> tuple[Rubbing, ...]:
    """Where dry friction may act without a model term: across each damper between places that weigh."""
    if not isinstance(config.model, MechanicsModel) or not pushed.pushes:
        return ()
    rubbing = {frozenset(f.between) for f in config.model.friction}
    out = []
    for damper in config.model.damper:
        across = _across(damper.between, pushed, "velocity")
        if across is not None and frozenset(damper.between) not in rubbing:
            out.append(Rubbing(*across))
    return tuple(out)


def _across(
    between: Sequence[str], pushed: _Pushed, quantity: Quantity
) -> tuple[FloatArray, FloatArray] | None:
    """What takes the first end's motion against the second's from the states (n,), and a force along it (d,).

    None where an end is a place that does not weigh.
    """
    states, places = pushed.model.state_names, pushed.pushes
    ends = [(node, sign) for node, sign in zip(between, (1.0, -1.0), strict=True) if node != GROUND]
    if not all(node in places for node, _ in ends):
        return None
    row, push = np.zeros(len(states)), np.zeros(len(places))
    for node, sign in ends:
        row[states.index(f"{quantity} of {node}")] += sign
        push[places.index(node)] += sign
    return row, push


def with_cubics(config: RigConfig, rig: Rig) -> Rig:
    """Let springs harden or soften whose extension displacements show, between places that weigh.

    None beside polynomial holds, whose inputs enter at several readings.
    """
    pushed = _pushed(config, rig_model(config).model)
    cubics = _cubics(config, pushed) if not rig.shifts else ()
    if not cubics:
        return rig
    total = rig.model.continuous(rig.model.nominal).m
    constants = [Constant(f"{c.name} cubic", "cubic", i, OFF_CUBIC) for i, c in enumerate(cubics)]
    return replace(
        rig, model=WithCubics(rig.model, rig.pushed, cubics), cubics=cubics,
        measured=np.append(rig.measured, total + np.arange(len(cubics))),
        driven=np.append(rig.driven, np.zeros(len(cubics), dtype=bool)),
        constants=(*rig.constants, *constants),
    )  # fmt: skip


def _cubics(config: RigConfig, pushed: _Pushed) -> tuple[Cubic, ...]:
    """Springs between places that weigh, whose extensions follow from displacements that are measured."""
    if not isinstance(config.model, MechanicsModel) or not pushed.pushes:
        return ()
    seen = np.array([float(c.quantity == "displacement") for c in config.outputs])
    displacements = pushed.model.continuous(pushed.model.nominal).C * seen[:, None]
    shows = np.linalg.pinv(displacements)
    found = []
    for spring in config.model.spring:
        across = _across(spring.between, pushed, "displacement")
        if across is None or not spring.nominal > 0:
            continue
        row, push = across
        extension = row @ shows
        if np.allclose(extension @ displacements, row, rtol=0.0, atol=SHOWN):
            found.append(Cubic(spring.name, extension, -push, spring.nominal))
    return tuple(found)


def _is_white(config: RigConfig) -> bool:
    """Whether the configuration denies unknown forces: the record is explained as a whole."""
    return config.estimator.observer.process_sd == 0


def _has_friction(config: RigConfig) -> bool:
    return isinstance(config.model, MechanicsModel) and bool(config.model.friction)


def _has_known_mass(config: RigConfig) -> bool:
    """Whether a known mass sets the scale: without one all parameters times c fit as well."""
    if not isinstance(config.model, MechanicsModel):
        return True
    wanted = set(estimated(config))
    return any(m.value > 0 and m.name not in wanted for m in config.model.mass)


def _is_massless(config: RigConfig) -> bool:
    """Whether no mass has an inertia, so that springs and dampers alone carry the forces."""
    return isinstance(config.model, MechanicsModel) and not any(
        m.value > 0 or m.name in estimated(config) for m in config.model.mass
    )


def _delay_samples(config: RigConfig) -> float:
    """Data-sheet sd of the inputs' delay, samples: 0 beside dry friction, which a delay would look like.

    Not stated, it is 0 where no mass is, since nothing tells it from dampers there. None of polynomials
    through more readings either, whose lateness no slope gives.
    """
    if _has_friction(config) or not config.inputs or config.estimator.hold not in ("first", "zero"):
        return 0.0
    stated = [c.delay_sd_s for c in config.inputs if c.delay_sd_s is not None]
    if stated:
        return max(stated) * config.rig.sample_rate_hz
    if _is_massless(config):  # to first order a delay does there what a damper does
        return 0.0
    # where forces are denied, a delay of commands would stand for what the model lacks (ECP-210: m1 -6 %)
    is_denied = _is_white(config) and config.estimator.hold == "zero"
    return 0.0 if is_denied else DELAY_SHEET


def _holding(config: RigConfig) -> set[str]:
    """The dampers that hold nodes without mass: there is no motion without them."""
    if not isinstance(config.model, MechanicsModel):
        return set()
    massless = {mass.name for mass in config.model.mass if mass.value == 0}
    return {damper.name for damper in config.model.damper if massless & set(damper.between)}


def estimator_settings(config: RigConfig, resolution: FloatArray) -> EstimatorSettings:
    """Return the settings of window-ml; resolution (p,) is the wire's smallest step of each output, SI."""
    built = rig_model(config)
    sigma, floor = output_noise(config, resolution)
    plan = hop_plan(config)
    limits = np.where(built.limits > 0, built.limits, np.inf)
    rig = with_cubics(config, statistical_rig(config))
    return EstimatorSettings(
        rig=rig, plan=HopPlan(plan.window, plan.hop), longer=longer_windows(config, plan),
        sigma=sigma, sigma_spread=np.array([c.noise_sd_spread for c in config.outputs]), floor=floor,
        enough_sd=config.estimator.resolve * limits, wanted_sd=0.1 * limits, wire=wire_of(config.outputs),
    )  # fmt: skip
