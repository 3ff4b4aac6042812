"""Workers and latency as make bench runs them; on a machine that does nothing else."""

import pytest

from tests.bench import bench_latency, bench_workers

RIGS = 20


@pytest.mark.bench
def test_two_cores_carry_more_rigs_over_workers_than_one_process_can() -> None:
    alone, spread = (bench_workers.measure("modbus", RIGS, workers) for workers in (1, 2))
    for found in (alone, spread):
        print(f"\n{bench_workers.reported('modbus', found)}")
    assert alone.lost == spread.lost == {}
    assert spread.carried(2) > 1.4 * alone.carried(2)


@pytest.mark.bench
@pytest.mark.parametrize("bus", ["modbus", "can", "serial"])
def test_prompt_settings_store_rows_within_100_ms_and_alarms_within_50(bus: str) -> None:
    rows, alarms = (bench_latency.measure(bus, "prompt", what) for what in ("rows", "alarms"))
    print(f"\n{bench_latency.reported(bus, 'prompt', 'rows', rows)}")
    print(bench_latency.reported(bus, "prompt", "alarms", alarms))
    assert rows.p99 <= 0.1
    assert alarms.p99 <= 0.05


@pytest.mark.bench
@pytest.mark.parametrize("bus", ["modbus", "can", "serial"])
def test_rig_of_1_khz_takes_6_percent_of_a_core_at_the_default_settings(bus: str) -> None:
    found = bench_latency.measure(bus, "default", "rows")
    print(f"\n{bench_latency.reported(bus, 'default', 'rows', found)}")
    assert found.cpu <= 0.06
