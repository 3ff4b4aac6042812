"""Opening and reading an slcan adapter on a pseudo-terminal."""

import os
import select
import threading
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.can.bus import slcan as can_slcan
from drivers.can.driver import CanDriver, CanSettings
from drivers.port import DriverConfigError, DriverIOError, SourceRequest
from tests.conformance import test_can_conformance

FOLDER = Path(test_can_conformance.__file__).parent
FRAME = b"t10080100000405000000\r"


class Adapter:
    """The far end of a line: takes down what is asked and answers each command as it is told."""

    def __init__(self, answers: dict[bytes, bytes]) -> None:
        self.master, slave = os.openpty()
        tty.setraw(slave)
        self.port = os.ttyname(slave)
        self._slave = slave
        self.asked: list[bytes] = []
        self._answers = answers
        self._wake, self._woken = os.pipe()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        waiting = b""
        while True:
            ready, _, _ = select.select([self.master, self._wake], [], [])
            if self._wake in ready:
                return
            waiting += os.read(self.master, 100)
            while b"\r" in waiting:
                command, _, waiting = waiting.partition(b"\r")
                self.asked.append(command)
                os.write(self.master, self._answers.get(command[:1], b"\r"))

    def unplug(self) -> None:
        if self._thread.is_alive():
            os.close(self._woken)
            self._thread.join(10.0)
            for end in (self._wake, self._slave, self.master):
                os.close(end)


@pytest.fixture
def adapter(request: pytest.FixtureRequest) -> Iterator[Adapter]:
    made = Adapter(getattr(request, "param", {}))
    yield made
    made.unplug()


def driver(port: str, **keys: object) -> CanDriver:
    settings = CanSettings.model_validate({"interface": "slcan", "channel": port, "dbc": "rig.dbc", **keys})
    return CanDriver(SourceRequest("line", settings, ("RIG_SAMPLE.X1",), "RIG_SAMPLE.Counter", FOLDER))


def samples_of(reader: CanDriver, count: int) -> list[float]:
    got: list[float] = []
    for _ in range(200):
        got += reader.read(0.1).values[:, 0].tolist()
        if len(got) >= count:
            break
    return got


def test_adapter_is_read_and_nothing_is_written_to_it(adapter: Adapter) -> None:
    reader = driver(adapter.port)
    reader.open()
    os.write(adapter.master, b"\xff\xfe\r" + FRAME * 3 + b"\a")
    assert samples_of(reader, 3) == [2.5] * 3
    assert reader.counts.rejected == {}  # the first line may have begun before the port was opened
    assert reader.counts.faults == {"adapter refuses": 1}
    reader.close()
    assert adapter.asked == []


def test_descriptor_of_an_adapter_that_is_only_read_refuses_writes(adapter: Adapter) -> None:
    reader = driver(adapter.port)
    reader.open()
    assert isinstance(reader._bus, can_slcan.SlcanBus)
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.write(reader._bus._pipe.fileno(), b"t1000\r")
    reader.close()


@pytest.mark.parametrize("adapter", [{}, {b"C": b"\a"}, {b"C": b"", b"S": b"", b"L": b""}], indirect=True)
def test_adapter_is_opened_to_listen_only_and_closed_again_where_that_is_asked(adapter: Adapter) -> None:
    reader = driver(adapter.port, open_adapter=True, bitrate=500_000)
    reader.open()
    assert adapter.asked == [b"C", b"S6", b"L"]
    os.write(adapter.master, FRAME)
    assert samples_of(reader, 1) == [2.5]
    reader.close()
    for _ in range(1000):
        if len(adapter.asked) == 4:
            break
        threading.Event().wait(0.01)
    assert adapter.asked[3:] == [b"C"]


@pytest.mark.parametrize("adapter", [{b"L": b"\a"}], indirect=True)
def test_adapter_that_cannot_listen_only_is_refused_and_never_opened_otherwise(adapter: Adapter) -> None:
    with pytest.raises(DriverIOError, match="refuses to listen only"):
        driver(adapter.port, open_adapter=True, bitrate=500_000).open()
    assert b"O" not in adapter.asked


@pytest.mark.parametrize("bitrate", [None, 300_000])
def test_bit_rate_without_a_code_is_a_fault_of_the_configuration(
    adapter: Adapter, bitrate: int | None
) -> None:
    with pytest.raises(DriverConfigError, match="10000, 20000, 50000"):
        driver(adapter.port, open_adapter=True, bitrate=bitrate).open()


def test_adapter_that_is_unplugged_is_told(adapter: Adapter) -> None:
    reader = driver(adapter.port)
    reader.open()
    adapter.unplug()
    with pytest.raises(DriverIOError):
        samples_of(reader, 1)
    reader.close()


def test_bus_off_that_an_adapter_tells_of_is_reported(adapter: Adapter) -> None:
    reader = driver(adapter.port)
    reader.open()
    os.write(adapter.master, b"\rsb000000\r" + FRAME)
    assert samples_of(reader, 1) == [2.5]
    assert [name for name, _ in reader.take_reports()] == ["bus-off"]
    assert reader.counts.faults == {"bus-off": 1}
    assert reader.counts.received == 1
    reader.close()
