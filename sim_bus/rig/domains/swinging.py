"""Chains of inertias and frames of beams: M q'' + D q' + K q = f from their energies."""

import numpy as np
from scipy.linalg import null_space

from sim_bus.arrays import FloatArray
from sim_bus.rig.domains.built import Built, Place, Raw, Values, swinging

HELD = {"free": "", "slide": "y", "pinned": "xy", "clamped": "xyt"}
GAUSS = np.polynomial.legendre.leggauss(4)


def torsional_values(raw: Raw) -> dict[str, float]:
    """Return inertias, shafts and bearings."""
    return {
        row["name"]: row["nominal"] for key in ("inertia", "shaft", "bearing") for row in raw.get(key, ())
    }


def torsional(raw: Raw, values: Values) -> Built:
    """Return the chain; each shaft and bearing sees the difference of two angles, a gear's by its ratio."""
    names = tuple(row["name"] for row in raw["inertia"])
    f = len(names)
    seen = {row["name"]: _twist(row, names) for key in ("shaft", "bearing") for row in raw.get(key, ())}
    K, D = (_sum(raw.get(key, ()), values, seen, f) for key in ("shaft", "bearing"))  # noqa: N806 - letters of the books
    F, inverse, states = swinging(np.diag([values[name] for name in names]), D, K, names)  # noqa: N806 - a letter
    drives, reads = {}, {}
    for i, name in enumerate(names):
        drives["torque", name] = np.concatenate([inverse[:, i], np.zeros(f)])
        reads["speed", name], reads["angle", name] = np.eye(2 * f)[i], np.eye(2 * f)[f + i]
    for row in raw.get("shaft", ()):
        torque = values[row["name"]] * seen[row["name"]]
        reads["torque", row["name"]] = np.concatenate([np.zeros(f), torque])
    return Built(states, F, drives, reads)


def _twist(row: Raw, names: tuple[str, ...]) -> FloatArray:
    one, other = row["between"]
    return np.array([float(name == one) - row.get("ratio", 1.0) * float(name == other) for name in names])


def _sum(rows: tuple[Raw, ...], values: Values, seen: dict[str, FloatArray], size: int) -> FloatArray:
    parts = [values[row["name"]] * np.outer(seen[row["name"]], seen[row["name"]]) for row in rows]
    return np.asarray(sum(parts, np.zeros((size, size))))


def frame_values(raw: Raw) -> dict[str, float]:
    """Return EI and mass a metre of each beam, and tau."""
    values = {row["name"]: row["nominal"] for row in raw["beam"]}
    values |= {f"{row['name']}.mass": row["mass_per_m"] for row in raw["beam"]}
    return values | ({"tau": raw["damping_s"]} if raw.get("damping_s") else {})


def frame(raw: Raw, values: Values) -> Built:
    """Return a frame whose beams bend and do not stretch: its energies by integration over each beam."""
    nodes = {row["name"]: i for i, row in enumerate(raw["node"])}
    size = 3 * len(nodes)
    at = np.array([row["at"] for row in raw["node"]], dtype=float)
    held = [
        np.eye(size)[3 * i + "xyt".index(c)]
        for i, row in enumerate(raw["node"])
        for c in HELD[row.get("support", "free")]
    ]
    M, K = np.zeros((size, size)), np.zeros((size, size))  # noqa: N806 - letters of the books
    for row in raw["beam"]:
        one, other = (nodes[end] for end in row["between"])
        stretch, mass, stiffness = _beam(one, other, at, size)
        held.append(stretch)
        M += values[f"{row['name']}.mass"] * mass  # noqa: N806 - a letter of the books
        K += values[row["name"]] * stiffness  # noqa: N806 - a letter of the books
    for i, row in enumerate(raw["node"]):
        M[[3 * i, 3 * i + 1], [3 * i, 3 * i + 1]] += row.get("mass", 0.0)
    Z = null_space(np.array(held))  # noqa: N806 - a letter of the books
    K = Z.T @ K @ Z  # noqa: N806 - a letter of the books
    names = tuple(f"motion {i + 1}" for i in range(Z.shape[1]))
    F, inverse, states = swinging(Z.T @ M @ Z, values.get("tau", 0.0) * K, K, names)  # noqa: N806 - a letter
    drives, reads = _places(list(nodes), Z, inverse)
    return Built(states, F, drives, reads)


def _beam(one: int, other: int, at: FloatArray, size: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return how it would stretch (size,), and its mass and stiffness (size, size) for 1 kg/m and EI = 1."""
    length = float(np.linalg.norm(at[other] - at[one]))
    c, s = (at[other] - at[one]) / length
    along, across, turn = (np.zeros((2, size)) for _ in range(3))
    for row, node in enumerate((one, other)):
        along[row, 3 * node : 3 * node + 2] = c, s
        across[row, 3 * node : 3 * node + 2] = -s, c
        turn[row, 3 * node + 2] = 1.0
    mass, stiffness = np.zeros((size, size)), np.zeros((size, size))
    for point, weight in zip(*GAUSS, strict=True):
        x = (1 + point) / 2
        straight = (1 - x) * along[0] + x * along[1]
        bent = (1 - 3 * x**2 + 2 * x**3) * across[0] + (3 * x**2 - 2 * x**3) * across[1]
        bent = bent + length * ((x - 2 * x**2 + x**3) * turn[0] + (x**3 - x**2) * turn[1])
        curve = (
            (12 * x - 6) * (across[0] - across[1]) + length * ((6 * x - 4) * turn[0] + (6 * x - 2) * turn[1])
        ) / (length**2)
        mass += weight * length / 2 * (np.outer(straight, straight) + np.outer(bent, bent))
        stiffness += weight * length / 2 * np.outer(curve, curve)
    return along[1] - along[0], mass, stiffness


def _places(
    nodes: list[str],
    Z: FloatArray,  # noqa: N803 - a letter of the books
    inverse: FloatArray,
) -> tuple[dict[Place, FloatArray], dict[Place, FloatArray]]:
    drives: dict[Place, FloatArray] = {}
    reads: dict[Place, FloatArray] = {}
    nothing = np.zeros(Z.shape[1])
    for i, row in enumerate(Z):
        node, motion = nodes[i // 3], "xyt"[i % 3]
        words = ("torque", "angle", "speed") if motion == "t" else ("force", "displacement", "velocity")
        place = node if motion == "t" else f"{node}.{motion}"
        if np.abs(row).max(initial=0.0) > 1e-9:
            drives[words[0], place] = np.concatenate([inverse @ row, nothing])
            reads[words[1], place] = np.concatenate([nothing, row])
            reads[words[2], place] = np.concatenate([row, nothing])
    return drives, reads
