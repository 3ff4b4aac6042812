"""Alarms of a shipped scenario explained from their records: the same verdicts, to the same digits."""

import json
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.cli.operator.explain import draw
from agent.errors import StoreError
from agent.evaluation.explain.explain import Explained, agreeing, explain
from agent.recording.states import StateError, thawed
from agent.storage.database.checksum import row_crc
from agent.storage.database.columns import columns_of
from tests.figures import figure
from tests.replay.test_event_replays import Live, asked, configured, deltak, live
from tests.scenario.live import agent, hops, wait_until
from tests.sim.rigs import simulator

__all__ = ["live"]


def alarms(live: Live) -> list[dict[str, Any]]:
    return asked(live.db, "SELECT * FROM v_alarms WHERE kind = 'level' ORDER BY id")


@pytest.fixture(scope="module")
def found(live: Live) -> list[Explained]:
    return [explain(live.db, alarm["id"]) for alarm in alarms(live)]


def test_every_alarm_is_explained_by_the_same_verdict_to_the_same_digits(found: list[Explained]) -> None:
    assert len(found) >= 3
    for document in (one.document for one in found):
        assert document["same"], document
        assert document["digits"] >= 12
        assert document["code_version"] == document["code_version_here"]


def test_explanation_says_what_moved_what_else_was_tested_and_which_samples(
    live: Live, found: list[Explained], tmp_path: Path
) -> None:
    alarm, document = alarms(live)[0], found[0].document
    words = document["words"]
    assert alarm["message"] in words
    assert "Computed again from its samples the verdict is the same" in words
    assert "At the same instant" in words
    assert "the verdict rests on the 250 of the last 0.25 s before it" in words
    own, *others = document["tested"]
    assert (own["hypothesis"], own["size"], own["sd"]) == (alarm["parameter"], alarm["delta"], alarm["sd"])
    assert own["probability"] == pytest.approx(alarm["probability"], abs=1e-12)
    assert {one["hypothesis"] for one in others} >= {"k1", "k2", "B1", "B2"} - {alarm["parameter"]}
    draw(found[0], tmp_path / "alarm.png")
    assert (tmp_path / "alarm.png").stat().st_size > 10_000


def test_verdict_rests_on_the_samples_of_the_record(live: Live, found: list[Explained]) -> None:
    alarm = alarms(live)[0]["id"]
    path = live.db.parent / found[0].document["record"]
    whole = path.read_bytes()
    try:
        with np.load(path) as file:
            arrays = {name: file[name] for name in file.files}
        arrays["x1"] = arrays["x1"] * 1.01
        np.savez_compressed(path, **arrays)
        document = explain(live.db, alarm).document
        assert not document["same"]
        assert document["digits"] < 6
    finally:
        path.write_bytes(whole)


def test_alarm_without_its_record_says_so(live: Live, found: list[Explained]) -> None:
    alarm = alarms(live)[0]["id"]
    path = live.db.parent / found[0].document["record"]
    away = path.rename(path.with_suffix(".away"))
    try:
        document = explain(live.db, alarm).document
    finally:
        away.rename(path)
    assert (document["same"], document["digits"]) == (False, 0)
    assert "is not beside the database any more" in document["words"]


def test_alarm_of_another_version_says_which(live: Live) -> None:
    alarm = alarms(live)[0]["id"]
    other = live.db.with_name("other.db")
    other.write_bytes(live.db.read_bytes())
    with closing(sqlite3.connect(other)) as connection:
        names = ", ".join(columns_of("runs"))
        (row,) = connection.execute(f"SELECT {names} FROM runs").fetchall()
        place = columns_of("runs").index("code_version")
        cells = (*row[:place], "0.0.1", *row[place + 1 : -1])
        connection.execute("UPDATE runs SET code_version = '0.0.1', crc = ?", (row_crc(cells),))
        connection.commit()
    words = explain(other, alarm).document["words"]
    assert "It was raised by version 0.0.1" in words


def test_alarm_that_is_not_there_is_refused(live: Live) -> None:
    with pytest.raises(StoreError, match=r"alarm 999: there is no such alarm; deltak alarms .* lists them"):
        explain(live.db, 999)
    done = deltak("explain", live.db, 999, "--json")
    assert (done.returncode, "no such alarm" in json.loads(done.stdout)["errors"][0]["message"]) == (3, True)


@pytest.mark.parametrize(
    "name", ["os\nsystem", "builtins\neval", "agent.clock\nPath", "agent.recording.folder\nos"]
)
def test_state_runs_nothing_but_what_computes(name: str) -> None:
    with pytest.raises(StateError, match="is no part of a state"):
        thawed(f"c{name}\n.".encode())


@pytest.mark.parametrize(
    ("one", "other", "digits"), [(1.0, 1.0, 17), (1.0, 1.0 + 1e-12, 11), (1.0, 2.0, 0), (None, 1.0, 0)]
)
def test_digits_are_those_in_which_all_figures_agree(one: Any, other: Any, digits: int) -> None:
    stored = {"delta": one, "sd": 0.5, "probability": 0.9, "message": "a"}
    assert agreeing(stored, stored | {"delta": other}) == digits


@pytest.mark.soak
@pytest.mark.timeout(1200)
def test_fifty_alarms_of_random_changes_are_explained_to_the_same_digits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    digits: list[int] = []
    for seed in range(100):
        if len(digits) >= 50:
            break
        monkeypatch.setenv("DELTAK_SEED", str(seed))
        for alarm, document in played(tmp_path / f"{seed}", ("can", "serial", "modbus")[seed % 3]):
            assert document["same"], (seed, alarm, document["words"])
            digits.append(document["digits"])
    figure(
        f"{len(digits)} alarms of random changes over three buses explained: "
        f"all the same, to {min(digits)} digits"
    )
    assert len(digits) >= 50
    assert min(digits) >= 12


def played(folder: Path, bus: str) -> list[tuple[int, dict[str, Any]]]:
    """Return the level alarms of a live run of the scenario `random`, each with its explanation."""
    folder.mkdir()
    db = folder / "live.db"
    with (
        simulator(folder, configured(bus, folder), "--scenario", "random", "--fast") as device,
        agent(device.config, options=["--db", str(db)]) as running,
    ):
        wait_until(lambda: hops(db) == 60, "60 rows", 60)
        running.document()
    found = alarms(Live(device.config, db))
    return [(alarm["id"], explain(db, alarm["id"]).document) for alarm in found]
