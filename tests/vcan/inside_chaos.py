"""The kernel's bus set down and up, deleted and made anew, again and again; DELTAK_CYCLES says how often."""

import os

import pytest

from tests.faults.test_can_chaos import assert_recovers
from tests.vcan.inside import KernelLine, ip

CYCLES = int(os.environ.get("DELTAK_CYCLES", "5"))


class DownLine(KernelLine):
    """The bus goes down, and comes back as it was."""

    bus = "vcan1"

    def kill(self) -> None:
        self.receive()
        ip("set", self.bus, "down")

    def restore(self) -> None:
        self.sent.clear()
        ip("set", self.bus, "up")
        for end in (self.sender, self.monitor):  # they still hold the error of a bus that went
            end.close()
        self.listen()


@pytest.mark.timeout(60 + 8 * CYCLES)
def test_buses_that_go_and_return_are_read_within_two_seconds_and_others_lose_nothing() -> None:
    assert_recovers({"down and up": DownLine, "deleted and made anew": KernelLine}, CYCLES, samples=1)
