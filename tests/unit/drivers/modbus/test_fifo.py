"""Which samples of a queue are new, whatever the width of the counter that says so."""

import numpy as np
import pytest

from drivers.fields import ByteArray
from drivers.modbus.fifo import FifoReader
from drivers.modbus.frames import Request
from drivers.modbus.settings import ModbusSettings
from drivers.port import Counts, IntArray, SourceRequest


def read(kind: str, *queues: IntArray) -> list[list[int]]:
    """Return the counters of what is new in each state of a queue."""
    fields = [{"name": "n", "type": kind}, {"name": "x", "type": "int16"}]
    settings = ModbusSettings.model_validate(
        {"mode": "fifo", "address": 7, "fields": fields, "period_s": 1e-9}
    )
    reader = FifoReader(SourceRequest("press", settings, ("x",), "n"), settings, Counts(), lambda _: None)
    waiting = [reader.layout.pack({"n": queue, "x": np.zeros(len(queue))}).reshape(-1) for queue in queues]

    def ask(_: Request) -> ByteArray:
        return waiting.pop(0)

    found = []
    while waiting:
        counter = reader.read(ask, float("inf")).counter
        found.append([] if counter is None else counter.tolist())
    return found


@pytest.mark.parametrize("kind", ["uint16", "uint32", "int64", "uint64"])
def test_samples_of_a_queue_that_were_seen_before_are_left_out(kind: str) -> None:
    assert read(kind, np.arange(3), np.arange(1, 5), np.arange(4, 6)) == [[0, 1, 2], [3, 4], [5]]
