"""A graph of masses, springs, dampers and dry friction as a state-space model with exact derivatives.

Nodes are masses (a mass of 0 is a massless node held by dampers) and `ground`. Elements act between two
nodes. The states are the velocities of the nodes with mass, then the displacements of all nodes, the order of
the paper's (20).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np

from agent.numerics.model.statespace import StateSpace, stacked
from agent.types import BoolArray, FloatArray

GROUND = "ground"
Quantity = Literal["displacement", "velocity", "acceleration"]


@dataclass(frozen=True, slots=True)
class Mass:
    """A node with inertia, kg."""

    name: str
    value: float


@dataclass(frozen=True, slots=True)
class Element:
    """A spring (N/m), damper (N s/m) or dry friction (N) between two nodes."""

    name: str
    between: tuple[str, str]
    nominal: float


@dataclass(frozen=True, slots=True)
class Output:
    """What a sensor reads, and where."""

    quantity: Quantity
    at: str


@dataclass(frozen=True, slots=True)
class Structure:
    """The elements of a rig."""

    masses: tuple[Mass, ...]
    springs: tuple[Element, ...]
    dampers: tuple[Element, ...]
    frictions: tuple[Element, ...] = ()


@dataclass(frozen=True)
class MassSpringDamper:
    """The parametric model of a structure.

    Attributes:
        structure: its elements; what is not estimated keeps its nominal value.
        parameters: names of the estimated elements (masses, springs, dampers, friction), q of them.
        forces: nodes that the model's force inputs act on, in order; frictions follow them as further inputs,
            each the sign of the velocity difference of its two nodes.
        outputs: what is measured, in order.
    """

    structure: Structure
    parameters: tuple[str, ...]
    forces: tuple[str, ...]
    outputs: tuple[Output, ...]
    nominal: FloatArray = field(init=False)
    _affine: StateSpace | None = field(init=False, default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        values = self._values()
        missing = [name for name in self.parameters if name not in values]
        if missing:
            raise ValueError(f"no element is called {missing}; elements are {sorted(values)}")
        object.__setattr__(self, "nominal", np.array([values[name] for name in self.parameters], dtype=float))
        if all(m.value > 0 for m in self.structure.masses):
            # at nominal masses all matrices are straight lines in the elements: assembled once, at zero
            weightless = np.where(self._is_mass, self.nominal, 0.0)
            object.__setattr__(self, "_affine", self._assembled(weightless))

    @cached_property
    def _is_mass(self) -> BoolArray:
        """(q,) which parameters are masses."""
        masses = {m.name for m in self.structure.masses}
        return np.array([name in masses for name in self.parameters], dtype=bool)

    def _values(self) -> dict[str, float]:
        s = self.structure
        return {m.name: m.value for m in s.masses} | {
            e.name: e.nominal for e in (*s.springs, *s.dampers, *s.frictions)
        }

    @cached_property
    def _divided(self) -> list[tuple[int, list[int], list[int]]]:
        """Masses among the parameters, with the states and the outputs whose rows each divides."""
        found = []
        for i in np.flatnonzero(self._is_mass).tolist():
            name = self.parameters[i]
            sensed = [o for o, output in enumerate(self.outputs) if self._accelerates(output, name)]
            found.append((i, [self.state_names.index(f"velocity of {name}")], sensed))
        return found

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states: "velocity of m1", ..., "displacement of m1", ..."""
        masses = self.structure.masses
        moving = tuple(f"velocity of {m.name}" for m in masses if m.value > 0)
        return moving + tuple(f"displacement of {m.name}" for m in masses)

    def at(self, theta: FloatArray) -> Structure:
        """Return the structure with the estimated values put in."""
        values = self._values() | dict(
            zip(self.parameters, np.asarray(theta, dtype=float).tolist(), strict=True)
        )

        def moved(elements: tuple[Element, ...]) -> tuple[Element, ...]:
            return tuple(replace(e, nominal=values[e.name]) for e in elements)

        s = self.structure
        masses = tuple(replace(m, value=values[m.name]) for m in s.masses)
        return Structure(masses, moved(s.springs), moved(s.dampers), moved(s.frictions))

    def continuous(self, theta: FloatArray) -> StateSpace:
        """Return A, B, C, D at theta (q,) and their derivatives by each parameter."""
        base = self._affine
        if base is None:
            return self._assembled(theta)
        row = np.where(self._is_mass, 0.0, theta)[None]
        A, B, C, D = (
            matrix + np.dot(row, slope.reshape(len(theta), matrix.size)).reshape(matrix.shape)
            for matrix, slope in ((base.A, base.dA), (base.B, base.dB), (base.C, base.dC), (base.D, base.dD))
        )
        straight = StateSpace(A, B, C, D, base.dA, base.dB, base.dC, base.dD)
        return self._weighed(straight, theta) if self._is_mass.any() else straight

    def _weighed(self, at: StateSpace, theta: FloatArray) -> StateSpace:
        """Put theta's masses in place of the nominal ones: a mass divides its row, and what senses it."""
        dA, dB, dC, dD = at.dA.copy(), at.dB.copy(), at.dC.copy(), at.dD.copy()
        for i, moved, sensed in self._divided:
            lighter = self.nominal[i] / theta[i]
            for matrix, slope, rows in (
                (at.A, dA, moved), (at.B, dB, moved), (at.C, dC, sensed), (at.D, dD, sensed),
            ):  # fmt: skip
                for row in rows:
                    matrix[row] *= lighter
                    slope[:, row] *= lighter
                    slope[i, row] = -matrix[row] / theta[i]
        return StateSpace(at.A, at.B, at.C, at.D, dA, dB, dC, dD)

    @staticmethod
    def _accelerates(output: Output, mass: str) -> bool:
        return output.quantity == "acceleration" and output.at == mass

    def _assembled(self, theta: FloatArray) -> StateSpace:
        """Return the same from the elements one by one."""
        equations = _Equations(self.at(theta), self.forces)
        A, B = equations.matrices()
        derivatives = [equations.derivative(name) for name in self.parameters]
        dA = stacked(A.shape, [d[0] for d in derivatives])
        dB = stacked(B.shape, [d[1] for d in derivatives])
        C, D = self._sense(A, B)
        sensed = [self._sense(*d, constant=0.0) for d in derivatives]
        dC = stacked(C.shape, [s[0] for s in sensed])
        dD = stacked(D.shape, [s[1] for s in sensed])
        return StateSpace(A, B, C, D, dA, dB, dC, dD)

    def _sense(self, A: FloatArray, B: FloatArray, constant: float = 1.0) -> tuple[FloatArray, FloatArray]:
        """Output rows: a displacement is a state, a velocity or acceleration a row of x' = A x + B u."""
        rows = [self._output_row(output, A, B, constant) for output in self.outputs]
        return np.array([row[0] for row in rows]), np.array([row[1] for row in rows])

    def _output_row(
        self, output: Output, A: FloatArray, B: FloatArray, constant: float
    ) -> tuple[FloatArray, FloatArray]:
        names = self.state_names
        displacement = names.index(f"displacement of {output.at}")
        if output.quantity == "displacement":
            return constant * np.eye(len(names))[displacement], np.zeros(B.shape[1])
        if output.quantity == "velocity":
            return A[displacement], B[displacement]
        velocity = f"velocity of {output.at}"
        if velocity not in names:
            raise ValueError(f"{output.at} has no mass: its acceleration is not defined")
        return A[names.index(velocity)], B[names.index(velocity)]


