"""The suite that every driver passes, for pytest.

Outsiders import it and say how their device is played:

    from drivers.conformance import DriverConformance, Line

    class TestMyDriver(DriverConformance):
        def make_line(self) -> Line:
            return MyLine()

A line is a device under the test's control: it offers known samples, dies and comes back. Waiting is always
on a condition with a deadline. A driver that misses a sample, invents one, or writes what a listener must
not, fails.
"""

# ruff: noqa: S101 (a test says what must hold by assert)

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np

from drivers.port import (
    Driver,
    DriverConfigError,
    DriverError,
    DriverIOError,
    FloatArray,
    IntArray,
    SampleBlock,
    SourceRequest,
)
from drivers.tuning import CONFORMANCE_READ_S, DEADLINE_S
from drivers.write_gate import permitted


class Line(ABC):
    """A device that plays what it is told.

    Attributes:
        driver_class: the driver under test.
        protocol: the name under which `drivers.write_gate` knows what may be written.
        counts_samples: whether samples carry a counter.
        outlives: how many samples the device still holds for a driver that comes back; 0 when it holds none.
    """

    driver_class: type[Driver]
    protocol: str
    counts_samples: bool = True
    outlives: int = 0

    @abstractmethod
    def request(self) -> SourceRequest:
        """Return the request of a driver for this line, for all its fields."""

    @abstractmethod
    def play(self, values: FloatArray) -> None:
        """Offer the next samples, (n, m) in the fields' units; the counter goes on from the last played."""

    @abstractmethod
    def kill(self) -> None:
        """Break the line as a pulled plug does."""

    @abstractmethod
    def restore(self) -> None:
        """Mend the line; the counter goes on."""

    @abstractmethod
    def written(self) -> Sequence[bytes]:
        """Return every message that the device received."""

    @abstractmethod
    def close(self) -> None:
        """Take the device away."""

    def bad_requests(self) -> Sequence[Callable[[], SourceRequest]]:
        """Return makers of requests that cannot work beyond an unknown field (missing file, wrong bus)."""
        return ()

    def attached(self, driver: Driver) -> None:  # noqa: B027 (most buses need nothing here)
        """Wait until an opened driver would get what is played next; needed where the bus keeps nothing."""


