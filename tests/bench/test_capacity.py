"""Live capacity as make bench runs it: so many rigs at 1 kHz on one core, without a lost sample."""

import pytest

from tests.bench.bench_capacity import measure, told

TARGETS = {"modbus": 30, "can": 30, "serial": 10}


@pytest.mark.bench
@pytest.mark.parametrize("bus", TARGETS)
def test_one_core_keeps_up_with_its_rigs(bus: str) -> None:
    found = measure(bus, TARGETS[bus])
    print(f"\n{told(bus, found)}")
    assert found.kept_up
