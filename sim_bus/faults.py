"""Faults of devices and lines by name, each for an exact run of samples.

A fault is called `<driver>.<name>`, e.g. serial.garbage; it strikes every source of that driver, or the one named.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim_bus.errors import SimUsageError
from sim_bus.ranges import Runs
from sim_bus.scenario import FaultAt, Scenario
from sim_bus.schedule import first_sample

ONE_SAMPLE = 0.0
SOME_TIME = 0.5

STREAM_FAULTS: Mapping[str, float] = {
    "drop": ONE_SAMPLE,
    "duplicate": ONE_SAMPLE,
    "reorder": ONE_SAMPLE,
    "corrupt": ONE_SAMPLE,
    "truncate": ONE_SAMPLE,
    "garbage": ONE_SAMPLE,
    "freeze": SOME_TIME,
    "stall": SOME_TIME,
    "disconnect": SOME_TIME,
}
"""What a device that sends by itself can do, and for how long where nothing is said.

drop: the sample is not sent. duplicate: it is sent twice. reorder: it changes places with the next one. corrupt: one
bit of it is wrong. truncate: its second half is missing. garbage: rubbish comes before it. freeze: nothing is sent.
stall: everything is sent, but only at the end. disconnect: the line is gone for that time.
"""
MODBUS_FAULTS: Mapping[str, float] = {
    "hang": SOME_TIME,
    "silent": SOME_TIME,
    "busy": SOME_TIME,
    "disconnect": SOME_TIME,
}
"""hang: the registers do not move. silent: no answer. busy: exception 6. disconnect: the server is gone."""
BY_THE_CLOCK = frozenset({"disconnect", "silent", "busy", "hang"})
KNOWN: Mapping[str, Mapping[str, float]] = {"can": STREAM_FAULTS, "serial": STREAM_FAULTS, "modbus": MODBUS_FAULTS}


@dataclass(frozen=True, slots=True)
class Strike:
    """One fault of one source: what, and the samples first .. end − 1 that it strikes."""

    name: str
    first: int
    end: int


def strikes(scenario: Scenario, driver: str, source: str, sample_rate_hz: float) -> tuple[Strike, ...]:
    """Return the scenario's faults that strike a source."""
    mine = [fault for fault in scenario.fault if _driver(fault) == driver and fault.source in (None, source)]
    return tuple(_strike(fault, sample_rate_hz) for fault in mine)


def check(scenario: Scenario, drivers: Sequence[str]) -> None:
    """Raise SimUsageError for a fault that does not exist, or that no source can have."""
    names = [f"{driver}.{name}" for driver, faults in KNOWN.items() for name in faults]
    wrong = [fault.name for fault in scenario.fault if fault.name not in names]
    if wrong:
        raise SimUsageError(f"--fault: no fault is called {', '.join(wrong)}; faults are {', '.join(names)}")
    idle = [fault.name for fault in scenario.fault if _driver(fault) not in drivers]
    if idle:
        raise SimUsageError(f"--fault: {', '.join(idle)}: the configuration has no source with such a driver")


def _driver(fault: FaultAt) -> str:
    return fault.name.partition(".")[0]


def _strike(fault: FaultAt, rate: float) -> Strike:
    driver, _, name = fault.name.partition(".")
    first = first_sample(fault.at_s, rate)
    end = first_sample(fault.at_s + (fault.for_s or KNOWN[driver][name]), rate)
    return Strike(name, first, max(end, first + 1))


class LineFaults:
    """What the faults of one source make of the samples that it sends.

    Args:
        struck: the faults.
        seed: of wrong bits and rubbish.
    """

    def __init__(self, struck: Sequence[Strike], seed: int) -> None:
        self._strikes = tuple(struck)
        self._rng = np.random.default_rng([seed, 4])
        self._late: list[bytes] = []
        self._swapped: bytes | None = None
        self._done = {strike: Runs() for strike in struck}

    def active(self, name: str, sample: int) -> bool:
        """Tell whether a fault strikes at a sample, and note that it did."""
        hit = self._hit(name, sample)
        for strike in hit:
            self._done[strike].add(sample, sample)
        return bool(hit)

    def at_time(self, name: str, sample: int) -> bool:
        """Tell whether a fault that lasts by the clock lasts while `sample` is the newest; it is noted as planned."""
        return bool(self._hit(name, sample))

    def _hit(self, name: str, sample: int) -> list[Strike]:
        return [strike for strike in self._strikes if strike.name == name and strike.first <= sample < strike.end]

    def apply(self, sample: int, data: bytes) -> bytes:
        """Return what goes over the line when a sample is due."""
        if not self._strikes:
            return data
        if self.active("freeze", sample) or self.active("drop", sample):
            data = b""
        data = self._damaged(sample, data)
        if self.active("stall", sample):
            self._late.append(data)
            return b""
        late, self._late = b"".join(self._late), []
        return late + self._in_order(sample, data)

    def _damaged(self, sample: int, data: bytes) -> bytes:
        if data and self.active("corrupt", sample):
            place = int(self._rng.integers(len(data)))
            data = data[:place] + bytes([data[place] ^ 1 << int(self._rng.integers(8))]) + data[place + 1 :]
        if self.active("truncate", sample):
            data = data[: len(data) // 2]
        if self.active("duplicate", sample):
            data = data * 2
        if self.active("garbage", sample):
            data = self._rng.bytes(int(self._rng.integers(1, 40))) + data
        return data

    def _in_order(self, sample: int, data: bytes) -> bytes:
        earlier, self._swapped = self._swapped, None
        if earlier is None and self.active("reorder", sample):
            self._swapped = data
            return b""
        return data + (earlier or b"")

    def refuse(self, names: Iterable[str], why: str) -> None:
        """Raise SimUsageError where a fault cannot be caused."""
        here = sorted({strike.name for strike in self._strikes} & set(names))
        if here:
            raise SimUsageError(f"--fault: {', '.join(here)}: {why}")

    def ledger(self, played: int) -> list[dict[str, Any]]:
        """Return every fault with the samples, among those played, that it struck (or lasted over)."""
        return [{"fault": strike.name, "samples": self._struck(strike).before(played)} for strike in self._strikes]

    def _struck(self, strike: Strike) -> Runs:
        planned = Runs()
        planned.add(strike.first, strike.end - 1)
        return planned if strike.name in BY_THE_CLOCK else self._done[strike]
