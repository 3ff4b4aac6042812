"""What is modelled: the parametric state space of a rig with its unknown forces and uncertain constants."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from scipy.linalg import matrix_balance

from agent.numerics.model.cubic import Cubic
from agent.numerics.model.holds import curvature, lateness, sample, straight, taps
from agent.numerics.model.statespace import Discrete, Hold, Model, StateSpace, discretise
from agent.types import BoolArray, FloatArray, IntArray

Kind = Literal["mass", "output", "input", "delay", "cubic"]
CURVED = 2
"""Fixed by the list of constants: number of the constant that says how smooth inputs are between samples."""
LAG = 3
"""Fixed by the list of constants: the number of how late the first output is read, the others follow."""


@dataclass(frozen=True, slots=True)
class Constant:
    """A constant of the rig that is known as well as its data sheet says.

    Attributes:
        name: of the mass or channel; "delay" for the delay of the inputs; "k1 cubic".
        kind: a mass, an output's or an input's gain, the delay of all measured inputs, or by how much a
            spring hardens.
        number: which mass (of the model's parameters after θ), output, input or spring (of `cubics`) it
            belongs to; of delays 0 where the inputs are late, 1 for what is so or not: that an input is held
            until the next reading (½ sample) in place of a straight line, or that outputs are read before a
            held one steps (1); 2 for what smooth inputs do beyond straight lines between samples (1: all of
            it); 3 and on for how late each output is read against all else.
        sheet: standard deviation of its logarithm; of the delay: samples; of a cubic: share of the stiffness.
        shows: whether data can tell that it is off: no gain can be told where all masses are estimated or
            absent.
        apart: its being off says nothing of how well all else is known.
    """

    name: str
    kind: Kind
    number: int
    sheet: float
    shows: bool = True
    apart: bool = False

    @property
    def is_binary(self) -> bool:
        """Whether what it says of the inputs is so or not, and nothing between to start with."""
        return self.kind == "delay" and self.number == 1

    @property
    def is_lag(self) -> bool:
        """Whether it says how late one output is read against all else."""
        return self.kind == "delay" and self.number >= LAG


@dataclass(frozen=True)
class Rubbing:
    """Two places that may rub on each other.

    Attributes:
        speed: (n,) takes their relative speed from the states.
        push: (d,) how the unknown forces act where a force acts between them.
    """

    speed: FloatArray
    push: FloatArray


@dataclass(frozen=True)
class Rig:
    """A rig as the estimator sees it.

    Attributes:
        model: parametric model; its parameters are θ (q of them), then the masses that are constants.
        q: how many parameters are estimated.
        measured: columns of the model's inputs that the samples u hold, in their order.
        driven: (m,) which of those are measured by a channel (a friction's sign and the constant 1 are not).
        pushed: columns of the model's inputs that are unknown forces.
        constants: what is known by its data sheet only; masses first, in the model's order.
        period_s: sampling period, s.
        hold: how inputs run between samples.
        scale: (q,) size of each parameter: |nominal|, or what stands for it.
        lower: (q,) bound from below of the point of linearisation.
        slow_forces: unknown forces may last; beside dry friction nothing tells them from it.
        rubbings: where dry friction is looked for that the model has no term for.
        cubics: springs that may harden or soften; their forces are the last of the measured inputs.
        white: what the model leaves is white noise of the sensors, and nothing else, by the configuration.
    """

    model: Model
    q: int
    measured: IntArray
    driven: BoolArray
    pushed: IntArray
    constants: tuple[Constant, ...]
    period_s: float
    hold: Hold
    scale: FloatArray
    lower: FloatArray
    slow_forces: bool = True
    white: bool = False
    rubbings: tuple[Rubbing, ...] = ()
    cubics: tuple[Cubic, ...] = ()

    @cached_property
    def sizes(self) -> FloatArray:
        """(n,) units of the states in which they are alike in size, powers of two.

        In metres and metres a second the matrices of a fast mode have entries as far apart as the square of
        its frequency, and what is small beside others would be taken for nothing.
        """
        A = self.model.continuous(self.model.nominal).A
        _, (sizes, _) = matrix_balance(A, permute=False, separate=True)
        return np.asarray(sizes, dtype=np.float64)

    @property
    def masses(self) -> int:
        """Number of masses among the constants."""
        return len(self.model.parameters) - self.q

    @property
    def nominal(self) -> FloatArray:
        """(q,) nominal parameters."""
        return self.model.nominal[: self.q]

    @property
    def is_curved(self) -> bool:
        """Whether inputs may be smooth between samples where the hold says straight lines."""
        return any(c.kind == "delay" and c.number == CURVED for c in self.constants)

    @property
    def has_lags(self) -> bool:
        """Whether outputs may be read late."""
        return any(c.is_lag for c in self.constants)

    @property
    def shifts(self) -> tuple[int, ...]:
        """Offsets of the further readings a polynomial hold takes of driven inputs; none for other holds."""
        return () if self.hold == straight(self.hold) else tuple(o for o in taps(self.hold) if o)

    def taps_of(self, number: int) -> IntArray:
        """Return the columns of the stacked inputs that hold readings of one measured input."""
        if not self.driven[number]:
            return np.array([number])
        place, count = int(np.count_nonzero(self.driven[:number])), int(np.count_nonzero(self.driven))
        return np.array([number, *(len(self.measured) + i * count + place for i in range(len(self.shifts)))])

    def cubic_input(self, number: int) -> int:
        """Return which measured input is the force of a spring's cube."""
        return len(self.measured) - len(self.cubics) + number

    def of_kind(self, kind: Kind) -> IntArray:
        """Return which constants are of a kind."""
        return np.array([i for i, c in enumerate(self.constants) if c.kind == kind], dtype=np.int64)


@dataclass(frozen=True, slots=True)
class Sampled:
    """Sampled model at a point, x(k+1) = A x + B u + E f, y = C x + D u + F f (shifted state: `discretise`).

    States are in the rig's `sizes`.

    With a polynomial hold u is stacked: the m inputs at sample k, then the driven ones at k + o for each of
    the rig's shifts; the state is then the physical one as to the driven inputs, and shifted as to the others
    and f.

    Attributes:
        A, B, C, D: (n, n), (n, m), (p, n), (p, m).
        E, F: (n, d), (p, d) for unknown forces f.
        dA, dB, dC, dD: the derivatives of A, B, C, D by θ_i in units of `unit`, then by each mass's
            logarithm.
        theta, log_mass, delays: the point.
        unit: (q,) what a deviation of 1 means for each parameter.
        late: (2, n + p, m) derivatives of the slopes' columns of B, above those of D, by the delays; with
            them u is followed by the slopes u(k) − u(k−1). None of a rig whose inputs are never late.
        curve: (p, n + 2 m) derivatives of C and D by delays[2], what smooth inputs do beyond straight lines;
            None of a rig whose inputs are straight.
        lag: (p, n + 2 m) derivatives of each output's row of them by how late it is read; None of a rig whose
            outputs are all read at once.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    E: FloatArray
    F: FloatArray
    dA: FloatArray
    dB: FloatArray
    dC: FloatArray
    dD: FloatArray
    theta: FloatArray
    log_mass: FloatArray
    unit: FloatArray
    delays: FloatArray | None
    late: FloatArray | None
    curve: FloatArray | None
    lag: FloatArray | None

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.A)

    def is_at(self, theta: FloatArray, log_mass: FloatArray, delays: FloatArray | None) -> bool:
        """Tell whether a point is the one at which this is the model; of one rig, delays are there or not."""
        is_late_alike = self.delays is None or delays is None or np.array_equal(self.delays, delays)
        is_same = np.array_equal(self.theta, theta) and np.array_equal(self.log_mass, log_mass)
        return is_same and is_late_alike


def unit_of(rig: Rig, theta: FloatArray) -> FloatArray:
    """Return each parameter's unit of deviation at theta (q,): its size, or a tenth of its nominal one."""
    return np.asarray(np.maximum(np.abs(theta), 0.1 * rig.scale))


def sampled(rig: Rig, theta: FloatArray, log_mass: FloatArray, delays: FloatArray | None = None) -> Sampled:
    """Return the sampled model at θ (q,), masses nominal · exp(log_mass), and delays (see `delays_of`)."""
    mass = rig.model.nominal[rig.q :] * np.exp(log_mass)
    continuous = rig.model.continuous(np.concatenate([theta, mass])).in_units(rig.sizes)
    discrete = discretise(continuous, rig.period_s, straight(rig.hold))
    model = discrete.model
    B, D, dB, dD = _stacked(rig, continuous, model)
    C, dC = model.C, model.dC
    late = curve = lag = None
    if delays is not None:
        (B, D, dB, dD), late = _late(rig, discrete, (B, D, dB, dD), delays)
        n = continuous.n
        if rig.is_curved:
            curve, d_curve = _static(rig, curvature(continuous, discrete), rig.driven)
            C, D = C + delays[CURVED] * curve[:, :n], D + delays[CURVED] * curve[:, n:]
            dC, dD = dC + delays[CURVED] * d_curve[..., :n], dD + delays[CURVED] * d_curve[..., n:]
        if rig.has_lags:
            lag, d_lag = _static(rig, lateness(continuous, discrete), np.ones_like(rig.driven))
            lags = np.zeros((len(C), 1))
            lags[: len(delays) - LAG, 0] = delays[LAG:]
            C, D = C + lags * lag[:, :n], D + lags * lag[:, n:]
            dC, dD = dC + lags * d_lag[..., :n], dD + lags * d_lag[..., n:]
    unit = unit_of(rig, theta)
    steps = np.concatenate([unit, mass])[:, None, None]
    f = rig.pushed
    return Sampled(
        model.A, B, C, D, model.B[:, f], model.D[:, f],
        model.dA * steps, dB * steps, dC * steps, dD * steps,
        theta.copy(), log_mass.copy(), unit, delays, late, curve, lag,
    )  # fmt: skip


def _late(
    rig: Rig, discrete: Discrete, given: tuple[FloatArray, ...], delays: FloatArray
) -> tuple[list[FloatArray], FloatArray]:
    """Return B, D, dB, dD with columns of the slopes after them, and their derivatives by the delays.

    Slopes are s(k) = u(k) − u(k−1).
    """
    less = np.where(rig.driven, -1.0, 0.0)
    missing = (_missing_of_steps if rig.hold == "zero" else _missing_of_lines)(rig, discrete, given, delays)
    slopes = [less * part for part in missing.parts]
    late = np.stack([less * np.vstack(rate) for rate in missing.rates])
    return [np.concatenate(pair, axis=-1) for pair in zip(given, slopes, strict=True)], late


def _static(rig: Rig, outputs: tuple[FloatArray, ...], acting: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return what is added to outputs as columns of C, of D, and of the slopes' D beside it.

    The derivatives of these by each parameter come second. outputs: see `curvature`;  acting: (m,) inputs
    that do any of it. What no channel drives has no slope.
    """
    Cx, Du, Ds, dCx, dDu, dDs = outputs
    u = rig.measured
    added = np.hstack([Cx, Du[:, u] * acting, Ds[:, u] * rig.driven])
    return added, np.concatenate([dCx, dDu[:, :, u] * acting, dDs[:, :, u] * rig.driven], axis=-1)


class _Missing(NamedTuple):
    """What slopes take from the motion: columns of B, D, dB, dD; rates of B and D by either delay."""

    parts: Sequence[FloatArray]
    rates: Sequence[tuple[FloatArray, FloatArray]]


def _line_for_step(rig: Rig, discrete: Discrete) -> tuple[FloatArray, ...]:
    """Return columns of B, D, dB, dD by which slopes make of a step the straight line that ends there."""
    model, u = discrete.model, rig.measured
    ramp, d_ramp = discrete.ramp[:, u], discrete.d_ramp[:, :, u]
    dB, dD = model.dA @ ramp + model.A @ d_ramp, model.dC @ ramp + model.C @ d_ramp
    return model.A @ ramp, model.C @ ramp, dB, dD


def _missing_of_lines(
    rig: Rig, discrete: Discrete, given: tuple[FloatArray, ...], delays: FloatArray
) -> _Missing:
    """Of inputs that run in straight lines: an input one sample late is u less s.

    One that is held from sample to sample is half a sample late but seen at once where it is seen directly.
    Either is exact there, and a straight line between.
    """
    half = [2 * part for part in _line_for_step(rig, discrete)]
    parts = [delays[0] * one + delays[1] * two for one, two in zip(given, half, strict=True)]
    return _Missing(parts, [(given[0], given[1]), (half[0], half[1])])


def _missing_of_steps(
    rig: Rig, discrete: Discrete, given: tuple[FloatArray, ...], delays: FloatArray
) -> _Missing:
    """Of inputs that are held: a step that comes d samples late lacks s for the first d of its sample.

    That is ∫₀ᵈ φ of φ(σ) = exp(A T (1 − σ)) B T, whose integral over the sample is B, and its first moment
    the ramp R. Of the straight line that has these it is d B + 3 d (1 − d) (B − 2 R): exact at d = 0 and 1,
    and right to the second order in the motion of a sample. A force that acts early is one that is not held
    but runs in straight lines, exact at −½. Outputs that are read before the step see u less s directly.
    """
    B, D, dB, dD = given
    d, unseen = delays[:2]
    if d < 0:
        early = [2 * part for part in _line_for_step(rig, discrete)]
        parts = [d * part for part in early]
        rate = early[0], early[1]
    else:
        bend = 3 * (B - 2 * discrete.ramp[:, rig.measured])
        dbend = 3 * (dB - 2 * discrete.d_ramp[:, :, rig.measured])
        parts = [d * (B + (1 - d) * bend), np.zeros_like(D), d * (dB + (1 - d) * dbend), np.zeros_like(dD)]
        rate = B + (1 - 2 * d) * bend, np.zeros_like(D)
    parts[1], parts[3] = parts[1] + unseen * D, parts[3] + unseen * dD
    return _Missing(parts, [rate, (np.zeros_like(B), D)])


def delays_of(rig: Rig, eta: FloatArray) -> FloatArray | None:
    """Return the delays, by their numbers, among constants (c,); None of a rig in which nothing is late.

    Two of inputs at the least, a third where they may be smooth, further ones where outputs may be read late.
    """
    found = rig.of_kind("delay")
    numbers = [rig.constants[i].number for i in found]
    delays = np.zeros(1 + max(1, *numbers)) if numbers else np.zeros(0)
    delays[numbers] = eta[found]
    return delays if numbers else None


def gains_of(
    rig: Rig, eta: FloatArray, at: Sampled, stretch: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return the gains of outputs (p,) and of inputs (m,), their slopes' among these, at constants (c,).

    Those of springs' cubes are by how much each hardens at mean square extensions `stretch` (s,), m².
    """
    outputs, inputs = np.ones(len(at.C)), np.ones(at.B.shape[1])
    for number in range(len(rig.cubics)):
        inputs[columns_of(rig, rig.cubic_input(number), at)] = 0.0
    for i, constant in enumerate(rig.constants):
        if constant.kind == "output":
            outputs[constant.number] = np.exp(eta[i])
        elif constant.kind == "input":
            inputs[columns_of(rig, constant.number, at)] = np.exp(eta[i])
        elif constant.kind == "cubic":
            size = 1.0 if stretch is None else stretch[constant.number]
            inputs[columns_of(rig, rig.cubic_input(constant.number), at)] = eta[i] / size
    return outputs, inputs


def columns_of(rig: Rig, number: int, at: Sampled) -> IntArray:
    """Return the columns of a model's inputs that hold readings of a measured one, or their slopes."""
    taps = rig.taps_of(number)
    return np.append(taps, len(rig.measured) + taps) if at.late is not None else taps


def _stacked(
    rig: Rig, continuous: StateSpace, model: StateSpace
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return B, D, dB, dD of the measured inputs; `model` is the sampled one of straight lines or steps."""
    u = rig.measured
    straight_lines = model.B[:, u], model.D[:, u], model.dB[:, :, u], model.dD[:, :, u]
    if not rig.shifts:
        return straight_lines
    c, pushing = continuous, u[rig.driven]
    driven = StateSpace(
        c.A, c.B[:, pushing], c.C, c.D[:, pushing], c.dA, c.dB[:, :, pushing], c.dC, c.dD[:, :, pushing]
    )
    tapped = sample(driven, rig.period_s, rig.hold)
    polynomials = tapped.model.B, tapped.model.D, tapped.model.dB, tapped.model.dD
    places = np.split(np.arange(polynomials[0].shape[1]), len(tapped.taps))
    at_sample = places.pop(tapped.taps.index(0))
    out = []
    for line, polynomial in zip(straight_lines, polynomials, strict=True):
        here = line.copy()
        here[..., rig.driven] = polynomial[..., at_sample]
        out.append(np.concatenate([here, polynomial[..., np.concatenate(places)]], axis=-1))
    return out[0], out[1], out[2], out[3]
