"""The line that tests break: what breaks is what is connected now, not what was before it was mended."""

import socket
import threading

from tests.northbound.line import line_to
from tests.scenario.live import wait_until


class Sink:
    """A server that takes whatever comes."""

    def __init__(self) -> None:
        self.socket = socket.create_server(("127.0.0.1", 0))
        self.taken = 0
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                one, _ = self.socket.accept()
            except OSError:
                return
            threading.Thread(target=self._take, args=(one,), daemon=True).start()

    def _take(self, one: socket.socket) -> None:
        with one:
            try:
                while data := one.recv(65536):
                    self.taken += len(data)
            except OSError:
                return


def ended(connection: socket.socket) -> bool:
    try:
        return connection.recv(1) == b""
    except ConnectionError:
        return True


def test_bytes_of_a_connection_that_froze_do_not_spend_what_the_next_may_carry() -> None:
    sink = Sink()
    with sink.socket, line_to(sink.socket.getsockname()[1]) as line:
        line.freezes, line.budget = True, 1000
        with socket.create_connection(("127.0.0.1", line.port), 10) as frozen:
            frozen.sendall(bytes(1000))
            wait_until(lambda: line.budget is None, "the line to freeze", 10)
            frozen.sendall(bytes(9000))
            line.freezes, line.budget = False, 5000
            line.mend()
            assert ended(frozen)
        assert (line.cuts, line.budget) == (1, 5000)
        with socket.create_connection(("127.0.0.1", line.port), 10) as fresh:
            fresh.sendall(bytes(4999))
            wait_until(lambda: sink.taken == 1000 + 4999, "what may pass", 10)
            fresh.sendall(bytes(1))
            assert ended(fresh)
        assert (line.cuts, line.budget) == (2, None)
