"""Opening a serial line: for reading only where the protocol is passive, for nobody else meanwhile.

pyserial sets the line up (speeds that no table has, parity); it opens lines for writing too and locks them
for those alone who ask for the same lock, so opening and locking are done here.
"""

import contextlib
import errno
import fcntl
import os
import re
import termios
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from drivers.port import DriverConfigError, DriverIOError, DriverSettings

if TYPE_CHECKING:
    import serial

BY_ID = Path("/dev/serial/by-id")
_ENUMERATED = re.compile(r"/dev/tty(USB|ACM)\d+")


class SerialKeys(DriverSettings):
    """What every serial line needs to know."""

    port: str = Field(min_length=1)
    baudrate: int = Field(default=115200, gt=0)
    parity: Literal["N", "E", "O", "M", "S"] = "N"
    stopbits: int = Field(default=1, ge=1, le=2)
    bytesize: int = Field(default=8, ge=5, le=8)


def open_port(keys: SerialKeys, device: str, *, read_only: bool) -> int:
    """Open a line, claim it, set it up and throw away what came before; return its descriptor.

    A link is followed anew each time: an adapter that comes back under another number is found by its stable
    name. Raises DriverIOError (not there, not ours, taken) and DriverConfigError (a speed that cannot be).
    """
    # what comes between opening and clearing is lost: the library is there before
    line = _configuration(keys)
    access = os.O_RDONLY if read_only else os.O_RDWR
    try:
        descriptor = os.open(device, access | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise DriverIOError(f"{device}: {_refusal(device, error)}") from error
    try:
        _claim(descriptor, device)
        _set_up(descriptor, line, device)
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def close_port(descriptor: int) -> None:
    """Give a line back; harmless on one that was unplugged."""
    with contextlib.suppress(OSError):
        fcntl.ioctl(descriptor, termios.TIOCNXCL)
    with contextlib.suppress(OSError):
        os.close(descriptor)


def port_hint(port: str) -> str | None:
    """Return advice on a port whose name another adapter may get, naming the stable link; None on others."""
    if not _ENUMERATED.fullmatch(port):
        return None
    stable = next(
        (str(link) for link in _stable_names() if os.path.realpath(link) == port), f"its link under {BY_ID}"
    )
    return f"{port} is numbered in the order of plugging, a replug may change it; write port = {stable}"


def _stable_names() -> list[Path]:
    return sorted(BY_ID.iterdir()) if BY_ID.is_dir() else []


def _claim(descriptor: int, device: str) -> None:
    """Lock the line, for those who ask for locks and for those who only open it."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        raise DriverIOError(f"{device}: {_refusal(device, error)}") from error
    with contextlib.suppress(OSError):  # what is no terminal is refused by name when it is set up
        fcntl.ioctl(descriptor, termios.TIOCEXCL)


def _configuration(keys: SerialKeys) -> "serial.Serial":
    import serial

    return serial.Serial(
        None, keys.baudrate, parity=keys.parity, stopbits=keys.stopbits, bytesize=keys.bytesize, timeout=0
    )


def _set_up(descriptor: int, line: "serial.Serial", device: str) -> None:
    line.fd = descriptor
    try:
        line._reconfigure_port(force_update=True)  # noqa: SLF001 (its public way opens the line for writing)
        termios.tcflush(descriptor, termios.TCIFLUSH)
    except (OSError, termios.error) as error:  # the library's own errors are OSErrors
        raise DriverIOError(f"{device}: {error}") from error
    except (ValueError, OverflowError) as error:
        raise DriverConfigError(f"{device}: {error}") from error


def _refusal(device: str, error: OSError) -> str:
    """Return why a line cannot be had, in words."""
    if error.errno in {errno.EBUSY, errno.EWOULDBLOCK}:
        who = ", ".join(holders(device)) or "another program"
        return f"{who} has it open; a serial line has one reader: stop that one, or read another line"
    if error.errno == errno.EACCES:
        return "Permission denied; the agent's user must be in the group of the device (dialout)"
    return os.strerror(error.errno) if error.errno else str(error)


def holders(device: str) -> list[str]:
    """Return the other processes that have a device open, as "name (pid)", as far as this one may see."""
    real = os.path.realpath(device)
    return [_name(process) for process in _processes() if real in _open_files(process)]


def _processes() -> Iterator[Path]:
    own = str(os.getpid())
    return (path for path in Path("/proc").glob("[0-9]*") if path.name != own)


def _open_files(process: Path) -> set[str]:
    found = set()
    # processes and their files come and go while they are looked at, and most of them are closed to others
    with contextlib.suppress(OSError):
        for link in (process / "fd").iterdir():
            with contextlib.suppress(OSError):
                found.add(str(link.readlink()))
    return found


def _name(process: Path) -> str:
    try:
        name = (process / "comm").read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        name = "a program"
    return f"{name} ({process.name})"
