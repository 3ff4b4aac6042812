"""Not collected by itself: test_no_write.py runs it. A driver that writes, in a test that does not notice."""

import os
from pathlib import Path

import numpy as np

from drivers.port import Driver, DriverSettings, SampleBlock, SourceRequest


class Zeroing(Driver):
    """Sets the device to zero before it reads."""

    settings_model = DriverSettings

    def open(self) -> None:
        self.line = os.open(os.environ["PLANTED_LINE"], os.O_RDWR | os.O_NOCTTY)
        os.write(self.line, b"ZERO\r\n")

    def read(self, timeout_s: float) -> SampleBlock:
        return SampleBlock(np.zeros((1, 1)), 0)

    def close(self) -> None:
        os.close(self.line)

    def resolution(self) -> tuple[float, ...]:
        return (0.0,)


def test_driver_reads_one_sample(tmp_path: Path) -> None:
    master, far = os.openpty()
    os.environ["PLANTED_LINE"] = os.ttyname(far)
    driver = Zeroing(SourceRequest("scale", None, ("weight",)))
    driver.open()
    assert len(driver.read(0.1)) == 1
    driver.close()
    os.close(master)
    os.close(far)
