"""What is computed at once changes no row; how often a bus is read and a round of computing begins."""

import re
import signal
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agent.blocks.acquisition.indexing import Indexer
from agent.config import RigConfig, driver_class, load
from agent.records import Record
from agent.runtime.pipeline import Pipeline
from agent.runtime.process.requests import Request
from agent.runtime.service import Service, _rest_s
from agent.runtime.tuning import LONGEST_ROUND, LONGEST_ROUND_S
from agent.types import EstimateBatch, FloatArray
from drivers.port import Driver, SampleBlock, SourceRequest
from sim_bus.rig.scenario import load_scenario
from sim_bus.virtual_time.bench import PlayedBench
from tests.scenario.live import example
from tests.scenario.offline import Played, play

SECONDS = 3.0


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> Played:
    return play("default", tmp_path_factory.mktemp("offline"), cut=50)


def in_rounds(played: Played, values: FloatArray, rng: np.random.Generator) -> Iterator[Record]:
    """Take blocks of random lengths, and compute after random numbers of them."""
    names = [channel.name for channel in played.config.channel]
    steps = dict(zip(names, (1e-3, 2e-6, 2e-6), strict=True))
    pipeline = Pipeline(played.config, steps, {"wire": {name: name for name in names}})
    start = 0
    while start < len(values):
        for _ in range(int(rng.integers(1, 12))):
            piece = values[start : start + int(rng.integers(1, 60))]
            number = np.arange(start, start + len(piece), dtype=np.int64)
            pipeline.take("wire", SampleBlock(piece, start * 1_000_000, number), 2**32, None)
            start += len(piece)
        yield from pipeline.compute()
    assert pipeline.compute() == []


def rows_of(records: list[Record]) -> dict[str, FloatArray]:
    batches = [record for record in records if isinstance(record, EstimateBatch)]
    names = ("index", "t_ns", "status", "reason", "value", "sd", "held")
    return {name: np.concatenate([getattr(batch, name) for batch in batches]) for name in names}


def test_blocks_computed_at_once_give_the_rows_that_they_give_one_by_one(
    played: Played, rng: np.random.Generator
) -> None:
    values = np.round(played.chunk.readings / [1e-3, 2e-6, 2e-6]) * [1e-3, 2e-6, 2e-6]
    here, there = rows_of(list(in_rounds(played, values, rng))), rows_of(played.records)
    for name in ("index", "t_ns", "status", "reason"):
        np.testing.assert_array_equal(here[name], there[name])
    within = 1e-9 * there["sd"]
    for name in ("value", "sd", "held"):
        both = np.isfinite(there[name]) & np.isfinite(within)
        assert np.all(np.abs(here[name] - there[name])[both] <= within[both])
        np.testing.assert_array_equal(np.isnan(here[name]), np.isnan(there[name]))


def test_rounds_rest_three_times_as_long_as_they_take_where_none_waits_too_long_for_that() -> None:
    least_s = 0.05
    assert _rest_s(0.0, least_s) == least_s
    assert _rest_s(0.03, least_s) == pytest.approx(0.09)
    assert _rest_s(0.1, least_s) == pytest.approx(LONGEST_ROUND * least_s - 0.1)
    assert _rest_s(0.4, least_s) == 0.0
    assert _rest_s(0.2, least_s=0.2) == pytest.approx(LONGEST_ROUND_S - 0.2)
    assert _rest_s(0.2, least_s=1.0) == pytest.approx(0.8)


def test_signal_amid_a_wait_does_not_wait_for_the_lock_that_the_wait_holds(tmp_path: Path) -> None:
    service = Service([load(example("modbus", tmp_path))], tmp_path / "rig.db", "live")
    stop = Request("stop")
    stop.begin(service.stop)
    handler = threading.Thread(target=stop, args=(signal.SIGTERM, None))
    with service._wake._cond, service._stop._cond:
        handler.start()
        handler.join(5.0)
        assert not handler.is_alive()
    assert service._stop.wait(5.0)
    stop.end()


def read_in_played_time(config: RigConfig, bench: PlayedBench) -> tuple[Driver, list[SampleBlock]]:
    """Read the only source for SECONDS; return its driver and the blocks that hold samples."""
    (source,) = config.source
    request = SourceRequest(
        source.name, source.settings, tuple(source.map.values()), source.counter, config.folder
    )
    blocks = []
    with bench.at(source.name):
        driver = driver_class(source.driver)(request)
        driver.open()
        while bench.now_s(source.name) < SECONDS:
            blocks.append(driver.read(0.2))
        driver.close()
    return driver, [block for block in blocks if len(block)]


