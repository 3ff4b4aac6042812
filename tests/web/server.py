"""`deltak serve` as a process of its own, and how tests ask it."""

import http.client
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

PASSWORD = "correct horse"


@dataclass(slots=True)
class Client:
    """Somebody who asks over HTTP, with the cookie and the token of a session once signed in."""

    port: int
    pid: int = 0
    headers: dict[str, str] = field(default_factory=dict)

    def ask(
        self, method: str, path: str, body: Any = None, headers: dict[str, str] | None = None
    ) -> tuple[int, dict[str, str], bytes]:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=20)
        sent = {**self.headers, **(headers or {})}
        if body is not None:
            body = body if isinstance(body, bytes) else json.dumps(body).encode()
            sent = {"Content-Type": "application/json", **sent}
        try:
            connection.request(method, path, body, sent)
            answer = connection.getresponse()
            return answer.status, {k.lower(): v for k, v in answer.getheaders()}, answer.read()
        finally:
            connection.close()

    def get(self, path: str) -> Any:
        status, _, body = self.ask("GET", f"/api/v1/{path}")
        assert status == 200, body
        return json.loads(body)

    def sign_in(self, name: str = "anna", password: str = PASSWORD) -> int:
        status, headers, body = self.ask("POST", "/api/v1/session", {"name": name, "password": password})
        if status == 200:
            self.headers = {
                "Cookie": headers["set-cookie"].partition(";")[0],
                "X-CSRF-Token": json.loads(body)["csrf"],
            }
        return status

    @contextmanager
    def events(self, since: str = "") -> Iterator[Iterator[tuple[str, str, Any]]]:
        """Listen; yields (id, kind, document)."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=20)
        connection.request("GET", "/api/v1/events", headers={"Last-Event-ID": since} if since else {})
        try:
            yield read_events(connection.getresponse())
        finally:
            connection.close()


def read_events(answer: http.client.HTTPResponse) -> Iterator[tuple[str, str, Any]]:
    found: dict[str, str] = {}
    for line in iter(answer.readline, b""):
        key, colon, value = line.decode().rstrip("\n").partition(": ")
        if colon and key:
            found[key] = value
        elif found:
            yield found["id"], found["event"], json.loads(found["data"])
            found = {}


@contextmanager
def serving(*arguments: str | Path) -> Iterator[Client]:
    """Run `deltak serve` on a free port; it must end by SIGTERM with exit code 0 and no traceback."""
    command = [sys.executable, "-m", "agent", "serve", "--port", "0", *map(str, arguments)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        line = process.stdout.readline()
        assert line.startswith("serving "), process.communicate()[1]
        yield Client(int(line.rstrip("/\n").rpartition(":")[2]), process.pid)
        if process.poll() is None:
            os.kill(process.pid, signal.SIGTERM)
            _, said = process.communicate(timeout=20)
            assert process.returncode in {0, -signal.SIGKILL}, said  # killed by a test that is about that
            assert "Traceback" not in said
    finally:
        process.kill()
        process.communicate()


def password_file(folder: Path) -> Path:
    """Make the file of a password as a user does."""
    path = folder / "password"
    command = [sys.executable, "-m", "agent", "serve", "--new-password", str(path)]
    subprocess.run(command, input=f"{PASSWORD}\n", text=True, check=True, capture_output=True, timeout=60)
    return path
