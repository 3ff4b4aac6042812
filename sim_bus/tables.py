"""Tables of a scenario, and those of a configuration as far as the simulator reads them."""

from pydantic import BaseModel, ConfigDict


class Table(BaseModel):
    """A table of a scenario; a key that it does not know is a fault."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Part(BaseModel):
    """A table of a configuration; its other keys are the agent's."""

    model_config = ConfigDict(extra="ignore", frozen=True)
