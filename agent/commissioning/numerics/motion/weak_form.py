"""Weak form of a rig's equations of motion: linear in springs, dampers, masses and friction, no derivatives.

With D a time derivative and φ = ψ^(r) a test function, for each node i

    m_i ∫φ D²x_i + Σ_e d_ei [k_e ∫φ d_e·x + B_e ∫φ d_e·Dx + F_e ∫φ s_e] = ∫φ f_i

where ∫ ψ^(r) Dʲx = (-1)^(j+q) ∫ ψ^(r+j-q) y for a sensor that reads y = D^q x, so velocities serve as
displacements do with r = 1. s_e is the sign of the velocity across a dry friction.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.commissioning.numerics.motion.modulation import Modulation, held
from agent.numerics.model.mechanics import GROUND, Element, MassSpringDamper
from agent.types import BoolArray, FloatArray, IntArray

ComplexArray = NDArray[np.complex128]
ORDERS = {"displacement": 0, "velocity": 1}
"""An acceleration integrated twice says nothing of slow motion: only its noise and aliases would be left."""


@dataclass(frozen=True)
class Sensing:
    """Which sensor shows which node.

    Attributes:
        node: (v,) numbers of the nodes that are measured;  sensor: (v,) the output that is used there.
        order: (v,) 0 for a displacement, 1 for a velocity.
        unseen: names of the nodes of which no displacement and no velocity is measured.
    """

    node: IntArray
    sensor: IntArray
    order: IntArray
    unseen: tuple[str, ...]

    @classmethod
    def of(cls, model: MassSpringDamper) -> "Sensing":
        """Choose for each node the sensor that needs the fewest integrations."""
        usable = [(i, output) for i, output in enumerate(model.outputs) if output.quantity in ORDERS]
        outputs = sorted(usable, key=lambda pair: ORDERS[pair[1].quantity], reverse=True)
        best = {output.at: (number, ORDERS[output.quantity]) for number, output in outputs}
        names = [mass.name for mass in model.structure.masses]
        seen = [(i, *best[name]) for i, name in enumerate(names) if name in best]
        table = np.array(seen, dtype=np.int64).reshape(-1, 3)
        unseen = tuple(name for name in names if name not in best)
        return cls(table[:, 0], table[:, 1], table[:, 2], unseen)

    @property
    def highest(self) -> int:
        """R: how often ψ is differentiated before anything else."""
        return int(self.order.max(initial=0))


@dataclass(frozen=True)
class Spectra:
    """What the bins of all stretches hold; b bins, N nodes.

    Attributes:
        omega: (b,) rad/s.
        motion: (3, b, N) transforms of x, Dx, D²x; 0 at nodes that nothing measures.
        force: (b, N) transform of the measured forces;  slip: (b, frictions) of the signs of velocities.
        standing: (b,) transform of the constant 1.
        energy: (b,) ∫ w² of the stretch: what white noise of one sample leaves.
    """

    omega: FloatArray
    motion: ComplexArray
    force: ComplexArray
    slip: ComplexArray
    standing: ComplexArray
    energy: FloatArray

    @classmethod
    def joined(cls, parts: Sequence["Spectra"]) -> "Spectra":
        """Put the bins of all stretches behind one another."""
        return cls(
            np.concatenate([p.omega for p in parts]), np.concatenate([p.motion for p in parts], axis=1),
            np.concatenate([p.force for p in parts]), np.concatenate([p.slip for p in parts]),
            np.concatenate([p.standing for p in parts]), np.concatenate([p.energy for p in parts]),
        )  # fmt: skip


def spectra(
    model: MassSpringDamper,
    sensing: Sensing,
    y: FloatArray,
    u: FloatArray,
    period_s: float,
    *,
    straight: bool,
) -> Spectra:
    """Transform one stretch of outputs y (L, p) and inputs u (L, m), the frictions' signs last."""
    r = sensing.highest
    nodes = [mass.name for mass in model.structure.masses]
    modulation = Modulation(len(y), period_s, r + 2)
    omega = modulation.omega
    ones = np.ones((len(y), 1))
    whole = modulation.transforms(np.hstack([y, u, ones]))
    motion: ComplexArray = np.zeros((3, len(omega), len(nodes)), dtype=np.complex128)
    for node, sensor, q in zip(sensing.node, sensing.sensor, sensing.order, strict=True):
        for j in range(3):
            motion[j, :, node] = (-1.0) ** (j + q) * whole[r + j - q, :, sensor]
    driven = (-1.0) ** r * whole[r, :, y.shape[1] :]
    between = held(omega, period_s, straight=straight)[:, None]
    force = np.zeros((len(omega), len(nodes)), dtype=complex)
    for column, at in enumerate(model.forces):
        force[:, nodes.index(at)] += (between * driven[:, [column]])[:, 0]
    # all of one sign: the test function's order is common to every term
    signs = driven[:, len(model.forces) : -1]
    energy = np.full(len(omega), len(y) * period_s**2)
    return Spectra(omega, np.asarray((-1.0) ** r * motion), force, signs, driven[:, -1], energy)


