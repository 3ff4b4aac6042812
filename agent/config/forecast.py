"""[forecast]: how often the agent forecasts when parameters reach their limits, and what it knows of like machines."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pydantic import Strict

from agent.config.fields import Duration, FilePath, Table, shown
from agent.config.parse import readable

if TYPE_CHECKING:
    from agent.config.draft import Draft

LEAST_EVERY_S = 1.0


class Forecast(Table):
    """When forecasts are made and how far ahead; like names histories of like machines, or a prior learnt of them.

    every: from one forecast of a parameter to the next; infinite makes them at alarms only. horizon: what the chance is
    of; None for as long again as the history is.
    """

    every: Duration = 3600.0
    horizon: Duration | None = None
    like: Annotated[tuple[FilePath, ...], Strict(False)] = ()

    def beside(self, folder: Path) -> "Forecast":
        """Return the same with paths that start at a folder."""
        return self.model_copy(update={"like": tuple(folder / path for path in self.like)})


def check_forecast(draft: "Draft") -> None:
    """Note the faults of [forecast] that its values do not show by themselves."""
    asked = draft.forecast
    if readable(asked.every) and asked.every < LEAST_EVERY_S:
        what = f"{asked.every:g} s is too often: a forecast takes a tenth of a second, and more on a small gateway"
        draft.faults.add("forecast.every", what, 'give "10s" or more')
    if asked.horizon is not None and math.isinf(asked.horizon):
        draft.faults.add("forecast.horizon", '"forever" is no horizon', 'write "90d", or leave it out')
    for i, path in enumerate(asked.like or ()):
        if not (draft.folder / path).exists():
            what = f"there is no file {shown(str(draft.folder / path))}"
            advice = "name databases, tables, or a prior by deltak fleet learn"
            draft.faults.add(f"forecast.like[{i}]", what, advice)
