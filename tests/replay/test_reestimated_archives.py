"""`deltak reestimate`: rigs beside each other, hour after hour, in processes that may die, equal a replay."""

import json
import multiprocessing
import os
import signal
from pathlib import Path

import pytest
from typer.testing import CliRunner

from agent.cli.app import app
from agent.config import load
from agent.errors import UsageError
from agent.runtime.reestimation.archive import configured, gathered
from agent.runtime.reestimation.pools import pool_of
from agent.runtime.reestimation.reestimate import Wanted, reestimate
from agent.runtime.replay import replay
from agent.storage.read import queries
from tests.replay.archives import SECOND, Here, archive, configuration, said


def test_process_killed_between_hours_leaves_what_a_replay_gives_to_the_last_bit(tmp_path: Path) -> None:
    configs = [configuration(tmp_path, name) for name in ("press-1", "press-2")]
    for seed, config in enumerate(configs):
        folder = tmp_path / "archive" / f"{config.stem}.db.raw"
        files = archive(folder, config.stem, 0.4, seed)
        replay(config=config, recordings=files, db=tmp_path / "replayed.db")
    killed: list[int] = []

    def kill_one(_words: str) -> None:
        if not killed:
            killed.extend(child.pid or 0 for child in multiprocessing.active_children()[:1])
            os.kill(killed[0], signal.SIGKILL)

    place = str(tmp_path / "again.db")
    wanted = Wanted([tmp_path / "archive"], configs, place, workers=2, hour_ns=SECOND // 8)
    document = reestimate(wanted, kill_one)
    assert killed
    assert document["repeated"] > 0
    assert document["parts"] >= 6
    assert document["errors"] == []
    assert said(tmp_path / "again.db") == said(tmp_path / "replayed.db")


def test_what_is_damaged_or_foreign_is_a_sentence_each_and_the_rest_is_estimated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("agent.runtime.reestimation.pools.LocalPool", Here)
    config, folder = configuration(tmp_path, "press-1"), tmp_path / "archive"
    _, cut = archive(folder, "press-1", 0.4)
    cut.write_bytes(cut.read_bytes()[:-7])
    (folder / "letter.txt").write_text("a letter", encoding="utf-8")
    (folder / "press-1-line-00000007.raw").write_bytes(b"nothing of the kind")
    answer = CliRunner().invoke(
        app, ["reestimate", str(folder), str(tmp_path / "gone"), "--config", str(config), "--workers", "1",
              "--db", f"{tmp_path}/out/", "--json"]
    )  # fmt: skip
    assert answer.exit_code == 2
    document = json.loads(answer.stdout)
    places = {Path(error["path"]).name: error["message"] for error in document["errors"]}
    assert places == {
        "letter.txt": "is no recording",
        "press-1-line-00000007.raw": "is not a raw recording of this version",
        "gone": "no such file",
        cut.name: "is cut short or damaged, its last 1629 bytes cannot be read",
    }
    assert answer.stderr.count("deltak: error: ") == 4
    (run,) = document["runs"]
    assert (run["rig"], run["samples"]["received"]) == ("press-1", 350)
    assert len(queries.estimates(tmp_path / "out" / "press-1.db")) == 4 * run["windows"] > 0


def test_configuration_is_for_the_rig_of_its_name_and_the_only_one_for_all(tmp_path: Path) -> None:
    configs = [configuration(tmp_path, name) for name in ("press-1", "press-2")]
    for name in ("press-1", "press-3"):
        archive(tmp_path / "archive" / name, name, seconds=0.1)
    found = gathered([tmp_path / "archive"], configured(configs))
    assert [one.rig.rig.name for one in found.rigs] == ["press-1"]
    (fault, *others) = found.faults
    assert 'is of the rig "press-3", which has no configuration' in str(fault)
    assert len(others) == 1
    alone = gathered([tmp_path / "archive"], [load(configs[1])])
    assert [one.rig.rig.name for one in alone.rigs] == ["press-1", "press-3"]
    assert alone.faults == []
    with pytest.raises(UsageError, match='two are of the rig "press-1"'):
        configured([configs[0], configs[0]])


@pytest.mark.parametrize(
    ("scheduler", "size", "words"),
    [
        ("cluster", None, '"cluster" is neither local nor an address'),
        ("http://127.0.0.1:80", None, "neither local nor an address"),
        ("dask://127.0.0.1:8786", 2, "is for the local scheduler"),
    ],
)
def test_scheduler_that_is_none_is_refused(scheduler: str, size: int | None, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        pool_of(scheduler, size)
