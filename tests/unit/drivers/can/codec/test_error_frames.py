"""Error frames by name: counted, reported once, never samples."""

import numpy as np
import pytest

from drivers.can.codec.error_frames import ErrorWatch, names_of
from drivers.can.codec.frames import ERROR, Frames, frames_of, pack_frame
from drivers.port import Counts, Driver, DriverSettings, SampleBlock, SourceRequest
from tests.links import NotedLink

SECOND = 1_000_000_000


def error(identifier: int, controller: int = 0, sent: int = 0, received: int = 0) -> bytes:
    return pack_frame(ERROR | identifier, bytes((0, controller, 0, 0, 0, 0, sent, received)))


def frames(*rows: bytes, step_ns: int = SECOND) -> Frames:
    return frames_of(rows, np.arange(len(rows)) * step_ns)


class Watched:
    def __init__(self) -> None:
        self.counts = Counts()
        self.reports: list[tuple[str, str]] = []
        self.watch = ErrorWatch("can0", self.counts, lambda name, words: self.reports.append((name, words)))

    def take(self, batch: Frames) -> list[str]:
        self.reports.clear()
        self.watch.take(batch.table, batch.t_ns)
        return [name for name, _ in self.reports]


@pytest.mark.parametrize(
    ("identifier", "controller", "names"),
    [
        (0x001, 0, ["transmit time-out"]),
        (0x002, 0, ["arbitration lost"]),
        (0x004, 0x00, ["controller fault"]),
        (0x004, 0x01, ["controller overflow"]),
        (0x004, 0x02, ["controller overflow"]),
        (0x004, 0x04, ["error-warning"]),
        (0x004, 0x08, ["error-warning"]),
        (0x204, 0x10, ["error-passive"]),
        (0x204, 0x20, ["error-passive"]),
        (0x204, 0x40, ["error-active"]),
        (0x008, 0, ["protocol error"]),
        (0x010, 0, ["transceiver fault"]),
        (0x020, 0, ["no acknowledgement"]),
        (0x040, 0, ["bus-off"]),
        (0x080, 0, ["bus error"]),
        (0x100, 0, ["restarted"]),
        (0x0A8, 0, ["protocol error", "no acknowledgement", "bus error"]),
        (0x000, 0, ["error frame"]),
        (0x200, 0, ["error frame"]),
    ],
)
def test_error_frame_of_every_class_has_its_name(identifier: int, controller: int, names: list[str]) -> None:
    assert names_of(identifier, controller) == names


def test_error_frames_are_counted_by_name_and_other_frames_are_not() -> None:
    watched = Watched()
    watched.take(frames(error(0x40), pack_frame(0x100, bytes(8)), error(0x20), error(0x20)))
    assert watched.counts.faults == {"bus-off": 1, "no acknowledgement": 2}
    assert watched.counts.received == 0


def test_state_of_the_controller_is_reported_once_when_it_begins() -> None:
    watched = Watched()
    passive = [error(0x204, 0x10, 3, 130)] * 5
    assert watched.take(frames(error(0x4, 0x04), *passive, error(0x40))) == [
        "error-warning", "error-passive", "bus-off",
    ]  # fmt: skip
    assert watched.take(frames(error(0x40), error(0x100))) == ["restarted"]
    assert watched.take(frames(error(0x40))) == ["bus-off"]


def test_report_names_bus_state_and_the_controllers_own_counts() -> None:
    watched = Watched()
    watched.take(frames(error(0x204, 0x10, 3, 130)))
    assert watched.reports[0][1].startswith("can0: error-passive: the controller sees so many errors")
    assert watched.reports[0][1].endswith("(transmit errors 3, receive errors 130)")


def test_other_faults_are_reported_when_they_begin_and_not_again_within_a_minute() -> None:
    watched = Watched()
    many = [error(0x20)] * 100
    assert watched.take(frames(*many)) == ["no acknowledgement"]
    late = Frames(frames(error(0x20)).table, np.array([99 + 61]) * SECOND)
    assert watched.take(late) == ["no acknowledgement"]
    assert watched.counts.faults == {"no acknowledgement": 101}


def test_error_frame_without_a_class_is_counted_and_told_to_nobody() -> None:
    watched = Watched()
    assert watched.take(frames(error(0))) == []
    assert watched.counts.faults == {"error frame": 1}


class Told(Driver):
    """Delivers what it is told, and reports what it is told."""

    settings_model = DriverSettings

    def __init__(self) -> None:
        super().__init__(SourceRequest("can", None, ("x",)))
        self.next = 0

    def open(self) -> None: ...

    def close(self) -> None: ...

    def resolution(self) -> tuple[float, ...]:
        return (0.0,)

    def read(self, timeout_s: float) -> SampleBlock:
        return SampleBlock(np.zeros((self.next, 1)), 0)


def test_bus_off_is_one_fault_until_samples_come_again() -> None:
    now = [0.0]
    driver = Told()
    wrapper = NotedLink(driver, 2.0, clock=lambda: now[0])
    driver.report("bus-off", "can0: bus-off")
    wrapper.read(0.0)
    driver.report("bus-off", "can0: bus-off again")
    wrapper.read(0.0)
    assert wrapper._fault is not None
    now[0] = 5.0  # silent for longer than stale_s: opened anew, and still the one fault
    wrapper.read(0.0)
    assert not wrapper.is_open
    now[0] = 10.0
    driver.next = 1
    wrapper.read(0.0)
    events = wrapper.take_events()
    assert [(event.cause, event.away) for event in events] == [("bus-off", True), ("recovered", False)]
    assert events[0].message == "can0: bus-off"


def test_error_passive_is_an_event_and_no_loss() -> None:
    driver = Told()
    driver.next = 1
    wrapper = NotedLink(driver, 2.0)
    driver.report("error-passive", "can0: error-passive")
    wrapper.read(0.0)
    assert [(event.cause, event.away) for event in wrapper.take_events()] == [("error-passive", False)]
    assert wrapper._fault is None
