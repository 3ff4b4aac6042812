import importlib
import importlib.metadata
import json
import socket
import tempfile
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.conformance import DriverConformance, Line
from drivers.port import Driver, FloatArray, SampleBlock, SourceRequest
from tests.tracing.watch import on_purpose

DISTRIBUTION = Path(__file__).parent / "thirdparty"


def found_driver() -> type[Driver]:
    """Find the driver as the agent finds any: by the entry point of its installed distribution."""
    points = importlib.metadata.entry_points(group="deltak.drivers", name="loadcell")
    (point,) = points
    driver = point.load()
    assert issubclass(driver, Driver)
    return driver  # type: ignore[no-any-return]


@pytest.fixture(autouse=True)
def installed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Put the distribution on the path, as an installation does."""
    monkeypatch.syspath_prepend(str(DISTRIBUTION))
    importlib.invalidate_caches()


class GatewayLine(Line):
    """The load cell's gateway."""

    protocol = "loadcell"

    def __init__(self, driver_class: type[Driver]) -> None:
        self.driver_class = driver_class
        self.folder = tempfile.TemporaryDirectory()
        self.path = str(Path(self.folder.name) / "s")
        self.played = 0
        self.captured: list[bytes] = []
        self.clients: list[socket.socket] = []
        self.changed = threading.Condition()
        self.up = False
        self.restore()

    def request(self) -> SourceRequest:
        settings = self.driver_class.settings_model.model_validate({"path": self.path})
        return SourceRequest("line", settings, ("force", "x1"))

    def play(self, values: FloatArray) -> None:
        lines = [json.dumps([(self.played + i) % 65536, *map(float, row)]) for i, row in enumerate(values)]
        self.clients[-1].sendall("".join(line + "\n" for line in lines).encode())
        self.played += len(values)

    def attached(self, driver: Driver) -> None:
        with self.changed:
            before = self.accepted
            assert self.changed.wait_for(lambda: self.accepted > self.seen, 20.0), before
            self.seen = self.accepted

    def kill(self) -> None:
        if self.up:
            self.up = False
            self.listener.shutdown(socket.SHUT_RDWR)
            self.thread.join()
            self.listener.close()
            Path(self.path).unlink()
            for client in self.clients:
                self.decode_capture(client)
                client.close()
            self.clients.clear()

    def decode_capture(self, client: socket.socket) -> None:
        client.setblocking(False)
        try:
            data = client.recv(4096)
        except OSError:
            data = b""
        if data:
            self.captured.append(data)

    def restore(self) -> None:
        self.accepted = self.seen = 0
        self.listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.listener.bind(self.path)
        self.listener.listen()
        self.up = True
        self.thread = threading.Thread(target=self.accept)
        self.thread.start()

    def accept(self) -> None:
        while True:
            try:
                client, _ = self.listener.accept()
            except OSError:
                return
            with self.changed:
                self.clients.append(client)
                self.accepted += 1
                self.changed.notify_all()

    def written(self) -> Sequence[bytes]:
        return self.captured

    def bad_requests(self) -> Sequence[Callable[[], SourceRequest]]:
        return [lambda: replace(self.request(), fields=("force", "humidity"))]

    def close(self) -> None:
        self.kill()
        self.folder.cleanup()


class TestThirdParty(DriverConformance):
    def make_line(self) -> Line:
        return GatewayLine(found_driver())


class TestTheSuiteItself:
    """Drivers that break the rules, one each: the suite must see every one of them."""

    def run(self, broken: type[Driver], test: str) -> None:
        class Broken(DriverConformance):
            def make_line(self) -> Line:
                return GatewayLine(broken)

        suite = Broken()
        suite.setup_method()
        try:
            getattr(suite, test)()
        finally:
            suite.teardown_method()

    def test_driver_that_writes_turns_the_suite_red(self) -> None:
        class Writes(found_driver()):  # type: ignore[misc]
            def open(self) -> None:
                super().open()
                self._socket.sendall(b"zero the scale")

        with (
            on_purpose() as found,
            pytest.raises(AssertionError, match=r"a listener wrote b'zero the scale'"),
        ):
            self.run(Writes, "test_read_of_known_samples_delivers_exactly_these")
        assert set(found) == {b"zero the scale"}

    def test_driver_that_repeats_a_sample_turns_the_suite_red(self) -> None:
        class Repeats(found_driver()):  # type: ignore[misc]
            def read(self, timeout_s: float) -> SampleBlock:
                block = super().read(timeout_s)
                return replace(
                    block, values=block.values[[0, *range(len(block))]] if len(block) else block.values
                )

        with pytest.raises(AssertionError):
            self.run(Repeats, "test_read_of_known_samples_delivers_exactly_these")

    def test_driver_that_hides_a_dead_device_turns_the_suite_red(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("drivers.conformance.DEADLINE_S", 0.3)

        class Quiet(found_driver()):  # type: ignore[misc]
            def _data(self) -> bytes:
                return self._socket.recv(65536)  # type: ignore[no-any-return]

        with pytest.raises(AssertionError, match="reads on from a dead device"):
            self.run(Quiet, "test_device_that_dies_raises_io_error_and_is_read_again_when_back")

    def test_driver_that_miscounts_turns_the_suite_red(self) -> None:
        class Miscounts(found_driver()):  # type: ignore[misc]
            def read(self, timeout_s: float) -> SampleBlock:
                block = super().read(timeout_s)
                self.counts.received += 1
                return block

        with pytest.raises(AssertionError):
            self.run(Miscounts, "test_counts_after_reading_are_conserved")
