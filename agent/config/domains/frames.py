"""Frames in a plane of beams that bend and do not stretch (Euler-Bernoulli): EI of each beam is watched.

Cubic shapes between nodes give each beam its stiffness EI and its mass a metre (Przemieniecki, Theory of
Matrix Structural Analysis, 1968, chapters 5 and 11); that no beam changes its length leaves fewer motions
than nodes have.
"""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, ClassVar, Final, Literal

from pydantic import Field

from agent.config.domains.plant import Domain, Fact, Link, Plant, loose, twice
from agent.config.reading.fields import Name, NotNegative, Number, Positive, Table, shown
from agent.config.tuning import ROUND_OFF

if TYPE_CHECKING:
    from agent.types import BoolArray, FloatArray


def bending(length: float) -> "FloatArray":
    """Return the stiffness of a beam of EI = 1, (6, 6), along each end left out."""
    import numpy as np

    a = length
    inner = np.array([[12, 6 * a, -12, 6 * a], [6 * a, 4 * a * a, -6 * a, 2 * a * a]]) / a**3
    other = np.array([[-12, -6 * a, 12, -6 * a], [6 * a, 2 * a * a, -6 * a, 4 * a * a]]) / a**3
    return _placed(np.vstack([inner, other]), np.zeros((2, 2)))


def weight(length: float) -> "FloatArray":
    """Return the consistent mass of a beam of 1 kg/m, (6, 6)."""
    import numpy as np

    a = length
    one = [[156, 22 * a, 54, -13 * a], [22 * a, 4 * a * a, 13 * a, -3 * a * a]]
    other = [[54, 13 * a, 156, -22 * a], [-13 * a, -3 * a * a, -22 * a, 4 * a * a]]
    return _placed(np.array(one + other) * a / 420, np.array([[2.0, 1.0], [1.0, 2.0]]) * a / 6)


def _placed(across: "FloatArray", along: "FloatArray") -> "FloatArray":
    """Return (6, 6) of a beam from its bending part and its part along."""
    import numpy as np

    whole = np.zeros((6, 6))
    whole[np.ix_([1, 2, 4, 5], [1, 2, 4, 5])] = across
    whole[np.ix_([0, 3], [0, 3])] = along
    return whole


def unit(place: int, count: int) -> "FloatArray":
    """Return (count,) zeros with a 1 at a place."""
    import numpy as np

    return np.asarray(np.eye(count)[place])


def kernel(rows: "FloatArray") -> "FloatArray":
    """Return a basis (count, f) of what rows @ z = 0 leaves free, each vector 1 where all others are 0."""
    import numpy as np

    left = rows.copy()
    pivots: list[tuple[int, int]] = []
    for column in range(rows.shape[1] - 1, -1, -1):
        free = [i for i in range(len(left)) if i not in [row for row, _ in pivots]]
        best = max(free, key=lambda i: abs(left[i, column]), default=None)
        if best is None or abs(left[best, column]) < ROUND_OFF:
            continue
        left[best] /= left[best, column]
        others = [i for i in range(len(left)) if i != best]
        left[others] -= np.outer(left[others, column], left[best])
        pivots.append((best, column))
    held = {column: row for row, column in pivots}
    basis = [unit(place, rows.shape[1]) for place in range(rows.shape[1]) if place not in held]
    for vector in basis:
        for column, row in held.items():
            vector[column] = -left[row] @ np.where(np.isin(np.arange(len(vector)), list(held)), 0.0, vector)
    return np.array(basis).T.reshape(rows.shape[1], -1)


MOTIONS: Final = ("x", "y", "turn")
HELD: Final = {"free": (), "slide": (1,), "pinned": (0, 1), "clamped": (0, 1, 2)}


class Node(Table):
    """Where beams meet: at (x, y) in m, held or free, with a mass of its own, kg."""

    name: Name
    at: Annotated[tuple[Number, Number], Field(strict=False)]
    support: Literal["free", "slide", "pinned", "clamped"] = "free"
    mass: NotNegative = 0.0


class Beam(Link):
    """A beam: EI in N m2, and its mass a metre, kg/m, called <name>.mass."""

    KEYS: ClassVar[Mapping[str, str]] = {"": "nominal", ".mass": "mass_per_m"}

    nominal: Positive
    mass_per_m: Positive


