"""The true motion of a graph of masses, springs and dampers, with parameters that may change at any sample.

Newton's law at every node, in the displacements q of all nodes and the velocities v of those with mass:

    M v' = f_m − S_m q − D_mm v − D_m0 q_0',      q_m' = v          (nodes with mass)
    D_00 q_0' = f_0 − S_0 q − D_0m v                                 (massless nodes)

S = Eₛᵀ diag(k) Eₛ and D = E_dᵀ diag(B) E_d, E the incidence matrices of springs and dampers. States are (q,
v), inputs the forces on all nodes. Between samples the force runs linearly or stays, so that the motion at
the samples is exact: matrix exponentials of [[F, G, 0], [0, 0, I], [0, 0, 0]].
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from sim_bus.arrays import FloatArray
from sim_bus.rig.domains.built import LinearMotion
from sim_bus.tuning import LIFTED_STATES

Hold = Literal["first", "zero"]
GROUND = "ground"


class PlantError(ValueError):
    """The graph has no motion: an unknown node, or a massless node that no damper holds."""


@dataclass(frozen=True, slots=True)
class Link:
    """A spring or damper between two nodes; its constant is looked up by name."""

    name: str
    ends: tuple[str, str]


@dataclass(frozen=True)
class Graph:
    """Nodes and links. A node named in `massless` has no inertia whatever the parameters say.

    Attributes:
        nodes: names of the nodes, ground left out; a node's mass is the parameter of its name.
        springs, dampers: the links.
        massless: nodes without inertia.
    """

    nodes: tuple[str, ...]
    springs: tuple[Link, ...]
    dampers: tuple[Link, ...]
    massless: frozenset[str] = frozenset()

    @cached_property
    def heavy(self) -> NDArray[np.intp]:
        """Numbers of the nodes with mass."""
        return np.array([i for i, name in enumerate(self.nodes) if name not in self.massless], dtype=np.intp)

    @cached_property
    def light(self) -> NDArray[np.intp]:
        """Numbers of the massless nodes."""
        return np.array([i for i, name in enumerate(self.nodes) if name in self.massless], dtype=np.intp)

    @cached_property
    def state_names(self) -> tuple[str, ...]:
        """`q.<node>` for every node, then `v.<node>` for those with mass."""
        return (*(f"q.{name}" for name in self.nodes), *(f"v.{self.nodes[i]}" for i in self.heavy))

    def node(self, name: str) -> int:
        """Return a node's number."""
        if name not in self.nodes:
            raise PlantError(f'no mass is called "{name}"; masses are {", ".join(self.nodes)}')
        return self.nodes.index(name)

    def equations(self, values: Mapping[str, float]) -> "Motion":
        """Return the motion for one set of constants."""
        return equations(self, values)

    def incidence(self, links: Sequence[Link]) -> FloatArray:
        """Return the incidence matrix (links, nodes): 1 at a link's start, −1 at its end, ground left out."""
        rows = np.zeros((len(links), len(self.nodes)))
        for row, link in zip(rows, links, strict=True):
            for sign, end in zip((1.0, -1.0), link.ends, strict=True):
                if end != GROUND:
                    row[self.node(end)] += sign
        return rows

    def weighted(self, links: Sequence[Link], constants: Mapping[str, float]) -> FloatArray:
        """Return Eᵀ diag(constants) E (nodes, nodes)."""
        rows = self.incidence(links)
        return rows.T @ (np.array([constants[link.name] for link in links]).reshape(-1, 1) * rows)


@dataclass(frozen=True)
class Motion:
    """x' = F x + G u for one set of parameters; `light` gives the velocities of the massless nodes."""

    graph: Graph
    F: FloatArray
    G: FloatArray
    is_sampled: bool = False

    def node(self, name: str) -> int:
        """Return a node's number."""
        return self.graph.node(name)

    def output(self, quantity: str, node: str) -> tuple[FloatArray, FloatArray]:
        """Return rows (h, j) with reading = h x + j u for a node's displacement, velocity or acceleration."""
        number = self.graph.node(node)
        nodes = len(self.graph.nodes)
        if quantity == "displacement":
            return np.eye(len(self.F))[number], np.zeros(nodes)
        if quantity == "velocity":
            return self.F[number], self.G[number]
        if node in self.graph.massless:
            raise PlantError(f'"{node}" has no mass, and so no acceleration that a sensor could read')
        row = nodes + int(np.flatnonzero(self.graph.heavy == number)[0])
        return self.F[row], self.G[row]


Moving = Motion | LinearMotion


