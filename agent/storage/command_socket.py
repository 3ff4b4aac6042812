"""DB.sock: how a command changes a database that an agent owns. One JSON line asked, one JSON line answered.

    {"command": "compact", ...}  ->  {"ok": true, ...} when it is committed
                                     {"ok": false, "error": "what; what to do"} when it is refused

An empty line a second says that a long command is being done. The socket lies beside the database (mode 0660): who may
write to the folder may command.
"""

import json
import os
import socket
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from agent.errors import AgentError, StoreError
from agent.storage.files import beside

Handler = Callable[[Mapping[str, Any]], Mapping[str, Any]]
_LONGEST = 65536  # bytes of a line
_PATIENCE_S = 5.0
_LIFE_SIGN_S = 1.0


class CommandServer:
    """Answers commands while the agent runs; made by whoever holds the database's lock.

    Args:
        path: the database.
        handlers: by command; each gets the asked object and returns what to answer besides "ok". It runs in the
            server's thread, and what it raises is told to the asker.
    """

    def __init__(self, path: Path, handlers: Mapping[str, Handler]) -> None:
        self._file = beside(Path(path), ".sock")
        self._handlers = {"ping": lambda _: {"pid": os.getpid()}, **handlers}
        self._stopping = threading.Event()
        self._listener = _listen(self._file)
        self._thread = threading.Thread(target=self._serve, name="command-socket", daemon=True)
        self.progress = 0

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """End the thread and remove the socket; harmless when stopped."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(2 * _PATIENCE_S)
        self._listener.close()
        self._file.unlink(missing_ok=True)

    def _serve(self) -> None:
        self._listener.settimeout(0.2)
        while not self._stopping.is_set():
            self.progress += 1
            with suppress(OSError):
                peer, _ = self._listener.accept()
                with peer:
                    peer.settimeout(_PATIENCE_S)
                    self._converse(peer, _read_line(peer))

    def _converse(self, peer: socket.socket, line: bytes) -> None:
        """Answer one line; while the answer is being found the asker hears that the agent lives."""
        answers: list[Mapping[str, Any]] = []
        worker = threading.Thread(target=lambda: answers.append(self._answer(line)), name="command", daemon=True)
        worker.start()
        worker.join(_LIFE_SIGN_S)
        while worker.is_alive():
            self.progress += 1
            peer.sendall(b"\n")
            worker.join(_LIFE_SIGN_S)
        peer.sendall(_line(answers[0]))

    def _answer(self, line: bytes) -> Mapping[str, Any]:
        try:
            asked = json.loads(line)
            handler = self._handlers[asked["command"]]
        except (ValueError, KeyError, TypeError, RecursionError):
            return {"ok": False, "error": f"not a command; commands are {', '.join(sorted(self._handlers))}"}
        try:
            return {"ok": True, **handler(asked)}
        except AgentError as error:
            return {"ok": False, "error": str(error)}
        except Exception as error:  # noqa: BLE001 - the asker is told; the agent goes on
            return {"ok": False, "error": f"{type(error).__name__}: {error}"}


def _listen(file: Path) -> socket.socket:
    """Return a listening socket at a path; one that a killed agent left is replaced, since the lock is ours."""
    file.unlink(missing_ok=True)
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        with _short_name(file) as name:
            listener.bind(name)
        file.chmod(0o660)
        listener.listen(8)
    except BaseException:
        listener.close()
        raise
    return listener


class _short_name:  # noqa: N801 - used like a function
    """The name of a socket within the 107 bytes that the kernel allows: through the folder's descriptor if need be."""

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


def _read_line(peer: socket.socket) -> bytes:
    line = b""
    while not line.endswith(b"\n") and len(line) <= _LONGEST:
        more = peer.recv(4096)
        if not more:
            break
        line += more
    return line


def _last_line(peer: socket.socket) -> bytes:
    """Return the answer, without the signs of life before it."""
    while True:
        line = _read_line(peer)
        if line.strip() or not line:
            return line


def _line(answer: Mapping[str, Any]) -> bytes:
    return json.dumps(answer).encode() + b"\n"


def ask(path: Path, command: str, timeout_s: float = _PATIENCE_S, **arguments: Any) -> dict[str, Any]:
    """Ask the agent that owns a database; returns its answer once what was asked is committed.

    Raises:
        StoreError: no agent listens, it does not answer in time, or it refuses.
    """
    file = beside(Path(path), ".sock")
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as peer, _short_name(file) as name:
            peer.settimeout(timeout_s)
            peer.connect(name)
            peer.sendall(_line({"command": command, **arguments}))
            answer = json.loads(_last_line(peer))
    except TimeoutError as error:
        raise StoreError.at(str(path), f"its agent did not answer in {timeout_s:g} s", "try again") from error
    except (OSError, ValueError) as error:
        advice = "stop the process that holds the database, or try again"
        raise StoreError.at(str(path), f"its agent cannot be asked ({error})", advice) from error
    if not answer.pop("ok", False):
        raise StoreError.at(str(path), str(answer.get("error")), "see its log")
    return dict(answer)
