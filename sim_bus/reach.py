"""Whether a scenario fits a rig's wire: fields that end where the motion goes on would carry no readings."""

from collections.abc import Mapping

import numpy as np

from sim_bus.arrays import FloatArray
from sim_bus.errors import SimUsageError
from sim_bus.player import Player
from sim_bus.rig.covariates.channel import CovariateChannel
from sim_bus.rig.faults import check
from sim_bus.rig.rigfile import Channel, RigFile
from sim_bus.rig.scenario import Scenario, built_in_names, load_scenario
from sim_bus.rig.trajectory import Rig
from sim_bus.tuning import BEYOND_SHARE, INSTANTS, SEEN_S, SEEN_SAMPLES

_DAY_S = 86_400.0  # fixed by units

Carried = Mapping[str, tuple[float, float]]


def must_fit(rig: RigFile, scenario: Scenario, duration_s: float | None = None) -> None:
    """Raise SimUsageError where the first seconds of a scenario go beyond what the fields can carry.

    Covariates are looked at until the scenario ends.

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
    seconds = min(SEEN_S, duration_s or scenario.duration_s or SEEN_S)
    count = max(1, min(SEEN_SAMPLES, round(seconds * rig.rig.sample_rate_hz)))
    moved = Rig(rig, scenario)
    played = moved.advance(count).true
    beside = moved.covariates.true(np.linspace(0.0, duration_s or scenario.duration_s or _DAY_S, INSTANTS))
    lines = [
        _beyond(channel, played[:, column] / channel.si_factor, carried.get(channel.name))
        for column, channel in enumerate(rig.channel)
    ]
    lines += [
        _beyond(one, beside[:, column], carried.get(one.name)) for column, one in enumerate(rig.covariate)
    ]
    return [line for line in lines if line]


def _beyond(channel: Channel | CovariateChannel, values: FloatArray, ends: tuple[float, float] | None) -> str:
    """Return in words that a channel's values (n,), in its unit, leave its field, "" where they do not."""
    if ends is None:
        return ""
    low, high = sorted(end * channel.scale + channel.offset for end in ends)
    if np.mean((values < low) | (values > high)) <= BEYOND_SHARE:
        return ""
    reach = values[np.argmax(np.abs(values))]
    wanted = f"{channel.name} would reach {reach:.3g} {channel.unit}"
    return f"--scenario: {wanted}, its field carries {low:.3g} to {high:.3g}"
