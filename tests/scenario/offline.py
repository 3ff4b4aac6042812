"""The demo without processes or bus: what the simulator plays, rounded as the wire does, straight into the
pipeline."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from agent.blocks.rig_model import rig_model
from agent.commissioning.numerics.information import bound_sd, window_information
from agent.config import RigConfig, load
from agent.evaluation.demo.bus import COARSE, FINE, Wire, write_config
from agent.numerics.model.statespace import discretise
from agent.records import Record
from agent.runtime.pipeline import Pipeline
from agent.types import AlarmTransition, EstimateBatch, FloatArray, Status
from drivers.port import SampleBlock
from sim_bus.rig.rigfile import read_rig
from sim_bus.rig.scenario import load_scenario
from sim_bus.rig.trajectory import Chunk, Rig

SECOND = 1000


@dataclass(frozen=True)
class Played:
    """Three seconds of a scenario: what was true, what the agent made of it."""

    config: RigConfig
    chunk: Chunk
    names: tuple[str, ...]
    states: tuple[str, ...]
    records: list[Record]

    def truth(self, index: int) -> dict[str, float]:
        return dict(zip(self.names, self.chunk.parameters[index].tolist(), strict=True))

    def raised(self) -> list[tuple[str, int]]:
        """(parameter, sample) of every activation."""
        first = next(r for r in self.records if isinstance(r, EstimateBatch))
        origin = int(first.t_ns[0]) - int(first.index[0]) * 1_000_000
        changes = [r for r in self.records if isinstance(r, AlarmTransition) and r.to_state == "UNACK"]
        return [(r.parameter, (r.t_ns - origin) // 1_000_000) for r in changes]

    def row(self, index: int) -> dict[str, tuple[float, float, Status]]:
        """Value, sd and status of every parameter in the row at a sample."""
        for batch in self.records:
            if isinstance(batch, EstimateBatch) and index in batch.index:
                at = int(np.flatnonzero(batch.index == index)[0])
                columns = zip(batch.value[at], batch.sd[at], batch.status[at], strict=True)
                cells = [(float(value), float(sd), Status(int(status))) for value, sd, status in columns]
                return dict(zip(batch.parameters, cells, strict=True))
        raise AssertionError(f"no row at sample {index}")

    def repeat(self, index: int) -> dict[str, float]:
        """The sd of every parameter against another window of the same rig, in the row at a sample."""
        for batch in self.records:
            if isinstance(batch, EstimateBatch) and index in batch.index:
                at = int(np.flatnonzero(batch.index == index)[0])
                return dict(zip(batch.parameters, batch.sd_repeat[at].tolist(), strict=True))
        raise AssertionError(f"no row at sample {index}")


def play(scenario: str, folder: Path, seed: int | None = None, cut: int = 200) -> Played:
    """Play three seconds of a scenario into the pipeline in blocks of `cut` samples."""
    wire = FINE if scenario == "paper" else COARSE
    path = write_config("modbus", wire, folder).config
    environment = {} if seed is None else {"DELTAK_SEED": str(seed)}
    rig = Rig(read_rig(path), load_scenario(scenario, environment))
    chunk = rig.advance(3 * SECOND)
    values = rounded(chunk.readings, wire)
    config = load(path)
    names = [c.name for c in config.channel]
    steps = dict(zip(names, _steps(wire), strict=True))
    pipeline = Pipeline(config, steps, {"wire": {name: name for name in names}})
    return Played(
        config, chunk, rig.timeline.names, rig.graph.state_names, list(_records(pipeline, values, cut))
    )


def _steps(wire: Wire) -> FloatArray:
    return np.array([float(wire.force_step), float(wire.length_step), float(wire.length_step)])


def rounded(readings: FloatArray, wire: Wire) -> FloatArray:
    """Round to the wire's steps and rails."""
    limit = 2**31 if wire is FINE else 2**15
    return np.clip(np.round(readings / _steps(wire)), -limit, limit - 1) * _steps(wire)


def _records(pipeline: Pipeline, values: FloatArray, cut: int) -> Any:
    for start in range(0, len(values), cut):
        piece = values[start : start + cut]
        counter = np.arange(start, start + len(piece), dtype=np.int64)
        yield from pipeline.step("wire", SampleBlock(piece, start * 1_000_000, counter), 2**32, None)


def called_for(played: Played) -> list[tuple[str, int]]:
    """(parameter, segment) of every change that carries a parameter from within its limit to beyond it."""
    limits = {alarm.parameter: alarm.limit for alarm in played.config.alarm}
    nominal = {name: played.config.parameters[name].nominal for name in limits}
    found = []
    for segment in range(3):
        now = played.truth(segment * SECOND)
        before = played.truth(segment * SECOND - 1) if segment else nominal
        for name, limit in limits.items():
            if abs(now[name] - nominal[name]) > limit >= abs(before[name] - nominal[name]):
                found.append((name, segment))
    return found


def bounds(played: Played, last: int) -> Mapping[str, float]:
    """The Cramer-Rao bound of the window ending at sample `last`, noise of 1 um and the wire's rounding."""
    config, rig = played.config, rig_model(played.config)
    names = [p.name for p in rig.parameters]
    start = last + 1 - round(config.estimator.windows_s[0] * config.rig.sample_rate_hz)
    truth = played.truth(start)
    model = rig.model.continuous(np.array([truth[name] for name in names]))
    sigma = np.full(2, np.hypot(1e-6, 2e-6 / np.sqrt(12)))
    u = played.chunk.forces[start : last + 1, [1]]
    order = [
        played.states.index(name.replace("velocity of ", "v.").replace("displacement of ", "q."))
        for name in rig.model.state_names
    ]
    x0 = played.chunk.states[start, order]
    information = window_information(discretise(model, 1e-3), x0, u, sigma)
    return dict(zip(names, bound_sd(information).tolist(), strict=True))
