"""Where the bank works: the model with what is known of constants, noise, and what rows take of the learner.

The constants enter rows whole: with P = L Lᵀ their covariance each column of L is a direction of unit prior.
One that moves no parameter in the window learnt from may move all of them in the next, of other excitation.
Scales that no window can ever show (`model.scales`) need no column: L is turned so that they stand apart, and
what they do to the parameters is theirs by the prior in every row.
"""

from dataclasses import dataclass, replace

import numpy as np

from agent.numerics.estimator.tuning import IN_TIME, LINE_LEVEL, MOST_LINES, PRESENT_NODES
from agent.numerics.inference.constants import farthest
from agent.numerics.inference.mixture import NORMAL_975, interval95
from agent.numerics.inference.noise.rounding import Rounding
from agent.numerics.inference.noise.state import Noise
from agent.numerics.inference.posterior import Knowledge, Posterior, neglected, shifted
from agent.numerics.inference.spectral.sources import Source
from agent.numerics.inference.tuning import ACTIVE_NODES, SURE
from agent.numerics.model.scales import combined, scales_of
from agent.numerics.model.statespace import StateSpace
from agent.numerics.model.uncertain import (
    CURVED,
    LAG,
    Rig,
    Sampled,
    columns_of,
    delays_of,
    gains_of,
    sampled,
    unit_of,
)
from agent.numerics.window.filtering.noise import Coloured, Line, NoiseModel, Push
from agent.types import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class Shape:
    """How the constants' mixture differs from one Gaussian, in units of the sd (q,) it gives a parameter.

    Attributes:
        mean, centre: (q,) mean of the mixture and middle of its interval, from the Gaussian's mean.
        share: (q,) sd of the Gaussian with as wide an interval, beyond `apart`.
        apart: (q,) half of the distance between hypotheses: an interval holds each as surely as one alone.
    """

    mean: FloatArray
    centre: FloatArray
    share: FloatArray
    apart: FloatArray


@dataclass(frozen=True)
class OperatingPoint:
    """The model, its noise, and how rows are read.

    Attributes:
        model: columns are the parameters (deviations in `unit`), then directions of the constants with unit
            priors, the parameters moved along as the constants move them: what no window shows is zero then,
            and no difference of large numbers.
        along: (q, r) by how much each direction moves the parameters along.
        unseen: (q,) variance of the parameters by scales that no reading shows, in squares of `unit`.
        push, noise: unknown forces and noise of the bank.
        theta, unit: (q,) point and size of a deviation of 1;  sharpest: (q,) sd of the windows that tell
            most, in it.
        wider: (q,) factor on the parameters' own variance: intensities not known, scatter beyond the model's.
        shape: how the constants' mixture differs from one Gaussian.
        unsure: variance of log σ that the misfit allows for.
        scatter: largest factor by which jump statistics are divided.
        slide, slid: variance that a gain which drifts inside a window adds to scores of jumps, in units of
            their own, and (q,) sd of what it does to parameters.
        rounding: of the readings that the noise is of; None where it is the same for all.
        slopes: inputs are followed by their slopes.
        inputs: how many of the measured inputs it takes: without springs' cubes as long as springs are
            believed to be straight.
    """

    model: StateSpace
    along: FloatArray
    unseen: FloatArray
    push: Push
    noise: NoiseModel
    theta: FloatArray
    unit: FloatArray
    sharpest: FloatArray
    wider: FloatArray
    shape: Shape
    unsure: float
    scatter: float
    slide: float
    slid: FloatArray
    rounding: Rounding | None
    slopes: bool
    inputs: int


def operating_point(
    rig: Rig, known: Knowledge, posterior: Posterior, sources: tuple[Source, ...], window: int,
    sharpest: FloatArray,
) -> OperatingPoint:  # fmt: skip
    """Return where the bank works, from what is known and what the newest window that was learnt from said.

    sharpest: (q,) the parameters' own sd in the sharpest windows: what the constants' effect is held against.
    """
    wider = np.maximum(1 + np.maximum(known.noise.spread, -0.3).sum(axis=0), 0.5) * known.scatter.factor
    assert known.footing is not None  # noqa: S101 - since the first window
    # what constants do in the windows that the point rests on, since in one alone it may be anything
    sensitivity = known.footing.sensitivity
    shape = _shape(rig, known, sensitivity, sharpest)
    # rows are of windows to come: constants walk until then, and each row's own readings tell of them
    known = replace(known, constants=known.constants.predicted())
    eta = known.constants.standing[0]
    # where those windows would have it with the constants so, or rows would start far from the point
    theta = np.maximum(shifted(known.theta, sensitivity @ (eta - known.eta)), rig.lower)
    noise = known.noise
    at = sampled(rig, theta, eta[: rig.masses], delays_of(rig, eta))
    seen = _Seen(rig, eta, at, known.stretch)
    base = seen.model(at.A, at.B, at.C, at.D)
    columns = [seen.parameter(at.dA[i], at.dB[i], at.dC[i], at.dD[i]) for i in range(rig.q)]
    constants = [seen.parameter(at.dA[i], at.dB[i], at.dC[i], at.dD[i]) for i in range(rig.q, len(at.dA))]
    constants += [seen.sensor(i, base) for i in range(rig.masses, len(rig.constants))]
    kinds = [c.kind if c.sheet > 0 else "exact" for c in rig.constants]
    scales = scales_of(base, columns, constants, kinds)
    is_open = _open(rig, known)
    directions, turn = _directions(known, is_open, scales.constants)
    along = sensitivity @ directions / at.unit[:, None]
    both = np.concatenate([along, directions])
    columns += [combined([*columns, *constants], direction) for direction in both.T]
    dA, dB, dC, dD = (np.stack(part) for part in zip(*columns, strict=True))
    used, inputs = _used(rig, is_open, base[1].shape[1])
    model = StateSpace(
        base[0], base[1][:, used], base[2], base[3][:, used], dA, dB[..., used], dC, dD[..., used]
    )
    push = Push(at.E, seen.output_gain[:, None] * at.F)
    learnt = bank_noise(known, sources, window, len(rig.pushed))
    unseen = ((scales.parameters @ turn) ** 2).sum(axis=1)
    return OperatingPoint(
        model, along, unseen, push, learnt, theta, at.unit, sharpest / at.unit, wider, shape,
        noise.unsure, max(1.0, float(known.scatter.within.max())), posterior.slide, posterior.slid,
        noise.rounding,
        at.late is not None, inputs,
    )  # fmt: skip