class DriverConformance(ABC):
    """Tests of one driver; subclasses make the line."""

    line: Line
    driver: Driver

    @abstractmethod
    def make_line(self) -> Line:
        """Return a fresh device."""

    def setup_method(self) -> None:
        """Make the device and a driver that is not open yet."""
        self.line = self.make_line()
        self.driver = self.line.driver_class(self.line.request())

    def teardown_method(self) -> None:
        """Take both away and hold every byte that was written against what a listener may write."""
        self.driver.close()
        self.line.close()
        foreign = [data for data in self.line.written() if not permitted(self.line.protocol, data)]
        assert not foreign, f"a listener wrote {foreign[0]!r} and {len(foreign) - 1} messages more"

    def test_read_of_known_samples_delivers_exactly_these(self) -> None:
        played = self.samples(300)
        self.opened()
        self.line.play(played)
        values, counter = self.collect(300)
        np.testing.assert_array_equal(values, played)
        if self.line.counts_samples:
            self.check_counter(counter, 300)

    def test_read_in_several_goes_neither_misses_nor_repeats(self) -> None:
        played = self.samples(200)
        self.opened()
        pieces = []
        for part in np.array_split(played, 7):
            self.line.play(part)
            pieces.append(self.collect(len(part))[0])
        np.testing.assert_array_equal(np.concatenate(pieces), played)
        assert self.collect_for(3 * CONFORMANCE_READ_S) == 0

    def test_read_without_samples_is_empty_within_its_timeout(self) -> None:
        self.opened()
        begun = time.monotonic()
        block = self.driver.read(CONFORMANCE_READ_S)
        assert len(block) == 0
        assert block.values.shape == (0, len(self.driver.request.fields))
        assert time.monotonic() - begun < CONFORMANCE_READ_S + 2.0

    def test_close_twice_is_harmless(self) -> None:
        self.driver.close()
        self.opened()
        self.driver.close()
        self.driver.close()

    def test_read_before_open_raises_io_error(self) -> None:
        assert raises(DriverIOError, lambda: self.driver.read(CONFORMANCE_READ_S))

    def test_open_after_close_continues_counts_and_samples(self) -> None:
        played = self.samples(100)
        self.opened()
        self.line.play(played[:60])
        self.collect(60)
        self.driver.close()
        self.opened()
        self.line.play(played[60:])
        values, _ = self.collect(40)
        np.testing.assert_array_equal(values, played[60:])
        assert self.driver.counts.received == 100
        assert self.driver.counts.reopened == 1

    def test_device_that_dies_raises_io_error_and_is_read_again_when_back(self) -> None:
        played = self.samples(90)
        self.opened()
        self.line.play(played[:50])
        self.collect(50)
        self.line.kill()
        assert self.fails_in_time(), "the driver reads on from a dead device"
        self.driver.close()
        self.line.restore()
        self.open_in_time()
        self.line.play(played[50:])
        values, _ = self.collect(40)
        np.testing.assert_array_equal(values, played[50:])

    def test_open_without_device_raises_io_error(self) -> None:
        self.line.kill()
        assert raises(DriverIOError, self.open_and_read)

    def test_counts_after_reading_are_conserved(self) -> None:
        self.opened()
        self.line.play(self.samples(120))
        delivered = len(self.collect(120)[0])
        counts = self.driver.counts
        assert counts.received == delivered + counts.rejected.total()

    def test_resolution_before_open_is_one_step_a_field(self) -> None:
        steps = self.driver.resolution()
        assert len(steps) == len(self.driver.request.fields)
        assert all(np.isfinite(step) and step >= 0 for step in steps)

    def test_counter_modulus_once_open_is_known(self) -> None:
        self.opened()
        assert (self.driver.counter_modulus is not None) == self.line.counts_samples

    def test_fields_in_another_order_deliver_columns_in_that_order(self) -> None:
        request = self.line.request()
        turned = SourceRequest(
            request.name, request.settings, request.fields[::-1], request.counter, request.folder
        )
        self.driver = self.line.driver_class(turned)
        assert self.driver.resolution() == self.line.driver_class(request).resolution()[::-1]
        played = self.samples(20)
        self.opened()
        self.line.play(played[:, ::-1])
        np.testing.assert_array_equal(self.collect(20)[0], played)

    def test_field_that_does_not_exist_raises_config_error(self) -> None:
        request = self.line.request()
        wrong = SourceRequest(
            request.name, request.settings, ("Nosuch.field",), request.counter, request.folder
        )
        assert raises(DriverConfigError, lambda: self.line.driver_class(wrong).open())

    def test_request_that_cannot_work_raises_config_error(self) -> None:
        for make in self.line.bad_requests():
            assert raises(DriverConfigError, partial(self.open_request, make))

    def samples(self, count: int) -> FloatArray:
        """Return samples exact on the wire: whole steps of each field's resolution (eighths for floats)."""
        steps = np.array([step or 0.125 for step in self.driver.resolution()])
        whole = np.random.default_rng(count).integers(-100, 101, (count, len(steps)))
        values: FloatArray = whole * steps
        return values

    def open_request(self, make: Callable[[], SourceRequest]) -> None:
        """Make a driver of a request and open it."""
        self.line.driver_class(make()).open()

    def opened(self) -> None:
        """Open the driver and wait until it would get what is played next."""
        self.driver.open()
        self.line.attached(self.driver)

    def open_and_read(self) -> None:
        """Open and read once, as the absence of some devices shows only then."""
        self.driver.open()
        self.driver.read(CONFORMANCE_READ_S)

    def collect(self, count: int) -> tuple[FloatArray, IntArray]:
        """Read until `count` samples have come; return their values and counters."""
        got: list[SampleBlock] = []
        for block in self.blocks(lambda: sum(map(len, got)) < count):
            got.append(block)  # noqa: PERF402 (the loop ends by what it gathers)
        total = sum(map(len, got))
        assert total == count, f"{total} samples came of {count}; counts {self.driver.counts}"
        counters = [
            np.zeros(len(block), np.int64) if block.counter is None else block.counter for block in got
        ]
        return np.concatenate([block.values for block in got]), np.concatenate(counters)

    def blocks(self, wanted: Callable[[], bool]) -> Iterator[SampleBlock]:
        """Yield blocks while they are wanted, at most until the deadline."""
        deadline = time.monotonic() + DEADLINE_S
        while wanted() and time.monotonic() < deadline:
            yield self.driver.read(CONFORMANCE_READ_S)

    def collect_for(self, seconds: float) -> int:
        """Read for a while; return how many samples came."""
        deadline = time.monotonic() + seconds
        return sum(len(block) for block in self.blocks(lambda: time.monotonic() < deadline))

    def check_counter(self, counter: IntArray, count: int) -> None:
        """Hold the counters against one step a sample, modulo the driver's modulus."""
        assert self.driver.counter_modulus is not None
        np.testing.assert_array_equal(np.diff(counter) % self.driver.counter_modulus, np.ones(count - 1))

    def fails_in_time(self) -> bool:
        """Read until the driver says that its device is gone."""
        return raises(DriverIOError, lambda: [len(block) for block in self.blocks(lambda: True)])

    def open_in_time(self) -> None:
        """Open, trying again until the device is back."""
        deadline = time.monotonic() + DEADLINE_S
        while raises(DriverIOError, self.opened):
            self.driver.close()
            assert time.monotonic() < deadline, "the device did not come back"


def raises(kind: type[DriverError], action: Callable[[], object]) -> bool:
    """Tell whether an action raises an error of this kind."""
    try:
        action()
    except kind:
        return True
    return False
