"""The table of a linear model: matrices, parameters and uncertain entries, in continuous or discrete time."""

import re
from collections.abc import Iterator
from typing import Annotated, Any, Final, Literal

from pydantic import Field

from agent.config.reading.fields import Asked, Matrix, Name, Number, Positive, Table, Text

MATRICES: Final = ("A", "B", "C", "D")
ENTRY: Final = re.compile(
    r"(?P<matrix>[ABCD])\[(?P<row>0|[1-9][0-9]{0,3}),\s*(?P<column>0|[1-9][0-9]{0,3})\]"
)


class State(Table):
    """One state of a linear model, in the order of A's rows."""

    name: Name
    unit: str = ""


class LinearParameter(Table):
    """A linear model's parameter: A(θ) = A + Σ (θ - nominal) dA, B, C, D likewise; omitted ones are zero."""

    name: Asked
    nominal: Number
    unit: str = ""
    dA: Matrix = ()  # noqa: N815 - the key of the configuration file
    dB: Matrix = ()  # noqa: N815 - the key of the configuration file
    dC: Matrix = ()  # noqa: N815 - the key of the configuration file
    dD: Matrix = ()  # noqa: N815 - the key of the configuration file

    @property
    def derivatives(self) -> dict[str, Matrix]:
        """What it changes, by the name of the matrix."""
        return {"A": self.dA, "B": self.dB, "C": self.dC, "D": self.dD}


class LinearModel(Table):
    """x' = A x + B u, y = C x + D u, x' the derivative or next state; channels are its inputs and outputs.

    uncertain: entries such as "A[0,1]" (counted from zero) or whole matrices, each entry a parameter of that
    name. rate_hz: at which a model in discrete time was sampled.
    """

    kind: Literal["linear"]
    time: Literal["continuous", "discrete"] = "continuous"
    rate_hz: Positive | None = Field(
        default=None, description="of a model in discrete time: samples a second"
    )
    A: Matrix
    B: Matrix = ()
    C: Matrix
    D: Matrix = ()
    state: tuple[State, ...] = ()
    parameter: tuple[LinearParameter, ...] = ()
    uncertain: Annotated[tuple[Text, ...], Field(strict=False)] = ()

    @property
    def parameters(self) -> tuple[LinearParameter, ...]:
        """Those that are named, then the uncertain entries that the matrices have."""
        entries = dict.fromkeys(entry for text in self.uncertain or () for entry in self.entries(text))
        return (*(self.parameter or ()), *(self._entry(*entry) for entry in entries))

    @property
    def state_names(self) -> tuple[str, ...]:
        """The names of the states; "state 1" and so on where they have none."""
        given = [state.name for state in self.state or ()]
        return tuple(given) or tuple(f"state {i + 1}" for i in range(len(self.A or ())))

    def entries(self, text: str) -> Iterator[tuple[str, int, int]]:
        """Yield matrix, row and column of what an uncertain text names; nothing if the matrices lack it."""
        match = ENTRY.fullmatch(text)
        if match is not None:
            found = match["matrix"], int(match["row"]), int(match["column"])
            if self._has(*found):
                yield found
        elif text in MATRICES:
            rows = getattr(self, text) or ()
            yield from ((text, i, j) for i, row in enumerate(rows) for j in range(len(row)))

    def _has(self, matrix: str, row: int, column: int) -> bool:
        rows = getattr(self, matrix) or ()
        return row < len(rows) and column < len(rows[row])

    def _entry(self, matrix: str, row: int, column: int) -> LinearParameter:
        rows: Matrix = getattr(self, matrix)
        unit = tuple(
            tuple(float((i, j) == (row, column)) for j in range(len(cells))) for i, cells in enumerate(rows)
        )
        changes: dict[str, Any] = {f"d{name}": unit if name == matrix else () for name in MATRICES}
        name = f"{matrix}[{row},{column}]"
        return LinearParameter.model_construct(None, name=name, nominal=rows[row][column], unit="", **changes)
