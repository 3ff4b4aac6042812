"""Rings and branches, several forces, velocities and accelerations, a massless node: from a recording to
estimates."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm

from agent.runtime.replay import replay
from tests.replay.records import Replayed, rows_of

FloatArray = NDArray[np.float64]
RATE_HZ = 500.0
Part = tuple[str, str, str, float]
"""Name, two nodes, value."""


@dataclass(frozen=True)
class Rig:
    """A rig to play: nodes with their masses, elements, forces, and what is read where."""

    masses: dict[str, float]
    springs: list[Part]
    dampers: list[Part]
    forces: list[str]
    readings: list[tuple[str, str, float]]
    estimate: list[str] = field(default_factory=list)

    def matrix(self, parts: list[Part]) -> FloatArray:
        """Return the stiffness or damping matrix, by adding each element's two by two block."""
        nodes = list(self.masses)
        total = np.zeros((len(nodes) + 1, len(nodes) + 1))  # the last row and column are ground
        for _, first, second, value in parts:
            a, b = (nodes.index(n) if n != "ground" else len(nodes) for n in (first, second))
            total[[a, b], [a, b]] += value
            total[[a, b], [b, a]] -= value
        return total[:-1, :-1]


def equations(rig: Rig) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return x' and the accelerations as matrices of (places, velocities of nodes with mass, forces)."""
    K, B = rig.matrix(rig.springs), rig.matrix(rig.dampers)
    m = np.array(list(rig.masses.values()))
    N, heavy, light = len(m), np.flatnonzero(m > 0), np.flatnonzero(m == 0)
    F = np.array([[float(node == name) for name in rig.forces] for node in rig.masses])
    n = N + len(heavy)
    V = np.zeros((N, n + F.shape[1]))  # velocity of every node
    V[heavy, N + np.arange(len(heavy))] = 1.0
    pull = np.hstack([-K, np.zeros((N, len(heavy))), F])  # all forces but those of dampers
    if len(light):
        V[light] = np.linalg.solve(B[np.ix_(light, light)], (pull - B[:, heavy] @ V[heavy])[light])
    acceleration = (pull - B @ V)[heavy] / m[heavy, None]
    return np.vstack([V, acceleration]), V, acceleration


