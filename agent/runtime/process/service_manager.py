"""What the agent says to systemd: sd_notify(3) over the datagram socket that $NOTIFY_SOCKET names."""

import logging
import os
import socket
from collections.abc import Mapping
from contextlib import suppress

log = logging.getLogger(__name__)


class ServiceManager:
    """Whoever started the agent and wants to know how it is; without one, nothing is said to nobody.

    Args:
        environment: holds NOTIFY_SOCKET (a path, or @name in the abstract namespace), WATCHDOG_USEC and
            WATCHDOG_PID.
    """

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        self._address = environment.get("NOTIFY_SOCKET", "")
        self.watchdog_s = _watchdog_s(environment)
        """How often WATCHDOG=1 must come at least, s; None where nobody waits for it."""

    def say(self, **fields: object) -> None:
        """Send fields, such as READY=1, as one message; a manager not listening is no fault of the agent."""
        if not self._address.startswith(("/", "@")):
            return
        address = "\0" + self._address[1:] if self._address.startswith("@") else self._address
        lines = (f"{name}={' '.join(str(value).split())}" for name, value in fields.items())
        with (
            suppress(OSError),
            socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as peer,
        ):
            peer.settimeout(1.0)
            peer.connect(address)
            peer.sendall("\n".join(lines).encode())


def _watchdog_s(environment: Mapping[str, str]) -> float | None:
    """Return the watchdog's interval as sd_watchdog_enabled(3) reads it."""
    wanted = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
    text = environment.get("WATCHDOG_USEC", "")
    return int(text) / 1e6 if wanted and text.isdigit() and int(text) else None
