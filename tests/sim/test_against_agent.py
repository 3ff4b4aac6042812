"""The simulator's own derivations and readings held against the agent's; only tests may import both."""

import numpy as np
import pytest

from agent.config.reading.units import conversion
from agent.numerics.model.mechanics import Element, Mass, MassSpringDamper, Output, Structure
from agent.numerics.model.statespace import discretise, simulate
from sim_bus.rig.plant import Graph, Link, equations, propagate, step
from sim_bus.rig.units import SI_FACTORS, si_factor


@pytest.mark.parametrize("hold", ["first", "zero"])
@pytest.mark.parametrize("number", range(12))
def test_plant_random_graph_moves_as_the_agents_model_says(number: int, hold: str) -> None:
    rng = np.random.default_rng(number)
    count = int(rng.integers(1, 7))
    names = [f"n{k}" for k in range(count)]
    places = ["ground", *names]
    # a chain of springs and dampers, and some elements across it
    chain = [(places[k], places[k + 1]) for k in range(count)]
    extra = [tuple(rng.choice(places, 2, replace=False).tolist()) for _ in range(int(rng.integers(0, 3)))]
    ends = chain + [(str(a), str(b)) for a, b in extra]
    massless = {names[k] for k in range(count) if rng.random() < 0.25 and count > 1}
    masses = {name: 0.0 if name in massless else float(rng.uniform(0.5, 5)) for name in names}
    springs = {f"k{k}": float(rng.uniform(10, 200)) for k in range(len(ends))}
    dampers = {f"b{k}": float(rng.uniform(0.5, 10)) for k in range(len(ends))}

    graph = Graph(
        tuple(names),
        tuple(Link(name, end) for name, end in zip(springs, ends, strict=True)),
        tuple(Link(name, end) for name, end in zip(dampers, ends, strict=True)),
        frozenset(massless),
    )
    forces = rng.normal(size=(400, count)) * 5
    motion = equations(graph, masses | springs | dampers)
    states = propagate(step(motion, 1e-3, hold), np.zeros(len(graph.state_names)), forces)
    ours = []
    for quantity in ("displacement", "velocity"):
        for name in names:
            h, j = motion.output(quantity, name)
            ours.append(states @ h + forces @ j)

    structure = Structure(
        tuple(Mass(name, value) for name, value in masses.items()),
        tuple(Element(name, end, springs[name]) for name, end in zip(springs, ends, strict=True)),
        tuple(Element(name, end, dampers[name]) for name, end in zip(dampers, ends, strict=True)),
    )
    outputs = tuple(Output(quantity, name) for quantity in ("displacement", "velocity") for name in names)
    model = MassSpringDamper(structure, (), tuple(names), outputs)
    discrete = discretise(model.continuous(np.empty(0)), 1e-3, hold)
    _, theirs = simulate(discrete, np.zeros(len(model.state_names)), forces)
    np.testing.assert_allclose(np.array(ours).T, theirs, atol=1e-11)


@pytest.mark.parametrize("quantity", ["force", "displacement", "velocity", "acceleration"])
def test_units_are_those_of_the_agent(quantity: str) -> None:
    for unit in (*SI_FACTORS[quantity], " mm ", "µm", "μm/s", "m/s²", "V", "counts", "N s"):
        assert si_factor(quantity, unit) == pytest.approx(conversion(quantity, unit)[0], rel=1e-15), unit
