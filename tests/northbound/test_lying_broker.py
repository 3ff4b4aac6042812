"""A broker that lies: what it says is no MQTT, of no message, or no. One event, and nothing is lost.

What a broker acknowledges as its own and does not keep cannot be told from one that keeps it.
"""

import json
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from agent.config.sections.north import North
from tests.northbound.supply import events, numbers, supplied
from tests.northbound.test_mqtt import plant
from tests.scenario.live import wait_until
from tests.storage.conftest import memory
from tests.storage.rows import batch

__all__ = ["memory"]
CONNECT, CONNACK, PUBLISH, PUBACK, SUBSCRIBE, SUBACK, PINGREQ, DISCONNECT = 1, 2, 3, 4, 8, 9, 12, 14
HONEST_CONNACK = b"\x20\x03\x00\x00\x00"


def puback(number: int, reason: int = 0) -> bytes:
    return struct.pack(">BBHBB", PUBACK << 4, 4, number, reason, 0)


Lie = Callable[[int, int], bytes]
"""Returns what is said to a packet of a kind and number in place of the truth."""


def _to(kind: int, make: Callable[[int], bytes]) -> Lie:
    return lambda came, number: make(number) if came == kind else truth(came, number)


def truth(kind: int, number: int) -> bytes:
    return {
        CONNECT: HONEST_CONNACK, PUBLISH: puback(number), PINGREQ: b"\xd0\x00",
        SUBSCRIBE: struct.pack(">BBHBB", SUBACK << 4, 4, number, 0, 1),
    }.get(kind, b"")  # fmt: skip


LIES: dict[str, Lie] = {
    "no answer to the connection": _to(CONNECT, lambda _: b""),
    "a connection that is refused": _to(CONNECT, lambda _: b"\x20\x03\x00\x97\x00"),
    "an answer that is cut short": _to(CONNECT, lambda _: b"\x20\x00"),
    "an answer of another protocol": _to(CONNECT, lambda _: b"HTTP/1.1 400 Bad Request\r\n\r\n"),
    "an answer of impossible properties": _to(CONNECT, lambda _: b"\x20\x08\x00\x00\x05\xff\xff\xff\xff\xff"),
    "an answer without an end": _to(CONNECT, lambda _: b"\x20\xff\xff\xff\x7f" + 1000 * b"\x00"),
    "acknowledgements of other messages": _to(PUBLISH, lambda n: puback(n + 1000)),
    "acknowledgements that say no": _to(PUBLISH, lambda n: puback(n, 0x87)),
    "acknowledgements that say it is full": _to(PUBLISH, lambda n: puback(n, 0x97)),
    "acknowledgements without a number": _to(PUBLISH, lambda _: b"\x40\x00"),
    "acknowledgements of unknown reason": _to(PUBLISH, lambda n: puback(n, 0x7E)),
    "subscriptions confirmed that nobody asked for": _to(
        PUBLISH, lambda n: struct.pack(">BBHBB", SUBACK << 4, 4, n, 0, 1)
    ),
    "halves of the promise of another service": _to(PUBLISH, lambda n: struct.pack(">BBH", 0x50, 2, n)),
    "noise": _to(PUBLISH, lambda _: bytes(range(255, 0, -1))),
    "messages that nobody asked for, and no more": _to(PUBLISH, lambda _: b"\x30\x07\x00\x03a/b\x00x"),
    "an end that is said to have been asked for": _to(PUBLISH, lambda _: b"\xe0\x02\x00\x00"),
}


class Broker:
    """Answers one connection after the other as `lie` has it, and keeps what it acknowledged in truth."""

    def __init__(self, lie: Lie) -> None:
        self.lie = lie
        self.kept: list[dict[str, Any]] = []
        self.connections = 0
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._server.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        with suppress(OSError):
            self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                line, _ = self._server.accept()
                self.connections += 1
                threading.Thread(target=self._serve, args=(line,), daemon=True).start()

    def _serve(self, line: socket.socket) -> None:
        with line, suppress(OSError, EOFError), line.makefile("rb") as read:
            while True:
                kind, flags, body = _packet(read)
                number = self._number(kind, flags, body)
                said = self.lie(kind, number)
                if kind == PUBLISH and said == truth(kind, number):
                    self._keep(body)
                line.sendall(said)

    def _number(self, kind: int, flags: int, body: bytes) -> int:
        if kind == PUBLISH and flags & 6:
            at = 2 + int.from_bytes(body[:2], "big")
            return int.from_bytes(body[at : at + 2], "big")
        return int.from_bytes(body[:2], "big") if kind == SUBSCRIBE else 0

    def _keep(self, body: bytes) -> None:
        topic = body[2 : 2 + int.from_bytes(body[:2], "big")].decode()
        if "/estimates/" in topic:
            self.kept.append(json.loads(body[body.index(b"{") :]))


def _packet(read: Any) -> tuple[int, int, bytes]:
    first = read.read(1)
    if not first:
        raise EOFError
    length = shift = 0
    while True:
        byte = read.read(1)[0]
        length |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            return first[0] >> 4, first[0] & 15, read.read(length)


@contextmanager
def broker(lie: Lie) -> Iterator[Broker]:
    found = Broker(lie)
    try:
        yield found
    finally:
        found.close()


@pytest.mark.parametrize("lie", LIES)
def test_broker_that_lies_is_one_event_and_costs_no_row_and_no_other_consumer(lie: str, memory: Path) -> None:
    path = memory / "rig.db"
    with broker(LIES[lie]) as liar, broker(truth) as other:
        consumers = [plant(liar.port, timeout_s=0.5, topics=("estimates",)), _other(other.port)]
        with supplied(path, consumers, late_s=60.0) as (writer, (to_liar, to_other)):
            writer.publish([batch(5)])
            wait_until(lambda: to_other.sent == 20, "the rows of the other consumer", 10)
            wait_until(lambda: to_liar.retries > 3, "more attempts", 15)
            assert to_liar.document()["state"] == "failing"
            assert (to_liar.sent, to_other.retries) == (0, 0)
            attempts = liar.connections
            liar.lie = truth
            writer.publish([batch(5, first=5)])
            wait_until(lambda: to_liar.sent == 40, "every row", 15)
            wait_until(lambda: to_other.sent == 40, "every row of the other", 10)
    assert attempts < 12
    said = [(cause, message) for cause, message in events(path) if "plant" in message or "consumer" in cause]
    assert [cause for cause, _ in said] == ["consumer failed", "consumer recovered"]
    assert {row["seq"] for row in liar.kept} == {*numbers(path)}
    assert [row["seq"] for row in other.kept] == numbers(path)


def _other(port: int) -> North:
    consumer = plant(port, topics=("estimates",))
    return consumer.model_copy(update={"name": "other", "client_id": "other"})
