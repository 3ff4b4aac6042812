"""Frames that carry several samples and a checksum: simulated, read by the driver, held against the truth."""

import time
from pathlib import Path

import numpy as np
import pytest

from agent.config import load
from agent.evaluation.demo.bus import COARSE
from drivers.can.codec.layout import FrameKeys
from drivers.can.driver import CanDriver
from drivers.port import SourceRequest
from sim_bus.devices.can.packing import Packing, load_database
from sim_bus.errors import SimUsageError
from sim_bus.rig.rigfile import Source
from tests.scenario import wires

SIGNALS = ("Force", 1e-3), ("X1", 2e-6), ("X2", 2e-6)
COUNT = 8


def dbc() -> str:
    """A frame of 64 bytes: counter, eight samples of three numbers, a CRC of 16 bits."""
    lines = ['VERSION ""', "NS_ :", "BS_:", "BU_: RIG", "BO_ 257 RIG_BLOCK: 64 RIG"]
    lines.append(' SG_ Counter : 0|32@1+ (1,0) [0|0] "" RIG')
    for place in range(COUNT):
        for number, (name, scale) in enumerate(SIGNALS):
            start = 32 + 16 * (3 * place + number)
            lines.append(f' SG_ {name}_{place} : {start}|16@1- ({scale:g},0) [0|0] "" RIG')
    lines.append(' SG_ Check : 416|16@1+ (1,0) [0|0] "" RIG')
    return "\n".join([*lines, ""])


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = wires.configure("daemon", tmp_path)
    text = path.read_text().replace(
        "fd = false",
        f"""fd = true
samples_per_frame = {COUNT}
checksum = {{ signal = "Check", method = "CRC-16/IBM-3740", data_id = "0101" }}""",
    )
    for name in ("Force", "X1", "X2"):
        text = text.replace(f"RIG_SAMPLE.{name}", f"RIG_BLOCK.{name}_0")
    path.write_text(text.replace("RIG_SAMPLE.Counter", "RIG_BLOCK.Counter"))
    (path.parent / "demo.dbc").write_text(dbc())
    return path


def test_frames_of_eight_samples_arrive_whole_and_as_played(config: Path) -> None:
    source = load(config).source[0]
    request = SourceRequest("can", source.settings, tuple(source.map.values()), source.counter, config.parent)
    driver, values, counters = CanDriver(request), [], []
    with wires.devices(config):
        driver.open()
        deadline = time.monotonic() + wires.LIMIT_S
        while sum(map(len, values)) < wires.SAMPLES and time.monotonic() < deadline:
            block = driver.read(1.0)
            values.append(block.values)
            counters.append(block.counter)
        driver.close()
    assert driver.counts.rejected == {}
    assert driver.counts.received == wires.SAMPLES
    np.testing.assert_array_equal(np.concatenate(counters), np.arange(wires.SAMPLES))
    steps = np.array([scale for _, scale in SIGNALS])
    numbers = np.rint(np.concatenate(values) / steps)
    np.testing.assert_array_equal(numbers, wires.integers(config.with_name("truth.npz"), COARSE))


@pytest.mark.parametrize(
    ("keys", "fields"),
    [
        ({"samples_per_frame": 3}, ("RIG_BLOCK.Force_0",)),
        ({"samples_per_frame": 4, "counter_counts": "frames"}, ("RIG_BLOCK.Force_0",)),
    ],
)
def test_layout_that_cannot_be_simulated_is_refused_in_words(
    tmp_path: Path, keys: dict[str, object], fields: tuple[str, ...]
) -> None:
    (tmp_path / "a.dbc").write_text(dbc())
    source = Source(driver="can", name="can", map={"force": fields[0]}, counter="RIG_BLOCK.Counter")
    layout = FrameKeys.model_validate({"dbc": "a.dbc", **keys})
    with pytest.raises(SimUsageError, match="samples_per_frame"):
        Packing(load_database(tmp_path / "a.dbc", "dbc"), source, fd=True, keys=layout)
