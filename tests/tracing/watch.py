"""Holds every write of a driver, in every Python process of a test run, against what a listener may write.

The run puts this folder on PYTHONPATH, so that agents which tests start are watched as well
(sitecustomize.py). A write is a driver's when, going outwards from the call, code of the drivers or a method
of a Driver is met before code of a test or of the simulator. What no rule permits is written to the file that
$DELTAK_WRITES names; the run ends red when anything stands there.
"""

import atexit
import os
import socket
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

REPORT = "DELTAK_WRITES"
PEERS = ("tests", "sim_bus", "drivers.conformance")
RULES = {
    "an internet socket": ("modbus-tcp", "socketcand"),
    "a serial line": ("modbus-rtu", "slcan"),
    "a socket of family 16": ("netlink",),
}

permitted: Counter[str] = Counter()
_purpose: list[list[bytes]] = []


def install() -> None:
    """Watch all writes of this process; harmless when they are watched already."""
    if getattr(socket.socket, "watched_writes", False):
        return
    socket.socket.watched_writes = True  # type: ignore[attr-defined]
    for name in ("send", "sendall", "sendto", "sendmsg"):
        setattr(socket.socket, name, _watched_socket(getattr(socket.socket, name)))
    for name in ("write", "writev", "pwrite", "pwritev"):
        setattr(os, name, _watched_descriptor(getattr(os, name)))
    atexit.register(_report_count)


def _watched_socket(original: Callable[..., Any]) -> Callable[..., Any]:
    def call(self: socket.socket, data: Any, *rest: Any) -> Any:
        if _is_drivers(sys._getframe(1)):
            inet = self.family in {socket.AF_INET, socket.AF_INET6}
            _assess("an internet socket" if inet else f"a socket of family {int(self.family)}", data)
        return original(self, data, *rest)

    return call


def _watched_descriptor(original: Callable[..., Any]) -> Callable[..., Any]:
    def call(number: int, data: Any, *rest: Any) -> Any:
        if os.isatty(number) and _is_drivers(sys._getframe(1)):
            _assess("a serial line", data)
        return original(number, data, *rest)

    return call


def _is_drivers(frame: FrameType | None) -> bool:
    port = sys.modules.get("drivers.port")
    while port is not None and frame is not None:
        module = str(frame.f_globals.get("__name__", ""))
        if isinstance(frame.f_locals.get("self"), port.Driver):
            return True
        if module.startswith(PEERS):
            return False
        if module.startswith("drivers."):
            return True
        frame = frame.f_back
    return False


def _assess(kind: str, data: Any) -> None:
    from drivers import write_gate

    whole = bytes(data) if isinstance(data, bytes | bytearray | memoryview) else b"".join(map(bytes, data))
    protocol = next((name for name in RULES.get(kind, ()) if write_gate.permitted(name, whole)), None)
    if protocol is not None:
        permitted[protocol] += 1
    elif _purpose:
        _purpose[-1].append(whole)
    else:
        _say(f"{os.environ.get('PYTEST_CURRENT_TEST', 'no test')}: to {kind}: {whole[:40].hex(' ')}")


def _say(line: str) -> None:
    if path := os.environ.get(REPORT):
        with Path(path).open("a", encoding="utf-8") as file:
            file.write(f"{line}\n")


def _report_count() -> None:
    if permitted:
        _say(f"permitted {permitted.total()}")


@contextmanager
def on_purpose() -> Iterator[list[bytes]]:
    """Collect forbidden writes instead of reporting them, for tests that plant a driver which writes."""
    found: list[bytes] = []
    _purpose.append(found)
    try:
        yield found
    finally:
        _purpose.remove(found)
