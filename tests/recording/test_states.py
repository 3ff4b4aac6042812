"""What a record holds of the estimation leads to the same alarm again, also with several sources."""

from functools import partial
from pathlib import Path

import numpy as np

from agent.config import load
from agent.evaluation.explain.recompute import read_kept, recomputed
from agent.recording.event_files import alone
from agent.recording.event_writer import Job, _state
from agent.recording.events import EventKeeper
from agent.recording.states import frozen
from agent.runtime.pipeline import Pipeline
from agent.types import AlarmTransition, IntArray
from drivers.port import SampleBlock
from tests.scenario.two_sources import BLOCK, NOISE_M, STEPS, configure, readings

MS = 1_000_000


class Pen:
    """A writer that only remembers."""

    def __init__(self) -> None:
        self.jobs: list[Job] = []

    def name(self, kind: str, parameter: str) -> str:
        return f"{kind}-{parameter}"

    def submit(self, job: Job) -> None:
        self.jobs.append(job)


def stamps(index: IntArray) -> IntArray:
    return 10**18 + index * MS


def test_alarm_of_two_sources_is_computed_again_to_the_last_digit(tmp_path: Path) -> None:
    values = readings(configure(tmp_path), 1.0, 0.0, 3, NOISE_M / 100)
    config = load(configure(tmp_path, {"nominal = 25.0": "nominal = 60.0"}))
    pipeline = Pipeline(config, STEPS, {source.name: source.map for source in config.source})
    pen, raised = Pen(), list[AlarmTransition]()
    keeper = EventKeeper(config, pen, lambda _: None)
    for start in range(0, len(values), BLOCK):
        count = np.arange(start, start + BLOCK)
        keeper.begin_round(partial(frozen, pipeline))
        for name, block, modulus in (
            ("can", SampleBlock(values[count, :1], int(count[-1]) * MS, count % 65536), 65536),
            ("modbus", SampleBlock(values[count, 1:], int(count[-1]) * MS, count), 2**32),
        ):
            pipeline.take(name, block, modulus, keeper.labelled(stamps))
            keeper.take(name, block, modulus)
        records = pipeline.compute()
        raised += [record for record in records if isinstance(record, AlarmTransition)]
        keeper.see(records)
    assert next(step.parameter for step in raised if step.kind == "level") == "k1"
    path = tmp_path / "a.state.npz"
    path.write_bytes(alone(_state(pen.jobs[0], whole=True)))
    again = recomputed(read_kept(tmp_path / "a.*.raw"))
    assert again.steps[0] == raised[0]
