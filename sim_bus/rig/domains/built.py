"""What the domains put together: a motion with every place where it can be driven or read."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sim_bus.arrays import FloatArray


@dataclass(frozen=True)
class Between:
    """A rig between its channels.

    Attributes:
        inputs, outputs: names of the channels.
    """

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    @property
    def nodes(self) -> tuple[str, ...]:
        """Where a force of a scenario may act: the inputs."""
        return self.inputs

    @property
    def massless(self) -> frozenset[str]:
        """Nodes without inertia: there are no nodes."""
        return frozenset()


@dataclass(frozen=True)
class LinearMotion:
    """x' = F x + G u with what its outputs read, for one set of parameters."""

    system: Between
    F: FloatArray
    G: FloatArray
    C: FloatArray
    D: FloatArray
    is_sampled: bool = False

    def node(self, name: str) -> int:
        """Return an input's number."""
        return self.system.inputs.index(name)

    def output(self, _quantity: str, name: str) -> tuple[FloatArray, FloatArray]:
        """Return the rows (h, j) with reading = h x + j u of an output channel."""
        number = self.system.outputs.index(name)
        return self.C[number], self.D[number]


Place = tuple[str, str]
Raw = Mapping[str, Any]
Values = Mapping[str, float]


@dataclass(frozen=True)
class Built:
    """x' = F x + drives[place] u, reading = reads[place] x.

    Attributes:
        states: their names.
        F: (n, n).
        drives, reads: (n,) a column of G, a row of C, by quantity and place.
    """

    states: tuple[str, ...]
    F: FloatArray
    drives: dict[Place, FloatArray]
    reads: dict[Place, FloatArray]

    def place(self, quantity: str, at: str) -> Place | None:
        """Return the place of a channel; without `at` the only one of its quantity; None if there is none."""
        of_kind = {place for place in (*self.drives, *self.reads) if place[0] == quantity}
        wanted = of_kind if not at else of_kind & {(quantity, at)}
        return wanted.pop() if len(wanted) == 1 else None


@dataclass
class Network:
    """Stores joined by losses and exchanges of power: S x' = (X - sum of g a a') x + b u, X skew.

    A loss g sees the difference a' x and acts back along a; an exchange gives one store what another one
    loses.
    """

    stores: dict[str, float] = field(default_factory=dict)
    losses: list[tuple[float, dict[str, float]]] = field(default_factory=list)
    exchanges: list[tuple[float, str, str]] = field(default_factory=list)
    efforts: dict[Place, dict[str, float]] = field(default_factory=dict)
    readings: dict[Place, dict[str, float]] = field(default_factory=dict)
    outside: dict[str, Place] = field(default_factory=dict)

    def lose(self, value: float, seen: dict[str, float]) -> None:
        """Add a loss; a name in `outside` is an input that the difference is taken to."""
        self.losses.append((value, seen))

    def exchange(self, value: float, giver: str, taker: str) -> None:
        """Let the taker's equation gain value · giver, and the giver's lose value · taker."""
        self.exchanges.append((value, giver, taker))

    def built(self) -> Built:
        """Return the motion."""
        names = list(self.stores)
        size = len(names)
        power = np.zeros((size, size))
        pushed = {place: _vector(names, at) for place, at in self.efforts.items()}
        for value, seen in self.losses:
            a = _vector(names, {name: share for name, share in seen.items() if name in self.stores})
            power -= value * np.outer(a, a)
            for name, share in seen.items():
                if name in self.outside:
                    place = self.outside[name]
                    pushed[place] = pushed.get(place, np.zeros(size)) - value * share * a
        for value, giver, taker in self.exchanges:
            i, j = names.index(giver), names.index(taker)
            power[j, i] += value
            power[i, j] -= value
        by = 1.0 / np.array(list(self.stores.values()))
        reads = {place: _vector(names, at) for place, at in self.readings.items()}
        return Built(
            tuple(names), by[:, None] * power, {p: by * column for p, column in pushed.items()}, reads
        )


def _vector(names: list[str], shares: Mapping[str, float]) -> FloatArray:
    out = np.zeros(len(names))
    for name, share in shares.items():
        out[names.index(name)] += share
    return out


def swinging(
    mass: FloatArray, damping: FloatArray, stiffness: FloatArray, names: tuple[str, ...]
) -> tuple[FloatArray, FloatArray, tuple[str, ...]]:
    """Return F, M^-1 and the states of M q'' + D q' + K q = f: velocities, then places."""
    inverse = np.asarray(np.linalg.inv(mass), dtype=np.float64)
    f = len(mass)
    moved = [[-inverse @ damping, -inverse @ stiffness], [np.eye(f), np.zeros((f, f))]]
    F = np.asarray(np.block(moved), dtype=np.float64)  # noqa: N806 - a letter of the books
    return (
        F,
        inverse,
        (*(f"velocity of {name}" for name in names), *(f"displacement of {name}" for name in names)),
    )
