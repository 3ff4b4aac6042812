"""A thermometer beside a simulated rig: what the drivers read of it."""

from pathlib import Path

import numpy as np
import pytest

from agent.evaluation.score.play import Outcome, open_bench, play
from agent.records import CovariateMean
from tests.peers import ROOT

HALL = """
[[channel]]
name = "hall"
role = "covariate"
unit = "degC"
"""
LINE = (
    HALL
    + """
[[source]]
name = "thermometer"
driver = "serial"
port = "hall.tty"
baudrate = 9600
format = "text"
columns = ["T"]
stale_s = 60.0
map = { hall = "T" }
"""
)
REGISTER = (
    HALL
    + """
[[source]]
name = "thermometer"
driver = "modbus"
mode = "poll"
host = "127.0.0.1"
port = 1502
device_id = 7
period_s = 1.0
stale_s = 60.0
fields = [{ name = "T", address = 0, type = "int16", scale = 0.1 }]
map = { hall = "T" }
"""
)
SCENARIO = """
seed = 3
rig = "rig.toml"
duration_s = {seconds}
[[force]]
kind = "random"
rms = {rms}
[[covariate]]
channel = "hall"
kind = "sine"
value = 20.0
amplitude = {amplitude}
period_s = {period}
noise_sd = 0.01
[[wear]]
kind = "covariate"
channel = "hall"
percent = {{ k1 = -0.3, k2 = -0.3 }}
lag_s = {lag}
every_s = 1.0
"""


def written(folder: Path, example: str, thermometer: str, **changes: str) -> Path:
    """Write an example with a thermometer, and its scenario beside it."""
    text = (ROOT / f"deploy/examples/{example}.toml").read_text(encoding="utf-8")
    for before, after in changes.items():
        assert before in text
        text = text.replace(before, after)
    path = folder / "rig.toml"
    path.write_text(text + thermometer, encoding="utf-8")
    return path


def scenario(folder: Path, **keys: float) -> str:
    path = folder / "hall.toml"
    path.write_text(SCENARIO.format(**{"rms": 5.0, "amplitude": 5.0, "lag": 0.0} | keys), encoding="utf-8")
    return str(path)


def means(outcome: Outcome) -> list[CovariateMean]:
    return [record for record in outcome.records if isinstance(record, CovariateMean)]


@pytest.mark.parametrize("thermometer", [LINE, REGISTER], ids=["serial", "modbus"])
def test_covariate_of_a_source_of_its_own_is_read_over_its_bus(tmp_path: Path, thermometer: str) -> None:
    written(tmp_path, "modbus", thermometer)
    outcome = play(open_bench(scenario(tmp_path, seconds=2.0, period=4.0), ()), lambda _: None)
    (one,) = means(outcome)
    assert (one.name, one.unit) == ("hall", "degC")
    # a second apart: at 20 and 25 degrees, or with the next at 20 once more
    assert 21.5 < one.value < 23.6
    assert outcome.truth["covariate_names"].tolist() == ["hall"]
    assert [health.source for health in outcome.health] == ["modbus", "thermometer"]


def test_covariate_of_the_signals_source_is_read_with_them(tmp_path: Path) -> None:
    field = '    { name = "x2", type = "int16", scale = 2e-6 },'
    more = field + '\n    { name = "T", type = "int16", scale = 0.01, offset = 15.0 },'
    written(tmp_path, "serial", HALL, **{field: more, "map = { force": 'map = { hall = "T", force'})
    outcome = play(open_bench(scenario(tmp_path, seconds=2.0, period=4.0), ()), lambda _: None)
    (one,) = means(outcome)
    assert one.n == 2000
    assert one.value == pytest.approx(20.0 + 5.0 * 2.0 / np.pi, abs=0.01)
