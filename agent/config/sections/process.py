"""The [agent] table: what holds for all rigs of an agent, and the rule that its files agree on it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pydantic import Field

from agent.config.reading.fields import Table, shown
from agent.config.tuning import ROUND_S
from agent.errors import Fault


class Agent(Table):
    """How an agent computes. Files that name a key agree on it; a change holds from the next start on.

    workers: processes that compute, 0 or 1 for the agent's own alone; None for one a core, as many as rigs at
    most. round_s: from one round of computing to the next at least.
    """

    workers: int | None = Field(default=None, ge=0, le=256, description="a number of processes from 0 to 256")
    round_s: Annotated[float, Field(ge=0.005, le=1.0, description="seconds from 0.005 to 1")] = ROUND_S


def agreed(named: Sequence[tuple[Path, Agent]]) -> tuple[Agent, list[Fault]]:
    """Return what files say together, and a fault for each key of which two say different things."""
    first: dict[str, tuple[Path, object]] = {}
    faults = []
    for file, settings in named:
        for key in sorted(settings.model_fields_set):
            value = getattr(settings, key)
            owner, known = first.setdefault(key, (file, value))
            if known != value:
                what = f"is {shown(value)}, but {shown(known)} in {owner}"
                faults.append(
                    Fault(f"{file}: agent.{key}", what, "make them the same: it holds for the whole agent")
                )
    return Agent.model_validate({key: value for key, (_, value) in first.items()}), faults
