"""Random rigs as a user may write them, with a recording of each, integrated by neither agent nor simulator.

1-5 masses in a tree with or without loops, on the ground or free, six decades of mass and stiffness, damping
from one hundred-thousandth of critical to thrice, sensors of every kind in any unit, noise stated or not.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

FloatArray = NDArray[np.float64]
UNITS = {"displacement": {"m": 1.0, "mm": 1e-3, "um": 1e-6}, "velocity": {"m/s": 1.0, "mm/s": 1e-3},
         "acceleration": {"m/s2": 1.0, "g": 9.80665}}  # fmt: skip
SAMPLES, WINDOW = 75, 50
GROUND = 0


@dataclass(frozen=True)
class Element:
    """A spring and a damper between two nodes; node 0 is the ground."""

    ends: tuple[int, int]
    k: float
    B: float


@dataclass(frozen=True)
class Rig:
    """Masses, elements, places of forces and (quantity, node, unit, noise share, stated) of sensors."""

    masses: tuple[float, ...]
    elements: tuple[Element, ...]
    forces: tuple[int, ...]
    sensors: tuple[tuple[str, int, str, float, bool], ...]
    rate_hz: float
    estimator: str

    def generator(self) -> tuple[FloatArray, FloatArray]:
        """A (2n, 2n) and B (2n, forces) of displacements, then velocities."""
        n = len(self.masses)
        K, D = np.zeros((n, n)), np.zeros((n, n))
        for element in self.elements:
            way = np.zeros(n)
            for end, sign in zip(element.ends, (1.0, -1.0), strict=True):
                if end != GROUND:
                    way[end - 1] = sign
            K += element.k * np.outer(way, way)
            D += element.B * np.outer(way, way)
        M = np.array(self.masses)[:, None]
        A = np.block([[np.zeros((n, n)), np.eye(n)], [-K / M, -D / M]])
        B = np.zeros((2 * n, len(self.forces)))
        for column, node in enumerate(self.forces):
            B[n + node - 1, column] = 1.0 / self.masses[node - 1]
        return A, B


def random_rig(rng: np.random.Generator) -> Rig:
    """Draw a rig."""
    n = int(rng.integers(1, 6))
    masses = 10.0 ** (rng.uniform(-2, 2) + rng.uniform(-1, 1, n) * rng.choice([0.3, 1.0]))
    stiffness, damping = 10.0 ** rng.uniform(-0.5, 3.5), 10.0 ** rng.uniform(-5, 0.5)
    pairs = [(int(rng.integers(rng.random() > 0.1, i)) if i > 1 else GROUND, i) for i in range(1, n + 1)]
    if n > 1 and rng.random() < 0.2:
        pairs = [(1 + int(rng.integers(0, i - 1)), i) for i in range(2, n + 1)]  # free-free
    if n > 2 and rng.random() < 0.3:
        pairs.append((1, n))
    elements = []
    for ends in dict.fromkeys(pairs):
        k = float(stiffness * 10.0 ** (rng.uniform(-1, 1) * 1.25))
        critical = 2.0 * np.sqrt(k * np.min(masses[[end - 1 for end in ends if end]]))
        elements.append(Element(ends, k, float(damping * critical * 10.0 ** rng.uniform(-0.3, 0.3))))
    forces = tuple(sorted(rng.choice(n, int(rng.integers(0, min(n, 2) + 1)), replace=False) + 1))
    count = int(rng.integers(1, 2 * n + 1))
    spots = sorted({(str(rng.choice(list(UNITS))), int(rng.integers(1, n + 1))) for _ in range(count)})
    stated = rng.choice([0.0, 0.5, 1.0])
    sensors = tuple(
        (
            kind,
            node,
            str(rng.choice([*UNITS[kind]])),
            float(10.0 ** rng.uniform(-6, -2)),
            bool(rng.random() < stated),
        )
        for kind, node in spots
    )
    rig = Rig(tuple(masses.tolist()), tuple(elements), forces, sensors, 1.0, "")
    fastest = float(np.abs(np.linalg.eigvals(rig.generator()[0])).max())
    rate = fastest / 2 / np.pi * rng.choice([3.0, 10.0, 30.0, 300.0])
    rate = 1000.0 if rng.random() < 0.25 else float(f"{rate:.4g}")
    return Rig(rig.masses, rig.elements, forces, sensors, rate, _estimator(rng, rate))


def _estimator(rng: np.random.Generator, rate: float) -> str:
    window, hop = WINDOW / rate, WINDOW / 5 / rate
    lengths = f"[{window!r}, {2 * window!r}]" if rng.random() < 0.2 else repr(window)
    lines = [f"window_s = {lengths}", f"hop_s = {hop!r}", f'hold = "{rng.choice(["first", "zero"])}"']
    if rng.random() < 0.2:
        lines.append(f'observer = {{ gain = "kalman", process_sd = {10.0 ** rng.uniform(-6, 2)!r} }}')
    return "\n".join(lines)


def name(node: int) -> str:
    """The node's name in the configuration."""
    return "ground" if node == GROUND else f"m{node}"


