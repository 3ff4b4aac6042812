"""sd_repeat beside sd, and what is believed of a rig's constants: stored, shown, exported, saved from damaged
files."""

import csv
import gzip
import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agent.storage import maintenance
from agent.storage.read import queries
from agent.storage.write.store import Store
from agent.types import Verdict
from tests.storage.rows import START, batch, run_info, select, step, verdict, warming

EARLIER = sorted((Path(__file__).parent / "fixtures").glob("version-*.db.gz"))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "rig.db"


def write(path: Path, *records: object, kind: str = "live") -> None:
    with Store.open(path) as store:
        store.write(store.begin_run(run_info(kind=kind)), list(records))  # type: ignore[arg-type]


def repeats(path: Path) -> list[tuple[float | None, float | None]]:
    return select(path, "SELECT sd, sd_repeat FROM v_estimates ORDER BY t_ns, parameter")  # type: ignore[return-value]


@pytest.mark.parametrize("share", [3.0, 1.0, 0.9999, 0.37123456, 0.05, 0.011, 0.0012345678, 1e-9])
def test_sd_repeat_is_stored_to_half_a_percent_whatever_its_share_of_sd(path: Path, share: float) -> None:
    one = batch(20)
    write(path, replace(one, sd_repeat=share * one.sd))
    for sd, repeat in repeats(path):
        assert sd is not None
        assert repeat == pytest.approx(share * sd, rel=5e-3)
        assert share != 1.0 or repeat == sd


def test_sd_repeat_is_null_where_sd_is_and_is_sd_where_none_was_given(path: Path) -> None:
    one = batch(3, first=2)
    write(path, warming(2), replace(one, sd_repeat=np.full_like(one.sd, np.nan)))
    shown = repeats(path)
    assert shown[:8] == [(None, None)] * 8
    assert all(sd is not None and repeat == sd for sd, repeat in shown[8:])


@pytest.mark.parametrize("file", EARLIER, ids=lambda file: file.name)
def test_rows_of_earlier_versions_have_their_sd_as_sd_repeat_and_keep_their_checksums(
    path: Path, file: Path
) -> None:
    path.write_bytes(gzip.decompress(file.read_bytes()))
    write(path, batch(5, first=10**6))
    before = [(sd, repeat) for sd, repeat in repeats(path) if sd == repeat]
    assert len(before) == 168
    assert maintenance.check(path).problems == []


def test_rows_with_and_without_sd_repeat_are_read_from_the_pages_of_a_torn_file(path: Path) -> None:
    path.write_bytes(gzip.decompress(EARLIER[0].read_bytes()))
    write(path, batch(30, first=10**6), *(verdict(START + i) for i in range(60)), step("NORM", "UNACK"))
    before = repeats(path), queries.verdicts(path), queries.alarms(path)
    octets = bytearray(path.read_bytes())
    for table in ("estimates", "hypotheses"):
        (page,) = select(path, "SELECT rootpage FROM sqlite_master WHERE name = ?", table)[0]
        assert octets[(page - 1) * 1024] == 0x05  # an inner page: no way leads to the leaves any more
        octets[(page - 1) * 1024 : page * 1024] = b"\xa5" * 1024
    path.write_bytes(octets)
    assert maintenance.repair(path) is not None
    assert (repeats(path), queries.verdicts(path), queries.alarms(path)) == before


def test_flipped_bit_in_sd_repeat_is_damage(path: Path) -> None:
    write(path, batch(3))
    with Store.open(path) as store:
        store.connection.execute("UPDATE estimates SET repeat = NULL WHERE seq % 1024 = 1")
    assert maintenance.check(path).problems == ["3 rows of estimates have a wrong checksum"]


def test_verdicts_are_listed_by_time_with_their_run_and_exported(path: Path) -> None:
    later = verdict(START + 10**9, hypothesis="delay", size=2e-3, sd=1e-4, unit="s", probability=float("nan"))
    write(path, batch(5), later, verdict())
    first, second = queries.verdicts(path, "press-7")
    assert first == {
        "rig": "press-7", "run_id": 1, "t_ns": START, "time": "2026-01-01T00:00:00.000000000Z",
        "hypothesis": "m1",
        "size": 4.25, "sd": 0.5, "unit": "%", "probability": 0.97,
    }  # fmt: skip
    assert (second["hypothesis"], second["unit"], second["probability"]) == ("delay", "s", None)
    out = io.StringIO()
    assert maintenance.export_csv(path, "verdicts", out) == 2
    rows = list(csv.DictReader(io.StringIO(out.getvalue())))
    assert {row["hypothesis"] for row in rows} == {"m1", "delay"}


def test_verdicts_are_those_of_the_newest_run_that_covers_their_instant(path: Path) -> None:
    write(path, batch(40), verdict())
    write(path, batch(40), verdict(probability=0.2), kind="replay")
    assert [row["run_id"] for row in queries.verdicts(path)] == [2]


def test_verdict_is_a_record_of_one_row(path: Path) -> None:
    record: Verdict = verdict()
    with Store.open(path) as store:
        run = store.begin_run(run_info())
        store.write(run, [record, record])
    assert len(queries.verdicts(path)) == 2
