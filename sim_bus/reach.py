"""Whether a scenario fits a rig's wire: fields that end where the motion goes on would carry no readings."""

from collections.abc import Mapping

import numpy as np

from sim_bus.errors import SimUsageError
from sim_bus.player import Player
from sim_bus.rig.faults import check
from sim_bus.rig.rigfile import RigFile
from sim_bus.rig.scenario import Scenario, built_in_names, load_scenario
from sim_bus.rig.trajectory import Chunk, Rig

_LOOK_S = 10.0
_MOST_SAMPLES = 50_000
_TOLERATED = 0.01
"""Share of samples beyond the ends of a field from which on the scenario is not made for that wire."""

Carried = Mapping[int, tuple[float, float]]


def must_fit(rig: RigFile, scenario: Scenario, duration_s: float | None = None) -> None:
    """Raise SimUsageError where the first seconds of a scenario go beyond what the fields can carry.

    What the scenario's sensors get wrong does not count.
    """
    lines = _too_far(rig, scenario, carried_by(rig), duration_s)
    if lines:
        names = ", ".join(fitting(rig))
        raise SimUsageError(
            [f"{line}; play one that fits this rig ({names}) or widen the field" for line in lines]
        )


def fitting(rig: RigFile) -> list[str]:
    """Return the names of the scenarios that come along and fit a rig and its wire."""
    carried = carried_by(rig)
    return [name for name in built_in_names() if _fits(rig, load_scenario(name), carried)]


def carried_by(rig: RigFile) -> Carried:
    """Return what a rig's fields can carry, see `Rig.carried`; its devices are made and put away unopened."""
    player = Player(rig, Scenario())
    for device in player.devices:
        device.stop()
    return player.rig.carried


def _fits(rig: RigFile, scenario: Scenario, carried: Carried) -> bool:
    try:
        check(scenario, rig.drivers)
        return not _too_far(rig, scenario, carried, None)
    except SimUsageError:
        return False


def _too_far(rig: RigFile, scenario: Scenario, carried: Carried, duration_s: float | None) -> list[str]:
    """Return in words which channels leave their fields in the first seconds."""
    seconds = min(_LOOK_S, duration_s or scenario.duration_s or _LOOK_S)
    count = max(1, min(_MOST_SAMPLES, round(seconds * rig.rig.sample_rate_hz)))
    played = Rig(rig, scenario).advance(count)
    return [line for column, ends in sorted(carried.items()) if (line := _beyond(rig, played, column, ends))]


def _beyond(rig: RigFile, played: Chunk, column: int, ends: tuple[float, float]) -> str:
    """Return in words that a channel leaves its field, "" where it does not."""
    channel = rig.channel[column]
    low, high = sorted(end * channel.scale + channel.offset for end in ends)
    values = played.true[:, column] / channel.si_factor
    if np.mean((values < low) | (values > high)) <= _TOLERATED:
        return ""
    reach = values[np.argmax(np.abs(values))]
    wanted = f"{channel.name} would reach {reach:.3g} {channel.unit}"
    return f"--scenario: {wanted}, its field carries {low:.3g} to {high:.3g}"
