"""A replay with a database makes the forecasts that the agent would have made, in the time of its samples."""

from pathlib import Path

import numpy as np
import pytest

from agent.evaluation.demo.bus import COARSE, write_config
from agent.runtime.replay import replay
from agent.storage.read import queries
from agent.text import iso_time
from tests.rigs import two_mass_recording

MILLISECOND = 1_000_000


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """The same recording replayed twice, and cut after two seconds."""
    folder = tmp_path_factory.mktemp("forecasts")
    config = write_config("modbus", COARSE, folder).config
    head, *alarms = config.read_text(encoding="utf-8").split("[[alarm]]\n")
    rest = alarms[-1].split("\n\n", 1)[1]
    k1 = 'parameter = "k1"\nlimit = 15.0\noff_delay_s = 0.2\nwithin = "1s"\nrate_per_day = 1e5\n'
    text = f'{head}[[alarm]]\n{k1}\n{rest}\n[forecast]\nevery = "1s"\n'
    config.write_text(text, encoding="utf-8")
    whole, cut = folder / "whole.csv", folder / "cut.csv"
    two_mass_recording(whole, np.random.default_rng(3))
    cut.write_text("\n".join(whole.read_text(encoding="utf-8").splitlines()[:2001]) + "\n", encoding="utf-8")
    made = [(folder / "a.db", whole), (folder / "b.db", whole), (folder / "cut.db", cut)]
    for db, recording in made:
        replay(config=config, recordings=[recording], db=db)
    return [db for db, _ in made]


def test_replay_forecasts_each_second_and_where_the_alarm_changes(files: list[Path]) -> None:
    rows = queries.forecasts(files[0])
    alarms = [alarm for alarm in queries.alarms(files[0]) if alarm["kind"] == "level"]
    changes = [at for alarm in alarms for at in (alarm["raised_at"], alarm["cleared_at"]) if at is not None]
    assert len(changes) >= 3
    assert [row["made_at"] for row in rows if row["cause"] == "alarm"] == changes
    due = [row["made_at"] for row in rows if row["cause"] == "due"]
    assert due == [iso_time(t * MILLISECOND) for t in (1049 - 50, 2049 - 50)]
    assert {row["parameter"] for row in rows} == {"k1"}


def test_two_replays_forecast_the_same_to_the_last_bit(files: list[Path]) -> None:
    assert queries.forecasts(files[0]) == queries.forecasts(files[1])


def test_forecasts_know_nothing_of_what_the_recording_goes_on_with(files: list[Path]) -> None:
    whole, cut = (queries.forecasts(files[i]) for i in (0, 2))
    said = (
        "made_at",
        "status",
        "p10_at",
        "p50_at",
        "p90_at",
        "chance",
        "family",
        "draws",
        "level",
        "limit_value",
    )
    assert len(cut) >= 3
    early = [row for row in whole if row["made_at_ns"] <= cut[-1]["made_at_ns"]]
    assert [[row[name] for name in said] for row in early] == [[row[name] for name in said] for row in cut]


def test_drift_of_the_replay_raises_its_alarm(files: list[Path]) -> None:
    kinds = {alarm["kind"]: alarm for alarm in queries.alarms(files[0])}
    assert {"level", "rate"} <= set(kinds)
    assert "N/m a day (limit 100000)" in kinds["rate"]["message"]
