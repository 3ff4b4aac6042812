"""The paper's conditions, window by window: stored, shown, kept in number, saved from damaged files."""

import gzip
import json
import math
from pathlib import Path

import pytest

from agent.records import ConditionsRecord
from agent.storage import maintenance
from agent.storage.read import queries
from agent.storage.write.store import Store
from agent.types import WindowConditions
from tests.storage.rows import START, run_info, select

EARLIER = Path(__file__).parent / "fixtures" / "version-7.db.gz"
FOUND = WindowConditions(
    window=250, defect=0.25, defect_outputs=0.5, rank=4, rank_joined=5, defect_special=math.inf, z_zero=True,
    iterations=9, converged=True, cost=1e-9, step=1e-13, passes=2, ratio=None,
    trail=((1.0, 2.0), (math.nan, 2.5)),
)  # fmt: skip


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "rig.db"


def write(path: Path, count: int) -> None:
    records = [ConditionsRecord("press-7", START + i, 0.25, ("k1", "B1"), FOUND) for i in range(count)]
    with Store.open(path) as store:
        store.write(store.begin_run(run_info()), records)


def test_conditions_are_shown_with_the_trail_by_parameter(path: Path) -> None:
    write(path, 1)
    (row,) = queries.conditions(path)
    names = (
        "window_s",
        "condition_11",
        "rank",
        "rank_joined",
        "condition_12",
        "condition_15",
        "z_zero",
        "iterations",
    )
    assert [row[name] for name in names] == [0.25, 0.25, 4, 5, 0, None, 1, 9]
    assert json.loads(row["trail"]) == [{"k1": 1.0, "B1": 2.0}, {"k1": None, "B1": 2.5}]


def test_file_of_the_version_before_takes_conditions_up(path: Path) -> None:
    path.write_bytes(gzip.decompress(EARLIER.read_bytes()))
    write(path, 2)
    assert len(queries.conditions(path)) == 2
    assert maintenance.check(path).problems == []


def test_conditions_are_read_from_the_pages_of_a_torn_file(path: Path) -> None:
    write(path, 60)
    before = queries.conditions(path)
    octets = bytearray(path.read_bytes())
    (page,) = select(path, "SELECT rootpage FROM sqlite_master WHERE name = 'conditions'")[0]
    octets[(page - 1) * 1024 : page * 1024] = b"\xa5" * 1024
    path.write_bytes(octets)
    assert maintenance.repair(path) is not None
    assert queries.conditions(path) == before
