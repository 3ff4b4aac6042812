"""Random machines that nobody has modelled: masses known to 2 %, no nominals, every displacement measured."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

FloatArray = NDArray[np.float64]
SPAN_S = 60.0


@dataclass(frozen=True)
class Machine:
    """Masses, (k, B) of elements between nodes (0 is the ground), nodes that a measured force acts on."""

    masses: FloatArray
    ends: tuple[tuple[int, int], ...]
    k: FloatArray
    B: FloatArray
    forces: tuple[int, ...]

    @property
    def truth(self) -> dict[str, float]:
        named = [(f"k{i}", v) for i, v in enumerate(self.k.tolist(), 1)]
        return dict(named + [(f"B{i}", v) for i, v in enumerate(self.B.tolist(), 1)])

    def generator(self) -> FloatArray:
        n = len(self.masses)
        K, D = np.zeros((n, n)), np.zeros((n, n))
        for ends, k, B in zip(self.ends, self.k, self.B, strict=True):
            way = np.zeros(n)
            for end, sign in zip(ends, (1.0, -1.0), strict=True):
                if end:
                    way[end - 1] = sign
            K += k * np.outer(way, way)
            D += B * np.outer(way, way)
        M = self.masses[:, None]
        return np.block([[np.zeros((n, n)), np.eye(n)], [-K / M, -D / M]])


def machine(rng: np.random.Generator, masses: int | None = None) -> Machine:
    """Draw 1-4 masses in a tree from the ground, some with a ring; a force on each part that hangs on the
    ground."""
    n = masses or int(rng.integers(1, 5))
    m = 10.0 ** rng.uniform(-0.3, 1.0, n)
    ends = [(int(rng.integers(0, i)), i) for i in range(1, n + 1)]
    if n > 2 and rng.random() < 0.4 and (1, n) not in ends:
        ends.append((1, n))
    k = 10.0 ** rng.uniform(2.0, 3.5, len(ends))
    lightest = np.array([min(m[e - 1] for e in pair if e) for pair in ends])
    B = 2.0 * rng.uniform(0.02, 0.2, len(ends)) * np.sqrt(k * lightest)
    return Machine(m, tuple(ends), k, B, _forced(n, ends))


def _part(node: int, ends: Sequence[tuple[int, int]]) -> set[int]:
    """Return the nodes that hang together with one, not by the ground."""
    part, size = {node}, 0
    while size < len(part):
        size = len(part)
        part |= {e for pair in ends if 0 not in pair and part & set(pair) for e in pair}
    return part


def _forced(n: int, ends: list[tuple[int, int]]) -> tuple[int, ...]:
    left, forces = set(range(1, n + 1)), []
    while left:
        part = _part(max(left), ends)
        forces.append(max(part))
        left -= part
    return tuple(sorted(forces))


Sensors = tuple[tuple[str, int], ...]
"""Quantity and node of each motion that is measured."""
LETTERS = {"displacement": ("x", "m"), "acceleration": ("a", "m/s2")}


def displacements(one: Machine) -> Sensors:
    return tuple(("displacement", i) for i in range(1, len(one.masses) + 1))


def accelerations(one: Machine) -> Sensors:
    return tuple(("acceleration", i) for i in range(1, len(one.masses) + 1))


def one_of_two(one: Machine, rng: np.random.Generator) -> Sensors:
    """Draw a displacement for each two masses, and at least one in each part that hangs on the ground."""
    picked = {int(rng.choice(sorted(_part(force, one.ends)))) for force in one.forces}
    others = rng.permutation([i for i in range(1, len(one.masses) + 1) if i not in picked])
    more = max(0, (len(one.masses) + 1) // 2 - len(picked))
    return tuple(("displacement", i) for i in sorted({*picked, *others[:more].tolist()}))


def recorded(
    one: Machine, rng: np.random.Generator, noise: float, span_s: float = SPAN_S, sensors: Sensors = ()
) -> dict[str, FloatArray]:
    """Return a recording under white forces of 10 N rms, integrated exactly; noise: share of each motion's
    rms; sensors: every displacement where empty."""
    A, n = one.generator(), len(one.masses)
    rate = float(max(round(20 * np.abs(np.linalg.eigvals(A)).max() / 2 / np.pi), 50))
    N, c = int(span_s * rate), len(one.forces)
    G = np.zeros((2 * n, c))
    for column, node in enumerate(one.forces):
        G[n + node - 1, column] = 1.0 / one.masses[node - 1]
    block = np.zeros((2 * n + 2 * c,) * 2)
    block[: 2 * n, : 2 * n], block[: 2 * n, 2 * n : 2 * n + c] = A / rate, G / rate
    block[2 * n : 2 * n + c, 2 * n + c :] = np.eye(c)
    E = expm(block)[: 2 * n]
    F, G1 = E[:, : 2 * n], E[:, 2 * n + c :]
    G0 = E[:, 2 * n : 2 * n + c] - G1
    u, x = rng.normal(0.0, 10.0, (N, c)), np.zeros((N, 2 * n))
    for i in range(N - 1):
        x[i + 1] = F @ x[i] + G0 @ u[i] + G1 @ u[i + 1]
    accelerated = x @ A[n:].T + u @ np.array(
        [np.eye(n)[node - 1] / one.masses[node - 1] for node in one.forces]
    )
    motion = {"displacement": x[:, :n], "acceleration": accelerated}
    seen = np.array([motion[quantity][:, node - 1] for quantity, node in sensors or displacements(one)]).T
    y = seen + rng.normal(size=seen.shape) * noise * seen.std(axis=0)
    columns = {"t": np.arange(N) / rate} | {f"f{node}": u[:, i] for i, node in enumerate(one.forces)}
    names = [f"{LETTERS[quantity][0]}{node}" for quantity, node in sensors or displacements(one)]
    return columns | dict(zip(names, y.T, strict=True))


def name(node: int) -> str:
    return f"m{node}" if node else "ground"


def configuration(
    one: Machine,
    columns: dict[str, FloatArray],
    masses: FloatArray,
    nominal: str = "",
    without: int | None = None,
    sensors: Sensors = (),
) -> str:
    """Write what is known of a machine; nominal: text behind each element; without: an element left out."""
    kept = [i for i in range(len(one.ends)) if i != without]
    rate = float(1.0 / columns["t"][1])
    lines = [f'[rig]\nname = "unknown"\nsample_rate_hz = {rate!r}\nclock = "uniform"\n\n[model]']
    lines.append(_rows("mass", [f'name = "m{i}", value = {m!r}' for i, m in enumerate(masses.tolist(), 1)]))
    for kind, letter in (("spring", "k"), ("damper", "B")):
        ends = [(i + 1, name(one.ends[i][0]), name(one.ends[i][1])) for i in kept]
        lines.append(
            _rows(kind, [f'name = "{letter}{i}", between = ["{a}", "{b}"]{nominal}' for i, a, b in ends])
        )
    channels = [("f", "force", node, "N") for node in one.forces]
    channels += [
        (LETTERS[quantity][0], quantity, node, LETTERS[quantity][1])
        for quantity, node in sensors or displacements(one)
    ]
    lines += [
        f'\n[[channel]]\nname = "{letter}{node}"\nquantity = "{quantity}"\nat = "m{node}"\nunit = "{unit}"'
        for letter, quantity, node, unit in channels
    ]
    return "\n".join([*lines, ""])


def _rows(kind: str, rows: list[str]) -> str:
    return f"{kind} = [{', '.join(f'{{ {row} }}' for row in rows)}]"


def written(
    folder: Path, seed: int, nominal: str = "", masses: int | None = None, without: int | None = None,
    sensing: Callable[[Machine, np.random.Generator], Sensors] = lambda one, _: displacements(one),
    span_s: float = SPAN_S,
) -> tuple[Machine, Path, Path]:  # fmt: skip
    """Write configuration and recording of the machine of a seed; return it and their paths."""
    rng = np.random.default_rng([17, seed])
    one = machine(rng, masses)
    sensors = sensing(one, np.random.default_rng(seed))
    columns = recorded(one, rng, float(10.0 ** rng.uniform(-4.0, -1.5)), span_s, sensors)
    stated = one.masses * (1.0 + np.clip(0.02 * rng.normal(size=len(one.masses)), -0.04, 0.04))
    config, record = folder / f"{seed}.toml", folder / f"{seed}.npz"
    config.write_text(configuration(one, columns, stated, nominal, without, sensors), encoding="utf-8")
    np.savez(record, **columns)
    return one, config, record