def configuration(rig: Rig, noise: FloatArray) -> str:
    """Write the rig as a configuration; noise (p,) is the sd of each sensor, SI."""
    lines = [f'[rig]\nname = "fuzz"\nsample_rate_hz = {rig.rate_hz!r}\nclock = "uniform"\n\n[model]']
    lines.append(_rows("mass", [f'name = "m{i}", value = {m!r}' for i, m in enumerate(rig.masses, 1)]))
    for kind, letter in (("spring", "k"), ("damper", "B")):
        rows = [
            f'name = "{letter}{i}", between = {[name(end) for end in e.ends]}, '
            f"nominal = {getattr(e, letter)!r}"
            for i, e in enumerate(rig.elements, 1)
        ]
        lines.append(_rows(kind, rows))
    lines += [
        f'\n[[channel]]\nname = "f{node}"\nquantity = "force"\nat = "m{node}"\nunit = "N"'
        for node in rig.forces
    ]
    for (quantity, node, unit, _, stated), sd in zip(rig.sensors, noise.tolist(), strict=True):
        lines.append(f'\n[[channel]]\nname = "{quantity[0]}{node}"\nquantity = "{quantity}"')
        lines.append(f'at = "m{node}"\nunit = "{unit}"')
        lines += [f"noise_sd = {sd / UNITS[quantity][unit]!r}"] if stated else []
    return "\n".join([*lines, "", "[estimator]", rig.estimator, ""])


def _rows(kind: str, rows: list[str]) -> str:
    return f"{kind} = [{', '.join(f'{{ {row} }}' for row in rows)}]"


def recording(rig: Rig, rng: np.random.Generator) -> tuple[dict[str, FloatArray], FloatArray]:
    """Return the columns of a recording, in the channels' units, and the noise sd (p,) of each sensor, SI."""
    A, B = rig.generator()
    n, m = len(rig.masses), len(rig.forces)
    step = expm(np.block([[A, B], [np.zeros((m, 2 * n + m))]]) / rig.rate_hz)
    u = rng.normal(0.0, 1.0, (SAMPLES, m))
    x = np.empty((SAMPLES, 2 * n))
    x[0] = rng.normal(0.0, 0.01, 2 * n)
    for k in range(SAMPLES - 1):
        x[k + 1] = step[: 2 * n, : 2 * n] @ x[k] + step[: 2 * n, 2 * n :] @ u[k]
    moved = np.hstack([x, x @ A[n:].T + u @ B[n:].T])
    columns = {f"f{node}": u[:, i] for i, node in enumerate(rig.forces)}
    noise = []
    for quantity, node, unit, share, _ in rig.sensors:
        signal = moved[:, list(UNITS).index(quantity) * n + node - 1]
        noise.append(float(share * np.sqrt(np.mean(signal**2)) + 1e-12))
        columns[f"{quantity[0]}{node}"] = (signal + rng.normal(0.0, noise[-1], SAMPLES)) / UNITS[quantity][
            unit
        ]
    return columns, np.array(noise)


def written(folder: Path, seed: int) -> tuple[Path, Path]:
    """Write configuration and recording of the rig of a seed; return their paths."""
    rng = np.random.default_rng([12, seed])
    rig = random_rig(rng)
    columns, noise = recording(rig, rng)
    config, record = folder / f"{seed}.toml", folder / f"{seed}.npz"
    config.write_text(configuration(rig, noise), encoding="utf-8")
    np.savez(record, t=np.arange(SAMPLES) / rig.rate_hz, **columns)
    return config, record
