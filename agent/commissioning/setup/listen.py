"""`deltak listen`: what comes over a rig's buses, unit by unit, beside what it decodes to; nothing is stored.

Frames, lines and registers are those that the drivers themselves read; nothing is sent but what reading
needs.
"""

import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from agent.clock import monotonic_ns
from agent.commissioning.probe import OPEN_ADVICE, require_sources
from agent.commissioning.readings import Gathering
from agent.commissioning.tuning import KEPT_LINES, MOST_BAD, SHOWN_EVERY_S, TURN_S
from agent.config import RigConfig, load
from agent.config.model.tables import Channel
from agent.config.sections.covariates import Covariate
from agent.config.tables import Source
from agent.errors import BusError, Fault
from agent.runtime.process.requests import asked_by
from agent.runtime.sources import Arrival, Connection, Use, connect, part
from agent.text import printable
from agent.types import FloatArray
from drivers.port import Trace, Unit
from drivers.reconnect import LinkEvent


@dataclass(frozen=True)
class Line:
    """One thing to show: a unit that came, or what happened to a source.

    Attributes:
        at_s: since listening began.
        source: its name.
        raw: the unit as it came, without orders to a terminal; or words.
        values: channel -> (value, unit) of a good unit; None of what is rejected, or is no unit.
        reason: why it was rejected; the cause of what happened.
    """

    at_s: float
    source: str
    raw: str
    values: dict[str, tuple[float, str]] | None = None
    reason: str = ""


Say = Callable[[Line], None]


def listen(config: Path, duration_s: float | None, say: Say) -> dict[str, Any]:
    """Listen for the duration or until a signal; say each line; return rates, ledger and the newest lines.

    Raises ConfigError, UsageError without sources, BusError where a source could not be opened and nothing
    came.
    """
    rig = load(config, identified=True)
    require_sources(rig)
    watch = _Watch.of(rig, say)
    interrupted = False
    try:
        with asked_by(signal.SIGTERM, "stop") as stop:
            stop.begin(watch.end)
            watch.start()
            watch.run(duration_s)
    except KeyboardInterrupt:
        interrupted = True
    finally:
        watch.stop()
    return watch.document() | {"interrupted": interrupted}


@dataclass
class _Ear:
    """One connection: its trace, and the channels of each column of its blocks."""

    connection: Connection
    trace: Trace
    sources: tuple[Source, ...]
    channels: dict[int, Channel | Covariate]
    shown_at_s: float = -1.0
    received: int = 0

    @property
    def name(self) -> str:
        return self.sources[0].name

    def values(self, row: FloatArray) -> dict[str, tuple[float, str]]:
        """Return what a row of fields is in the channels' own units."""
        return {
            channel.name: (float(channel.scale * row[column] + channel.offset), channel.unit)
            for column, channel in self.channels.items()
            if np.isfinite(row[column])
        }


