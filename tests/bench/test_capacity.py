"""Capacity as make bench runs it: rigs at 1 kHz live on one core without a lost sample, frames of a log a
second."""

import pytest

from tests.bench import bench_candump
from tests.bench.bench_capacity import measure, reported

TARGETS = {"modbus": 30, "can": 30, "serial": 10}


@pytest.mark.bench
@pytest.mark.parametrize("bus", TARGETS)
def test_one_core_keeps_up_with_its_rigs(bus: str) -> None:
    found = measure(bus, TARGETS[bus])
    print(f"\n{reported(bus, found)}")
    assert found.kept_up


@pytest.mark.bench
@pytest.mark.parametrize("each", bench_candump.PARTS)
def test_whole_replay_of_a_candump_log_takes_300000_frames_a_second(each: int) -> None:
    found = bench_candump.measure(each)
    print(f"\n{bench_candump.reported(found)}")
    assert found.steady >= 300_000