class _Equations:
    """M a = f - K x - B v with the massless nodes' velocities eliminated, for one set of values.

    With a the nodes with mass and b those without: v_b = S (f_b - K_b x - B_ba v_a), S = inv(B_bb).
    """

    def __init__(self, structure: Structure, forces: Sequence[str]) -> None:
        self.structure = structure
        self.nodes = [m.name for m in structure.masses]
        values = np.array([m.value for m in structure.masses])
        self.a, self.b = np.flatnonzero(values > 0), np.flatnonzero(values <= 0)
        self.mass = values[self.a]
        self.K = self._assemble(structure.springs)
        self.B = self._assemble(structure.dampers)
        self.F = self._input_matrix(forces)
        self.S = np.linalg.inv(self.B[np.ix_(self.b, self.b)])

    def _direction(self, between: tuple[str, str]) -> FloatArray:
        """(N,) +1 at the first node, -1 at the second; ground has no entry."""
        direction = np.zeros(len(self.nodes))
        for node, sign in zip(between, (1.0, -1.0), strict=True):
            if node != GROUND:
                direction[self.nodes.index(node)] += sign
        return direction

    def _assemble(self, elements: Sequence[Element]) -> FloatArray:
        total = np.zeros((len(self.nodes), len(self.nodes)))
        for element in elements:
            direction = self._direction(element.between)
            total += element.nominal * np.outer(direction, direction)
        return total

    def _input_matrix(self, forces: Sequence[str]) -> FloatArray:
        columns = [self._direction((node, GROUND)) for node in forces]
        columns += [-e.nominal * self._direction(e.between) for e in self.structure.frictions]
        return np.array(columns).reshape(-1, len(self.nodes)).T

    def _rows(
        self, K: FloatArray, B: FloatArray, F: FloatArray, Kb: FloatArray, Bba: FloatArray, Fb: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Rows of v_b = -[Bba, Kb] x + Fb u and forces on the masses, given pieces with S already applied."""
        a, b = self.a, self.b
        vb_x = np.hstack([-Bba, -Kb])
        Bab = B[np.ix_(a, b)]
        force_x = np.hstack([-B[np.ix_(a, a)], -K[a]]) - Bab @ vb_x
        return np.vstack([force_x, vb_x]), np.vstack([F[a] - Bab @ Fb, Fb])

    def matrices(self) -> tuple[FloatArray, FloatArray]:
        """Return A (n, n) and B (n, inputs)."""
        a, b, S = self.a, self.b, self.S
        x, u = self._rows(self.K, self.B, self.F, S @ self.K[b], S @ self.B[np.ix_(b, a)], S @ self.F[b])
        return self._first_order(x / self._inertia(), u / self._inertia(), constant=1.0)

    def _inertia(self) -> FloatArray:
        return np.concatenate([self.mass, np.ones(len(self.b))])[:, None]

    def _first_order(self, x: FloatArray, u: FloatArray, constant: float) -> tuple[FloatArray, FloatArray]:
        """Put rows a_a and v_b in place of v_a' and x_b'; x_a' = v_a fills the rest (not in derivatives)."""
        na, N = len(self.a), len(self.nodes)
        A, B = np.zeros((na + N, na + N)), np.zeros((na + N, u.shape[1]))
        A[:na], B[:na] = x[:na], u[:na]
        A[na + self.a, np.arange(na)] = constant
        A[na + self.b], B[na + self.b] = x[na:], u[na:]
        return A, B

    def derivative(self, name: str) -> tuple[FloatArray, FloatArray]:
        """Return dA (n, n) and dB (n, inputs) by the element called name, by the product rule."""
        zero, nothing = np.zeros_like(self.K), np.zeros_like(self.F)
        for element in self.structure.springs:
            if element.name == name:
                return self._change(self._unit(element), zero, nothing)
        for element in self.structure.dampers:
            if element.name == name:
                return self._change(zero, self._unit(element), nothing)
        for i, element in enumerate(self.structure.frictions):
            if element.name == name:
                dF = nothing.copy()
                dF[:, dF.shape[1] - len(self.structure.frictions) + i] = -self._direction(element.between)
                return self._change(zero, zero, dF)
        return self._mass_derivative(name)

    def _unit(self, element: Element) -> FloatArray:
        direction = self._direction(element.between)
        return np.outer(direction, direction)

    def _change(self, dK: FloatArray, dB: FloatArray, dF: FloatArray) -> tuple[FloatArray, FloatArray]:
        a, b, S = self.a, self.b, self.S
        dS = -S @ dB[np.ix_(b, b)] @ S
        Bba, dBba = self.B[np.ix_(b, a)], dB[np.ix_(b, a)]
        x0, u0 = self._rows(self.K, self.B, self.F, S @ self.K[b], S @ Bba, S @ self.F[b])
        dKb, dBb, dFb = dS @ self.K[b] + S @ dK[b], dS @ Bba + S @ dBba, dS @ self.F[b] + S @ dF[b]
        # the derivative of -Bab v_b has two parts: with dv_b (in _rows) and with dBab times v_b (added here)
        x = np.vstack([np.hstack([-dB[np.ix_(a, a)], -dK[a]]), np.hstack([-dBb, -dKb])])
        u = np.vstack([dF[a], dFb])
        na = len(a)
        Bab = self.B[np.ix_(a, b)]
        dBab = dB[np.ix_(a, b)]
        x[:na] -= Bab @ x[na:] + dBab @ x0[na:]
        u[:na] -= Bab @ u[na:] + dBab @ u0[na:]
        return self._first_order(x / self._inertia(), u / self._inertia(), constant=0.0)

    def _mass_derivative(self, name: str) -> tuple[FloatArray, FloatArray]:
        row = self.a.tolist().index(self.nodes.index(name))
        A, B = self.matrices()
        dA, dB = np.zeros_like(A), np.zeros_like(B)
        dA[row], dB[row] = -A[row] / self.mass[row], -B[row] / self.mass[row]
        return dA, dB
