"""State space of a plant whose elements stand in its equations as products of powers, with exact derivatives.

E(θ) x' = F(θ) x + G(θ) u and y = H(θ) x + J(θ) u with an invertible E; each entry is a sum of terms c θ_1^a
θ_2^b ... (an inductance in E, a resistance in F, its inverse where it lies across a voltage). By the product
rule A = E^-1 F, dA = E^-1 (dF - dE A), B likewise; nothing is linearised.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np

from agent.numerics.model.statespace import StateSpace, stacked
from agent.types import FloatArray, IntArray

LETTERS: Final = "EFGHJ"
READING: Final = LETTERS.index("H")


class Size(NamedTuple):
    """Numbers of states, inputs and outputs."""

    n: int
    m: int
    p: int


@dataclass(frozen=True, slots=True)
class Terms:
    """The terms of all five matrices, T of them, in P constants.

    Attributes:
        matrix: (T,) which of E, F, G, H, J a term is added to, as its number in that order.
        row, column: (T,) where.
        coefficient: (T,) the numbers c.
        powers: (T, P) exponents of the constants.
    """

    matrix: IntArray
    row: IntArray
    column: IntArray
    coefficient: FloatArray
    powers: FloatArray

    def at(self, values: FloatArray) -> FloatArray:
        """Return (T,) the terms for constants (P,)."""
        return np.asarray(self.coefficient * np.prod(np.power(values, self.powers), axis=1))

    def by(self, number: int, values: FloatArray) -> FloatArray:
        """Return (T,) the terms' derivatives by one constant."""
        power = self.powers[:, number]
        lowered = self.powers.copy()
        lowered[:, number] = np.where(power == 0, 0.0, power - 1.0)
        return np.asarray(power * self.coefficient * np.prod(np.power(values, lowered), axis=1))

    def matrices(self, terms: FloatArray, size: Size) -> list[FloatArray]:
        """Return E, F, G, H, J whose entries these terms (T,) add up to."""
        n, m, p = size
        found = [np.zeros(shape) for shape in ((n, n), (n, n), (n, m), (p, n), (p, m))]
        for number, matrix in enumerate(found):
            here = self.matrix == number
            np.add.at(matrix, (self.row[here], self.column[here]), terms[here])
        return found


@dataclass(frozen=True)
class DescriptorModel:
    """The parametric model of a plant of elements.

    Attributes:
        constants: names of all P elements; what is no parameter keeps its value.
        values: (P,) nominal values.
        parameters: names of those that theta holds.
        terms: the equations.
        size: states, measured inputs, outputs.
        state_names: n names.
        pushes: name and unit of each unknown effort (a voltage, a torque, heat ...) that may act.
        places: (d,) the equations that these are added to.
        forces: the same where they are further inputs of this model, behind the measured ones; else none.
    """

    constants: tuple[str, ...]
    values: FloatArray
    parameters: tuple[str, ...]
    terms: Terms
    size: Size
    state_names: tuple[str, ...]
    pushes: tuple[tuple[str, str], ...] = ()
    places: tuple[int, ...] = ()
    forces: tuple[int, ...] = ()
    nominal: FloatArray = field(init=False)
    _numbers: IntArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        numbers = np.array([self.constants.index(name) for name in self.parameters], dtype=np.int64)
        object.__setattr__(self, "_numbers", numbers)
        object.__setattr__(self, "nominal", self.values[numbers])

    def continuous(self, theta: FloatArray) -> StateSpace:
        """Return A, B, C, D at theta (q,) and their derivatives by each parameter."""
        values = self.values.copy()
        values[self._numbers] = theta
        E, F, G, H, J = self._with_forces(self.terms.matrices(self.terms.at(values), self.size), 1.0)
        inverse = np.linalg.inv(E)
        A, B = inverse @ F, inverse @ G
        slopes = [self._slopes(number, values) for number in self._numbers.tolist()]
        dA = stacked(A.shape, [inverse @ (dF - dE @ A) for dE, dF, *_ in slopes])
        dB = stacked(B.shape, [inverse @ (dG - dE @ B) for dE, _, dG, *_ in slopes])
        dC, dD = (stacked(at.shape, [slope[number] for slope in slopes]) for number, at in ((3, H), (4, J)))
        return StateSpace(A, B, H, J, dA, dB, dC, dD)

    def _slopes(self, number: int, values: FloatArray) -> Sequence[FloatArray]:
        return self._with_forces(self.terms.matrices(self.terms.by(number, values), self.size), 0.0)

    def _with_forces(self, matrices: list[FloatArray], push: float) -> list[FloatArray]:
        """Put the unknown efforts behind the measured inputs."""
        E, F, G, H, J = matrices
        pushed = np.zeros((len(E), len(self.forces)))
        pushed[list(self.forces), np.arange(len(self.forces))] = push
        return [E, F, np.hstack([G, pushed]), H, np.hstack([J, np.zeros((len(H), len(self.forces)))])]


def with_forces(model: DescriptorModel) -> DescriptorModel:
    """Return a model with its unknown efforts as further inputs."""
    return replace(model, forces=model.places)


def is_read(model: DescriptorModel, state: int) -> bool:
    """Tell whether some output is this state, in whatever unit, and nothing else."""
    terms = model.terms
    outputs, readings = terms.row[terms.matrix == READING], terms.column[terms.matrix == READING]
    return any(set(readings[outputs == output].tolist()) == {state} for output in range(model.size.p))


def with_reading(model: DescriptorModel, state: int) -> DescriptorModel:
    """Return a model with one more output that is a state."""
    terms, p = model.terms, model.size.p
    more = Terms(
        np.append(terms.matrix, READING), np.append(terms.row, p), np.append(terms.column, state),
        np.append(terms.coefficient, 1.0), np.vstack([terms.powers, np.zeros((1, len(model.constants)))]),
    )  # fmt: skip
    return replace(model, terms=more, size=model.size._replace(p=p + 1))
