"""Secrets of every kind, which servers quote as they refuse them, are in no log, answer, file or bundle."""

import base64
import http.server
import os
import socket
import struct
import tarfile
import threading
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from agent.cli.app import app
from agent.cli.gateway.status import status
from tests.northbound.test_lying_broker import CONNECT, broker, truth
from tests.ports import free_port
from tests.scenario.live import agent, example, rows, wait_until

pytestmark = pytest.mark.realtime
KINDS = ("broker", "node", "server", "hook", "address", "mail")
PLANTED = {kind: f"PLANTED-{kind}-5ecret" for kind in KINDS}


def refused(kind: int, number: int) -> bytes:
    """Refuse a connection, with a reason that quotes the passwords."""
    if kind != CONNECT:
        return truth(kind, number)
    said = f"nobody has {PLANTED['broker']} nor {PLANTED['node']}".encode()
    properties = b"\x1f" + struct.pack(">H", len(said)) + said
    body = bytes((0, 0x86, len(properties))) + properties
    return bytes((0x20, len(body))) + body


def served(line: socket.socket) -> None:
    """Ask for a password in clear text as PostgreSQL does, and quote it in the error."""
    with line, suppress(OSError, EOFError), line.makefile("rb") as read:
        while True:
            (length,) = struct.unpack(">I", read.read(4))
            (code,) = struct.unpack(">I", read.read(length - 4)[:4])
            if code not in {80877103, 80877104}:
                break
            line.sendall(b"N")
        line.sendall(b"R" + struct.pack(">II", 8, 3))
        read.read(1)
        password = read.read(struct.unpack(">I", read.read(4))[0] - 4).rstrip(b"\0")
        fields = b"SFATAL\0C28P01\0Mno user has the password " + password + b"\0\0"
        line.sendall(b"E" + struct.pack(">I", len(fields) + 4) + fields)


@contextmanager
def server_of(serve: Callable[[socket.socket], None]) -> Iterator[int]:
    def accept() -> None:
        with suppress(OSError):
            while True:
                threading.Thread(target=serve, args=(server.accept()[0],), daemon=True).start()

    with socket.create_server(("127.0.0.1", 0)) as server:
        threading.Thread(target=accept, daemon=True).start()
        yield int(server.getsockname()[1])
        with suppress(OSError):
            server.shutdown(socket.SHUT_RDWR)


def posted(line: socket.socket) -> None:
    """Let nobody in as a mail server, and quote what was said, as it came and in clear text."""
    with line, suppress(OSError, EOFError), line.makefile("rb") as read:
        line.sendall(b"220 mail\r\n")
        while said := read.readline().decode().split():
            if said[0].upper() == "EHLO":
                line.sendall(b"250-mail\r\n250 AUTH PLAIN\r\n")
            else:
                quoted = [base64.b64decode(word).decode() for word in said[2:]]
                line.sendall(f"535 {' '.join(said)} {quoted} is nobody\r\n".replace("\0", " ").encode())


class Echo(http.server.BaseHTTPRequestHandler):
    """Refuses what is posted, and quotes it."""

    def do_POST(self) -> None:
        said = f"{self.headers['Authorization']} may not see {self.path}"
        self.send_response(403, said)
        self.send_header("Content-Length", str(len(said)))
        self.end_headers()
        self.wfile.write(said.encode())

    def log_message(self, *_: Any) -> None:
        """Say nothing."""


@contextmanager
def hook_server() -> Iterator[int]:
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Echo) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield int(server.server_port)
        server.shutdown()


