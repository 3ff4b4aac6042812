"""A socketcand daemon of a few lines: one bus, raw mode, frames to every client."""

import select
import socket
import struct
import threading


class Socketcand:
    """Serves one channel on 127.0.0.1; keeps its port over stop and start."""

    def __init__(self, channel: str = "can0", hello: bytes = b"< hi >") -> None:
        self.channel = channel
        self.hello = hello
        self.port = 0
        self.received: list[bytes] = []
        self._lock = threading.Condition()
        self._raw: list[socket.socket] = []
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", self.port))
        self.port = self._listener.getsockname()[1]
        self._wake, self._woken = socket.socketpair()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def stop(self) -> None:
        if self._thread is not None:
            self._wake.close()
            self._thread.join()
            self._woken.close()
            self._thread = None

    def wait_for_clients(self, count: int) -> None:
        """Wait until that many clients are in raw mode."""
        with self._lock:
            assert self._lock.wait_for(lambda: len(self._raw) >= count, 20.0)

    def send(self, text: bytes) -> None:
        """Send text to every client in raw mode."""
        with self._lock:
            for client in self._raw:
                client.sendall(text)

    def _serve(self) -> None:
        clients: list[socket.socket] = []
        while True:
            ready, _, _ = select.select([self._woken, self._listener, *clients], [], [])
            if self._woken in ready:
                break
            for end in ready:
                if end is self._listener:
                    client, _ = end.accept()
                    client.sendall(self.hello)
                    clients.append(client)
                elif not self._answer(end):
                    self._drop(end)
                    clients.remove(end)
        self._listener.close()
        for client in clients:
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            self._drop(client)

    def _drop(self, client: socket.socket) -> None:
        with self._lock:
            if client in self._raw:
                self._raw.remove(client)
        client.close()

    def _answer(self, client: socket.socket) -> bool:
        try:
            data = client.recv(4096)
        except ConnectionError:
            return False
        if not data:
            return False
        self.received.append(data)
        known = data == b"< open %s >" % self.channel.encode() or data == b"< rawmode >"
        client.sendall(b"< ok >" if known else b"< error could not open bus >")
        if data == b"< rawmode >":
            with self._lock:
                self._raw.append(client)
                self._lock.notify_all()
        return True
