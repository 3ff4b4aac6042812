"""The serial driver, but that its thread hangs for as long as a file is there."""

import time
from pathlib import Path

from drivers.port import SampleBlock
from drivers.serial.driver import SerialDriver

HANG = Path("/run/deltak-hang")


class HangingDriver(SerialDriver):
    """Reads a line until it is told to hang."""

    def read(self, timeout_s: float) -> SampleBlock:
        while HANG.exists():
            time.sleep(0.1)
        return super().read(timeout_s)
