"""Channels at the end of their range: flat tops that readings run into faster than a rounded peak could.

A machine that moves somewhere and dwells there brakes before: its readings slow down over the last few
samples as much as they still go. Only speed that such braking does not explain runs into an end.

At the extreme of all readings one such top of an output is enough where it is long for the speed at which it
was entered: under a force that changes from sample to sample a channel may halt for a few of them. Shorter,
or below the extreme, the same value must stop it twice, with nothing beyond in between. A force may rest at
an end of its range between blows, which it also runs into: an input is named the second time only, and never
where it rests, which is at 0 or where it is most of the time.
"""

from typing import NamedTuple

import numpy as np

from agent.numerics.preprocessing import tuning
from agent.numerics.preprocessing.bridge import runs
from agent.numerics.preprocessing.wire import Wire
from agent.types import BoolArray, FloatArray

RAIL_ENTRY = tuning.PLATEAU + tuning.BRAKED_OVER + 1
"""Fixed by these: readings a top may begin with before a block, and those that tell how it was entered."""


class Top(NamedTuple):
    """A flat top (side 1) or bottom (side 0): its value, and how far the motion before would have gone.

    beyond: in steps of the wire about it, or sds of the noise.
    """

    side: int
    value: float
    beyond: float


class Rails:
    """Remembers where each of c channels was stopped; inputs (c,); wire: what they come in."""

    def __init__(self, inputs: BoolArray, wire: Wire) -> None:
        c = len(inputs)
        self._inputs, self._wire = inputs, wire
        self._value = np.full((2, c), np.nan)
        self._times = np.zeros((2, c), dtype=np.int64)
        self._there, self._since = (
            np.zeros((2, c)),
            np.zeros((2, c)),
        )  # readings at the rail, and all since it is one

    def known(self) -> bool:
        """Tell whether some channel was stopped twice at one value."""
        return bool((self._times > 1).any())

    def any_stopped(self) -> bool:
        """Tell whether some channel was stopped at a value, once or more."""
        return not bool(np.isnan(self._value).all())

    def met(self, low: FloatArray, high: FloatArray) -> BoolArray:
        """(N, c) whether readings between low and high (N, c) may be at a value that stopped them."""
        return np.asarray(((low <= self._value[:, None]) & (self._value[:, None] <= high)).any(axis=0))

    def pass_by(self, low: FloatArray, high: FloatArray, samples: int) -> None:
        """Take samples between low and high (c,); a rail that they go beyond is none."""
        self._since += samples
        beyond = np.stack([low < self._value[0], high > self._value[1]])
        self._value[beyond], self._times[beyond] = np.nan, 0

    def rests(self, channel: int, value: float, grain: float) -> bool:
        """Tell whether a channel is an input that may be at a value for long."""
        if not self._inputs[channel]:
            return False
        at = self._value[:, channel] == value
        share = (self._there[at, channel] / np.maximum(self._since[at, channel], 1.0)).max(initial=0.0)
        return bool(abs(value) <= 0.5 * grain or share >= tuning.REST)

    def stopped(self, channel: int, x: FloatArray, ends: tuple[float, float], grain: float) -> bool:
        """Tell whether readings x, RAIL_ENTRY of them before the block, run into an end of a channel's range.

        ends: of all readings so far. grain: step of the wire, or noise; a force that settles in a computer's
        numbers has the steps of their rounding, which it may go several of at once before it stops.
        """
        grain = max(grain, tuning.SAME * max(-ends[0], ends[1]))
        found = False
        for top in tops(x, grain, self._wire.part(slice(channel, channel + 1))):
            is_force_at_rest = self._inputs[channel] and abs(top.value) <= 0.5 * grain
            if not is_force_at_rest:
                found |= self._run_into(channel, top, ends, grain)
        for side in (0, 1):
            found |= self._is_held(channel, side, x, grain)
            self._there[side, channel] += int(np.sum(x[RAIL_ENTRY:] == self._value[side, channel]))
        return found

    def _run_into(self, channel: int, top: Top, ends: tuple[float, float], grain: float) -> bool:
        """Note a flat top; tell whether it is the end of the channel's range."""
        place = top.side, channel
        if self._value[place] != top.value:
            self._value[place] = top.value
            self._times[place] = self._there[place] = self._since[place] = 0
        self._times[place] += 1
        is_extreme = abs(top.value - ends[top.side]) <= 0.5 * grain and not self._inputs[channel]
        is_end = self._times[place] > 1 or (is_extreme and top.beyond > tuning.SURE_OVERSHOOT)
        return bool(is_end) and not self.rests(channel, top.value, grain)

    def _is_held(self, channel: int, side: int, x: FloatArray, grain: float) -> bool:
        """Tell whether readings stay at an end that is known: it need not be run into."""
        rail = float(self._value[side, channel])
        is_known = self._times[side, channel] > 1 and not self.rests(channel, rail, grain)
        return bool(is_known) and any(
            stop - start >= tuning.PLATEAU for start, stop in runs(np.asarray(x == rail))
        )


