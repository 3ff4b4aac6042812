"""Ports for the tests' servers, and for those that nobody answers on."""

import socket

_given: set[int] = set()


def free_port() -> int:
    """Return a TCP port that nobody listens on; two calls of one process never return the same.

    The kernel may hand a closed socket's number out again at once, and two sources of one port are one bus.
    """
    while True:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = int(probe.getsockname()[1])
        if port not in _given:
            _given.add(port)
            return port
