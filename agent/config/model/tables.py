"""The tables of a mechanical model and of channels as frozen models; attribute names are the file's keys."""

import math
from typing import Annotated, Literal

from pydantic import Field, PrivateAttr, Strict

from agent.config.domains.kinds import DomainModel
from agent.config.model.linear import LinearModel
from agent.config.reading.fields import Name, NotNegative, Number, Positive, Table, Text
from agent.config.reading.units import Quantity, conversion

GROUND = "ground"
Nodes = Annotated[tuple[Name, Name], Strict(False)]


class Mass(Table):
    """A node; value in kg, 0 for a node without mass."""

    name: Name
    value: NotNegative = Field(description="a mass is in kg; 0 makes a massless node, which needs a damper")
    sd_percent: NotNegative = Field(
        default=2.0, description="how well the mass is known, per cent; 0 for exactly"
    )


class Element(Table):
    """A spring, a damper or a dry friction between two nodes, with its healthy value."""

    name: Name
    between: Nodes = Field(description='two nodes, such as ["ground", "m1"]')
    nominal: NotNegative = math.nan

    @property
    def is_known(self) -> bool:
        """Whether its nominal is stated; `deltak identify` finds one that is not."""
        return not math.isnan(self.nominal)


class MechanicsModel(Table):
    """A graph of masses, springs, dampers and dry friction."""

    kind: Literal["mass-spring-damper"] = "mass-spring-damper"
    mass: tuple[Mass, ...] = ()
    spring: tuple[Element, ...] = ()
    damper: tuple[Element, ...] = ()
    friction: tuple[Element, ...] = ()


Model = MechanicsModel | LinearModel | DomainModel


class Channel(Table):
    """An input or output of the model: SI value = ((field * scale) + offset) * si_factor."""

    name: Name
    quantity: Quantity = Field(description="force, displacement, velocity or acceleration")
    at: Name = Field(default="", description='the mass it acts on or is measured at, such as "m1"')
    unit: Text = Field(description='the unit after scale and offset, such as "N", "mm" or "counts"')
    scale: Number = 1.0
    offset: Number = 0.0
    noise_sd: Positive | None = Field(default=None, description="leave it out where the noise is not known")
    noise_sd_spread: Positive = Field(
        default=0.3, description="how far noise_sd may be off, as a share of it"
    )
    gain_sd_percent: NotNegative = Field(
        default=1.0, description="how far the gain may be off, per cent; 0: exact"
    )
    bias: bool = False
    gain: bool = False
    delay_s: NotNegative = 0.0
    delay_sd_s: NotNegative | None = Field(
        default=None, description="how far delay_s may be off; 0 for exactly"
    )
    _drives: bool | None = PrivateAttr(default=None)

    @property
    def is_input(self) -> bool:
        """Whether it drives the model rather than being measured."""
        return self.quantity in ("force", "input") if self._drives is None else self._drives

    def placed(self, *, at: str, drives: bool) -> "Channel":
        """Return it at a place of a template, which says whether its quantity drives there or is read."""
        copy = self.model_copy(update={"at": at})
        copy._drives = drives  # noqa: SLF001 - its own class
        return copy

    @property
    def si_factor(self) -> float:
        """What turns the unit into SI; 1.0 for text that is no known unit."""
        return conversion(self.quantity, self.unit)[0]

    @property
    def si_unit(self) -> str:
        """The unit that the model sees; the text itself where it is no known unit."""
        return conversion(self.quantity, self.unit)[1]