def equations(graph: Graph, values: Mapping[str, float]) -> Motion:
    """Return the equations of motion for given constants (masses kg, springs N/m, dampers N s/m, by name)."""
    nodes = len(graph.nodes)
    heavy = graph.heavy
    light = graph.light
    spring, damper = graph.weighted(graph.springs, values), graph.weighted(graph.dampers, values)
    # velocities of all nodes as rows over (states, forces)
    rate = np.zeros((nodes, nodes + len(heavy) + nodes))
    rate[heavy, nodes + np.arange(len(heavy))] = 1.0
    balance = np.hstack([-spring, -damper[:, heavy], np.eye(nodes)])
    if len(light):
        rate[light] = _light_rates(
            damper[np.ix_(light, light)], balance[light], [graph.nodes[i] for i in light]
        )
    inertia = np.array([values[graph.nodes[i]] for i in heavy]).reshape(-1, 1)
    rows = balance[heavy] - damper[np.ix_(heavy, light)] @ rate[light]
    both = np.vstack([rate, rows / inertia])
    states = nodes + len(heavy)
    return Motion(graph, both[:, :states], both[:, states:])


def _light_rates(damping: FloatArray, forces: FloatArray, names: list[str]) -> FloatArray:
    if np.linalg.cond(damping) > 1e12:
        raise PlantError(f"{', '.join(names)}: a massless node needs a damper with a constant above 0")
    return np.asarray(np.linalg.solve(damping, forces), dtype=np.float64)


@dataclass(frozen=True)
class Step:
    """One fixed-length step: x(t + τ) = A x(t) + B0 u_k + B1 u_(k+1), u at the samples before and after."""

    A: FloatArray
    B0: FloatArray
    B1: FloatArray

    @cached_property
    def lifted(self) -> tuple[FloatArray, FloatArray]:
        """A block of L steps at once, as (from_state, from_pushes).

        from_state (n, L n) holds the powers A .. A^L; from_pushes (L n, L n) maps the pushes v_k = B0 u_k +
        B1 u_(k+1) onto the L states that follow the block's first.
        """
        n = len(self.A)
        length = max(4, LIFTED_STATES // n)
        powers = [np.eye(n)]
        for _ in range(length):
            powers.append(self.A @ powers[-1])
        pushes = np.zeros((length * n, length * n))
        for late in range(length):
            for early in range(late + 1):
                pushes[early * n : (early + 1) * n, late * n : (late + 1) * n] = powers[late - early].T
        return np.hstack([power.T for power in powers[1:]]), pushes


def step(motion: Moving, sample_s: float, hold: Hold = "first", part: float = 1.0) -> Step:
    """Return the exact step over `part` of a sampling interval.

    With hold "first" the force runs linearly from u_k to u_(k+1) over the whole interval; with "zero" it
    stays u_k. A motion in discrete time has whole steps only, else PlantError.
    """
    n, m = motion.G.shape
    if motion.is_sampled:
        if part != 1.0:
            raise PlantError(
                "a model in discrete time has no motion between samples: delays must be whole samples"
            )
        return Step(motion.F, motion.G, np.zeros((n, m)))
    big = np.zeros((n + 2 * m, n + 2 * m))
    big[:n, :n], big[:n, n : n + m] = motion.F, motion.G
    big[n : n + m, n + m :] = np.eye(m)
    grown: FloatArray = expm(big * (sample_s * part))[:n]
    held = grown[:, n : n + m]
    ramp = grown[:, n + m :] / sample_s
    if hold == "zero":
        return Step(grown[:, :n], held, np.zeros((n, m)))
    return Step(grown[:, :n], held - ramp, ramp)


def propagate(steps: Step, start: FloatArray, forces: FloatArray) -> FloatArray:
    """Return the states (k + 1, n) at the samples of `forces` (k + 1, m), the first of them `start` (n,)."""
    n = len(start)
    count = len(forces) - 1
    states = np.empty((count + 1, n))
    states[0] = start
    pushes = forces[:-1] @ steps.B0.T + forces[1:] @ steps.B1.T
    done = 0
    if count >= LIFTED_STATES:
        done = _propagate_blocks(steps, states, pushes)
    for k in range(done, count):
        states[k + 1] = steps.A @ states[k] + pushes[k]
    return states


def _propagate_blocks(steps: Step, states: FloatArray, pushes: FloatArray) -> int:
    """Fill states[1 : done + 1] in whole blocks; return done."""
    from_state, from_pushes = steps.lifted
    n = states.shape[1]
    length = int(from_state.shape[1]) // n
    blocks = len(pushes) // length
    done = int(blocks * length)
    driven = pushes[:done].reshape(blocks, length * n) @ from_pushes
    onward = np.ascontiguousarray(from_state[:, -n:].T)
    heads = np.empty((blocks, n))
    head = states[0]
    for block, last in enumerate(driven[:, -n:]):
        heads[block] = head
        head = onward @ head + last
    driven += heads @ from_state
    states[1 : done + 1] = driven.reshape(done, n)
    return done
