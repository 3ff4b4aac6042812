"""Targets that misbehave, and a writer with a notifier beside it."""

import socket
import threading
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from aiosmtpd.controller import Controller

from agent.config.sections.results import Notify
from agent.notification.notifier import Notifier
from agent.notification.routing import concerns
from agent.storage.write.store import Store
from agent.storage.write.writer import StoreWriter
from tests.storage.rows import run_info

LATE_S = 0.3
"""The timeout of targets here; a late answer takes longer."""


@dataclass
class Post:
    """A receiver that knows repetitions by key, as receivers do; script: what becomes of each attempt."""

    script: list[str] = field(default_factory=list)
    attempts: list[str] = field(default_factory=list)
    accepted: list[str] = field(default_factory=list)
    over: threading.Event = field(default_factory=threading.Event)

    def arrived(self, key: str) -> str:
        self.attempts.append(key)
        fate = self.script.pop(0) if self.script else "fine"
        if fate in {"fine", "late", "lost"} and key not in self.accepted:
            self.accepted.append(key)
        return fate

    @property
    def doubles(self) -> Counter[str]:
        return Counter(self.attempts)


@contextmanager
def webhook(post: Post) -> Iterator[str]:
    """Serve on loopback: "500", "late" (taken, answer after the timeout), "lost" (taken, closed), "hang"."""

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            self.rfile.read(int(self.headers["Content-Length"]))
            fate = post.arrived(self.headers["Idempotency-Key"])
            if fate in {"late", "hang"}:
                post.over.wait(2 * LATE_S)
            if fate in {"fine", "late", "500"}:
                self.send_response(500 if fate == "500" else 200)
                self.send_header("Content-Length", "0")
                self.end_headers()

        def log_message(self, *_: Any) -> None:
            pass

    class Quiet(ThreadingHTTPServer):
        def handle_error(self, *_: Any) -> None:
            pass  # who waited has gone

    server = Quiet(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}/alarms"
    finally:
        post.over.set()
        server.shutdown()
        thread.join()
        server.server_close()


class MailRoom:
    """A mail server's handler: "451" refuses for now."""

    def __init__(self, post: Post) -> None:
        self.post = post
        self.mails: list[bytes] = []

    async def handle_DATA(  # noqa: N802 - the server's name for it
        self, _server: Any, _session: Any, envelope: Any
    ) -> str:
        (key,) = [
            line[12:].strip()
            for line in envelope.content.decode().splitlines()
            if line.startswith("Message-ID")
        ]
        if self.post.arrived(key) == "451":
            return "451 4.3.0 come back later"
        self.mails.append(envelope.content)
        return "250 taken"


@contextmanager
def mail_server(room: MailRoom) -> Iterator[int]:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    controller = Controller(room, hostname="127.0.0.1", port=port)
    controller.start()
    try:
        yield port
    finally:
        controller.stop()


@contextmanager
def agent(
    path: Path, targets: Sequence[Notify], **settings: Any
) -> Iterator[tuple[StoreWriter, list[Notifier]]]:
    """A writer whose steps of alarms are for targets, and their notifiers."""

    def names(step: Any) -> list[str]:
        return [target.name for target in targets if concerns(target, step)]

    writer = StoreWriter(lambda: Store.open(path, route=names), [run_info()], served={})
    notifiers = [
        Notifier(target, path.parent, writer.ask, pause_s=(0.01, 0.05), **settings) for target in targets
    ]

    def wake() -> None:
        for notifier in notifiers:
            notifier.wake()

    writer.on_outbox = wake
    writer.start()
    for notifier in notifiers:
        notifier.start()
    try:
        yield writer, notifiers
    finally:
        for notifier in notifiers:
            notifier.stop()
        writer.stop()
