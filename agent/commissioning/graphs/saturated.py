"""The graph with every possible spring and damper: between any two masses, and from each to the ground."""

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from agent.commissioning.identification.graph import elements_of, mechanics, with_blanks
from agent.commissioning.numerics.motion.start import still
from agent.commissioning.numerics.motion.weak_form import Sensing
from agent.config import MechanicsModel, RigConfig
from agent.config.model.tables import GROUND, Element
from agent.types import FloatArray

KINDS = {"spring": "k", "damper": "B"}


def saturated(config: RigConfig) -> RigConfig:
    """Return the configuration with every element between measured masses and the ground that it lacks."""
    model = config.model
    if not isinstance(model, MechanicsModel):
        raise TypeError("not a mass-spring-damper model")
    unseen = Sensing.of(mechanics(with_blanks(config))).unseen
    nodes = [GROUND, *(mass.name for mass in model.mass if mass.name not in unseen)]
    more = {kind: tuple(_missing(getattr(model, kind), nodes, letter)) for kind, letter in KINDS.items()}
    return _with(config, {kind: (*getattr(model, kind), *rows) for kind, rows in more.items()})


def _missing(rows: Sequence[Element], nodes: Sequence[str], letter: str) -> Iterator[Element]:
    there = {frozenset(element.between) for element in rows}
    for pair in combinations(nodes, 2):
        if frozenset(pair) not in there:
            yield Element(name=f"{letter}_{pair[0]}_{pair[1]}"[:64], between=pair)


def _with(config: RigConfig, tables: dict[str, tuple[Element, ...]]) -> RigConfig:
    """Return the configuration with other springs and dampers; those that are new are estimated."""
    known = {e.name for e in elements_of(config.model)}
    kept = {e.name for rows in tables.values() for e in rows}
    wanted = [name for name in config.estimator.estimate if name in kept or name not in known]
    added = [e.name for rows in tables.values() for e in rows if e.name not in known]
    estimator = config.estimator.model_copy(update={"estimate": (*wanted, *added)})
    return config.model_copy(update={"model": config.model.model_copy(update=tables), "estimator": estimator})


def without(config: RigConfig, names: Sequence[str]) -> RigConfig:
    """Return the configuration without elements of these names."""
    tables = {kind: tuple(e for e in getattr(config.model, kind) if e.name not in names) for kind in KINDS}
    left_out = _with(config, tables)
    estimate = tuple(name for name in left_out.estimator.estimate if name not in names)
    estimator = left_out.estimator.model_copy(update={"estimate": estimate})
    return left_out.model_copy(update={"estimator": estimator})


def stretched(
    config: RigConfig, kept: Sequence[str], pieces: Sequence[tuple[FloatArray, FloatArray]], sigma: FloatArray
) -> RigConfig:
    """Return the configuration without proposed elements that nothing stretches; kept: those it has stay."""
    quiet, _ = still(mechanics(with_blanks(config)), pieces, sigma)
    return without(config, [name for name in quiet if name not in kept])


def elective(names: Sequence[str], config: RigConfig) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Return which of the parameters are springs and dampers, which a machine may have or not."""
    kinds = {e.name for kind in KINDS for e in getattr(config.model, kind)}
    return np.array([name in kinds for name in names], dtype=bool)
