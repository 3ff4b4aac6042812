"""Random structures, sampled records and observers that the tests of the numerical core share."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.numerics.model.mechanics import Element, Mass, MassSpringDamper, Output, Structure
from agent.numerics.model.statespace import Discrete, discretise, simulate
from tests.unit.numerics.paper_rig import rig

FloatArray = NDArray[np.float64]
PERIOD = 1e-3


def random_structure(rng: np.random.Generator, masses: int) -> Structure:
    """A random tree from the ground, some with one more edge that closes a ring; a spring and a damper an
    edge."""
    nodes = ["ground", *(f"m{i}" for i in range(1, masses + 1))]
    edges = [(nodes[rng.integers(i)], nodes[i]) for i in range(1, masses + 1)]
    closing = (nodes[rng.integers(masses)], nodes[-1])
    if masses > 1 and rng.random() < 0.5 and closing not in edges:
        edges.append(closing)
    springs = tuple(Element(f"k{i}", e, float(rng.uniform(50, 200))) for i, e in enumerate(edges))
    dampers = tuple(Element(f"B{i}", e, float(rng.uniform(1, 6))) for i, e in enumerate(edges))
    return Structure(tuple(Mass(name, float(rng.uniform(1, 5))) for name in nodes[1:]), springs, dampers)


def measured_model(structure: Structure, forces: tuple[str, ...]) -> MassSpringDamper:
    """Every spring and damper estimated, every displacement measured."""
    names = tuple(e.name for e in (*structure.springs, *structure.dampers))
    return MassSpringDamper(
        structure, names, forces, tuple(Output("displacement", m.name) for m in structure.masses)
    )


@dataclass(frozen=True)
class Record:
    """Samples of a rig with what made them."""

    y: FloatArray
    u: FloatArray
    states: FloatArray

    @property
    def v(self) -> FloatArray:
        return np.hstack([self.y, self.u])


def record(discrete: Discrete, u: FloatArray, x0: FloatArray | None = None) -> Record:
    states, y = simulate(discrete, np.zeros(discrete.model.n) if x0 is None else x0, u)
    return Record(y, u, states)


def sampled(theta: FloatArray | None = None) -> Discrete:
    """The paper's rig, sampled at 1 kHz."""
    model = rig()
    return discretise(model.continuous(model.nominal if theta is None else theta), PERIOD)


def disturbance(model: MassSpringDamper) -> FloatArray:
    masses = np.array([m.value for m in model.structure.masses])
    return np.vstack([np.diag(1 / masses), np.zeros((len(masses), len(masses)))])


def noisy(rng: np.random.Generator, samples: int, sigma: float, theta: FloatArray | None = None) -> Record:
    """The paper's rig under 5 N rms of white force from rest, settled for 2000 samples, with sensor noise."""
    truth = record(sampled(theta), 5.0 * rng.standard_normal((samples + 2000, 1)))
    y = truth.y + sigma * rng.standard_normal(truth.y.shape)
    return Record(y[2000:], truth.u[2000:], truth.states[2000:])
