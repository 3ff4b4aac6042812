import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import can
import pytest

from drivers.can.driver import CanDriver, CanSettings
from drivers.port import DriverConfigError, DriverIOError, SourceRequest
from tests.conformance import test_can_conformance
from tests.conformance.socketcand_device import Socketcand

FOLDER = Path(test_can_conformance.__file__).parent


def driver(**keys: object) -> CanDriver:
    settings = CanSettings.model_validate({"channel": "can0", "dbc": "rig.dbc", **keys})
    return CanDriver(SourceRequest("line", settings, ("RIG_SAMPLE.X1",), "RIG_SAMPLE.Counter", FOLDER))


@pytest.fixture
def daemon() -> Iterator[Socketcand]:
    device = Socketcand()
    device.start()
    yield device
    device.stop()


def test_interface_of_python_can_is_read_by_its_name() -> None:
    reader = driver(interface="virtual", channel="shared")
    reader.open()
    with can.Bus("shared", "virtual") as sender:
        for number in range(300):
            data = number.to_bytes(2, "little") + bytes([0, 0, number % 100, 0, 0, 0])
            sender.send(can.Message(arbitration_id=0x100, data=data, is_extended_id=False))
            sender.send(can.Message(arbitration_id=0x101, data=data, is_extended_id=False))
        sender.send(can.Message(arbitration_id=0x100, dlc=8, is_remote_frame=True, is_extended_id=False))
        block = reader.read(5.0)
    assert block.counter is not None
    assert block.counter.tolist() == list(range(300))
    assert block.values[:, 0].tolist() == [number % 100 * 0.5 for number in range(300)]
    assert reader.counts.rejected == {"remote frame": 1}
    reader.close()
    reader.close()


def test_interface_that_python_can_lacks_is_refused() -> None:
    with pytest.raises(DriverConfigError, match='python-can has no interface "nosuch"'):
        driver(interface="nosuch").open()


def test_kernel_bus_that_is_not_there_raises_io_error_in_words() -> None:
    with pytest.raises(DriverIOError, match="can77"):
        driver(interface="socketcan", channel="can77").open()


@pytest.mark.realtime
def test_refused_daemon_is_told_at_once_and_costs_no_processor_time() -> None:
    with Free() as port:
        reader = driver(interface="socketcand", port=port)
        begun, used = time.monotonic(), time.process_time()
        with pytest.raises(DriverIOError, match="refused"):
            reader.open()
        assert time.monotonic() - begun < 1.0
        assert time.process_time() - used < 1.0


class Free:
    """A port at which nobody listens."""

    def __enter__(self) -> int:
        device = Socketcand()
        device.start()
        device.stop()
        return device.port

    def __exit__(self, *_: object) -> None: ...


def test_daemon_that_does_not_serve_the_bus_is_told_in_words(daemon: Socketcand) -> None:
    with pytest.raises(DriverIOError, match="does it serve can9"):
        driver(interface="socketcand", port=daemon.port, channel="can9").open()


def test_server_that_is_no_daemon_is_told_in_words() -> None:
    device = Socketcand(hello=b"HTTP/1.1 400 Bad Request\r\n" * 200)
    device.start()
    with pytest.raises(DriverIOError, match="socketcand answers"):
        driver(interface="socketcand", port=device.port).open()
    device.stop()


def test_daemon_that_dies_is_told_though_the_library_would_be_silent(daemon: Socketcand) -> None:
    reader = driver(interface="socketcand", port=daemon.port)
    reader.open()
    daemon.wait_for_clients(1)
    daemon.stop()
    with pytest.raises(DriverIOError):
        read_often(reader)
    reader.close()


def read_often(reader: CanDriver) -> None:
    for _ in range(100):
        reader.read(0.05)


def test_daemon_messages_that_make_no_sense_are_rejected_as_text(daemon: Socketcand) -> None:
    reader = driver(interface="socketcand", port=daemon.port)
    reader.open()
    daemon.wait_for_clients(1)
    daemon.send(b"< frame 100 1.0 010000000000 >< frame zzz >< frame 100 1.0 0200000000000000 >")
    block = reader.read(5.0)
    assert len(block) == 1
    assert reader.counts.rejected == {"text": 1, "dlc": 1}
    assert reader.counts.received == 3
    reader.close()


def test_frames_that_come_with_the_last_answer_are_not_taken_for_a_refusal() -> None:
    frames = b"".join(b"< frame 100 1.%06d %04X000000000000 >" % (number, number) for number in range(500))
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            client, _ = server.accept()
            with client:
                for answer in (b"< hi >", b"< ok >", b"< ok >" + frames):
                    client.sendall(answer)
                    client.recv(100)

        serving = threading.Thread(target=serve)
        serving.start()
        reader = driver(interface="socketcand", port=server.getsockname()[1])
        reader.open()
        seen = 0
        deadline = time.monotonic() + 10.0
        while seen < 500 and time.monotonic() < deadline:
            seen += len(reader.read(0.1))
        reader.close()
        serving.join()
    assert seen == 500