def tables(ports: dict[str, int]) -> str:
    return f"""
[metrics]
listen = "127.0.0.1:{ports["metrics"]}"
[[north]]
name = "plain"
kind = "mqtt"
url = "mqtt://127.0.0.1:{ports["broker"]}"
user = "press"
password = {{ file = "secrets/broker" }}
[[north]]
name = "node"
kind = "sparkplug"
url = "mqtt://127.0.0.1:{ports["broker"]}"
user = "press"
password = {{ env = "PLANTED_NODE" }}
[[north]]
name = "server"
kind = "postgres"
url = "postgresql://127.0.0.1:{ports["server"]}/plant"
user = "press"
password = {{ credential = "server" }}
[[notify]]
name = "hook"
kind = "webhook"
url = "http://127.0.0.1:{ports["hook"]}/alarms"
token = {{ file = "secrets/hook" }}
[[notify]]
name = "address"
kind = "webhook"
url = {{ file = "secrets/address" }}
[[notify]]
name = "mail"
kind = "smtp"
host = "127.0.0.1"
port = {ports["mail"]}
tls = "none"
sender = "press@example.org"
recipients = ["shift@example.org"]
user = "press"
password = {{ file = "secrets/mail" }}
"""


@pytest.fixture(scope="module")
def left(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """What an agent left behind that no server let in, by where it was."""
    folder = tmp_path_factory.mktemp("planted")
    secrets = folder / "secrets"
    secrets.mkdir()
    with ExitStack() as stack:
        ports = {
            "broker": stack.enter_context(broker(refused)).port, "metrics": free_port(),
            "server": stack.enter_context(server_of(served)), "mail": stack.enter_context(server_of(posted)),
            "hook": stack.enter_context(hook_server()),
        }  # fmt: skip
        address = f"http://127.0.0.1:{ports['hook']}/{PLANTED['address']}"
        for kind in KINDS:
            (secrets / kind).write_text(address if kind == "address" else PLANTED[kind], encoding="utf-8")
        own = {"PLANTED_NODE": PLANTED["node"], "CREDENTIALS_DIRECTORY": str(secrets)}
        stack.enter_context(pytest.MonkeyPatch.context()).setattr(os, "environ", {**os.environ, **own})
        config = example("modbus", folder)  # whose device is away: an alarm of its source is to be notified
        config.write_text(config.read_text(encoding="utf-8") + tables(ports), encoding="utf-8")
        db = folder / "two-mass-rig.db"
        running = stack.enter_context(agent(config, options=["--debug"]))
        wait_until(lambda: len(failed(db)) == 3, "three consumers that failed")
        wait_until(lambda: len(rows(db, TRIED)) == 3, "three targets that failed")
        found = {"status": str(status(db)).encode()}
        with closing(urllib.request.urlopen(f"http://127.0.0.1:{ports['metrics']}/metrics")) as answer:
            found["metrics"] = answer.read()
        bundle = folder / "diag.tar.gz"
        done = CliRunner().invoke(app, ["diag", str(config), "--to", str(bundle), "--json"])
        assert done.exit_code == 0
        found["diag"] = done.output.encode()
        found["document"] = str(running.document()).encode()
        found["log"] = running.err.encode()
    with tarfile.open(bundle) as archive:
        for name in archive.getnames():
            found[name] = archive.extractfile(name).read()  # type: ignore[union-attr]
    files = [file for file in folder.rglob("*") if file.is_file() and file.parent != secrets]
    return found | {str(file): file.read_bytes() for file in files}


TRIED = "SELECT target, last_error FROM v_notifications WHERE last_error IS NOT NULL"


def failed(db: Path) -> list[tuple[str, ...]]:
    return rows(db, "SELECT message FROM v_events WHERE cause = 'consumer failed'")


def test_every_server_refused_what_it_was_shown(left: dict[str, bytes]) -> None:
    for words in (
        b"Bad user name or password",
        b"no user has the password ***",
        b"may not see",
        b"is nobody",
    ):
        assert words in left["log"] or any(words in content for content in left.values())


@pytest.mark.parametrize("kind", KINDS)
def test_planted_secret_is_nowhere(left: dict[str, bytes], kind: str) -> None:
    assert len(left) > 12
    assert [where for where, content in left.items() if PLANTED[kind].encode() in content] == []
