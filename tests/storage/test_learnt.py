"""What a rig's windows have taught outlives the process, the version and an edit elsewhere in the
configuration."""

import gzip
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from agent.records import LearntRecord, RunInfo
from agent.storage.write.store import Store
from agent.storage.write.writer import StoreWriter
from agent.types import Learnt
from tests.storage.rows import START, run_info, select

VERSION_4 = Path(__file__).parent / "fixtures" / "version-4.db.gz"
KNOWN, NEWER = '{"sigma": [1.0]}', '{"sigma": [2.0]}'


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "rig.db"


def learnt(content: str, key: str = "aa") -> LearntRecord:
    return LearntRecord("press-7", START, Learnt(key, content))


def of(key: str, **changes: Any) -> RunInfo:
    return replace(run_info(**changes), learnt_key=key)


def write(path: Path, *records: LearntRecord, **changes: Any) -> int:
    with Store.open(path) as store:
        run_id = store.begin_run(run_info(**changes))
        store.write(run_id, list(records))
    return run_id


def test_newest_of_a_rig_kind_and_key_is_found_whatever_version_and_configuration_wrote_it(
    path: Path,
) -> None:
    write(path, learnt(KNOWN), learnt(NEWER))
    write(path, learnt("{}", key="bb"))
    write(path, learnt("{}"), kind="replay")
    with Store.open(path) as store:
        assert store.learnt(of("aa")) == Learnt("aa", NEWER)
        assert store.learnt(of("bb")) == Learnt("bb", "{}")
        assert store.learnt(of("aa", kind="replay")) == Learnt("aa", "{}")
        assert store.learnt(of("cc")) is None
        assert store.learnt(of("aa", rig="other")) is None
        assert store.learnt(run_info()) is None


def test_run_that_learns_more_changes_its_own_row_only(path: Path) -> None:
    first = write(path, learnt(KNOWN), learnt(NEWER))
    second = write(path, learnt(KNOWN))
    assert select(path, "SELECT run_id, content FROM learnt ORDER BY seq") == [
        (first, NEWER),
        (second, KNOWN),
    ]


@pytest.mark.parametrize("damage", ["content = '{\"sigma\": [3.0]}'", "key = 'aa', content = '{'"])
def test_damaged_row_is_passed_over(path: Path, damage: str) -> None:
    write(path, learnt(KNOWN))
    write(path, learnt(NEWER))
    with Store.open(path) as store:
        store.connection.execute(f"UPDATE learnt SET {damage} WHERE seq = 2")
        assert store.learnt(of("aa")) == Learnt("aa", KNOWN)


def test_writer_hands_out_what_was_known_before_its_own_run(path: Path) -> None:
    write(path, learnt(KNOWN))
    writer = StoreWriter(lambda: Store.open(path), [of("aa")])
    writer.start()
    writer.publish([learnt(NEWER)])
    assert writer.flush()
    writer.stop()
    assert writer.learnt == {"press-7": Learnt("aa", KNOWN)}
    with Store.open(path) as store:
        assert store.learnt(of("aa")) == Learnt("aa", NEWER)


def test_calibrations_of_version_4_are_dropped(path: Path) -> None:
    path.write_bytes(gzip.decompress(VERSION_4.read_bytes()))
    assert "calibrations" in tables(path)
    write(path, learnt(KNOWN))
    assert "learnt" in tables(path)
    assert "calibrations" not in tables(path)


def tables(path: Path) -> set[str]:
    with closing(sqlite3.connect(path)) as base:
        return {name for (name,) in base.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
