"""One scenario end to end on simulated time: configured drivers on played lines, the agent's own pipeline.

The simulator is a plug-in (entry-point group `deltak.simulators`): it plays each source's device, faults
included, to the driver that the configuration names. No clock is read and no bus is opened, so two runs are
alike.
"""

import random
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Protocol

from agent.config import RigConfig, driver_class, load
from agent.config.tables import Source
from agent.errors import Fault, UsageError
from agent.evaluation.tuning import LINGER_S, READ_S, STEP_S
from agent.records import Health, Record
from agent.runtime.ledger import Conservation
from agent.runtime.rig_runtime import RigRuntime
from agent.runtime.sources import Arrival, use_of
from agent.types import Samples
from drivers.port import Driver, SourceRequest
from drivers.reconnect import ReconnectingDriver

GROUP = "deltak.simulators"

Progress = Callable[[float], None]


class Bench(Protocol):
    """A scenario that is ready to be played."""

    @property
    def config(self) -> Path: ...
    @property
    def duration_s(self) -> float: ...
    @property
    def expect(self) -> Mapping[str, Any]: ...
    def at(self, source: str) -> AbstractContextManager[None]: ...
    def now_s(self, source: str) -> float: ...
    def strikes(self) -> Sequence[tuple[str, str, int, int]]: ...
    def finish(self) -> Mapping[str, Any]: ...


@dataclass(slots=True)
class Outcome:
    """What the agent made of a scenario.

    Attributes:
        truth: what was played, as in a truth file.
        records: all that was published.
        samples: what reached the estimation.
        arrivals: (source, s on its played clock, samples) of every block.
        health: the ledger of each source at the end.
    """

    config: RigConfig
    truth: Mapping[str, Any] = field(default_factory=dict)
    records: list[Record] = field(default_factory=list)
    samples: list[Samples] = field(default_factory=list)
    arrivals: list[tuple[str, float, int]] = field(default_factory=list)
    health: list[Health] = field(default_factory=list)


class _Reader:
    """One source: its driver, kept open, on its played machine."""

    def __init__(self, bench: Bench, config: RigConfig, source: Source) -> None:
        self.source = source
        self._bench = bench
        fields = tuple(dict.fromkeys(source.fields))
        self._use = use_of(config.rig.name, source, fields)
        request = SourceRequest(source.name, source.settings, fields, source.counter, config.folder)
        with bench.at(source.name):
            self.driver: Driver = driver_class(source.driver)(request)
            self._link = ReconnectingDriver(self.driver, source.stale_s, rng=random.Random(1))  # noqa: S311 (jitter)

    def read_until(self, then_s: float, rig: RigRuntime, outcome: Outcome) -> None:
        """Read and process until the source's time has come."""
        with self._bench.at(self.source.name):
            while self._bench.now_s(self.source.name) < then_s:
                block, events = self._link.read(READ_S)
                if len(block):
                    outcome.arrivals.append(
                        (self.source.name, self._bench.now_s(self.source.name), len(block))
                    )
                    whole = replace(block, wall_offset_ns=0)
                    rig.take(
                        self._use, Arrival(whole, self.driver.counts.copy(), self.driver.counter_modulus)
                    )
                    rig.compute()
                for event in events:
                    rig.link(self.source.name, event)

    def close(self) -> None:
        with self._bench.at(self.source.name):
            self._link.close()


class Simulator(Protocol):
    """What the plug-in offers."""

    def scored(self) -> Sequence[str]: ...
    def open_bench(self, name_or_file: str, more_faults: Sequence[str]) -> Bench: ...


def _simulator() -> Simulator:
    points = sorted(entry_points(group=GROUP), key=lambda point: point.name)
    if not points:
        raise UsageError.at("score", "no simulator is installed", "install deltak with its simulator")
    simulator: Simulator = points[0].load()
    return simulator


def shipped() -> Sequence[str]:
    """Return the names of scenarios that ship with an expectation. Raises UsageError without a simulator."""
    return _simulator().scored()


def open_bench(scenario: str, faults: Sequence[str]) -> Bench:
    """Return the bench of a scenario, with more faults. Raises UsageError."""
    try:
        return _simulator().open_bench(scenario, faults)
    except ValueError as error:
        lines = getattr(error, "lines", (str(error),))
        raise UsageError([Fault(*_parted(line)) for line in lines]) from error


def _parted(line: str) -> tuple[str, str, str]:
    """Return where, what and advice of a simulator's line."""
    where, _, rest = line.partition(": ")
    what, _, advice = rest.partition("; ")
    return where, what, advice


def play(bench: Bench, progress: Progress) -> Outcome:
    """Play a scenario to its end; `progress` is called with the share that is done."""
    config = load(bench.config)
    outcome = Outcome(config)
    now = _Now()
    rig = RigRuntime(config, outcome.records.extend, now)
    rig.pipeline.watch = outcome.samples.append
    readers = [_Reader(bench, config, source) for source in (*config.source, *config.covariate_source)]
    end = bench.duration_s + LINGER_S
    while now.seconds < end:
        now.seconds = min(end, now.seconds + STEP_S)
        for reader in readers:
            reader.read_until(now.seconds, rig, outcome)
        progress(now.seconds / end)
    for reader in readers:
        reader.close()
    rig.finish()
    ledger = {r.source.name: Conservation(r.driver.counts, Counter()) for r in readers}
    outcome.health = rig.pipeline.ledger.health(ledger, 0, None)
    outcome.truth = bench.finish()
    return outcome


@dataclass(slots=True)
class _Now:
    """The wall clock of a played run: seconds since its first sample."""

    seconds: float = 0.0

    def __call__(self) -> int:
        return round(self.seconds * 1e9)
