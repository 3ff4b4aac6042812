"""What is played for the golden outputs: shipped scenarios, example configurations, faults, recorded plants.

All of it on simulated or recorded time; nothing here reads a clock, so two runs are alike.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory

from agent.config import load
from agent.evaluation.score.measures import Assessment
from agent.evaluation.score.play import Outcome, open_bench, play
from agent.evaluation.score.score import _expectation, _failures
from agent.records import Record
from agent.runtime.replay import begun
from sim_bus.rig.fault_names import KNOWN
from sim_bus.rig.scenario import load_scenario
from sim_bus.virtual_time.bench import PlayedBench, scored
from tests.faults.played import SCENARIO, write_rig
from tests.golden.text import lines
from tests.peers import ROOT, data

FOLDER = Path(__file__).parent
EXAMPLES = ROOT / "deploy" / "examples"
LINES = {"serial": "serial", "can": "can", "modbus": "tcp"}
STRUCK_S = 1.2
FAULTS: Mapping[str, str] = {
    "can.drop": "can", "can.corrupt": "can", "can.bus-off": "can", "can.restart": "can",
    "can.checksum": "can sum",
    "can.error-passive": "can adapter", "can.nan": "can float", "can.range": "can", "serial.loss": "serial",
    "serial.duplicate": "serial", "serial.shuffle": "serial", "serial.corrupt": "serial",
    "serial.disconnect": "serial",
    "serial.baud": "serial", "serial.counter-reset": "serial", "serial.garbage": "text", "modbus.busy": "tcp",
    "modbus.silent": "tcp", "modbus.late": "tcp", "modbus.reset": "tcp", "modbus.truncate": "rtu",
    "modbus.restart": "tcp", "modbus.wrong-unit": "rtu",
}  # fmt: skip
"""Faults of each kind of line, and the line on which they are played."""
SENSOR_FAULTS = ("gain", "offset", "spikes", "stuck")


@dataclass(frozen=True)
class Case:
    """One golden output: its file, and what makes it as lines."""

    group: str
    name: str
    make: Callable[[], list[str]]

    @property
    def file(self) -> Path:
        """Where it is committed."""
        return FOLDER / self.group / f"{self.name}.txt"

    def __str__(self) -> str:
        return f"{self.group}-{self.name}"


def cases() -> list[Case]:
    """Return every case."""
    scenarios = [Case("scenarios", name, partial(_scenario, name)) for name in scored()]
    examples = [Case("examples", name, partial(_example, name)) for name in ("can", "modbus", "serial")]
    faults = [Case("faults", name, partial(_fault, name, line)) for name, line in FAULTS.items()]
    sensors = [Case("faults", f"sensor.{name}", partial(_sensor_fault, name)) for name in SENSOR_FAULTS]
    recorded = [Case("recorded", "emps", _emps), Case("recorded", "ecp210", _ecp210)]
    return [*scenarios, *examples, *faults, *sensors, *recorded]


@cache
def shipped(name: str) -> tuple[Outcome, list[str]]:
    """Play a scenario that ships; return what the agent made of it, and in words what it expects and is not
    so."""
    bench = open_bench(name, [])
    outcome = play(bench, _unseen)
    measures = Assessment(outcome, bench.strikes()).document()
    return outcome, _failures(_expectation(name, bench.expect), measures)


def _unseen(_share: float) -> None:
    """Show no progress."""


def _scenario(name: str) -> list[str]:
    return _lines(shipped(name)[0], 20)


def _lines(outcome: Outcome, every: int) -> list[str]:
    return lines(outcome.records, outcome.health, every)


def _example(name: str) -> list[str]:
    bench = PlayedBench(EXAMPLES / f"{name}.toml", load_scenario("default", {}))
    return _lines(play(bench, _unseen), 10)


def _fault(name: str, line: str) -> list[str]:
    driver, _, fault = name.partition(".")
    with TemporaryDirectory() as folder:
        scenario = Path(folder) / "scenario.toml"
        scenario.write_text(
            SCENARIO.format(duration=STRUCK_S + KNOWN[driver][fault].lasts_s + 0.8), encoding="utf-8"
        )
        played = load_scenario(str(scenario), {}).with_faults([f"{name}@{STRUCK_S}s"])
        return _lines(play(PlayedBench(write_rig(line, Path(folder)), played), _unseen), 15)


def _sensor_fault(name: str) -> list[str]:
    return _lines(play(open_bench("healthy", [f"sensor.{name}@1.5s+1.0s"]), _unseen), 20)


def _emps() -> list[str]:
    return _recording("emps.toml", data("emps/emps.csv"), rows=20_000, every=2)


def _ecp210() -> list[str]:
    narrower = ("window_s = 11.27 ", "window_s = 6.0 ")
    return _recording("ecp210.toml", data("ecp210/both_free_a.txt"), rows=9_000, every=8, changed=narrower)


def _recording(
    example: str, recording: Path, *, rows: int, every: int, changed: tuple[str, str] = ("", "")
) -> list[str]:
    """Replay the first rows of a recorded plant by its example configuration."""
    with TemporaryDirectory() as folder:
        config, short = Path(folder) / example, Path(folder) / recording.name
        config.write_text(
            (EXAMPLES / example).read_text(encoding="utf-8").replace(*changed), encoding="utf-8"
        )
        text = recording.read_text(encoding="utf-8").splitlines(keepends=True)
        short.write_text("".join(text[: rows + 1]), encoding="utf-8")
        return _replayed(config, short, every)


def _replayed(config: Path, recording: Path, every: int) -> list[str]:
    playing = begun(load(config), [recording])
    found: list[Record] = [record for records in playing.records() for record in records]
    ledger = playing.ledger()
    playing.close()
    return lines(found, ledger, every)
