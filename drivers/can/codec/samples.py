"""A message's signals as samples: multiplexed ones, several samples in a frame, and their counters. Pure."""

from dataclasses import dataclass

import numpy as np

from drivers.can.codec.frames import FrameTable
from drivers.can.codec.signals import SignalCodec
from drivers.port import BoolArray, FloatArray, IntArray

Switches = tuple[tuple[SignalCodec, tuple[int, ...]], ...]
"""Multiplexers that must show one of some numbers, (codec, numbers) each."""


@dataclass(frozen=True, slots=True)
class Selected:
    """A signal that is asked for, and the multiplexers that must say that it is there."""

    column: int
    codec: SignalCodec
    switches: Switches

    def values(self, table: FrameTable) -> FloatArray:
        """Return the signal's values, (n,), NaN in the frames that carry another one in its place."""
        values = self.codec.values(table)
        for switch, numbers in self.switches:
            values[~shows(table, switch, numbers)] = np.nan
        return values


@dataclass(frozen=True, slots=True)
class Page:
    """Columns that come in the same frames: those where the multiplexers show what `switches` names."""

    columns: IntArray
    switches: Switches

    def shown(self, table: FrameTable) -> BoolArray:
        """Tell of each frame whether it carries the page."""
        here = np.ones(len(table), np.bool_)
        for switch, numbers in self.switches:
            here &= shows(table, switch, numbers)
        return here


@dataclass(frozen=True, slots=True)
class FrameCounter:
    """What numbers samples.

    Attributes:
        codec: the signal.
        modulus: the signal begins anew after so many.
        samples: in a frame.
        of_frames: the signal counts frames, not samples.
    """

    codec: SignalCodec
    modulus: int
    samples: int
    of_frames: bool

    @property
    def sample_modulus(self) -> int:
        """The samples' counter begins anew after so many."""
        return self.modulus * self.samples if self.of_frames else self.modulus

    def possible(self, table: FrameTable) -> BoolArray:
        """Tell of each frame whether its counter is one that can be."""
        if self.modulus == 1 << self.codec.length:
            return np.ones(len(table), np.bool_)
        below: BoolArray = self.codec.bits(table) < np.uint64(self.modulus)
        return below

    def numbers(self, table: FrameTable) -> IntArray:
        """Return the counter of each sample, (frames × samples,)."""
        counter = self.codec.counter(table)
        if self.samples == 1:
            return counter
        first = counter * self.samples if self.of_frames else counter
        return (first[:, None] + np.arange(self.samples)).reshape(-1) % self.sample_modulus


def shows(table: FrameTable, switch: SignalCodec, numbers: tuple[int, ...]) -> BoolArray:
    """Tell of each frame whether a multiplexer shows one of these numbers."""
    return np.isin(switch.bits(table), np.array(numbers, np.uint64))


def pages_of(selected: tuple[Selected, ...]) -> tuple[Page, ...]:
    """Return the pages of a message's signals; those that no multiplexer switches stand on every one."""
    keys = {_key(signal.switches): signal.switches for signal in selected if signal.switches}
    if len(keys) < 2:
        return (Page(np.array([signal.column for signal in selected]), ()),)
    return tuple(
        Page(np.array([s.column for s in selected if not s.switches or _key(s.switches) == key]), switches)
        for key, switches in keys.items()
    )


def _key(switches: Switches) -> tuple[tuple[str, tuple[int, ...]], ...]:
    return tuple((codec.name, numbers) for codec, numbers in switches)
