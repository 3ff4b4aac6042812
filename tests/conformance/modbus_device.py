"""A Modbus device of a few lines on sockets and ptys, made without the library under test; it can lie on
purpose."""

import os
import pty
import select
import socket
import struct
import threading
import tty
from collections.abc import Callable
from pathlib import Path

import numpy as np

Liar = Callable[[bytes], bytes | None]


def crc16(data: bytes) -> bytes:
    """CRC-16/MODBUS bit by bit, low byte first."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0xA001 if crc & 1 else 0)
    return struct.pack("<H", crc)


class Registers:
    """65,536 registers, queues for function 24 and a log of the requests; `answer` is the whole device."""

    def __init__(self, unit: int = 1) -> None:
        self.unit = unit
        self.words = np.zeros(65536, ">u2")
        self.queues: dict[int, list[int]] = {}
        self.requests: list[bytes] = []
        self.lock = threading.Lock()
        self.before_answer: Callable[[bytes], None] | None = None

    def answer(self, pdu: bytes) -> bytes:
        """Return the reply to a request, both from the function code on."""
        if self.before_answer:
            self.before_answer(pdu)
        with self.lock:
            if pdu[0] == 24:
                words = self.queues.get(int.from_bytes(pdu[1:3], "big"), [])[:31]
                return struct.pack(f">BHH{len(words)}H", 24, 2 + 2 * len(words), len(words), *words)
            if pdu[0] not in (3, 4):
                return bytes([pdu[0] | 0x80, 1])
            address, count = struct.unpack(">HH", pdu[1:5])
            if not 1 <= count <= 125:
                return bytes([pdu[0] | 0x80, 3])
            return bytes([pdu[0], 2 * count]) + self.words[address : address + count].tobytes()


class Device:
    """A register device on a line; `lie` may change or swallow whole replies as bytes."""

    def __init__(self, registers: Registers, lie: Liar | None = None) -> None:
        self.registers = registers
        self.lie = lie
        self._thread: threading.Thread | None = None
        self._wake = os.pipe()

    def start(self) -> None:
        """Come up."""
        self._up()
        self._run()

    def _run(self) -> None:
        self._stop = False
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _halt(self) -> None:
        if self._thread is not None:
            self._stop = True
            os.write(self._wake[1], b"x")
            self._thread.join()
            os.read(self._wake[0], 1)
            self._thread = None

    def stop(self) -> None:
        """Go away as when the plug is pulled; harmless when away."""
        if self._thread is not None:
            self._halt()
            self._down()

    def close(self) -> None:
        self.stop()
        for end in self._wake:
            os.close(end)

    def _serve(self) -> None:
        buffers: dict[int, bytes] = {}
        while not self._stop:
            ready, _, _ = select.select([self._wake[0], *self._ends()], [], [])
            for end in ready:
                if end != self._wake[0]:
                    self._serve_end(end, buffers)

    def _serve_end(self, end: int, buffers: dict[int, bytes]) -> None:
        data = self._take(end)
        if data is None:
            return
        frame, rest = self._split(buffers.get(end, b"") + data)
        while frame:
            self.registers.requests.append(frame)
            reply = self._reply(frame)
            reply = self.lie(reply) if self.lie else reply
            if reply:
                os.write(end, reply)
            self._replied(end)
            frame, rest = self._split(rest)
        buffers[end] = rest

    def _replied(self, end: int) -> None: ...
    def _up(self) -> None: ...
    def _down(self) -> None: ...
    def _ends(self) -> list[int]: ...
    def _take(self, end: int) -> bytes | None: ...
    def _split(self, data: bytes) -> tuple[bytes, bytes]: ...
    def _reply(self, frame: bytes) -> bytes: ...


class TcpDevice(Device):
    """On 127.0.0.1; keeps its port over stop and start.

    Attributes:
        closes_after: replies to a connection after which the device ends it; None: it never does.
        resets: it ends connections by a reset instead of an end of file.
        connections: how many were made.
    """

    port = 0
    closes_after: int | None = None
    resets = False
    connections = 0

    def _up(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", self.port))
        self.port = self._listener.getsockname()[1]
        self._clients: dict[int, socket.socket] = {}
        self._replies: dict[int, int] = {}

    def _down(self) -> None:
        self._listener.close()
        self.resets = True  # the port is free at once then
        for end in list(self._clients):
            self._end(end)

    def hang_up(self) -> None:
        """End every connection, as devices do with those that were idle."""
        self._halt()
        for end in list(self._clients):
            self._end(end)
        self._run()

    def _end(self, end: int) -> None:
        client = self._clients.pop(end)
        if self.resets:
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        client.close()

    def _replied(self, end: int) -> None:
        self._replies[end] += 1
        if self._replies[end] == self.closes_after:
            self._end(end)

    def _ends(self) -> list[int]:
        return [self._listener.fileno(), *self._clients]

    def _take(self, end: int) -> bytes | None:
        if end == self._listener.fileno():
            client, _ = self._listener.accept()
            self._clients[client.fileno()] = client
            self._replies[client.fileno()] = 0
            self.connections += 1
            if self.closes_after == 0:
                self._end(client.fileno())
            return None
        try:
            data = self._clients[end].recv(4096)
        except ConnectionError:
            data = b""
        if not data:
            self._clients.pop(end).close()
            return None
        return data

    def _split(self, data: bytes) -> tuple[bytes, bytes]:
        size = 6 + int.from_bytes(data[4:6], "big") if len(data) >= 6 else 6
        return (data[:size], data[size:]) if len(data) >= size > 6 else (b"", data)

    def _reply(self, frame: bytes) -> bytes:
        pdu = self.registers.answer(frame[7:])
        return frame[:4] + struct.pack(">HB", len(pdu) + 1, frame[6]) + pdu


class PtyDevice(Device):
    """On a pty under a path that stays the same over stop and start."""

    def __init__(self, registers: Registers, link: Path, lie: Liar | None = None) -> None:
        super().__init__(registers, lie)
        self.link = link

    def _up(self) -> None:
        self._master, slave = pty.openpty()
        tty.setraw(slave)
        self.link.symlink_to(os.ttyname(slave))
        self._slave = slave

    def _down(self) -> None:
        self.link.unlink()
        os.close(self._slave)
        os.close(self._master)

    def _ends(self) -> list[int]:
        return [self._master]

    def _take(self, end: int) -> bytes | None:
        return os.read(end, 4096)

    def _split(self, data: bytes) -> tuple[bytes, bytes]:
        size = 6 if data[1:2] == b"\x18" else 8
        return (data[:size], data[size:]) if len(data) >= size else (b"", data)

    def _reply(self, frame: bytes) -> bytes:
        if crc16(frame[:-2]) != frame[-2:] or frame[0] != self.registers.unit:
            return b""
        reply = frame[:1] + self.registers.answer(frame[1:-2])
        return reply + crc16(reply)
