"""The reference of a parameter at what its covariates are now, and how well it is known."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from math import floor, hypot, log10, sqrt

from agent.reference.covariates.lags import Lag, Lagged, Shape
from agent.reference.tuning import LITTLE, OUTSIDE, STRANGE


@dataclass(frozen=True, slots=True)
class Dependence:
    """What a parameter's reference depends on, as it stands in v_baselines.

    Attributes:
        name, unit: the covariate.
        coefficient, sd, lower, upper: parameter's unit a unit of the covariate; 95 % interval.
        shape, lag_s: how the machine follows it; lag_lower_s, lag_upper_s: as probable.
        center: what the reference holds at; low, high: what was learnt lies between; spread: sd of the
            readings.
        hold_s: a reading stands for so long.
        used: whether it is compensated; false where no dependence was found.
    """

    name: str
    unit: str
    coefficient: float
    sd: float
    lower: float
    upper: float
    shape: Shape
    lag_s: float
    lag_lower_s: float
    lag_upper_s: float
    center: float
    low: float
    high: float
    spread: float
    hold_s: float
    used: bool

    @property
    def lag(self) -> Lag:
        """How the machine follows it."""
        return Lag(self.shape, self.lag_s)


def written(found: Sequence[Dependence]) -> str:
    """Return dependences as JSON."""
    return json.dumps([asdict(one) for one in found], allow_nan=False)


def read(text: str) -> tuple[Dependence, ...]:
    """Return dependences from JSON; raises ValueError, KeyError or TypeError for what is none."""
    return tuple(Dependence(**row) for row in json.loads(text))


def shift(lagged: Mapping[str, Lagged], found: Sequence[Dependence]) -> tuple[float, float]:
    """Return by how much covariates move a reference, and the sd of that.

    What is missing is off by as much as the covariate spreads, and more the longer it is missing; beyond what
    was learnt the dependence goes on as a line that may be half off there.
    """
    total, variance = 0.0, 0.0
    for one in found:
        now = lagged[one.name]
        missing = one.coefficient * one.spread * (1.0 - now.known) * now.inflation
        strange = STRANGE * one.coefficient * beyond(one, now)
        variance += (one.sd * now.deviation) ** 2 + missing**2 + strange**2
        total += one.coefficient * now.deviation
    return total, sqrt(variance)


def beyond(one: Dependence, now: Lagged) -> float:
    """Return by how much a covariate is outside what was learnt, in its unit; 0 inside."""
    value = one.center + now.deviation
    return max(value - one.high, one.low - value, 0.0)


def stepped(reference: float, moved: float, step: float) -> float:
    """Return a reference that was moved, in whole steps from where it was learnt."""
    return reference + (step * floor(moved / step + 0.5) if step > 0.0 else moved)


def widened(sd: float, moved_sd: float) -> float:
    """Return the sd of a moved reference, rounded up to two digits so that it is seldom another."""
    whole = hypot(sd, moved_sd)
    if not whole > 0.0:
        return whole
    unit = 10.0 ** (floor(log10(whole)) - 1)
    return sd if moved_sd == 0.0 else float(f"{unit * (floor(whole / unit) + 1):.2g}")


def remark(one: Dependence, now: Lagged) -> str:
    """Say why a reference is not as well known as learnt; empty where it is.

    The words stay while the reason does.
    """
    if now.known < LITTLE:
        return f"{one.name} is missing, or has been for as long as it matters"
    if beyond(one, now) > OUTSIDE * (one.high - one.low):
        return f"{one.name} is outside the {one.low:.3g} to {one.high:.3g} {one.unit} that were learnt"
    return ""
