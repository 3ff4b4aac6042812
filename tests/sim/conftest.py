"""Clients that are closed when a test ends."""

from collections.abc import Callable, Iterator

import pytest

from tests.sim.rigs import RawModbus


@pytest.fixture
def connect() -> Iterator[Callable[[int], RawModbus]]:
    """Give a maker of Modbus clients."""
    clients: list[RawModbus] = []

    def make(port: int) -> RawModbus:
        clients.append(RawModbus(port))
        return clients[-1]

    yield make
    for client in clients:
        client.close()