@dataclass
class _Watch:
    """All that is listened to: per source ledger and rates, per channel what it showed last and in all."""

    rig: RigConfig
    gathering: Gathering
    wake: threading.Event
    ears: list[_Ear]
    say: Say
    began_ns: int = 0
    over: bool = False
    lines: deque[Line] = field(default_factory=lambda: deque(maxlen=KEPT_LINES))
    lost: dict[str, str] = field(default_factory=dict)
    seen: dict[str, dict[str, float]] = field(default_factory=dict)

    @classmethod
    def of(cls, rig: RigConfig, say: Say) -> "_Watch":
        wake = threading.Event()
        named = {source.name: source for source in _sources(rig)}
        channels = _channels(rig)
        ears = []
        for connection in connect([rig], wake):
            columns = {
                column: channels[name]
                for use in connection.uses
                for column, name in _columns(use, named[use.source])
            }
            sources = tuple(named[use.source] for use in connection.uses)
            ears.append(_Ear(connection, connection.look_on(), sources, columns))
        gathering = Gathering(rig, {source.name: source.map for source in rig.source}, keep=False)
        return cls(rig, gathering, wake, ears, say)

    def start(self) -> None:
        self.began_ns = monotonic_ns()
        for ear in self.ears:
            ear.connection.start()

    def stop(self) -> None:
        for ear in self.ears:
            ear.connection.stop()
        self._take()

    def run(self, duration_s: float | None) -> None:
        """Show what arrives until the end, or until no source is tried any more."""
        until = float("inf") if duration_s is None else duration_s
        while not self.over and self._now() < until and any(ear.connection.is_alive() for ear in self.ears):
            self.wake.wait(min(TURN_S, max(until - self._now(), 0.0)))
            self.wake.clear()
            self._take()

    def end(self) -> None:
        """Have it end before its time."""
        self.over = True
        self.wake.set()

    def _now(self) -> float:
        return (monotonic_ns() - self.began_ns) / 1e9

    def _take(self) -> None:
        for ear in self.ears:
            arrivals, events = ear.connection.take()
            for event in events:
                self._happened(ear, event)
            for arrival in arrivals:
                self._gather(ear, arrival)
            self.gathering.counts |= {
                use.source: ear.connection.counts for use in ear.connection.uses if use.columns
            }
            for line in self._lines(ear, ear.trace.take()):
                self._show(line)

    def _happened(self, ear: _Ear, event: LinkEvent) -> None:
        if event.cause == "lost":
            self.lost[ear.name] = event.message
        self._show(Line(self._now(), ear.name, printable(event.message), None, event.cause))

    def _gather(self, ear: _Ear, arrival: Arrival) -> None:
        ear.received += len(arrival.block)
        for use in (use for use in ear.connection.uses if use.columns):
            self.gathering.take(use.source, part(arrival.block, use.columns), arrival.modulus)
        for column, channel in ear.channels.items():
            self._note(channel, arrival.block.values[:, column])

    def _note(self, channel: Channel | Covariate, readings: FloatArray) -> None:
        values = channel.scale * readings[np.isfinite(readings)] + channel.offset
        if len(values):
            before = self.seen.get(channel.name, {"n": 0, "min": np.inf, "max": -np.inf})
            low = min(before["min"], float(values.min()))
            high = max(before["max"], float(values.max()))
            self.seen[channel.name] = {
                "n": before["n"] + len(values), "min": low, "max": high, "last": float(values[-1])
            }  # fmt: skip

    def _lines(self, ear: _Ear, units: Sequence[Unit]) -> Iterator[Line]:
        now = self._now()
        bad = [unit for unit in units if unit.values is None]
        for unit in bad[-MOST_BAD:]:
            yield Line(now, ear.name, printable(unit.raw), None, unit.reason)
        # units that carry other fields are other frames: of each kind the newest
        rows = [(unit.raw, unit.values) for unit in units if unit.values is not None]
        newest = {tuple(np.isfinite(values)): (raw, values) for raw, values in rows}
        if newest and now >= ear.shown_at_s + SHOWN_EVERY_S:
            ear.shown_at_s = now
            for raw, values in newest.values():
                yield Line(now, ear.name, printable(raw), ear.values(values))

    def _show(self, line: Line) -> None:
        self.lines.append(line)
        self.say(line)

    def document(self) -> dict[str, Any]:
        """Return everything as JSON carries it. Raises BusError."""
        silent = [ear for ear in self.ears if not ear.received and ear.name in self.lost]
        if silent:
            raise BusError([Fault(ear.name, printable(self.lost[ear.name]), OPEN_ADVICE) for ear in silent])
        sources = self.gathering.sources()
        for source in sources:
            counts = self.gathering.counts[source["name"]]
            first = {reason: printable(raw) for reason, raw in counts.first.items()}
            source |= {"faults": dict(counts.faults), "first_rejected": first}
        return {
            "rig": self.rig.rig.name, "seconds": self._now(), "sources": sources,
            "channels": [
                self._channel(source, name) for source in _sources(self.rig) for name in _fields(source)
            ],
            "lines": [
                {
                    "at_s": line.at_s, "source": line.source, "raw": line.raw, "reason": line.reason,
                    "values": (
                        None if line.values is None else {name: v for name, (v, _) in line.values.items()}
                    ),
                }
                for line in self.lines
            ],
        }  # fmt: skip

    def _channel(self, source: Source, name: str) -> dict[str, Any]:
        channel = _channels(self.rig)[name]
        seen = self.seen.get(name, {})
        return {
            "name": name, "unit": channel.unit, "source": source.name, "field": _fields(source)[name],
            "rate_hz": self._rate(source, int(seen.get("n", 0))), "samples": int(seen.get("n", 0)),
            "last": seen.get("last"), "min": seen.get("min"), "max": seen.get("max"),
        }  # fmt: skip

    def _rate(self, source: Source, readings: int) -> float | None:
        """Readings a second: the source's rate, less what its samples lack of this channel."""
        if not source.map:
            return readings / self._now() if readings else None
        (facts,) = [facts for facts in self.gathering.sources() if facts["name"] == source.name]
        samples = sum(ear.received for ear in self.ears if source in ear.sources)
        return facts["rate_hz"] * readings / samples if facts["rate_hz"] and samples else None


def _sources(rig: RigConfig) -> tuple[Source, ...]:
    """Return all sources, those of covariates alone last."""
    return (*rig.source, *rig.covariate_source)


def _channels(rig: RigConfig) -> dict[str, Channel | Covariate]:
    """Return the channels and covariates by name."""
    found: dict[str, Channel | Covariate] = {channel.name: channel for channel in rig.channel}
    return found | {covariate.name: covariate for covariate in rig.covariate}


def _fields(source: Source) -> dict[str, str]:
    """Return the fields of a source by channel, covariates last."""
    return {**source.map, **source.covariates}


def _columns(use: Use, source: Source) -> list[tuple[int, str]]:
    """Return the columns of a source's blocks with the channels that they are."""
    return [
        *zip(use.columns, source.map, strict=True),
        *((place, name) for name, place in use.covariates.items()),
    ]
