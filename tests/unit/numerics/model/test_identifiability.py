"""Which parameters a model's channels can tell apart: the list that theory gives, found by the test."""

from dataclasses import replace

import numpy as np
import pytest

from agent.numerics.model.identifiability import identifiability
from agent.numerics.model.mechanics import Element, Mass, MassSpringDamper, Output, Structure
from agent.numerics.model.sensors import Nuisance, SensedModel
from agent.numerics.model.statespace import Model

PHYSICAL = ("k1", "k2", "B1", "B2")
ALL = ("m1", "m2", *PHYSICAL)
BIASES = (Nuisance("f.bias", "bias", "input", 0), Nuisance("x1.bias", "bias", "output", 0),
          Nuisance("x2.bias", "bias", "output", 1))  # fmt: skip
GAINS = (Nuisance("f.gain", "gain", "input", 0), Nuisance("x1.gain", "gain", "output", 0),
         Nuisance("x2.gain", "gain", "output", 1))  # fmt: skip


def chain(
    masses: int,
    names: tuple[str, ...] = (),
    outputs: tuple[int, ...] = (),
    *,
    forced: bool = True,
    seed: int = 0,
) -> MassSpringDamper:
    """Masses in series from ground; a force on the last; displacements of `outputs`, of all where none is
    named."""
    rng = np.random.default_rng(seed)
    nodes = ["ground", *(f"m{i + 1}" for i in range(masses))]
    links = [(nodes[i], nodes[i + 1]) for i in range(masses)]
    structure = Structure(
        tuple(Mass(name, rng.uniform(1, 5)) for name in nodes[1:]),
        tuple(Element(f"k{i + 1}", link, rng.uniform(20, 500)) for i, link in enumerate(links)),
        tuple(Element(f"B{i + 1}", link, rng.uniform(1, 10)) for i, link in enumerate(links)),
    )
    every = tuple(e.name for e in (*structure.springs, *structure.dampers))
    places = outputs or tuple(range(1, masses + 1))
    measured = tuple(Output("displacement", f"m{i}") for i in places)
    return MassSpringDamper(structure, names or every, (nodes[-1],) if forced else (), measured)


def blends(model: Model, measured: int = 1) -> list[set[str]]:
    """Return the sets of parameters that cannot be told apart."""
    found = identifiability(model, measured, np.abs(model.nominal))
    assert not found.silent
    return [
        {name for name, change in zip(model.parameters, blend, strict=True) if change}
        for blend in found.blends
    ]


@pytest.mark.parametrize("masses", range(1, 7))
@pytest.mark.parametrize("forced", [True, False], ids=["forced", "free decay"])
def test_chain_with_all_displacements_tells_every_spring_and_damper(masses: int, forced: bool) -> None:
    for seed in range(5):
        assert blends(chain(masses, forced=forced, seed=seed), int(forced)) == []


@pytest.mark.parametrize("masses", range(1, 7))
def test_chain_with_one_displacement_and_a_force_is_told(masses: int) -> None:
    assert blends(chain(masses, outputs=(masses,))) == []


@pytest.mark.parametrize(
    ("nuisances", "expected"),
    [
        (BIASES, [{"f.bias", "x1.bias", "x2.bias"}]),
        (BIASES[:2], []),
        (BIASES[1:], []),
        (GAINS, [{"f.gain", "x1.gain", "x2.gain"}]),
        (GAINS[:2], []),
        (GAINS[1:], []),
        ((*BIASES[1:], *GAINS[1:]), []),
    ],
    ids=[
        "all biases",
        "force and one",
        "both outputs",
        "all gains",
        "input and one",
        "both output gains",
        "outputs",
    ],
)
def test_sensor_constants_that_cannot_be_separated_are_named(
    nuisances: tuple[Nuisance, ...], expected: list[set[str]]
) -> None:
    assert blends(SensedModel(chain(2), nuisances)) == expected


def test_masses_are_told_with_a_force_and_scale_with_everything_without() -> None:
    assert blends(chain(2, ALL)) == []
    assert blends(chain(2, ALL, forced=False), 0) == [set(ALL)]


def test_all_masses_with_the_input_gain_are_one_scale() -> None:
    assert blends(SensedModel(chain(2, ALL), GAINS[:1])) == [{*ALL, "f.gain"}]


def test_parallel_springs_are_one_and_the_blend_says_in_which_ratio() -> None:
    model = chain(2)
    springs = (*model.structure.springs, Element("k3", ("m1", "ground"), 40.0))
    model = replace(
        model, structure=replace(model.structure, springs=springs), parameters=("k1", "k2", "k3", "B1")
    )
    found = identifiability(model, 1, np.abs(model.nominal))
    assert len(found.blends) == 1
    k1, k2, k3, B1 = found.blends[0] / found.blends[0][0]
    assert (k2, B1) == (0, 0)
    assert k1 == pytest.approx(-k3, rel=1e-9)


def test_two_separate_faults_are_two_blends() -> None:
    model = chain(2)
    springs = (
        *model.structure.springs,
        Element("k3", ("m1", "ground"), 40.0),
        Element("k4", ("m1", "m2"), 7.0),
    )
    names = ("k1", "k2", "k3", "k4", "B1", "B2")
    model = replace(model, structure=replace(model.structure, springs=springs), parameters=names)
    assert sorted(map(sorted, blends(model))) == [["k1", "k3"], ["k2", "k4"]]


def test_element_that_no_channel_feels_is_silent() -> None:
    model = chain(2)
    apart = replace(
        model.structure,
        masses=(*model.structure.masses, Mass("m3", 1.0)),
        springs=(*model.structure.springs, Element("k3", ("m3", "ground"), 40.0)),
    )
    model = replace(model, structure=apart, parameters=("k1", "k3", "k2"))
    assert identifiability(model, 1, np.abs(model.nominal)).silent == (1,)


@pytest.mark.parametrize("scale", [1e-9, 1e9])
def test_verdict_does_not_depend_on_units(scale: float) -> None:
    """Forces in other units scale masses, springs and dampers alike."""
    model = chain(2, ALL)
    s = model.structure
    scaled = Structure(
        tuple(Mass(m.name, m.value * scale) for m in s.masses),
        tuple(replace(e, nominal=e.nominal * scale) for e in s.springs),
        tuple(replace(e, nominal=e.nominal * scale) for e in s.dampers),
    )
    assert blends(replace(model, structure=scaled)) == []
    assert blends(replace(model, structure=scaled, forces=()), 0) == [set(ALL)]
