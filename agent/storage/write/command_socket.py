"""DB.sock: how a command changes a database that an agent owns. One JSON line asked, one JSON line answered.

    {"command": "compact", ...}  ->  {"ok": true, ...} when it is committed
                                     {"ok": false, "error": "what; what to do"} when it is refused

An empty line a second says that a long command is being done. The socket lies beside the database and may be
used by the agent's own user, and by the group deltak-command where there is one that the agent belongs to:
who may read the database may not therefore command (see deploy/systemd).
"""

import grp
import json
import os
import selectors
import socket
import struct
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from agent.errors import AgentError, Fault, StoreError
from agent.storage.database.files import beside
from agent.storage.tuning import (
    CONNECTIONS_WAITING,
    LIFE_SIGN_S,
    LONGEST_ANSWER,
    LONGEST_REQUEST,
    MOST_COMMANDS,
    PATIENCE_S,
)

GROUP = "deltak-command"
Handler = Callable[[Mapping[str, Any]], Mapping[str, Any]]


@dataclass(slots=True)
class _Caller:
    """Somebody who connected, and what of the line has come so far."""

    peer: socket.socket
    line: bytes = b""
    since: float = field(default_factory=time.monotonic)

    def receive(self) -> bool:
        """Take what has come; True when the line is complete."""
        try:
            more = self.peer.recv(4096)
        except BlockingIOError:
            return False
        except OSError:
            more = b""
        self.line += more
        return not more or self.line.endswith(b"\n") or len(self.line) > LONGEST_REQUEST


class CommandServer:
    """Answers commands while the agent runs; made by whoever holds the database's lock.

    One thread listens to all callers at once, so that one who dribbles keeps nobody waiting; each has 5 s for
    its line.

    Args:
        path: the database.
        handlers: by command; each gets the asked object and returns what to answer besides "ok". It runs in a
            thread of its own, and what it raises is the answer.
    """

    def __init__(self, path: Path, handlers: Mapping[str, Handler]) -> None:
        self._file = beside(Path(path), ".sock")
        self._handlers = {"ping": lambda _: {"pid": os.getpid()}, **handlers}
        self._stopping = threading.Event()
        self._listener = _listen(self._file)
        self._callers: list[_Caller] = []
        self._talks: list[threading.Thread] = []
        self._thread = threading.Thread(target=self._serve, name="command-socket", daemon=True)
        self.progress = 0

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """End the thread and remove the socket; harmless when stopped."""
        self._stopping.set()
        end = time.monotonic() + 2 * PATIENCE_S
        for thread in (self._thread, *self._talks):
            if thread.is_alive():
                thread.join(max(0.0, end - time.monotonic()))
        self._listener.close()
        self._file.unlink(missing_ok=True)

    def _serve(self) -> None:
        self._listener.setblocking(False)
        with selectors.DefaultSelector() as selector:
            selector.register(self._listener, selectors.EVENT_READ)
            while not self._stopping.is_set():
                self.progress += 1
                for key, _ in selector.select(0.2):
                    self._receive(selector, key.data)
                self._cut_off(selector)
        for caller in self._callers:
            caller.peer.close()

    def _receive(self, selector: selectors.BaseSelector, caller: _Caller | None) -> None:
        """Take the next caller (None), or what a caller said."""
        if caller is None:
            with suppress(OSError):
                peer, _ = self._listener.accept()
                peer.setblocking(False)
                self._callers.append(_Caller(peer))
                selector.register(peer, selectors.EVENT_READ, self._callers[-1])
        elif caller.receive():
            self._callers.remove(caller)
            selector.unregister(caller.peer)
            self._begin(caller)

    def _cut_off(self, selector: selectors.BaseSelector) -> None:
        """Close the connections of those who take too long, oldest first."""
        late = time.monotonic() - PATIENCE_S
        while self._callers and (len(self._callers) > CONNECTIONS_WAITING or self._callers[0].since < late):
            caller = self._callers.pop(0)
            selector.unregister(caller.peer)
            caller.peer.close()

    def _begin(self, caller: _Caller) -> None:
        """Have a complete line answered in a thread of its own."""
        self._talks = [thread for thread in self._talks if thread.is_alive()]
        if len(self._talks) >= MOST_COMMANDS:
            busy = {"ok": False, "error": f"{MOST_COMMANDS} commands are being done; try again"}
            with caller.peer, suppress(OSError):
                caller.peer.send(_line(busy))
            return
        talk = threading.Thread(target=self._converse, args=(caller,), name="command-caller", daemon=True)
        self._talks.append(talk)
        talk.start()

    def _converse(self, caller: _Caller) -> None:
        """Answer one line; while the answer is being found empty lines say that the agent lives."""
        answers: list[Mapping[str, Any]] = []
        worker = threading.Thread(
            target=lambda: answers.append(self._answer(caller.line)), name="command", daemon=True
        )
        worker.start()
        worker.join(LIFE_SIGN_S)
        with caller.peer, suppress(OSError):
            caller.peer.settimeout(PATIENCE_S)
            while worker.is_alive():
                caller.peer.sendall(b"\n")
                worker.join(LIFE_SIGN_S)
            caller.peer.sendall(_line(answers[0]))

    def _answer(self, line: bytes) -> Mapping[str, Any]:
        try:
            asked = json.loads(line)
            handler = self._handlers[asked["command"]]
        except (ValueError, KeyError, TypeError, RecursionError):
            return {"ok": False, "error": f"not a command; commands are {', '.join(sorted(self._handlers))}"}
        try:
            return {"ok": True, **handler(asked)}
        except AgentError as error:
            return {
                "ok": False,
                "error": str(error),
                "faults": [[f.path, f.message, f.advice] for f in error.faults],
            }
        except Exception as error:  # noqa: BLE001 - it is the answer; the agent goes on
            return {"ok": False, "error": f"{type(error).__name__}: {error}"}


