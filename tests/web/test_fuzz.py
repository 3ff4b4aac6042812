"""Requests of any kind: no answer of 500 or more, no traceback, no write without a session and its token."""

import random
import select
import socket
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from agent.cli.web.documents import DOCUMENTS, PARAMETERS
from agent.storage.write.command_socket import CommandServer
from tests.conftest import SEED
from tests.web import files
from tests.web.server import password_file, serving

NAMES = [
    *DOCUMENTS,
    "session",
    "events",
    "openapi.json",
    "alarms/rig/1/ack",
    "alarms/rig/-1/shelve",
    "alarms/rig/" + "9" * 30 + "/ack",
    "",
    "..",
    "%00",
]
WRITES = ["session", "alarms/rig/1/ack", "alarms/rig/1/shelve", "alarms/rig/7/unshelve", "alarms/x/1/ack"]
KEYS = [*PARAMETERS, "what", "", "%ff", "rig[]"]
VALUES = [
    "press-7", "rig", "k1", "1", "0", "-1", "nan", "1e999", "9" * 25, "60s", "9" * 60 + "w", "0.0000001ms",
    "2026-01-01",
    "9999-12-31T23:59:59Z", "0001-01-01", "", "%00", "%ff%fe", "'--", "<script>", "a" * 300, "%F0%9F%92%A9",
    "%ED%A0%80",
]  # fmt: skip
BODIES = [
    b"", b"{}", b"[]", b"null", b'{"name": 1}', b'{"name": "x", "password": "y"}', b"\xff", b"{" * 5000,
    b"1e999",
    b'{"name": "\\ud800", "password": "\\ud800"}', b'{"for": "8h", "comment": "x"}', b" " * 40000,
]  # fmt: skip
HEADERS = [
    b"", b"Last-Event-ID: 1.1\r\n", b"Last-Event-ID: \xff\r\n", b'If-None-Match: *, "x\r\n',
    b"X-CSRF-Token: \xff\r\n",
    b"Cookie: deltak_session=\xe9\r\n", b"Cookie: deltak_session=x; =; ;\r\n",
    b"Content-Type: application/json\r\n",
    b"Origin: http://evil.example\r\n", b"Range: bytes=0-1\r\n", b"Transfer-Encoding: chunked\r\n",
    b"Host: \xff\r\n",
    b"Content-Length: -1\r\n", b"Expect: 100-continue\r\n",
]  # fmt: skip


def request(rng: random.Random, cookie: bytes) -> bytes:
    """Return the bytes of a request, mostly well formed; cookie: of a session, whose token no request has."""
    method = rng.choice(
        ["GET"] * 6 + ["POST"] * 4 + ["DELETE", "PUT", "HEAD", "OPTIONS", "TRACE", "BREW", "get"]
    )
    query = "&".join(
        f"{rng.choice(KEYS)}={rng.choice(VALUES)}" for _ in range(rng.choice([0, 1, 2, 2, 3, 3]))
    )
    path = (
        rng.choice(["/", "/static/page.js", "/x"]) if rng.random() < 0.05 else f"/api/v1/{rng.choice(NAMES)}"
    )
    if method == "POST" and rng.random() < 0.8:
        path = f"/api/v1/{rng.choice(WRITES)}"
    body = rng.choice(BODIES) if method != "GET" or rng.random() < 0.05 else b""
    head = f"{method} {path}?{query} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n".encode()
    head += cookie * (rng.random() < 0.2)
    head += b"".join(rng.choice(HEADERS) for _ in range(rng.choice([0, 1, 1, 2])))
    if body:
        head += b"Content-Type: application/json\r\n" * (
            rng.random() < 0.8
        ) + b"Content-Length: %d\r\n" % len(body)
    whole = head + b"\r\n" + body
    return (
        whole
        if rng.random() < 0.97
        else bytes(rng.randrange(256) if rng.random() < 0.02 else byte for byte in whole)
    )


def status(port: int, sent: bytes) -> int:
    """Send a request and return the status of its answer; 0 where the connection is closed without one."""
    with socket.create_connection(("127.0.0.1", port), timeout=20) as peer:
        peer.sendall(sent)
        if not select.select([peer], [], [], 0.3)[0]:  # the server waits for a body that never comes
            peer.shutdown(socket.SHUT_WR)
        try:
            answer = peer.recv(64)
        except ConnectionResetError:
            return 0
    return int(answer.split(b" ", 2)[1]) if answer.startswith(b"HTTP/1.") else 0


@pytest.mark.parametrize(
    "count", [300, pytest.param(100_000, marks=[pytest.mark.soak, pytest.mark.timeout(3600)])]
)
def test_no_request_breaks_the_server_or_writes(memory: Path, count: int) -> None:
    rng = random.Random(f"{SEED} {count}")
    path = files.make(memory, hops=20)
    asked: list[Mapping[str, Any]] = []

    def act(line: Mapping[str, Any]) -> Mapping[str, Any]:
        asked.append(line)
        return {}

    agent = CommandServer(path, {"alarm": act})
    agent.start()
    with serving("--config", path.with_suffix(".toml"), "--password-file", password_file(memory)) as client:
        client.sign_in()
        cookie = f"Cookie: {client.headers['Cookie']}\r\n".encode()
        seen: dict[int, int] = {}
        for _ in range(count):
            sent = request(rng, cookie)
            found = status(client.port, sent)
            seen[found] = seen.get(found, 0) + 1
            assert found < 500, sent
        assert client.get("rigs")["rigs"]
    agent.stop()
    assert asked == []
    assert {200, 400, 401, 403, 404} <= set(seen)
