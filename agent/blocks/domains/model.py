"""From a template of another domain to its parametric model."""

import numpy as np

from agent.config import RigConfig
from agent.config.domains.plant import Domain, Plant, Term
from agent.config.model.tables import Channel
from agent.numerics.model.elements.descriptor import LETTERS, DescriptorModel, Size, Terms


def descriptor_model(config: RigConfig, table: Domain, names: tuple[str, ...]) -> DescriptorModel:
    """Build the model of a template's rig between its channels; names: what is estimated."""
    plant = table.plant(frozenset(channel.quantity for channel in config.channel))
    constants = tuple(part.name for part in plant.parts)
    chosen = [_term(term, constants) for term in plant.terms(_places(config.inputs), _places(config.outputs))]
    matrix, row, column, coefficient, powers = (np.array(cells) for cells in zip(*chosen, strict=True))
    terms = Terms(matrix, row, column, coefficient, powers.astype(float))
    pushed = plant.pushed
    return DescriptorModel(
        constants=constants,
        values=np.array([part.nominal for part in plant.parts], dtype=float),
        parameters=names,
        terms=terms,
        size=Size(len(plant.states), len(config.inputs), len(config.outputs)),
        state_names=tuple(state.name for state in plant.states),
        pushes=_pushes(plant, pushed),
        places=pushed,
    )


def _places(channels: tuple[Channel, ...]) -> list[tuple[str, str]]:
    return [(channel.quantity, channel.at) for channel in channels]


def _term(term: Term, constants: tuple[str, ...]) -> tuple[int, int, int, float, list[int]]:
    powers = [0] * len(constants)
    for name, power in term.powers:
        powers[constants.index(name)] += power
    return LETTERS.index(term.matrix), term.row, term.column, term.coefficient, powers


def _pushes(plant: Plant, places: tuple[int, ...]) -> tuple[tuple[str, str], ...]:
    return tuple((plant.states[i].name, plant.states[i].push) for i in places)