def tops(x: FloatArray, grain: float, wire: Wire) -> list[Top]:
    """Return the flat tops and bottoms of readings that were entered too fast to be rounded peaks.

    Each is found in one block only: its last equal reading that makes it one is not in the first RAIL_ENTRY.
    grain: step of the wire, noise or rounding of readings, whichever is largest; above 0. wire: what this one
    channel comes in.
    """
    found = []
    for start, stop in runs(np.asarray(np.diff(x) == 0)):
        count = stop - start + 1
        if count < tuning.PLATEAU or start < tuning.BRAKED_OVER + 2 or start + tuning.PLATEAU <= RAIL_ENTRY:
            continue
        side = int(x[start] > x[start - 1])
        near = np.abs(x - x[start]) <= abs(x[start] - x[start - 2])
        here = max(grain, float(wire.unit[0]) * _step_at(wire.readings(x), start, near))
        speed = unbraked((1 if side else -1) * np.diff(x[start - tuning.BRAKED_OVER - 2 : start]), here)
        if speed * count > tuning.OVERSHOOT * here:
            found.append(Top(side, float(x[start]), float(speed * count / here)))
    return found


def _step_at(x: FloatArray, start: int, near: BoolArray) -> float:
    """Return the step of readings x about x[start]; near: those that are certainly of its step.

    Beyond a power of ten the step of a table is ten times that of readings which are not much smaller. What
    comes from before it in one step is no peak of such a table.
    """
    top = float(x[start])
    sign = np.sign(top)
    step = resolution(x[near | (x * top >= tuning.ALIKE * top**2)])
    if not step or not top:
        return step
    decade = 10.0 ** np.floor(np.log10(abs(top)))
    tens = 10.0 ** (np.floor(np.log10(step) + tuning.ROUNDING) + 1)
    beyond = x[x * sign >= (1 - tuning.WHOLE) * decade] / tens
    slow = x[start - 1] * sign >= (1 - tuning.WHOLE) * decade >= tuning.ALIKE * abs(top)
    is_table = slow and np.abs(beyond - np.round(beyond)).max(initial=0.0) < tuning.WHOLE
    return max(step, float(tens)) if is_table else step


def resolution(x: FloatArray) -> float:
    """Return the greatest common divisor of the differences between readings x, their step where they stand.

    Text of few digits, and floats of few bits, have steps that grow with what they say: the least step seen
    anywhere is a tenth or a hundredth of the one at an extreme. 0.0 where no two readings differ.
    """
    apart = np.diff(np.unique(x))
    rounding = tuning.ROUNDING * float(np.abs(x).max(initial=0.0))
    apart = apart[apart > rounding]
    divisor = 0.0
    while len(apart):  # Euclid's algorithm
        divisor = float(apart.min())
        rest = np.abs(apart - divisor * np.round(apart / divisor))
        apart = rest[rest > rounding]
    return divisor


def unbraked(steps: FloatArray, grain: float) -> float:
    """Return the speed, a sample, of the last step towards a top where no braking explains it; else 0.0."""
    last = float(steps[-1])
    lost = (steps[-2::-1] - last) / np.arange(1, len(steps))  # braking may have begun with any of them
    explained = last <= tuning.BRAKING * max(float(lost.max()), 0.0) + tuning.CREEP * grain
    return 0.0 if explained else last
