"""Every fault that the simulator can cause, on simulated time: what was lost, what was told, what no estimate
used.

The simulator says what it broke; the shadow of the samples that were used is held against what the sensors
read.
"""

from pathlib import Path
from typing import Any

import pytest

from agent.evaluation.score.measures import Assessment
from agent.evaluation.score.play import play
from sim_bus.rig.fault_names import KNOWN, names
from sim_bus.rig.scenario import load_scenario
from sim_bus.virtual_time.bench import PlayedBench
from tests.faults.played import RATE, Run, run

AT_S = 0.7
LINE = {"serial": "serial", "can": "can", "modbus": "tcp"}
OTHER_LINE = {
    "serial.nan": "text", "can.nan": "can float", "modbus.nan": "float",
    "serial.inf": "serial float", "can.inf": "can float", "modbus.inf": "float",
    "modbus.corrupt": "rtu", "can.checksum": "can sum", "can.error-warning": "can adapter",
    "can.error-passive": "can adapter", "can.overrun": "can adapter",
}  # fmt: skip
STRANGE_COUNT = {"counter-reset", "restart"}
"""While a counter runs behind, its samples are refused; that it began anew is known after a tenth of a
second."""

CAUSES = {
    "can.drop": "gap", "can.loss": "gap", "can.duplicate": "duplicate", "can.reorder": "backwards",
    "can.shuffle": "backwards", "can.corrupt": "text", "can.truncate": "gap", "can.garbage": "text",
    "can.freeze": "gap", "can.silence": "stale", "can.stall": "", "can.disconnect": "lost", "can.dlc": "dlc",
    "can.foreign": "", "can.flood": "", "can.error-frame": "bus error", "can.bus-off": "bus-off",
    "can.stuck-counter": "duplicate", "can.counter-reset": "restart", "can.counter-jump": "gap",
    "can.restart": "restart", "can.nan": "missing value", "can.range": "spike",
    "serial.drop": "gap", "serial.loss": "gap", "serial.duplicate": "duplicate",
    "serial.reorder": "backwards",
    "serial.shuffle": "backwards", "serial.corrupt": "crc", "serial.truncate": "stray bytes",
    "serial.garbage": "sync",
    "serial.freeze": "gap", "serial.silence": "stale", "serial.stall": "", "serial.disconnect": "lost",
    "serial.delete": "crc", "serial.insert": "crc", "serial.break": "sync", "serial.baud": "sync",
    "serial.stuck-counter": "duplicate", "serial.counter-reset": "restart", "serial.counter-jump": "gap",
    "serial.restart": "restart", "serial.nan": "missing value", "serial.range": "spike",
    "modbus.exception-1": "exception 1 (illegal function)",
    "modbus.exception-2": "exception 2 (illegal data address)",
    "modbus.exception-3": "exception 3 (illegal data value)",
    "modbus.exception-4": "exception 4 (device failure)",
    "modbus.exception-5": "exception 5 (acknowledge, still working)",
    "modbus.exception-6": "exception 6 (device busy)",
    "modbus.exception-8": "exception 8 (memory parity error)",
    "modbus.exception-10": "exception 10 (gateway path unavailable)",
    "modbus.exception-11": "exception 11 (gateway target does not answer)",
    "modbus.exception-85": "exception 85 (not a code of the standard)",
    "modbus.busy": "exception 6 (device busy)",
    "modbus.hang": "", "modbus.silent": "timeout", "modbus.late": "timeout", "modbus.slow": "",
    "modbus.dribble": "",
    "modbus.disconnect": "lost", "modbus.accept-close": "lost", "modbus.half-open": "timeout",
    "modbus.hang-up": "",
    "modbus.wrong-unit": "unit", "modbus.wrong-transaction": "transaction", "modbus.wrong-protocol": "reply",
    "modbus.wrong-function": "reply", "modbus.wrong-count": "reply", "modbus.short": "reply",
    "modbus.long": "reply",
    "modbus.corrupt": "timeout", "modbus.truncate": "timeout", "modbus.garbage": "reply",
    "modbus.duplicate": "reply",
    "modbus.restart": "timeout", "modbus.nan": "missing value", "modbus.range": "spike",
    "can.inf": "not finite", "can.swapped": "spike", "can.jitter": "", "can.split": "", "can.extended": "",
    "can.remote": "remote frame", "can.checksum": "checksum", "can.error-warning": "error-warning",
    "can.error-passive": "error-passive", "can.overrun": "controller overflow",
    "serial.inf": "not finite", "serial.swapped": "spike", "serial.jitter": "", "serial.split": "",
    "serial.stolen": "crc", "modbus.inf": "not finite", "modbus.swapped": "spike", "modbus.reset": "lost",
    "modbus.black-hole": "timeout",
    "sensor.offset": "", "sensor.drift": "", "sensor.saturated": "", "sensor.flicker": "",
    "sensor.spikes": "spike",
    "sensor.stuck": "", "sensor.dead": "", "sensor.reversed": "", "sensor.scaled": "", "sensor.gain": "",
}  # fmt: skip
"""Every fault, and the one thing that the agent has to say of it."""