@pytest.mark.parametrize(("bus", "most_a_second"), [("modbus", 12), ("can", 21), ("serial", 21)])
def test_line_that_flows_is_read_seldom_and_whole(bus: str, most_a_second: int, tmp_path: Path) -> None:
    path = example(bus, tmp_path)
    bench = PlayedBench(path, load_scenario("default", {}))
    driver, blocks = read_in_played_time(load(path), bench)
    number = np.concatenate([block.counter for block in blocks if block.counter is not None])
    np.testing.assert_array_equal(np.diff(number) % (driver.counter_modulus or 1), 1)
    assert len(number) > (SECONDS - 0.25) * 1000
    assert len(blocks) <= most_a_second * SECONDS
    assert not driver.counts.dropped
    assert not driver.counts.rejected


@pytest.mark.parametrize("bus", ["modbus", "can", "serial"])
def test_line_that_flows_is_read_as_often_as_its_period_says(bus: str, tmp_path: Path) -> None:
    path = example(bus, tmp_path)
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace(f'driver = "{bus}"', f'driver = "{bus}"\nperiod_s = 0.01'), encoding="utf-8")
    driver, blocks = read_in_played_time(load(path), PlayedBench(path, load_scenario("default", {})))
    sizes = np.array([len(block) for block in blocks[5:]])
    assert np.median(sizes) <= 12
    assert sizes.max() <= 25
    assert not driver.counts.rejected


@pytest.mark.parametrize("slots", [16, 64, 150])
def test_ring_that_is_full_before_the_period_is_over_is_read_in_time(slots: int, tmp_path: Path) -> None:
    path = example("modbus", tmp_path)
    text = path.read_text(encoding="utf-8")
    path.write_text(re.sub(r"slots = \d+", f"slots = {slots}", text), encoding="utf-8")
    bench = PlayedBench(path, load_scenario("default", {}))
    driver, blocks = read_in_played_time(load(path), bench)
    number = np.concatenate([block.counter for block in blocks if block.counter is not None])
    # the first contact comes before anything is known of the pace
    settled = number[number > 100]
    np.testing.assert_array_equal(np.diff(settled), 1)
    assert settled[-1] > (SECONDS - 0.25) * 1000
    assert driver.counts.dropped.total() <= 20
    assert not driver.counts.rejected


POLL = """
clock = "arrival"
[model]
mass = [{ name = "m1", value = 500.0 }]
spring = [{ name = "k1", between = ["ground", "m1"], nominal = 2500.0 }]
damper = [{ name = "B1", between = ["ground", "m1"], nominal = 500.0 }]
[[channel]]
name = "force"
quantity = "force"
at = "m1"
unit = "N"
[[channel]]
name = "x1"
quantity = "displacement"
at = "m1"
unit = "m"
noise_sd = 1e-5
[estimator]
window_s = 2.0
hop_s = 0.5
[[source]]
driver = "modbus"
host = "127.0.0.1"
port = 1502
mode = "poll"
fields = [{ name = "F", type = "float32", address = 0 }, { name = "X", type = "float32", address = 2 }]
map = { force = "F", x1 = "X" }
"""


def numbered(config: RigConfig, blocks: list[SampleBlock]) -> tuple[Indexer, list[int]]:
    indexer, numbers = Indexer(config.rig.clock, config.rig.sample_rate_hz), []
    for block in blocks:
        index, kept = indexer.take(block)
        numbers += index[kept].tolist()
    return indexer, numbers


@pytest.mark.parametrize("rate", [20, 50, 60, 200])
def test_polls_that_only_their_arrival_orders_are_numbered_one_by_one(rate: int, tmp_path: Path) -> None:
    path = tmp_path / "poll.toml"
    text = POLL + f"period_s = {1 / rate!r}\n"
    path.write_text(f'[rig]\nname = "poll"\nsample_rate_hz = {rate}.0' + text, encoding="utf-8")
    played = tmp_path / "played.toml"
    played.write_text('duration_s = 4.0\n[[force]]\nkind = "random"\nrms = 5.0\n', encoding="utf-8")
    config = load(path)
    driver, blocks = read_in_played_time(config, PlayedBench(path, load_scenario(str(played), {})))
    indexer, numbers = numbered(config, blocks)
    assert driver.counts.received == len(numbers) > (SECONDS - 0.25) * rate
    assert numbers == list(range(len(numbers)))
    assert not indexer.rejected


def test_line_without_a_counter_is_numbered_one_by_one_by_its_arrival(tmp_path: Path) -> None:
    path = example("serial", tmp_path)
    config = load(path)
    _, blocks = read_in_played_time(config, PlayedBench(path, load_scenario("default", {})))
    indexer = Indexer("arrival", config.rig.sample_rate_hz)
    numbers = np.concatenate([indexer.take(replace(block, counter=None))[0] for block in blocks])
    assert len(numbers) > (SECONDS - 0.25) * 1000
    np.testing.assert_array_equal(numbers, np.arange(len(numbers)))
    assert not indexer.rejected
