"""A model that is not the machine's, from samples to alarms: what it cannot estimate is said."""

import re
from pathlib import Path

import numpy as np

from agent.config import load
from agent.evaluation.demo.bus import COARSE, write_config
from agent.runtime.pipeline import Pipeline
from agent.types import AlarmTransition
from drivers.port import SampleBlock
from sim_bus.rig.rigfile import read_rig
from sim_bus.rig.scenario import load_scenario
from sim_bus.rig.trajectory import Rig
from tests.scenario.offline import rounded

WITHOUT = re.compile(r',\s*\{ name = "B2".*?\}')
"""The machine's second damper, which the model shall not know."""


def test_damper_that_the_model_lacks_leaves_its_neighbour_blind_and_one_alarm_says_so(tmp_path: Path) -> None:
    path = write_config("modbus", COARSE, tmp_path).config
    values = rounded(Rig(read_rig(path), load_scenario("random", {})).advance(2000).readings, COARSE)
    text = WITHOUT.sub("", path.read_text(encoding="utf-8"))
    text = re.sub(r'\[\[alarm\]\]\nparameter = "(?!B1)\w+"\n(.*\n)*?(?=\n|\[)', "", text).replace(
        ', "B2"', ""
    )
    path.write_text(
        text.replace("[[alarm]]", '[[alarm]]\nblind_s = 0.8\nadvice = "check the dampers"'), encoding="utf-8"
    )
    config = load(path)
    names = [channel.name for channel in config.channel]
    pipeline = Pipeline(config, {}, {"wire": {name: name for name in names}})
    raised = []
    for start in range(0, len(values), 500):
        piece = values[start : start + 500]
        counter = np.arange(start, start + len(piece), dtype=np.int64)
        for record in pipeline.step("wire", SampleBlock(piece, start * 1_000_000, counter), 2**32, None):
            raised += [record] if isinstance(record, AlarmTransition) and record.to_state == "UNACK" else []
    blind = [alarm for alarm in raised if alarm.kind in {"blind", "mismatch"}]
    assert [(alarm.parameter, alarm.advice) for alarm in blind] == [("B1", "check the dampers")], raised