def struck(name: str, folder: Path) -> Run:
    driver, _, fault = name.partition(".")
    lasts = KNOWN[driver][fault].lasts_s
    return run(OTHER_LINE.get(name, LINE[driver]), [f"{name}@{AT_S}s"], folder, AT_S + lasts + 0.8)


def test_every_fault_has_a_case() -> None:
    assert sorted(CAUSES) == sorted(names())
    assert {name: KNOWN[name.split(".")[0]][name.split(".")[1]].cause for name in CAUSES} == CAUSES


OF_LINES = [name for name in names() if not name.startswith("sensor.")]
OF_SENSORS = [name for name in names() if name.startswith("sensor.")]


@pytest.mark.parametrize("name", OF_LINES)
def test_fault_is_counted_to_the_sample_told_once_and_in_no_estimate(name: str, tmp_path: Path) -> None:
    found = struck(name, tmp_path)
    samples = found.found["samples"]
    assert samples["balanced"], samples
    assert found.causes == ([CAUSES[name]] if CAUSES[name] else [])
    assert found.found["spoilt_rows"] == 0
    assert len(found.assess.matched.number) > AT_S * RATE
    assert found.found["faults"][0]["recovery_s"] < 2.0
    refused = samples["rejected"].get("backwards", 0) if name.partition(".")[2] in STRANGE_COUNT else 0
    spikes = samples["rejected"].get("spike", 0)
    assert found.lost >= found.absent
    assert len(found.lost) == len(found.absent) + refused + spikes
    assert samples["gaps"] == gaps(found) + (name.endswith(("counter-reset", "counter-jump")))


def gaps(found: Run) -> int:
    """Places where the simulator says that samples are missing, but for those at the end, after which nothing
    comes."""
    (runs,) = found.found["samples"]["absent"].values()
    return sum(last < found.found["samples"]["played"] - 1 for _, last in runs)


def test_shadow_shows_the_wrong_bits_that_a_line_without_a_check_lets_through(tmp_path: Path) -> None:
    """What holds above would hold for a blind oracle too: this one sees."""
    found = run("bare", [f"serial.corrupt@{AT_S}s+0.3s"], tmp_path, AT_S + 0.8)
    assert int(found.assess.matched.spoilt.sum()) >= 3


UNNAMED = {"sensor.drift", "sensor.flicker"}
"""What no offset, gain or delay of one size explains: rows hold a change or a mismatch, and no channel is
named."""


def sensor_run(name: str) -> tuple[Assessment, dict[str, Any], list[tuple[int, int]]]:
    """Play two masses at 1 kHz with a sensor that fails; return the verdict and runs of wrong readings."""
    healthy = load_scenario("healthy", {}).model_copy(update={"duration_s": 3.4})
    assert healthy.rig is not None
    bench = PlayedBench(healthy.folder / healthy.rig, healthy.with_faults([f"{name}@1.5s+1.5s"]))
    assess = Assessment(play(bench, lambda _share: None), bench.strikes())
    touched = assess.truth.ledger["sensors"]["x2"]["affected"]
    return assess, assess.document(), [run for runs in touched.values() for run in runs] or [(1500, 2999)]


def valid_over(assess: Assessment, runs: list[tuple[int, int]]) -> int:
    """Count the rows with a valid estimate whose windows hold a wrong reading."""
    assert assess.rows is not None
    index, valid = assess.rows.index, assess.rows.valid.any(axis=1)
    first = index - assess.rows.window.max(axis=1) + 1
    assert valid[index < 1500].any()
    return int(sum(((index >= begin) & (first <= end) & valid).sum() for begin, end in runs))


@pytest.mark.parametrize("name", [name for name in OF_SENSORS if name != "sensor.spikes"])
def test_fault_of_a_sensor_is_an_alarm_of_its_channel_and_in_no_estimate(name: str) -> None:
    """From the first wrong reading on no estimate is valid, whether the other channels can tell which it was
    or not."""
    assess, found, runs = sensor_run(name)
    assert found["sensors"] == ([] if name in UNNAMED else ["x2"])
    assert found["samples"]["balanced"]
    assert (found["events"], found["alarms"]["false"]) == ([], [])
    assert valid_over(assess, runs) == 0


def test_spikes_of_a_sensor_are_refused_one_by_one_and_estimates_go_on() -> None:
    assess, found, runs = sensor_run("sensor.spikes")
    spikes = sum(last - first + 1 for first, last in runs)
    assert found["samples"]["rejected"] == {"spike": spikes}
    assert [cause for _, cause in found["events"]] == ["spike"]
    assert (found["sensors"], found["alarms"]["false"], found["spoilt_rows"]) == ([], [], 0)
    assert valid_over(assess, runs) > 20
    assert max(of["rms_sd"] for of in found["parameters"].values()) < 1.5
