"""A thermometer beside a simulated rig: what the drivers read of it, what is learnt, what is taken out."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.blocks.graph import graph_of
from agent.commissioning.baseline.learn import Stretch, learn
from agent.config import load
from agent.evaluation.score import play as playing
from agent.evaluation.score.play import Outcome, open_bench, play
from agent.runtime.rig_runtime import RigRuntime
from agent.storage.read import baselines
from agent.storage.write.store import Store
from agent.types import AlarmTransition, CovariateMean
from tests.peers import ROOT
from tests.storage.rows import run_info

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


def play_from(baseline_of: Path, bench: str, monkeypatch: pytest.MonkeyPatch) -> Outcome:
    """Play a scenario to an agent that counts from the baselines of a database."""

    def counting(*args: Any) -> RigRuntime:
        rig = RigRuntime(*args)
        rig.count_from(baselines.standing(baseline_of, "two-mass-rig"))
        return rig

    with monkeypatch.context() as patch:
        patch.setattr(playing, "RigRuntime", counting)
        return play(open_bench(bench, ()), lambda _: None)


def raised(outcome: Outcome) -> set[str]:
    steps = [r for r in outcome.records if isinstance(r, AlarmTransition)]
    return {step.parameter for step in steps if step.kind == "level" and step.cause == "raise"}


SLOW = {
    "sample_rate_hz = 1000.0": "sample_rate_hz = 50.0",
    "window_s = 0.25": "window_s = 4.0",
    "hop_s = 0.05": "hop_s = 1.0",
    "limit = 15.0 ": "limit_percent = 3.0 ",
    "limit = 20.0\n": "limit_percent = 3.0\n",
    "off_delay_s = 0.2": "on_delay_s = 8.0",
}


@pytest.mark.soak
@pytest.mark.timeout(3600)
def test_springs_that_follow_a_hall_raise_nothing_once_that_is_learnt(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = written(tmp_path, "modbus", LINE, **SLOW)
    warm: dict[str, float] = {"rms": 1.0, "amplitude": 15.0, "period": 900.0}
    healthy = play(open_bench(scenario(tmp_path, seconds=1900.0, **warm), ()), lambda _: None)
    assert {"k1", "k2"} <= raised(healthy)
    db = tmp_path / "rig.db"
    with Store.open(db) as store:
        run = store.begin_run(replace(run_info("two-mass-rig"), graph=graph_of(load(config))))
        store.write(run, healthy.records)
    found = learn(db, None, Stretch(("k1", "k2"), hours=0.5))["parameters"]
    for name in ("k1", "k2"):
        (one,) = found[name]["covariates"]
        assert one["used"]
        assert one["coefficient"] == pytest.approx(-0.003 * found[name]["reference"], rel=0.1)
    again = play_from(db, scenario(tmp_path, seconds=900.0, **warm), monkeypatch)
    assert raised(again) == set()
