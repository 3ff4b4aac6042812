"""What the simulator may open: nothing that can be a machine."""

import ipaddress
import os
import re
from pathlib import Path

from sim_bus.errors import SimUsageError

WORDS = "this looks like a real bus; sim never transmits on one"
_VIRTUAL_CAN = re.compile(r"vcan[0-9]{0,3}")


def loopback(host: str, key: str) -> str:
    """Return a loopback address (127.0.0.0/8, ::1) for a host; SimUsageError for every other."""
    if host == "localhost":
        return "127.0.0.1"
    try:
        if ipaddress.ip_address(host).is_loopback:
            return host
    except ValueError:
        pass  # a name that would have to be looked up can lead anywhere
    raise SimUsageError(f"{key}: {WORDS}")


def virtual_can(interface: str, channel: str, key: str) -> None:
    """Raise SimUsageError unless a python-can interface and channel cannot be a machine's bus."""
    if interface == "virtual" or (interface == "socketcan" and _VIRTUAL_CAN.fullmatch(channel)):
        return
    raise SimUsageError(f"{key}: {WORDS}")


def pty_link(port: str, folder: Path, key: str) -> Path:
    """Return the path for a link to a pseudo-terminal; SimUsageError where something real may be.

    The path must be free, or a link that leads to a pseudo-terminal (or nowhere any more), and not under
    /dev.
    """
    path = Path(os.path.abspath(folder / port))  # noqa: PTH100 (resolve would follow the link itself)
    leads_to_pty = path.is_symlink() and os.readlink(path).startswith("/dev/pts/")  # noqa: PTH115 (text is wanted)
    if path.is_relative_to("/dev") or (os.path.lexists(path) and not leads_to_pty):
        raise SimUsageError(f"{key}: {WORDS}")
    return path
