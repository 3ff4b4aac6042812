"""From what a sensor reads to the number that goes over the wire, and what does not fit it.

reading in the channel's unit → minus channel offset, over channel scale → minus field offset, over field
scale → rounded half to even → held at the ends of the field's range, and counted there.
"""

from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim_bus.arrays import BoolArray, FloatArray, IntArray
from sim_bus.devices.wire_faults import NumberFaults
from sim_bus.errors import SimUsageError
from sim_bus.rig.covariates.channel import CovariateChannel
from sim_bus.rig.faults import Strike
from sim_bus.rig.rigfile import Channel, RigFile, Source
from sim_bus.rig.trajectory import Chunk, Trajectory
from sim_bus.tuning import CHUNK, KEPT

NumberArray = IntArray | FloatArray
Raw = Mapping[str, NumberArray]
Pack = Callable[[Raw], Sequence[bytes]]


@dataclass(frozen=True, slots=True)
class WireNumber:
    """One field on the wire: an integer in low .. high, without them a float; value = raw·scale + offset."""

    name: str
    low: int | None
    high: int | None
    scale: float = 1.0
    offset: float = 0.0

    @classmethod
    def of_type(cls, name: str, type_name: str, scale: float = 1.0, offset: float = 0.0) -> "WireNumber":
        """Return a field by its type's name: int8 .. int64, uint8 .. uint64, float32, float64."""
        dtype = np.dtype(type_name)
        if dtype.kind == "f":
            return cls(name, None, None, scale, offset)
        limits = np.iinfo(dtype)
        return cls(name, int(limits.min), int(limits.max), scale, offset)

    @property
    def bounds(self) -> tuple[float, float]:
        """The least and the largest value that it can carry."""
        if self.low is None or self.high is None:
            return -np.inf, np.inf
        ends = [self.low * self.scale + self.offset, self.high * self.scale + self.offset]
        return min(ends), max(ends)

    @property
    def modulus(self) -> int:
        """After how many steps a counter in this field begins again."""
        return 1 if self.low is None or self.high is None else self.high - self.low + 1

    def encode(self, values: FloatArray) -> tuple[NumberArray, BoolArray]:
        """Return raw numbers of the field's values and where they had to be held at an end of the range."""
        scaled = (values - self.offset) / self.scale
        if self.low is None or self.high is None:
            return scaled, np.zeros(len(values), dtype=np.bool_)
        rounded = np.rint(scaled)
        # the largest 64-bit numbers are no floats: one step inwards keeps them from wrapping
        top = (
            float(self.high)
            if self.high < 2**53
            else float(np.nextafter(float(min(self.high, 2**63 - 1)), 0.0))
        )
        held = np.clip(rounded, float(self.low), top)
        return held.astype(np.int64), held != rounded

    def count(self, index: IntArray) -> IntArray:
        """Return sample numbers as this field counts them: from 0 on, wrapping in the bits that it has."""
        if self.high is None or self.modulus >= 2**63:
            return index
        wrapped = index % self.modulus
        return np.where(wrapped > self.high, wrapped - self.modulus, wrapped)