@dataclass(frozen=True)
class Equations:
    """The equations of the nodes that can be written down, as columns of what is asked.

    Attributes:
        model: the parametric model.
        usable: (N,) nodes whose equation holds measured motion only.
        standing: a constant force a node is asked beside the parameters, for offsets of sensors.
    """

    model: MassSpringDamper
    usable: BoolArray
    standing: bool

    @property
    def columns(self) -> int:
        """How many unknowns there are: the parameters, then the constant forces."""
        return len(self.model.parameters) + (int(self.usable.sum()) if self.standing else 0)

    def regression(self, at: Spectra) -> tuple[ComplexArray, ComplexArray]:
        """Return columns (b, n, columns) and right-hand sides (b, n) of the usable nodes' equations."""
        names = list(self.model.parameters)
        P = np.zeros((len(at.omega), self.usable.sum(), self.columns), dtype=complex)
        b = at.force[:, self.usable].copy()
        for name, value, term in self._terms(at):
            column = term[:, self.usable]
            if name in names:
                P[:, :, names.index(name)] += column
            elif value:
                b -= value * column
        if self.standing:
            rows = np.arange(int(self.usable.sum()))
            P[:, rows, len(names) + rows] = at.standing[:, None]
        return P, b

    def _terms(self, at: Spectra) -> list[tuple[str, float, ComplexArray]]:
        """Return name, configured value and (b, N) force a unit of every element."""
        s = self.model.structure
        nodes = [mass.name for mass in self.model.structure.masses]
        found = []
        for i, mass in enumerate(s.masses):
            found.append((mass.name, mass.value, at.motion[2] * (np.arange(len(nodes)) == i)))
        for order, elements in ((0, s.springs), (1, s.dampers)):
            for element in elements:
                way = _direction(element, nodes)
                found.append((element.name, element.nominal, (at.motion[order] @ way)[:, None] * way))
        for i, friction in enumerate(s.frictions):
            found.append((friction.name, friction.nominal, at.slip[:, [i]] * _direction(friction, nodes)))
        return found

    def stiffness(self, theta: FloatArray, omega: FloatArray) -> ComplexArray:
        """Return the dynamic stiffness (b, N, N) of all nodes at theta (q,): -ω² M + iω B + K."""
        s = self.model.at(theta)
        nodes = [mass.name for mass in s.masses]
        parts = [np.diag([mass.value for mass in s.masses]).astype(float)]
        for elements in (s.dampers, s.springs):
            ways = [(e.nominal, _direction(e, nodes)) for e in elements]
            parts.append(sum((v * np.outer(w, w) for v, w in ways), np.zeros((len(nodes), len(nodes)))))
        M, B, K = parts
        w = omega[:, None, None]
        return np.asarray(-(w**2) * M + 1j * w * B + K)


def _direction(element: Element, nodes: Sequence[str]) -> FloatArray:
    """(N,) +1 at the first node of an element, -1 at its second; ground has no entry."""
    way = np.zeros(len(nodes))
    for node, sign in zip(element.between, (1.0, -1.0), strict=True):
        if node != GROUND:
            way[nodes.index(node)] += sign
    return way


def usable_nodes(model: MassSpringDamper, sensing: Sensing) -> BoolArray:
    """(N,) nodes whose motion is measured, as is that of all they are joined to by springs and dampers."""
    nodes = [mass.name for mass in model.structure.masses]
    usable = np.array([name not in sensing.unseen for name in nodes], dtype=bool)
    for element in (*model.structure.springs, *model.structure.dampers):
        ends = [node for node in element.between if node != GROUND]
        if any(node in sensing.unseen for node in ends):
            usable[[nodes.index(node) for node in ends]] = False
    return usable