class Frame(Domain):
    """Beams between nodes. damping_s, called tau: forces of tau times those of the stiffness, by velocities.

    A place is a node with its direction, "tip.y"; turning ("angle", "torque") is at the node itself, "tip".
    """

    kind: Literal["frame"]
    node: tuple[Node, ...] = ()
    beam: tuple[Beam, ...] = ()
    damping_s: NotNegative = 0.0

    def facts(self) -> Iterator[Fact]:
        """Yield what is wrong between values."""
        wrong = list(twice({"node": self.node, "beam": self.beam}))
        wrong += loose("beam", self.beam, [node.name for node in self.node])
        joined = {end for beam in self.beam for end in beam.between}
        wrong += [
            Fact(f"node[{i}]", f"no beam ends at {shown(node.name)}", "join it to another node, or remove it")
            for i, node in enumerate(self.node)
            if node.name not in joined
        ]
        yield from wrong
        if wrong:
            return
        places = {node.name: node.at for node in self.node}
        if any(places.get(a) == places.get(b) for a, b in (beam.between for beam in self.beam)):
            yield Fact("beam", "one has no length: its nodes are at the same place", "move one of them")
        elif not self.beam or not self._motions().shape[1]:
            yield Fact("beam", "nothing can move", "add a beam, or leave a node free")

    def place_of(self, name: str) -> tuple[str | int, ...]:
        """Return where an element's value stands."""
        return ("damping_s",) if name == "tau" else super().place_of(name)

    def _motions(self) -> "FloatArray":
        """Return (3 nodes, f) how every node moves with each of f motions that no support or beam forbids."""
        import numpy as np

        rows = [
            unit(3 * i + j, 3 * len(self.node))
            for i, node in enumerate(self.node)
            for j in HELD[node.support]
        ]
        rows += [np.array([1.0, 0, 0, -1.0, 0, 0]) @ self._seen(beam) for beam in self.beam]
        return kernel(np.array(rows))

    def _seen(self, beam: Beam) -> "FloatArray":
        """Return (6, 3 nodes): along, across and turn of a beam's first end, then of its second."""
        import numpy as np

        names = [node.name for node in self.node]
        one, other = (names.index(end) for end in beam.between)
        along = np.subtract(self.node[other].at, self.node[one].at)
        c, s = along / np.hypot(*along)
        seen = np.zeros((6, 3 * len(names)))
        for row, node in ((0, one), (3, other)):
            seen[row : row + 3, 3 * node : 3 * node + 3] = [[c, s, 0], [-s, c, 0], [0, 0, 1]]
        return seen

    def _length(self, beam: Beam) -> float:
        import numpy as np

        ends = {node.name: node.at for node in self.node}
        return float(np.hypot(*np.subtract(ends[beam.between[0]], ends[beam.between[1]])))

    def plant(self, quantities: frozenset[str]) -> Plant:
        """Return the frame: velocities, then displacements, of the motions that are free."""
        import numpy as np

        plant = Plant()
        Z = self._motions()  # noqa: N806 - a letter of the books
        named = [_dof(self.node, int(row)) for row in np.argmax(np.isclose(Z, 1.0) & _lone(Z), axis=0)]
        f = len(named)
        for name in named:
            turns = "." not in name
            plant.state(f"velocity of {name}", "rad/s" if turns else "m/s", push="N m" if turns else "N")
        for i, name in enumerate(named):
            plant.state(f"displacement of {name}", "rad" if "." not in name else "m", {})
            plant.flow(f + i, i, 1.0)
        self._fill(plant, Z)
        _open(plant, self.node, Z)
        return plant

    def _fill(self, plant: Plant, Z: "FloatArray") -> None:  # noqa: N803 - a letter of the books
        """Put stiffness, damping and mass of the beams and nodes into the equations."""
        import numpy as np

        f = Z.shape[1]
        tau = {plant.part("tau", self.damping_s, "s"): 1} if self.damping_s > 0 else {}
        for beam in self.beam:
            EI = plant.part(beam.name, beam.nominal, "N m2")  # noqa: N806 - letters of the books
            mu = plant.part(f"{beam.name}.mass", beam.mass_per_m, "kg/m", stores=True)
            T = self._seen(beam) @ Z  # noqa: N806 - a letter of the books
            length = self._length(beam)
            for i, j in np.ndindex(f, f):
                stiffness = float((T.T @ bending(length) @ T)[i, j])
                plant.flow(i, f + j, -stiffness, {EI: 1})
                if tau:
                    plant.flow(i, j, -stiffness, {EI: 1, **tau})
                plant.inert(i, j, float((T.T @ weight(length) @ T)[i, j]), {mu: 1})
        for number, node in enumerate(self.node):
            moved = Z[3 * number : 3 * number + 2]
            for i, j in np.ndindex(f, f):
                plant.inert(i, j, node.mass * float((moved.T @ moved)[i, j]), {})


def _lone(Z: "FloatArray") -> "BoolArray":  # noqa: N803 - a letter of the books
    """Tell (3 nodes, 1) which rows move with one motion only."""
    import numpy as np

    return np.asarray(np.count_nonzero(np.abs(Z) > ROUND_OFF, axis=1) == 1)[:, None]


def _dof(nodes: tuple[Node, ...], row: int) -> str:
    node, motion = nodes[row // 3].name, MOTIONS[row % 3]
    return node if motion == "turn" else f"{node}.{motion}"


def _open(plant: Plant, nodes: tuple[Node, ...], Z: "FloatArray") -> None:  # noqa: N803 - a letter of the books
    """Let forces act and displacements be read wherever a node can move."""
    f = Z.shape[1]
    for row, moved in enumerate(Z.tolist()):
        place = _dof(nodes, row)
        effort, motion, speed = (
            ("torque", "angle", "speed") if "." not in place else ("force", "displacement", "velocity")
        )
        for i, share in enumerate(moved):
            if abs(share) > ROUND_OFF:
                plant.drive((effort, place), i, share)
                plant.read((motion, place), f + i, share)
                plant.read((speed, place), i, share)