def played(rig: Rig, seconds: float, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return forces (n, m) and readings (n, p) under smooth random forces, straight between samples."""
    slope, V, acceleration = equations(rig)
    nodes = list(rig.masses)
    heavy = [node for node in nodes if rig.masses[node] > 0]
    n, m, count = len(slope), len(rig.forces), round(seconds * RATE_HZ)
    generator = np.zeros((n + 2 * m, n + 2 * m))
    generator[:n, : n + m] = slope / RATE_HZ
    generator[n : n + m, n + m :] = np.eye(m)
    step = expm(generator)
    raw = rng.normal(0.0, 30.0, (count + 20, m))
    u = np.stack([np.convolve(raw[:, j], np.ones(5) / 5.0, "valid")[:count] for j in range(m)], axis=1)
    x, y = np.zeros(n), np.empty((count, len(rig.readings)))
    for k in range(count):
        both = np.concatenate([x, u[k]])
        for r, (quantity, node, _) in enumerate(rig.readings):
            rows = {"displacement": x[nodes.index(node)], "velocity": V[nodes.index(node)] @ both}
            if quantity == "acceleration":
                rows[quantity] = acceleration[heavy.index(node)] @ both
            y[k, r] = rows[quantity]
        change = (u[k + 1] if k + 1 < count else u[k]) - u[k]
        x = step[:n] @ np.concatenate([both, change])
    return u, y + rng.normal(0.0, 1.0, y.shape) * [sd for _, _, sd in rig.readings]


def configuration(rig: Rig, off: float) -> str:
    """Return a configuration of the rig whose estimated parameters are off by up to a share `off`."""
    unit = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s2"}

    def shifted(name: str, value: float) -> float:
        return (
            value * (1.0 + off * np.sin(7.0 * len(name) + ord(name[-1]))) if name in rig.estimate else value
        )

    def parts(kind: str, rows: list[Part]) -> str:
        cells = (
            f'{{ name = "{name}", between = ["{a}", "{b}"], nominal = {shifted(name, value)} }}'
            for name, a, b, value in rows
        )
        return f"{kind} = [{', '.join(cells)}]"

    masses = ", ".join(f'{{ name = "{k}", value = {shifted(k, v)} }}' for k, v in rig.masses.items())
    lines = [
        f'[rig]\nname = "graph"\nsample_rate_hz = {RATE_HZ}\nclock = "device"\n[model]',
        f"mass = [{masses}]",
    ]
    lines += [parts("spring", rig.springs), parts("damper", rig.dampers)]
    for j, node in enumerate(rig.forces):
        lines.append(f'[[channel]]\nname = "f{j}"\nquantity = "force"\nat = "{node}"\nunit = "N"')
    for r, (quantity, node, sd) in enumerate(rig.readings):
        lines.append(
            f'[[channel]]\nname = "y{r}"\nquantity = "{quantity}"\nat = "{node}"\nunit = "{unit[quantity]}"'
        )
        lines.append(f"noise_sd = {sd}")
    names = ", ".join(f'"{name}"' for name in rig.estimate)
    return "\n".join(
        [*lines, f"[estimator]\nwindow_s = 4.0\nhop_s = 0.5\nresolve = 3.0\nestimate = [{names}]", ""]
    )


def replayed_rig(rig: Rig, folder: Path, rng: np.random.Generator) -> Replayed:
    u, y = played(rig, 30.0, rng)
    head = ["t", *(f"f{j}" for j in range(u.shape[1])), *(f"y{r}" for r in range(y.shape[1]))]
    recording, config, database = folder / "played.csv", folder / "graph.toml", folder / "played.db"
    table = np.column_stack([np.arange(len(u)) / RATE_HZ, u, y])
    np.savetxt(recording, table, delimiter=",", header=",".join(head), comments="", fmt="%.12g")
    config.write_text(configuration(rig, 0.1), encoding="utf-8")
    return Replayed(replay(config=config, recordings=[recording], db=database), rows_of(database))


RING = Rig(
    {"a": 2.0, "b": 3.0, "c": 1.5},
    [("k1", "ground", "a", 800.0), ("k2", "a", "b", 500.0), ("k3", "b", "c", 600.0), ("k4", "c", "a", 400.0)],
    [("B1", "ground", "a", 6.0), ("B2", "a", "b", 4.0), ("B3", "b", "c", 3.0), ("B4", "c", "a", 5.0)],
    ["b"],
    [("displacement", "a", 1e-5), ("displacement", "b", 1e-5), ("displacement", "c", 1e-5)],
    ["k1", "k2", "k3", "k4", "B1", "B2", "B3", "B4"],
)
BRANCHES = Rig(
    {"trunk": 4.0, "left": 1.0, "right": 1.2},
    [("kt", "ground", "trunk", 2000.0), ("kl", "trunk", "left", 300.0), ("kr", "trunk", "right", 450.0)],
    [("Bt", "ground", "trunk", 8.0), ("Bl", "trunk", "left", 2.0), ("Br", "trunk", "right", 3.0)],
    ["trunk", "left"],
    [("displacement", "trunk", 1e-5), ("velocity", "left", 2e-4), ("acceleration", "right", 2e-2)],
    ["kt", "kl", "kr", "Bt", "Bl", "Br"],
)
WITHOUT_MASS = Rig(
    {"m": 2.0, "joint": 0.0},
    [("k1", "ground", "joint", 900.0), ("k2", "joint", "m", 700.0)],
    [("B1", "ground", "joint", 40.0), ("B2", "joint", "m", 10.0)],
    ["m"],
    [("displacement", "m", 1e-5), ("displacement", "joint", 1e-5)],
    ["k1", "k2", "B1", "B2"],
)
MAXWELL = Rig(
    {"m1": 2.0, "joint": 0.0, "m2": 3.0},
    [("k1", "ground", "m1", 800.0), ("k2", "m1", "m2", 500.0), ("k3", "m1", "joint", 600.0)],
    [("B1", "ground", "m1", 6.0), ("B2", "m1", "m2", 4.0), ("B3", "joint", "ground", 40.0)],
    ["m2"],
    [("displacement", "m1", 1e-6), ("displacement", "m2", 1e-6)],
    ["k1", "k2", "k3", "B1", "B2", "B3"],
)
"""A spring and a damper in series beside another spring; where they meet nothing weighs and nothing is
measured."""
MASSLESS = Rig(
    {"rod": 0.0},
    [("k", "ground", "rod", 900.0)],
    [("B", "ground", "rod", 60.0)],
    ["rod"],
    [("displacement", "rod", 1e-5)],
    ["k", "B"],
)
MASSES = Rig(
    {"m1": 2.0, "m2": 3.0},
    [("k1", "ground", "m1", 800.0), ("k2", "m1", "m2", 500.0)],
    [("B1", "ground", "m1", 6.0), ("B2", "m1", "m2", 4.0)],
    ["m2"],
    [("acceleration", "m1", 1e-2), ("displacement", "m2", 1e-5)],
    ["m1", "m2", "k1", "k2", "B1", "B2"],
)


RIGS = {
    "ring": RING, "branches": BRANCHES, "massless node": WITHOUT_MASS, "massless node in series": MAXWELL,
    "nothing but massless": MASSLESS, "masses": MASSES,
}  # fmt: skip


@pytest.mark.parametrize("rig", RIGS.values(), ids=list(RIGS))
def test_graph_is_recovered_with_honest_intervals(rig: Rig, tmp_path: Path) -> None:
    found = replayed_rig(rig, tmp_path, np.random.default_rng(11))
    truth = rig.masses | {name: value for name, _, _, value in (*rig.springs, *rig.dampers)}
    inside = []
    for name in rig.estimate:
        rows = [row for row in found.of(name) if row["status"] != "warming"]
        assert len(rows) > 50
        assert all(row["status"] == "valid" for row in rows), (
            name,
            {(r["status"], r["reason"]) for r in rows},
        )
        assert abs(rows[-1]["value"] / truth[name] - 1.0) < 0.1, name
        assert max(abs(row["value"] - truth[name]) / row["sd"] for row in rows) < 5.0, name
        inside += [row["lower"] <= truth[name] <= row["upper"] for row in rows]
    assert np.mean(inside) > 0.85
