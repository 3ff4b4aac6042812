"""Units that would make sense of recordings that a graph does not explain: x1 in mm where the file says m."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from agent.blocks.rig_model import rig_model
from agent.commissioning.explained import explained
from agent.commissioning.identification.material import noise_of_sensors
from agent.commissioning.identification.start import starts
from agent.commissioning.identification.windows import window_length
from agent.commissioning.progress import Progress
from agent.commissioning.readings import Recorded
from agent.commissioning.tuning import LEAST_SAMPLES, UNIT_FITS
from agent.config import RigConfig
from agent.config.model.tables import Channel
from agent.config.reading.units import conversion, is_known
from agent.errors import AgentError
from agent.types import FloatArray

USUAL_UNITS = {
    "force": ("N", "kN", "kgf", "lbf"),
    "displacement": ("m", "mm", "um", "in"),
    "velocity": ("m/s", "mm/s", "in/s"),
    "acceleration": ("m/s2", "g", "mm/s2"),
}
"""Units of a quantity that are taken for one another, the usual ones."""


@dataclass(frozen=True)
class _Reading:
    """Channels read in another unit than stated: their SI values times a factor are the motion's."""

    channels: tuple[Channel, ...]
    unit: str

    @property
    def words(self) -> str:
        names = ", ".join(channel.name for channel in self.channels)
        return f"{names} in {self.unit} where the file says {self.channels[0].unit}"

    def factors(self, channels: Sequence[Channel]) -> FloatArray:
        """Return what SI values of channels (n,) are to be multiplied by."""
        other = conversion(self.channels[0].quantity, self.unit)[0]
        return np.array([other / c.si_factor if c in self.channels else 1.0 for c in channels])


def fitting_units(begun: RigConfig, records: Sequence[Recorded], progress: Progress) -> str:
    """Say in which units the graph explains the recordings from a start; empty where it does in none.

    Other units of all channels of a quantity together come first; where none fits, those of single ones.
    """
    known = [c for c in (*begun.inputs, *begun.outputs) if is_known(c.quantity, c.unit)]
    alike = list(dict.fromkeys(tuple(o for o in known if _are_alike(o, c)) for c in known))
    single = [(c,) for channels in alike if len(channels) > 1 for c in channels]
    short = [_shortened(record) for record in records[:1]]
    for tried in (alike, single):
        found = []
        for reading in _readings(tried):
            progress(f"trying {reading.words}")
            found += [reading.words] if _fits(begun, short, reading) else []
        if found:
            return f"it fits with {'; or '.join(found)}: correct that unit, or the channel's scale"
    return ""


def _are_alike(one: Channel, other: Channel) -> bool:
    return (one.quantity, one.unit) == (other.quantity, other.unit)


def _readings(tried: Sequence[tuple[Channel, ...]]) -> Iterator[_Reading]:
    """Yield every other unit of some channels of one quantity and unit."""
    for channels in tried:
        for unit in USUAL_UNITS.get(channels[0].quantity, ()):
            if conversion(channels[0].quantity, unit)[0] != channels[0].si_factor:
                yield _Reading(channels, unit)


def _shortened(record: Recorded) -> Recorded:
    """Return a part of the longest piece of a recording: units show in it as well."""
    first, end = max(record.pieces, key=lambda piece: piece[1] - piece[0])
    length = max((end - first) // 4, LEAST_SAMPLES)
    return replace(record, pieces=((first, min(first + length, end)),))


def _fits(begun: RigConfig, records: Sequence[Recorded], reading: _Reading) -> bool:
    """Tell whether a start explains the recordings read so."""
    outputs = reading.factors(begun.outputs)
    inputs = reading.factors(begun.inputs)
    read = [
        replace(
            record,
            y=record.y * outputs,
            noise=record.noise * outputs,
            u=np.hstack([record.u[:, : len(inputs)] * inputs, record.u[:, len(inputs) :]]),
        )
        for record in records
    ]
    try:
        config = starts(begun, read)[0]
        seen = explained(
            config,
            rig_model(config).model.nominal,
            read,
            window_length(config, read),
            noise_of_sensors(config, read),
        )
    except (AgentError, np.linalg.LinAlgError):
        return False
    return bool(np.all(seen.beyond < UNIT_FITS))
