"""Where the numbers of a model stand: under [model] of a configuration, and in the text of its file."""

import re
from collections.abc import Iterator, Mapping
from itertools import islice
from typing import Any, Final

from agent.commissioning.editing.toml_text import NUMBER
from agent.config.domains.plant import Domain
from agent.config.model.linear import MATRICES, LinearModel, LinearParameter

Place = tuple[str | int, ...]
"""Keys and row numbers from [model] on: ("stage", 0, "R")."""
ELEMENTS: Final = {"mass": "value", "spring": "nominal", "damper": "nominal", "friction": "nominal"}
"""Kinds of elements of a graph, and the key of their value."""


def moved(model: Any, values: Mapping[str, float]) -> dict[Place, float]:
    """Return all numbers of a model that are others where parameters and masses have these values.

    Matrices of a linear model are those at its nominals, so they go along. Names of others are passed over.
    """
    if isinstance(model, LinearModel):
        return _of_matrices(model, values)
    if isinstance(model, Domain):
        known = {part.name for part in model.parts}
        return {model.place_of(name): value for name, value in values.items() if name in known}
    return {
        (kind, number, key): values[row.name]
        for kind, key in ELEMENTS.items()
        for number, row in enumerate(getattr(model, kind))
        if row.name in values
    }


def put(table: Any, place: Place, value: float) -> Any:
    """Return a table with another number at a place."""
    if not place:
        return value
    key, *rest = place
    if isinstance(key, int):
        return (*table[:key], put(table[key], tuple(rest), value), *table[key + 1 :])
    return table.model_copy(update={key: put(getattr(table, key), tuple(rest), value)})


def _of_matrices(model: LinearModel, values: Mapping[str, float]) -> dict[Place, float]:
    named = {row.name: number for number, row in enumerate(model.parameter or ())}
    chosen = [parameter for parameter in model.parameters if parameter.name in values]
    found: dict[Place, float] = {
        ("parameter", named[p.name], "nominal"): values[p.name] for p in chosen if p.name in named
    }
    for parameter in chosen:
        change = values[parameter.name] - parameter.nominal
        for (name, i, j), slope in _slopes(parameter):
            before = found.get((name, i, j), getattr(model, name)[i][j])
            found[name, i, j] = before + slope * change
    return found


def _slopes(parameter: LinearParameter) -> Iterator[tuple[tuple[str, int, int], float]]:
    """Yield the entries that a parameter moves, and by how much a unit of it."""
    for name, rows in parameter.derivatives.items():
        for i, row in enumerate(rows):
            yield from (((name, i, j), slope) for j, slope in enumerate(row) if slope != 0)


def numbers_in(text: str, place: Place, model: Mapping[str, Any]) -> Iterator[tuple[int, int]]:
    """Yield where in a text the number of a place may stand, from and to; model: as the file has it."""
    if place[0] in MATRICES:
        before = sum(len(cells) for cells in model[place[0]][: int(place[1])]) + int(place[2])
        for head in re.finditer(rf"(?m)^[ \t]*{place[0]}[ \t]*=", text):
            yield from islice(_numbers(text, head.end()), before, before + 1)
        return
    for found in re.finditer(rf"(?<![\w.-]){re.escape(str(place[-1]))}[ \t]*=[ \t]*({NUMBER})", text):
        yield found.span(1)


def _numbers(text: str, start: int) -> Iterator[tuple[int, int]]:
    """Yield the numbers after a place, comments passed over."""
    bare = re.sub(r"#[^\n]*", lambda comment: " " * len(comment[0]), text[start:])
    yield from ((start + found.start(), start + found.end()) for found in re.finditer(NUMBER, bare))