def command_group() -> int | None:
    """Return the number of the group that may command; None if it is not there or this process not in it."""
    try:
        number = grp.getgrnam(GROUP).gr_gid
    except KeyError:
        return None
    return number if os.geteuid() == 0 or number in {os.getegid(), *os.getgroups()} else None


def _listen(file: Path) -> socket.socket:
    """Return a listening socket at a path; one that a killed agent left is replaced, as the lock is ours."""
    file.unlink(missing_ok=True)
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        os.fchmod(listener.fileno(), 0o600)  # nobody else's from its first moment on
        with _short_name(file) as name:
            listener.bind(name)
        _admit(file, command_group())
        listener.listen(CONNECTIONS_WAITING)
    except BaseException:
        listener.close()
        raise
    return listener


def _admit(file: Path, group: int | None) -> None:
    """Let a group use the socket at a path; it is the one that was made, not what a link there leads to."""
    if group is None:
        return
    handle = os.open(file, os.O_PATH | os.O_NOFOLLOW)
    try:
        _let_in(Path(f"/proc/self/fd/{handle}"), group)
    finally:
        os.close(handle)


def _let_in(file: Path, group: int) -> None:
    try:
        os.chown(file, -1, group)
        file.chmod(0o660)
    except PermissionError:  # a service that may give no file away still sets its access control list
        os.setxattr(file, "system.posix_acl_access", access_list(group))


def access_list(group: int) -> bytes:
    """Return a POSIX ACL as acl(5) and the kernel have it: the owner and one group, nobody else."""
    nobody = 0xFFFFFFFF
    owner, own_group, named_group, mask, others = 0x01, 0x04, 0x08, 0x10, 0x20
    rows = [
        (owner, 6, nobody),
        (own_group, 0, nobody),
        (named_group, 6, group),
        (mask, 6, nobody),
        (others, 0, nobody),
    ]
    return struct.pack("<I", 2) + b"".join(struct.pack("<HHI", *row) for row in rows)


class _short_name:  # noqa: N801 - used like a function
    """The name of a socket within the kernel's 107 bytes: through the folder's descriptor if need be."""

    def __init__(self, file: Path) -> None:
        self._file = file.absolute()
        self._folder = -1

    def __enter__(self) -> str:
        if len(os.fsencode(self._file)) < 100:
            return str(self._file)
        self._folder = os.open(self._file.parent, os.O_PATH | os.O_DIRECTORY)
        return f"/proc/self/fd/{self._folder}/{self._file.name}"

    def __exit__(self, *_: object) -> None:
        if self._folder >= 0:
            os.close(self._folder)


def _read_line(peer: socket.socket, until: float | None = None) -> bytes:
    line = bytearray()
    while not line.endswith(b"\n") and len(line) <= LONGEST_ANSWER:
        if until is not None:
            left = until - time.monotonic()
            if left <= 0:
                raise TimeoutError
            peer.settimeout(left)
        more = peer.recv(65536)
        if not more:
            break
        line += more
    return bytes(line)


def _last_line(peer: socket.socket, until: float | None) -> bytes:
    """Return the answer, without signs of life before it; until: by when (monotonic, s), None: no limit."""
    while True:
        line = _read_line(peer, until)
        if line.strip() or not line:
            return line


def _line(answer: Mapping[str, Any]) -> bytes:
    return json.dumps(answer).encode() + b"\n"


def _timeval(seconds: float) -> bytes:
    """Return seconds as the kernel's struct timeval."""
    whole = int(seconds)
    return struct.pack("@ll", whole, int((seconds - whole) * 1e6))


def ask(
    path: Path, command: str, timeout_s: float = PATIENCE_S, *, brief: bool = False, **arguments: Any
) -> dict[str, Any]:
    """Ask the agent that owns a database; returns its answer once what was asked is committed.

    brief: the whole answer must come in timeout_s; otherwise signs of life are enough for longer.

    Raises:
        StoreError: no agent listens, it does not answer in time, or it refuses.
    """
    file = beside(Path(path), ".sock")
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as peer, _short_name(file) as name:
            # where others wait to be let in a socket with a time-out of Python's would be refused at once
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, _timeval(timeout_s))
            peer.connect(name)
            peer.settimeout(timeout_s)
            peer.sendall(_line({"command": command, **arguments}))
            answer = json.loads(_last_line(peer, time.monotonic() + timeout_s if brief else None))
    except (TimeoutError, BlockingIOError) as error:
        advice = "it may still be done: look, then try again"
        raise StoreError.at(path, f"its agent did not answer in {timeout_s:g} s", advice) from error
    except PermissionError as error:
        advice = f"run as the agent's user, or join the group {GROUP}"
        raise StoreError.at(path, "its agent may not be commanded by this user", advice) from error
    except (OSError, ValueError) as error:
        advice = "stop the process that holds the database, or try again"
        raise StoreError.at(path, f"its agent cannot be asked ({error})", advice) from error
    if not answer.pop("ok", False):
        if answer.get("faults"):
            raise StoreError(Fault(*map(str, fault)) for fault in answer["faults"])
        raise StoreError.at(path, str(answer.get("error")), "see its log")
    return dict(answer)
