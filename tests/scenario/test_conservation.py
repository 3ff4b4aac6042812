"""Every sample that a device took is accounted for: received = used + rejected + dropped, and gaps where they
were."""

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.config import load
from agent.runtime.ledger import Conservation
from agent.runtime.replay import make_pipeline
from drivers.port import Counts, SampleBlock
from tests.scenario.live import agent, example, hops, rows, wait_until
from tests.sim.rigs import Simulator, simulator

PLAYED = 2000
FAULTS = {
    "drop": (0.300, 0.305),
    "duplicate": (0.700, 0.707),
    "reorder": (1.000, 1.001),
    "freeze": (1.200, 1.240),
}
"""From and to, s, of each fault of a line."""


def scenario(folder: Path, driver: str, faults: Mapping[str, tuple[float, float]]) -> Path:
    """Write two seconds of the default scenario with faults on the line."""
    lines = ["duration_s = 2.0", '[[force]]\nkind = "random"\nrms = 5.0', "[noise]\ndisplacement = 1e-6"]
    for name, (start, end) in faults.items():
        lines.append(f'[[fault]]\nname = "{driver}.{name}"\nat_s = {start}\nfor_s = {end - start:.3f}')
    path = folder / "faults.toml"
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def played(
    folder: Path, bus: str, faults: Mapping[str, tuple[float, float]]
) -> tuple[Simulator, dict[str, Any], Path]:
    """Play a bus with faults to an agent until all is over; return device, the agent's document, its
    database."""
    example(bus, folder)
    text, db = (folder / f"{bus}.toml").read_text(encoding="utf-8"), folder / "agent.db"
    with simulator(folder, text, "--scenario", str(scenario(folder, bus, faults))) as device:
        with agent(device.config, options=["--db", str(db)]) as running:
            wait_until(lambda: hops(db) >= 35 and _newest(db) >= PLAYED - 50, "the last row")
            document = running.document()
        assert device.stop() == 0
    return device, document, db


def _newest(db: Path) -> int:
    """Samples from the run's first row to its newest."""
    first, last = rows(db, "SELECT min(t_ns), max(t_ns) FROM v_estimates")[0]
    return 0 if first is None else round((last - first) / 1e6) + 50


def struck(device: Simulator, fault: str) -> set[int]:
    """The samples that a fault struck, by the device's own ledger."""
    (ledger,) = device.ledger()["sources"].values()
    runs = next(entry["samples"] for entry in ledger["faults"] if entry["fault"] == fault)
    return {sample for first, last in runs for sample in range(first, last + 1)}


def assert_balanced(document: Mapping[str, Any]) -> None:
    samples = document["samples"]
    lost = sum(samples["rejected"].values()) + sum(samples["dropped"].values())
    assert samples["received"] == samples["used"] + lost, samples


def assert_stored(document: Mapping[str, Any], db: Path) -> None:
    """The database's ledger and reasons are the document's."""
    stored = rows(
        db, "SELECT received, used, rejected, dropped, gaps, t_ns FROM v_health ORDER BY t_ns DESC LIMIT 1"
    )[0]
    samples = document["samples"]
    rejected, dropped = samples["rejected"], samples["dropped"]
    expected = (
        samples["received"],
        samples["used"],
        sum(rejected.values()),
        sum(dropped.values()),
        samples["gaps"],
    )
    assert stored[:5] == expected
    reasons = rows(db, "SELECT kind, reason, count FROM v_health_reasons WHERE t_ns = ?", stored[5])
    assert {(kind, reason): count for kind, reason, count in reasons if count and kind != "faults"} == {
        (kind, reason): count for kind in ("rejected", "dropped") for reason, count in samples[kind].items()
    }


@pytest.mark.parametrize("bus", ["can", "serial"])
def test_line_faults_are_counted_as_the_device_caused_them(bus: str, tmp_path: Path) -> None:
    device, document, db = played(tmp_path, bus, FAULTS)
    assert_balanced(document)
    assert_stored(document, db)
    gone = struck(device, "drop") | struck(device, "freeze")
    twice, swapped = struck(device, "duplicate"), struck(device, "reorder")
    assert (len(gone), len(twice), len(swapped)) == (45, 7, 1)
    samples = document["samples"]
    assert samples["received"] == PLAYED - len(gone) + len(twice)
    assert samples["rejected"] == {"duplicate": len(twice), "backwards": len(swapped)}
    # each run of missing samples is one gap, and so is the place that the late sample left
    assert samples["gaps"] == 3
    assert samples["dropped"] == {}


def test_broken_frames_are_refused_and_counted_and_nothing_else_is_lost(tmp_path: Path) -> None:
    faults = {"corrupt": (0.500, 0.504), "truncate": (0.900, 0.902), "garbage": (1.300, 1.303)}
    device, document, db = played(tmp_path, "serial", faults)
    assert_balanced(document)
    assert_stored(document, db)
    broken = struck(device, "corrupt") | struck(device, "truncate")
    samples = document["samples"]
    assert samples["used"] == PLAYED - len(broken)
    assert samples["gaps"] == 2


def test_frames_that_are_broken_to_the_end_are_counted_to_the_end(tmp_path: Path) -> None:
    """No good sample follows those that could take their count along."""
    example("serial", tmp_path)
    text, db = (tmp_path / "serial.toml").read_text(encoding="utf-8"), tmp_path / "agent.db"
    faults = scenario(tmp_path, "serial", {"corrupt": (1.0, 2.0)})
    with simulator(tmp_path, text, "--scenario", str(faults)) as device:
        with agent(device.config, options=["--db", str(db)]) as running:
            wait_until(
                lambda: bool(rows(db, "SELECT id FROM v_events WHERE cause = 'stale'")), "no good sample"
            )
            document = running.document()
        assert device.stop() == 0
    assert_balanced(document)
    assert_stored(document, db)
    samples = document["samples"]
    assert samples["used"] == PLAYED - len(struck(device, "corrupt")) == 1000
    assert sum(samples["rejected"].values()) > 900


def test_modbus_ring_loses_nothing_while_the_device_does_not_answer(tmp_path: Path) -> None:
    """The ring holds a second: half a second without answers is read afterwards."""
    faults = {"silent": (0.5, 0.9), "busy": (1.2, 1.5)}
    device, document, db = played(tmp_path, "modbus", faults)
    assert_balanced(document)
    assert_stored(document, db)
    assert document["samples"] | {"gaps": 0} == document["samples"]
    assert document["samples"]["used"] == PLAYED
    assert device.ledger()["samples"] >= PLAYED


def test_ledger_adds_up_what_driver_queue_acquisition_and_estimation_counted(tmp_path: Path) -> None:
    pipeline = make_pipeline(load(example("modbus", tmp_path)))
    times = np.array([0, 1, 1, 2, 5, 4]) * 1_000_000
    values = np.ones((6, 3))
    values[3, 1] = np.nan
    pipeline.step("recording", SampleBlock(values, 0, None, times), None, None)
    driver = Counts(received=10, rejected=Counter({"crc": 3}), dropped=Counter({"kernel": 2}))
    (health,) = pipeline.ledger.health(
        {"recording": Conservation(driver, Counter({"queue full": 1}))}, 0, None
    )
    assert (health.received, health.used) == (10 + 2, 3)
    assert health.rejected == {"crc": 3, "duplicate": 1, "backwards": 1, "missing value": 1}
    assert health.dropped == {"kernel": 2, "queue full": 1}
    assert health.received == health.used + sum(health.rejected.values()) + sum(health.dropped.values())
