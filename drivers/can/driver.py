"""CAN as a source of samples: frames decoded in batches as a DBC file says. Nothing is sent to the bus."""

from typing import ClassVar

import numpy as np
from pydantic import Field

from drivers import clock
from drivers.can.bus import netlink as can_link
from drivers.can.bus.bus import BusKeys, CanBus, DaemonBus, Filters, PythonCanBus
from drivers.can.bus.kernel import KernelBus
from drivers.can.bus.slcan import SlcanBus
from drivers.can.codec.capture import CanCapture
from drivers.can.codec.database import MessageCodec, load, message_codecs
from drivers.can.codec.decoder import FrameDecoder
from drivers.can.codec.error_frames import ErrorWatch
from drivers.can.codec.frames import Frames
from drivers.can.codec.joiner import Decoded
from drivers.can.codec.layout import FrameKeys
from drivers.can.tuning import FEW_FRAMES
from drivers.port import DriverIOError, DriverSettings, IntArray, SampleBlock, SourceRequest
from drivers.tuning import RETRY_HERE_S, RETRY_S

_HERE = frozenset({"socketcan", "slcan"})
"""Buses of which this machine knows whether they are there."""


class CanSettings(BusKeys, FrameKeys):
    """Keys of a CAN source: the bus, how often it is read, its DBC file, how samples lie in its frames."""

    period_s: float | None = Field(default=None, gt=0, le=CanBus.gather_s)


class DbcDriver(CanCapture):
    """What live and recorded CAN share: the codecs of the messages asked for."""

    stamped: ClassVar[bool | None] = True
    _messages: tuple[MessageCodec, ...] = ()
    _decoder: FrameDecoder

    def prepare(self) -> None:
        """Load the database once; DriverConfigError when it lacks what is asked for."""
        if not self._messages:
            settings = self.request.settings
            database = load(self.request.folder / settings.dbc)
            self._messages = message_codecs(database, self.request.fields, self.request.counter, settings)
            errors = ErrorWatch(self.request.name, self.counts, self.report)
            self._decoder = FrameDecoder(
                self._messages, len(self.request.fields), self.counts, self.note, errors
            )
            self.counter_modulus = self._decoder.modulus

    def resolution(self) -> tuple[float, ...]:
        self.prepare()
        steps = {
            signal.column: signal.codec.resolution for codec in self._messages for signal in codec.selected
        }
        return tuple(steps[column] for column in range(len(self.request.fields)))

    def restart(self) -> None:
        self._decoder.restart()

    def decoded(self, frames: Frames) -> SampleBlock:
        """Return the samples that frames complete."""
        self.keep(frames)
        return self.block_of(self._decoder.decode(frames))

    def block_of(self, samples: Decoded) -> SampleBlock:
        """Return decoded samples as a block."""
        t_ns = self._spread(samples.t_ns)
        return SampleBlock(samples.values, clock.monotonic_ns(), samples.counter, t_ns, samples.epoch)

    def _spread(self, t_ns: IntArray) -> IntArray:
        """Return the times of samples that came in one frame: the last one has the frame's."""
        count, period_s = self.request.settings.samples_per_frame, self.request.settings.sample_period_s
        if count == 1 or period_s is None:
            return t_ns
        before = np.arange(count)[::-1] * round(period_s * 1e9)
        spread: IntArray = t_ns - np.tile(before, len(t_ns) // count)
        return spread


class CanDriver(DbcDriver):
    """Samples of a CAN bus; the counter is the signal's bits, its modulus follows from their number."""

    settings_model: ClassVar[type[DriverSettings]] = CanSettings

    def __init__(self, request: SourceRequest) -> None:
        super().__init__(request)
        self._bus: CanBus | None = None
        self._opened = False
        self._due = 0.0
        self._reported: set[str] = set()

    @property
    def retry_s(self) -> float:
        return RETRY_HERE_S if self.request.settings.interface in _HERE else RETRY_S

    def hints(self) -> tuple[str, ...]:
        return can_link.hints(self.request.settings)

    def open(self) -> None:
        self.close()
        self.prepare()
        self._decoder.restart()
        self._bus = self._open_bus()
        self._look()
        self.counts.reopened += self._opened
        self._opened = True

    def _open_bus(self) -> CanBus:
        settings: CanSettings = self.request.settings
        if settings.interface == "socketcan":
            return KernelBus(settings, self._filters(), self.counts)
        if settings.interface == "socketcand":
            return DaemonBus(settings, self.counts)
        if settings.interface == "slcan":
            return SlcanBus(settings, self.request.folder, self.counts)
        return PythonCanBus(settings)

    def _filters(self) -> Filters:
        return tuple((codec.number, codec.mask) for codec in self._messages)

    def _look(self) -> None:
        """Report, once each, what is amiss about how the interface was set up."""
        for hint in set(self.hints()) - self._reported:
            self._reported.add(hint)
            self.report("bus setup", f"{self.request.name}: {hint}")

    def read(self, timeout_s: float) -> SampleBlock:
        if self._bus is None:
            raise DriverIOError(f"{self.request.name}: read before open")
        deadline = clock.monotonic() + timeout_s
        clock.sleep(max(0.0, min(self._due, deadline) - clock.monotonic()))
        frames = self._bus.frames(deadline)
        self._due = clock.monotonic() + self._period_s(self._bus) if 0 < len(frames) < FEW_FRAMES else 0.0
        return self.decoded(frames)

    def _period_s(self, bus: CanBus) -> float:
        asked: float | None = self.request.settings.period_s
        return bus.gather_s if asked is None else min(asked, bus.gather_s)

    def close(self) -> None:
        if self._bus is not None:
            self._bus.close()
        self._bus = None
