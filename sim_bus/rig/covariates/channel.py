"""A channel of role "covariate": what is read beside the rig's signals."""

from typing import Self

from pydantic import Field, model_validator

from sim_bus.tables import Part


class CovariateChannel(Part):
    """One covariate: its unit, how a reading is written in it, and what it runs through if stated."""

    name: str
    unit: str = ""
    scale: float = Field(default=1.0, allow_inf_nan=False)
    offset: float = Field(default=0.0, allow_inf_nan=False)
    range: tuple[float, float] | None = None

    @property
    def middle(self) -> float:
        """Where it stays while no scenario says what it does: in the middle of its range, 0 without one."""
        return sum(self.range) / 2.0 if self.range else 0.0

    @model_validator(mode="after")
    def _scale_is_usable(self) -> Self:
        if self.scale == 0.0:
            raise ValueError("scale 0 cannot be undone; the simulator cannot tell what the device would send")
        return self
