"""The watchdog is fed while every thread makes progress; what the service manager is told, to the letter."""

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from agent.runtime.process.heartbeats import Heartbeats, Thread
from agent.runtime.process.service_manager import ServiceManager
from agent.runtime.process.watch import ProcessorWait, Watch

S = 1_000_000_000


class Told:
    """A service manager's socket."""

    def __init__(self, address: str) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(address)
        self._socket.settimeout(5.0)

    def next(self) -> str:
        return self._socket.recv(4096).decode()

    def close(self) -> None:
        self._socket.close()


@pytest.fixture(params=["path", "abstract"])
def manager(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[Told, ServiceManager]]:
    if request.param == "path":
        address = name = str(tmp_path / "notify")
    else:
        name = f"@deltak-test-{os.getpid()}"
        address = "\0" + name[1:]
    told = Told(address)
    yield told, ServiceManager({"NOTIFY_SOCKET": name, "WATCHDOG_USEC": "8000000"})
    told.close()


def test_manager_gets_fields_one_a_line_with_no_line_break_inside(
    manager: tuple[Told, ServiceManager],
) -> None:
    told, ours = manager
    ours.say(READY=1, STATUS="two\nlines")
    assert told.next() == "READY=1\nSTATUS=two lines"


def test_without_a_manager_or_with_one_that_left_nothing_is_said(tmp_path: Path) -> None:
    ServiceManager({}).say(READY=1)
    ServiceManager({"NOTIFY_SOCKET": str(tmp_path / "gone")}).say(READY=1)
    ServiceManager({"NOTIFY_SOCKET": "vsock:2:1234"}).say(READY=1)


@pytest.mark.parametrize(("environment", "interval_s"), [
    ({}, None), ({"WATCHDOG_USEC": "30000000"}, 30.0), ({"WATCHDOG_USEC": "0"}, None),
    ({"WATCHDOG_USEC": "30000000", "WATCHDOG_PID": "1"}, None),
    ({"WATCHDOG_USEC": "30000000", "WATCHDOG_PID": str(os.getpid())}, 30.0),
])  # fmt: skip
def test_interval_is_read_as_sd_watchdog_enabled_does(
    environment: dict[str, str], interval_s: float | None
) -> None:
    assert ServiceManager(environment).watchdog_s == interval_s


def test_thread_that_stalls_ends_the_feeding_and_is_named(
    manager: tuple[Told, ServiceManager], caplog: pytest.LogCaptureFixture
) -> None:
    told, ours = manager
    count = {"read can0": 0, "processing": 0}
    watch = Watch(lambda: [Thread(name, n) for name, n in count.items()], lambda: "1 rig", ours, 60.0, 1.0)
    for second in range(9):
        count["processing"] += 1
        watch.step(second * S)
        assert told.next() == "WATCHDOG=1\nSTATUS=1 rig"
    count["processing"] += 1
    watch.step(9 * S)
    assert told.next() == "STATUS=no progress: read can0"
    assert [record.args[0] for record in caplog.records] == ["read can0"]
    count["read can0"] += 1
    watch.step(10 * S)
    assert told.next().startswith("WATCHDOG=1")


def test_agent_without_processor_time_is_not_taken_for_a_hung_one() -> None:
    heartbeats = Heartbeats(lambda: [Thread("write", 7)], 60.0, 1.0)
    heartbeats.look(0)
    # the watcher itself was given the processor once in ten minutes: two periods count
    assert heartbeats.look(600 * S) == []
    assert heartbeats.beats["write"].silent_s == 2.0
    assert heartbeats.beats["write"].last_ns == 0


def test_thread_of_an_agent_that_waits_for_the_processor_is_silent_only_while_it_may_run() -> None:
    heartbeats = Heartbeats(lambda: [Thread("processing", 7)], 6.0, 1.0, lambda: 0.95)
    assert [heartbeats.look(second * S) for second in range(120)] == [[]] * 120
    assert heartbeats.beats["processing"].silent_s == pytest.approx(119 * 0.05)


def test_wait_for_the_processor_is_that_of_the_thread_that_waited_longest(tmp_path: Path) -> None:
    def write(ran: int = 70, **waited_ns: int) -> None:
        for task, wait in waited_ns.items():
            (tmp_path / task).mkdir(exist_ok=True)
            (tmp_path / task / "schedstat").write_text(f"{ran} {wait} 3\n")

    write(a=1_000_000_000, b=5)
    (tmp_path / "gone").mkdir()
    waits = ProcessorWait(tmp_path)
    write(a=1_200_000_000, b=900_000_005, c=7_000_000_000)  # the last has begun meanwhile
    assert waits.since_last_s() == pytest.approx(0.9)
    assert waits.since_last_s() == 0.0
    write(ran=400_000_070, a=2_200_000_000)  # its own thread ran for a part of it
    assert waits.since_last_s() == pytest.approx(0.6)
    assert ProcessorWait(tmp_path / "nowhere").since_last_s() == 0.0
    assert ProcessorWait().since_last_s() >= 0.0


def test_thread_that_ended_or_is_occupied_does_not_stop_the_feeding() -> None:
    heartbeats = Heartbeats(lambda: [Thread("read", 1, alive=False)], 2.0, 1.0)
    assert [heartbeats.look(second * S) for second in range(9)] == [[]] * 9


def test_patient_thread_may_be_silent_for_longer() -> None:
    heartbeats = Heartbeats(lambda: [Thread("write", 1, patience=2.0)], 2.0, 1.0)
    assert [heartbeats.look(second * S) for second in range(6)] == [[], [], [], [], [], ["write"]]
