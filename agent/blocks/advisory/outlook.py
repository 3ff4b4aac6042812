"""What is known of a parameter's future when its alarms are looked at."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # who makes none need not load what makes them
    from agent.prognosis.change import Change
    from agent.prognosis.forecast import Forecast


@dataclass(frozen=True, slots=True)
class Outlook:
    """A parameter's newest row and what its history leads to.

    Attributes:
        parameter, unit: which.
        t_ns: of the newest row; value, sd: its estimate; reference: what its change is counted from.
        way: |change| at the limit that the forecast is of, in the unit; None without a limit.
        forecast: of that limit, days from the newest row; None without a limit.
        change: None where there are too few rows for a slope.
    """

    parameter: str
    unit: str
    t_ns: int
    value: float
    sd: float
    reference: float
    way: float | None
    forecast: "Forecast | None"
    change: "Change | None"
