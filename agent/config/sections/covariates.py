"""A channel of role "covariate" and the table [baseline] as frozen models; attributes are the file's keys."""

from typing import Annotated, Literal

from pydantic import Field, Strict

from agent.config.reading.fields import Name, Number, Positive, Table, Text
from agent.config.tuning import BASELINE_CLASSES, BASELINE_DAYS

Span = Annotated[tuple[Number, Number], Strict(False)]
"""Lowest and highest value."""


class Covariate(Table):
    """What a healthy parameter may depend on: value = field * scale + offset in its unit; no model signal."""

    name: Name
    role: Literal["covariate"] = "covariate"
    quantity: Text = "covariate"
    unit: Text = Field(description='the unit after scale and offset, such as "degC", "kN" or "rpm"')
    scale: Number = 1.0
    offset: Number = 0.0
    range: Span | None = Field(
        default=None, description="what it runs through in a year, such as [-10.0, 40.0]"
    )


class BaselineTable(Table):
    """What `baseline learn` wants: covariates (None: all), days with valid rows, classes of each."""

    covariates: Annotated[tuple[Name, ...], Strict(False)] | None = None
    days: Positive = BASELINE_DAYS
    classes: int = Field(
        default=BASELINE_CLASSES, ge=1, le=50, description="classes of a covariate that it must have run in"
    )
