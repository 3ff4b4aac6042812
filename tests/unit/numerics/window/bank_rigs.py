"""Rigs of the bank's tests: chains and trees of masses with sensor constants, and records of them."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from itertools import chain, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.numerics.model.mechanics import Element, Mass, MassSpringDamper, Output, Structure
from agent.numerics.model.sensors import Nuisance, SensedModel
from agent.numerics.model.statespace import Hold, StateSpace, discretise
from agent.numerics.window.filtering.hops import HopPlan
from agent.numerics.window.filtering.noise import NoiseModel, Push
from agent.numerics.window.rows import BankRows
from agent.numerics.window.stream import Stream

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class BankRig:
    """A sampled model whose first `interest` parameters are springs and dampers, and how forces push it."""

    model: StateSpace
    push: Push
    interest: int

    def record(
        self, rng: np.random.Generator, noise: NoiseModel, samples: int, x0: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Outputs and inputs (measured force, constant 1) of a rig whose parameters are a little off."""
        model, push = self.model, self.push
        u = np.hstack([5.0 * rng.standard_normal((samples, model.m - 1)), np.ones((samples, 1))])
        d, p = push.B.shape[1], model.p
        force = noise.force * rng.standard_normal((samples, d))
        extra = noise.sigma * rng.standard_normal((samples, p))
        for c in noise.coloured:
            colour = gauss_markov(rng, c.pole, c.sd, samples)
            (force if c.side == "force" else extra)[:, c.number] += colour
        for line in noise.lines:
            extra[:, line.channel] += (
                30 * noise.sigma[line.channel] * np.cos(line.radians_per_sample * np.arange(samples) + 1)
            )
        x, y = x0.copy(), np.empty((samples, p))
        for k in range(samples):
            y[k] = model.C @ x + model.D @ u[k] + push.D @ force[k]
            x = model.A @ x + model.B @ u[k] + push.B @ force[k]
        return y + extra, u


def gauss_markov(rng: np.random.Generator, pole: float, sd: float, samples: int) -> FloatArray:
    out = np.empty(samples)
    value = sd * rng.standard_normal()
    for k in range(samples):
        out[k] = value
        value = pole * value + sd * np.sqrt(1 - pole**2) * rng.standard_normal()
    return out


def bank_rig(
    masses: int = 2, hold: Hold = "first", outputs: tuple[Output, ...] | None = None, period: float = 1e-2,
    grounded: bool = True, constants: tuple[Nuisance, ...] | None = None,
) -> BankRig:  # fmt: skip
    """A chain of masses from the ground (or free), force on the first, displacements of the first two."""
    nodes = ["ground", *(f"m{i}" for i in range(1, masses + 1))]
    edges = [pair for pair in pairwise(nodes) if grounded or "ground" not in pair]
    springs = tuple(Element(f"k{i}", e, 150.0 - 15 * i) for i, e in enumerate(edges))
    dampers = tuple(Element(f"B{i}", e, 2.0 + 0.2 * i) for i, e in enumerate(edges))
    structure = Structure(
        tuple(Mass(name, 2.0 + 0.5 * i) for i, name in enumerate(nodes[1:])), springs, dampers
    )
    seen = outputs or tuple(Output("displacement", name) for name in nodes[1 : 1 + min(masses, 2)])
    names = tuple(e.name for e in (*springs, *dampers))
    measured = MassSpringDamper(structure, names, ("m1",), seen)
    pushed = MassSpringDamper(structure, names, tuple(nodes[1:]), seen)
    if constants is None:
        constants = (
            Nuisance("g", "gain", "output", 0),
            Nuisance("b", "bias", "output", 0),
            Nuisance("f", "gain", "input", 0),
        )
    sensed = SensedModel(measured, constants)
    inner = sensed.continuous(sensed.nominal)
    sampled = discretise(inner, period, hold).model
    forces = discretise(pushed.continuous(pushed.nominal), period, hold).model
    return BankRig(sampled, Push(forces.B, forces.D), len(names))


def rows_of(
    rig: BankRig,
    noise: NoiseModel,
    plan: HopPlan,
    longer: tuple[int, ...],
    record: tuple[FloatArray, FloatArray],
) -> BankRows:
    stream = Stream(rig.model, rig.push, noise, plan, longer, rig.interest)
    stream.append(0, np.hstack(record))
    return joined(due(stream))


def due(stream: Stream) -> Iterator[BankRows]:
    """Yield all rows that have fallen due."""
    while (rows := stream.next()) is not None:
        yield rows


def joined(rows: Iterable[BankRows]) -> BankRows:
    """Return rows one after the other; there are some."""
    pieces = list(rows)
    index = np.concatenate([piece.index for piece in pieces])
    windows = zip(*(piece.windows for piece in pieces), strict=True)
    return BankRows(index, tuple(_together([w for w in each if w is not None]) for each in windows))


def _together(pieces: Sequence[Any]) -> Any:
    """Arrays along their first axis, records field by field; of all else the newest, None of nothing."""
    if not pieces:
        return None
    if isinstance(pieces[0], np.ndarray):
        return np.concatenate(pieces)
    if not is_dataclass(pieces[0]) or isinstance(pieces[0], type):
        return pieces[-1]
    parts = {f.name: [getattr(one, f.name) for one in pieces] for f in fields(pieces[0])}
    asked = {"asked": tuple(chain.from_iterable(parts.pop("asked")))} if "asked" in parts else {}
    found = {name: _together([one for one in each if one is not None]) for name, each in parts.items()}
    return replace(pieces[0], **found, **asked)