def taps_of(rig: Rig, outputs: int, inputs: int, slopes: bool) -> list[list[tuple[int, int, float]]]:
    """Return where each channel, outputs then inputs, enters the bank's samples (`window.lost.Taps`).

    inputs: how many of the measured ones the bank takes.
    """
    each: list[list[tuple[int, int, float]]] = [[(0, column, 1.0)] for column in range(outputs)]
    for number in range(inputs):
        # an input that no channel drives has one tap
        shifts = zip((0, *rig.shifts), (rig.taps_of(number) + outputs).tolist(), strict=False)
        entries = [(-shift, column, 1.0) for shift, column in shifts]
        if slopes:
            entries += [(o + k, column + inputs, 1.0 - 2 * k) for o, column, _ in entries for k in (0, 1)]
        each.append(entries)
    return each


class _Seen:
    """The sampled model as it is seen through gains at η."""

    def __init__(self, rig: Rig, eta: FloatArray, at: Sampled, stretch: FloatArray | None) -> None:
        self.rig, self.at, self.stretch = rig, at, stretch
        self.output_gain, self.input_gain = gains_of(rig, eta, at, stretch)

    def model(
        self, A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return A, B, C, D (or a derivative of them) with gains in."""
        y = self.output_gain[:, None]
        return A, B * self.input_gain, y * C, y * D * self.input_gain

    parameter = model

    def sensor(
        self, number: int, base: tuple[FloatArray, FloatArray, FloatArray, FloatArray]
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return the derivatives of A, B, C, D by the constant with this number, a gain or the delay."""
        constant, (A, B, C, D) = self.rig.constants[number], base
        dA, dB, dC, dD = np.zeros_like(A), np.zeros_like(B), np.zeros_like(C), np.zeros_like(D)
        m = len(self.rig.measured)
        if constant.kind == "output":
            dC[constant.number], dD[constant.number] = C[constant.number], D[constant.number]
        elif constant.kind == "input":
            columns = columns_of(self.rig, constant.number, self.at)
            dB[:, columns], dD[:, columns] = B[:, columns], D[:, columns]
        elif constant.kind == "cubic":
            j = self.rig.cubic_input(constant.number)
            assert self.stretch is not None  # noqa: S101 - since the first window
            dB[:, j] = self.at.B[:, j] / self.stretch[constant.number]
            dD[:, j] = self.output_gain * self.at.D[:, j] / self.stretch[constant.number]
        elif (curve := self.at.curve) is not None and constant.number == CURVED:
            n = len(A)
            dC = self.output_gain[:, None] * curve[:, :n]
            dD = self.output_gain[:, None] * curve[:, n:] * self.input_gain
        elif (lag := self.at.lag) is not None and constant.is_lag:
            own = constant.number - LAG
            dC[own] = self.output_gain[own] * lag[own, : len(A)]
            dD[own] = self.output_gain[own] * lag[own, len(A) :] * self.input_gain
        elif self.at.late is not None:
            late = self.at.late[constant.number] * self.input_gain[m:]
            dB[:, m:] = late[: len(A)]
            dD[:, m:] = self.output_gain[:, None] * late[len(A) :]
        return dA, dB, dC, dD


def _open(rig: Rig, known: Knowledge) -> BoolArray:
    """(c,) constants that are not known exactly.

    So outputs' lateness is as long as they are believed to be read at once, and a spring's cube as long as it
    is believed to be straight.
    """
    at_once = np.sqrt(np.diag(known.constants.standing[1])) < IN_TIME
    cubes = [known.constants.believes(np.array([i])) for i in range(len(rig.constants))]
    return np.array([
        c.sheet > 0 and not (c.is_lag and exact) and (c.kind != "cubic" or bent)
        for c, exact, bent in zip(rig.constants, at_once, cubes, strict=True)
    ], dtype=bool)  # fmt: skip


def _used(rig: Rig, is_open: BoolArray, columns: int) -> tuple[BoolArray, int]:
    """Return which columns of the inputs and slopes the bank takes, and how many of the measured inputs."""
    m = len(rig.measured)
    used = np.ones(columns, dtype=bool)
    if not rig.cubics or is_open[rig.of_kind("cubic")].any():
        return used, m
    straight = m - len(rig.cubics)
    used[straight:m] = used[m + straight :] = False
    return used, straight


def _directions(known: Knowledge, is_open: BoolArray, scales: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return combinations (c, r) of the open constants, of unit prior each, beside what no reading shows.

    scales (c, k): what no reading shows; times what comes second (k, k) these have unit priors too.
    """
    P = known.constants.standing[1]
    root = _root(P[np.ix_(is_open, is_open)])
    count = scales.shape[1]
    turned, turn = np.linalg.qr(np.linalg.solve(root, scales[is_open]), mode="complete")
    directions = np.zeros((len(is_open), len(root) - count))
    directions[is_open] = root @ turned[:, count:]
    return directions, np.linalg.inv(turn[:count])


def _shape(rig: Rig, known: Knowledge, sensitivity: FloatArray, own: FloatArray) -> Shape:
    """Return the shape of the mixture where constants move parameters of sd `own` (q,) by `sensitivity`."""
    constants = known.constants
    mean, P = constants.standing
    by_constants = np.sqrt(((sensitivity @ _root(P)) ** 2).sum(axis=1))
    size = np.maximum(by_constants, 1e-6 * own)
    moved = np.vstack([constants.mean, mean]) - known.eta
    *each, linear = shifted(known.theta, moved @ sensitivity.T)
    means = np.array(each)
    variance = ((sensitivity @ constants.covariance) * sensitivity).sum(axis=2)
    scales = farthest(rig.constants, constants.mean - mean)
    bent = neglected(means - linear, unit_of(rig, known.theta), scales)
    variance = np.maximum(variance, 0.0) + bent**2
    lower, upper = interval95(constants.weight, means, np.sqrt(own**2 + variance))
    apart = 0.5 * np.ptp(means[constants.stands], axis=0)
    half = np.maximum(0.5 * (upper - lower) - apart, 0.0) / NORMAL_975
    share = np.sqrt(np.maximum(half**2 - own**2, 0.0)) / size
    known_well = by_constants < 0.1 * own
    return Shape(
        np.where(known_well, 0.0, (constants.weight @ means - linear) / size),
        np.where(known_well, 0.0, (0.5 * (lower + upper) - linear) / size),
        np.where(known_well, 1.0, share),
        np.where(known_well, 0.0, apart / size),
    )


def _root(P: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(P)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def bank_noise(known: Knowledge, sources: tuple[Source, ...], window: int, forces: int) -> NoiseModel:
    """Return the learnt noise as the bank can realise it: intensities as states, high bins as lines.

    A slow force that may as well be absent is taken for a white one that shows as much.
    """
    noise = known.noise
    # a line's leakage is no noise where the line is followed
    usual = np.median(noise.levels[: max(known.kept, 1)], axis=0)
    sigma = noise.sd * np.sqrt(usual)
    white = np.zeros(forces)
    if not noise.is_started:
        return NoiseModel(sigma, white, (), _lines(noise, window))
    nodes = noise.nodes[:, 0]
    shown = noise.intensity / nodes  # beside the sensors' noise, where each source is strongest
    doubtful = (shown < ACTIVE_NODES) & (noise.log_weight[:, 0] > -SURE)
    present = [(a, source) for a, source in enumerate(sources) if shown[a] >= PRESENT_NODES]
    first_white = {s.number: nodes[a] for a, s in enumerate(sources) if _is_white_force(s)}
    coloured = []
    for a, source in present:
        if _is_white_force(source) or (source.kind == "force" and doubtful[a]):
            # two states for a force that may as well be absent would cost as much as all else
            white[source.number] = np.hypot(white[source.number], shown[a] * first_white[source.number])
        else:
            coloured.append(Coloured(source.kind, source.number, source.pole, float(noise.intensity[a])))
    return NoiseModel(sigma, white, tuple(coloured), _lines(noise, window))


def _is_white_force(source: Source) -> bool:
    return source.kind == "force" and source.pole == 0


def _lines(noise: Noise, window: int) -> tuple[Line, ...]:
    """The strongest lines in the levels of bins."""
    levels = noise.levels
    inner, below, above = levels[1:-1], levels[:-2], levels[2:]
    peaks = np.argwhere((inner > LINE_LEVEL) & (inner >= below) & (inner > above))
    strongest = sorted(peaks.tolist(), key=lambda place: -inner[place[0], place[1]])[:MOST_LINES]
    off = noise.places.off
    return tuple(Line(c, 2 * np.pi * (k + 1 + off[k + 1, c]) / window) for k, c in strongest)
