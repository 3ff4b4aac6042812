"""CAN as a source of samples: frames decoded in batches by what a DBC file says. Nothing is sent to the bus."""

from pathlib import Path
from typing import ClassVar

from drivers import clock
from drivers.can_bus import BusKeys, CanBus, Filters, open_bus
from drivers.can_codec import Decoded, FrameDecoder
from drivers.can_database import MessageCodec, load, message_codecs
from drivers.can_frames import Frames, joined, no_frames
from drivers.can_heard import HeardOnCan
from drivers.port import DriverIOError, DriverSettings, SampleBlock, SourceRequest

_GATHER_S = 0.01
_FEW = 64


class CanSettings(BusKeys):
    """Keys of a CAN source: the bus and the DBC file that describes it."""

    dbc: Path


class DbcDriver(HeardOnCan):
    """What live and recorded CAN share: the codecs of the messages asked for."""

    _messages: tuple[MessageCodec, ...] = ()
    _decoder: FrameDecoder

    def prepare(self) -> None:
        """Load the database once; DriverConfigError when it lacks what is asked for."""
        if not self._messages:
            database = load(self.request.folder / self.request.settings.dbc)
            self._messages = message_codecs(database, self.request.fields, self.request.counter)
            self._decoder = FrameDecoder(self._messages, len(self.request.fields), self.counts, self.note)
            self.counter_modulus = self._decoder.modulus

    def resolution(self) -> tuple[float, ...]:
        self.prepare()
        steps = {signal.column: signal.codec.resolution for codec in self._messages for signal in codec.selected}
        return tuple(steps[column] for column in range(len(self.request.fields)))

    def restart(self) -> None:
        self._decoder.restart()

    def decoded(self, frames: Frames) -> SampleBlock:
        """Return the samples that frames complete."""
        self.keep(frames)
        return self.block_of(self._decoder.decode(frames))

    def block_of(self, samples: Decoded) -> SampleBlock:
        """Return decoded samples as a block."""
        return SampleBlock(samples.values, clock.monotonic_ns(), samples.counter, samples.t_ns, samples.epoch)


class CanDriver(DbcDriver):
    """Samples of a CAN bus; the counter is the signal's bits, its modulus follows from their number."""

    settings_model: ClassVar[type[DriverSettings]] = CanSettings

    def __init__(self, request: SourceRequest) -> None:
        super().__init__(request)
        self._bus: CanBus | None = None
        self._opened = False
        self._failure: DriverIOError | None = None

    def open(self) -> None:
        self.close()
        self.prepare()
        self._decoder.restart()
        self._bus = open_bus(self.request.settings, self._filters(), self.counts)
        self.counts.reopened += self._opened
        self._opened = True

    def _filters(self) -> Filters:
        return tuple((codec.number, codec.mask) for codec in self._messages)

    def read(self, timeout_s: float) -> SampleBlock:
        if self._bus is None:
            raise DriverIOError(f"{self.request.name}: read before open")
        if self._failure is not None:
            raise self._failure
        deadline = clock.monotonic() + timeout_s
        frames = self._bus.frames(deadline)
        if 0 < len(frames) < _FEW:
            # a frame a wake-up costs ten times what a frame of a batch does: the next few are worth a short wait
            clock.sleep(max(0.0, min(_GATHER_S, deadline - clock.monotonic())))
            frames = joined(frames, self._rest(self._bus))
        return self.decoded(frames)

    def _rest(self, bus: CanBus) -> Frames:
        """Return what is there already; a failure waits for the next read, so that good frames go out first."""
        try:
            return bus.frames(0.0)
        except DriverIOError as error:
            self._failure = error
            return no_frames()

    def close(self) -> None:
        if self._bus is not None:
            self._bus.close()
        self._bus = None
        self._failure = None