class Feed:
    """One source's samples as bytes: a row a sample, in chunks, kept as long as those of the trajectory.

    Args:
        trajectory: what is played.
        rig: the configuration.
        source: the source whose fields are filled.
        numbers: the fields on the wire.
        pack: makes rows of bytes from the raw numbers of every field.
        strikes: the source's faults.
    """

    def __init__(
        self, trajectory: Trajectory, rig: RigFile, source: Source, numbers: Sequence[WireNumber], pack: Pack,
        strikes: Sequence[Strike] = (),
    ) -> None:  # fmt: skip
        self._trajectory = trajectory
        self._numbers = tuple(numbers)
        self._pack = pack
        self._columns = _columns(rig, source, {number.name for number in numbers})
        trajectory.rig.carried.update(
            {self._columns[n.name].channel.name: n.bounds for n in numbers if n.name in self._columns}
        )
        self._counters = _counters(source, self._numbers)
        tops = {number.name: number.high for number in numbers}
        signals = [field for field, column in self._columns.items() if not column.beside]
        struck = signals or list(self._columns)
        self._faults = NumberFaults(strikes, [(field, tops[field]) for field in struck])
        self._rows: deque[tuple[int, Sequence[bytes]]] = deque(maxlen=KEPT)
        self._saturated: dict[int, dict[str, BoolArray]] = {}
        self._past: Counter[str] = Counter()

    def raw(self, chunk: Chunk) -> tuple[dict[str, NumberArray], dict[str, BoolArray]]:
        """Return every field's raw numbers, and where a field could not hold its value."""
        index = np.arange(chunk.first, chunk.first + len(chunk))
        counted = self._faults.counted(index)
        raw: dict[str, NumberArray] = {}
        held: dict[str, BoolArray] = {}
        for number in self._numbers:
            if number.name in self._counters:
                raw[number.name] = number.count(counted)
            elif number.name in self._columns:
                values = self._columns[number.name].of(chunk)
                raw[number.name], held[number.name] = number.encode(values)
            else:
                raw[number.name] = np.zeros(len(chunk), dtype=np.int64)
        self._faults.spoil(index, raw)
        return raw, held

    def rows(self, first: int, end: int) -> list[bytes]:
        """Return samples first .. end − 1, one bytes object each."""
        out: list[bytes] = []
        while first < end:
            number, into = divmod(first, CHUNK)
            rows = self._chunk(number)[into : into + end - first]
            out.extend(rows)
            first += len(rows)
        return out

    def _chunk(self, number: int) -> Sequence[bytes]:
        for made, rows in reversed(self._rows):
            if made == number:
                return rows
        raw, held = self.raw(self._trajectory.chunk(number))
        rows = self._pack(raw)
        self._rows.append((number, rows))
        self._remember(number, held)
        return rows

    def _remember(self, number: int, held: dict[str, BoolArray]) -> None:
        self._saturated[number] = {name: where for name, where in held.items() if where.any()}
        for old in [made for made in self._saturated if made <= number - KEPT]:
            self._past.update({name: int(where.sum()) for name, where in self._saturated.pop(old).items()})

    def saturated(self, played: int) -> dict[str, int]:
        """Return how many of the first `played` samples each field could not hold."""
        total = Counter(self._past)
        for number, held in self._saturated.items():
            for name, where in held.items():
                total[name] += int(where[: max(0, played - number * CHUNK)].sum())
        return {name: count for name, count in total.items() if count}


@dataclass(frozen=True, slots=True)
class Column:
    """Where a field's values come from: a column of a chunk's readings, or of what is read beside them."""

    channel: Channel | CovariateChannel
    place: int
    beside: bool

    def of(self, chunk: Chunk) -> FloatArray:
        """Return the values (n,) of the field, before the channel's scale and offset."""
        readings = chunk.covariates if self.beside else chunk.readings
        return np.asarray((readings[:, self.place] - self.channel.offset) / self.channel.scale)


def _columns(rig: RigFile, source: Source, fields: set[str]) -> dict[str, Column]:
    """Return for each field that carries a channel where its values come from."""
    lost = [field for field in source.map.values() if field not in fields]
    if lost:
        known = ", ".join(sorted(fields))
        raise SimUsageError(
            f'source "{source.name}": no field is called {", ".join(lost)}; fields are {known}'
        )
    columns = {one.name: Column(one, place, beside=False) for place, one in enumerate(rig.channel)}
    columns |= {one.name: Column(one, place, beside=True) for place, one in enumerate(rig.covariate)}
    return {field: columns[channel] for channel, field in source.map.items()}


def _counters(source: Source, numbers: Sequence[WireNumber]) -> frozenset[str]:
    """Return the fields that count samples: the configured one, and its namesake in every other message."""
    if source.counter is None:
        return frozenset()
    signal = source.counter.rpartition(".")[2]
    mapped = set(source.map.values())
    same = {
        n.name
        for n in numbers
        if n.name.rpartition(".")[2] == signal and n.name not in mapped and n.low is not None
    }
    return frozenset(same)


def split(data: bytes, size: int) -> list[bytes]:
    """Return bytes as rows of `size`."""
    return [data[start : start + size] for start in range(0, len(data), size)]
