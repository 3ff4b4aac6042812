"""What must hold in a template and its rig's channels, each of which drives or is read at a place of it."""

from collections.abc import Iterable
from typing import NamedTuple, Protocol

from agent.config.domains.plant import Domain, Place, Plant
from agent.config.reading.fields import shown
from agent.config.reading.messages import listing
from agent.config.reading.parse import Faults, readable
from agent.config.reading.units import Quantity, examples, is_known, wrong_kind


class Placed(NamedTuple):
    """Where a channel is, and whether it drives there."""

    at: str
    drives: bool


class Signal(Protocol):
    """What is looked at of a channel."""

    @property
    def quantity(self) -> Quantity:
        """What it is of."""

    @property
    def at(self) -> str:
        """Where it is, as the file says."""

    @property
    def unit(self) -> str:
        """Its unit."""


def check_template(model: Domain, estimated: Iterable[str], faults: Faults) -> None:
    """Note the faults of a template that could be read; estimated: the names in estimator.estimate."""
    for key, what, advice in model.facts():
        faults.add(f"model.{key}", what, advice)
    if not any(fault.path.startswith("model") for fault in faults.found):
        _check_known(model, set(estimated), faults)


def _check_known(model: Domain, estimated: set[str], faults: Faults) -> None:
    """Note elements of sd_percent that there are not, or that are estimated."""
    storing = [part.name for part in model.parts if part.kind == "storage"]
    for name in model.sd_percent:
        path = f"model.sd_percent.{name}"
        if name not in storing:
            what = f"{shown(name)} is none of those that keep energy"
            faults.add(path, what, f"they are {listing(storing)}; others are estimated")
        elif name in estimated:
            what = f"{shown(name)} is estimated, which takes it for unknown"
            faults.add(path, what, "remove the key, or it from estimator.estimate")


def placed(path: str, channel: Signal, plant: Plant, faults: Faults) -> Placed | None:
    """Return where a channel is in a template; None where it is nowhere, or could not be read."""
    if not readable(channel.quantity, channel.at):
        return None
    place = plant.place(channel.quantity, channel.at)
    if place is None:
        _say_where(path, channel, plant, faults)
        return None
    unit = channel.unit
    if readable(unit) and not is_known(channel.quantity, unit) and wrong_kind(channel.quantity, unit) is None:
        what = f"{shown(unit)} is no unit of {channel.quantity} that is known"
        advice = (
            f"the parameters come out in SI: use one of {examples(channel.quantity)} ..., by scale and offset"
        )
        faults.add(f"{path}.unit", what, advice)
    return Placed(place[1], place in plant.drives)


def _say_where(path: str, channel: Signal, plant: Plant, faults: Faults) -> None:
    alike = _places(place for place in (*plant.drives, *plant.reads) if place[0] == channel.quantity)
    if alike:
        what = f"no {channel.quantity} is at {shown(channel.at)}" if channel.at else "is missing"
        faults.add(f"{path}.at", what, f"{channel.quantity} is at {listing(alike)}")
        return
    driven = listing(dict.fromkeys(place[0] for place in plant.drives))
    read = listing(dict.fromkeys(place[0] for place in plant.reads))
    what = f"{shown(channel.quantity)} is nowhere in this model"
    faults.add(f"{path}.quantity", what, f"what drives it is {driven}; what can be measured is {read}")


def _places(places: Iterable[Place]) -> list[str]:
    return list(dict.fromkeys(at for _, at in places))
