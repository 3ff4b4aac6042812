"""A rig whose force comes over CAN and whose motion over Modbus: configuration, and devices on simulated
time."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from agent.config import RigConfig, load
from agent.records import HealthEvent, Record
from agent.runtime.pipeline import Pipeline
from agent.types import EstimateBatch, FloatArray, Status
from drivers.port import SampleBlock
from sim_bus.rig.excitation import Force
from sim_bus.rig.rigfile import read_rig
from sim_bus.rig.scenario import Scenario
from sim_bus.rig.sensors import Sensor
from sim_bus.rig.trajectory import Rig
from tests.ports import free_port
from tests.sim.rigs import ROOT

EXAMPLES = ROOT / "deploy" / "examples"
STEPS = {"force": 1e-3, "x1": 2e-6, "x2": 2e-6}
TRUTH = np.array([25.0, 100.0, 5.0, 5.0])
NOISE_M = 1e-4
BLOCK = 20


def configure(folder: Path, changes: Mapping[str, str] | None = None, **keys: str) -> Path:
    """Write the configuration, on free ports, with text replaced and keys given to the Modbus source."""
    modbus, can = ((EXAMPLES / f"{name}.toml").read_text(encoding="utf-8") for name in ("modbus", "can"))
    frames = re.sub(r"map = \{.*\}", 'map = { force = "RIG_SAMPLE.Force" }', _source(can))
    ring = re.sub(r"map = \{.*\}", 'map = { x1 = "x1", x2 = "x2" }', _source(modbus))
    given = "".join(f"{key} = {value}\n" for key, value in keys.items())
    text = (
        modbus[: modbus.index("[[source]]")]
        + frames
        + ring
        + given
        + '[store]\npath = "rig.db"\nevery_s = 0\n'
    )
    for port in ("1502", "29536"):
        text = text.replace(f"port = {port}", f"port = {free_port()}")
    for old, new in (changes or {}).items():
        assert old in text, old
        text = text.replace(old, new)
    (folder / "two-mass-rig.dbc").write_bytes((EXAMPLES / "two-mass-rig.dbc").read_bytes())
    path = folder / "two-sources.toml"
    path.write_text(text, encoding="utf-8")
    return path


def _source(text: str) -> str:
    return text[text.index("[[source]]") : text.index("[store]")]


def noisy(folder: Path, **keys: str) -> Path:
    """A configuration for sensors of 0.1 mm and windows of 1 s, in which a skew hides in the noise."""
    changes = {"noise_sd = 1e-6": f"noise_sd = {NOISE_M}", "window_s = 0.25": "window_s = 1.0"}
    return configure(folder, changes, **keys)


@dataclass(frozen=True)
class Outcome:
    """What came of a run: the pipeline as it ended, and its records."""

    pipeline: Pipeline
    records: list[Record]

    @property
    def events(self) -> list[HealthEvent]:
        return [record for record in self.records if isinstance(record, HealthEvent)]

    def skew(self) -> tuple[float, float]:
        """Skew of the Modbus source against CAN and its sd, s."""
        skew, sd = self.pipeline.ledger.skew("modbus")
        assert skew is not None
        assert sd is not None
        return skew, sd

    def errors(self, every: int) -> FloatArray:
        """Errors of the valid rows (n, 4) in their sd, only of each `every`-th row (disjoint windows)."""
        batches = [record for record in self.records if isinstance(record, EstimateBatch)]
        value, sd, status = (
            np.vstack([getattr(b, name) for b in batches]) for name in ("value", "sd", "status")
        )
        good = (status == Status.VALID).all(axis=1)
        return np.asarray(((value - TRUTH) / sd)[good][::every])


def readings(config: Path, seconds: float, skew_s: float, seed: int, noise_m: float) -> FloatArray:
    """Return what the sensors read (n, 3), the motion `skew_s` late, as the wires carry it."""
    late = tuple(Sensor(channel=name, delay_s=skew_s) for name in ("x1", "x2"))
    force = (Force(kind="random", rms=5.0),)
    scenario = Scenario(seed=seed, force=force, noise={"displacement": noise_m}, sensor=late)
    steps = np.array(list(STEPS.values()))
    played = Rig(read_rig(config), scenario).advance(round(1000 * seconds)).readings
    return np.asarray(np.round(played / steps) * steps)


def play(path: Path, values: FloatArray, order: tuple[str, ...] = ("can", "modbus")) -> Outcome:
    """Let both devices deliver their readings in blocks, in their own order, and let the agent compute."""
    config: RigConfig = load(path)
    pipeline = Pipeline(config, STEPS, {source.name: source.map for source in config.source})
    records: list[Record] = []
    for start in range(0, len(values), BLOCK):
        count = np.arange(start, min(start + BLOCK, len(values)))
        arrival = int(count[-1]) * 1_000_000
        blocks = {
            "can": SampleBlock(values[count, :1], arrival, count % 65536),
            "modbus": SampleBlock(values[count, 1:], arrival, count),
        }
        for name in order:
            records += pipeline.step(name, blocks[name], 65536 if name == "can" else 2**32, None)
    return Outcome(pipeline, records + pipeline.finish())
