"""Forecasts are stored, scored once, proved, bounded, exported and saved; files of earlier versions get their
table."""

import gzip
import json
from pathlib import Path
from typing import Any

import pytest

from agent.records import ForecastRecord, ForecastScore, TrendRecord
from agent.storage import maintenance
from agent.storage.read import queries
from agent.storage.write.retention import purge_logs
from agent.storage.write.store import Store
from tests.storage.rows import START, batch, run_info, select

EARLIER = sorted((Path(__file__).parent / "fixtures").glob("version-*.db.gz"))
DAY = 86_400 * 10**9


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "rig.db"


def forecast(t_ns: int = START, **changes: Any) -> ForecastRecord:
    fields: dict[str, Any] = {
        "rig": "press-7", "parameter": "k1", "t_ns": t_ns, "level": 24.0, "limit": 20.0, "status": "ok",
        "p10_ns": t_ns + 3 * DAY, "p50_ns": t_ns + 5 * DAY, "p90_ns": t_ns + 8 * DAY, "chance": 0.75,
        "horizon_s": 6 * 86_400.0, "family": '{"constant": 1.0}', "draws": "[259200.0, 432000.0, 691200.0]",
        "cause": "due",
    }  # fmt: skip
    return ForecastRecord(**(fields | changes))


def trend(t_ns: int = START, **changes: Any) -> TrendRecord:
    fields: dict[str, Any] = {
        "rig": "press-7", "parameter": "k1", "t_ns": t_ns, "value": 24.0, "sd": 0.1, "slope_per_day": -0.02,
        "slope_sd": 0.003, "trend": True,
    }  # fmt: skip
    return TrendRecord(**(fields | changes))


def score(number: int = 1, **changes: Any) -> ForecastScore:
    fields: dict[str, Any] = {
        "rig": "press-7", "parameter": "k1", "number": number, "made_ns": START, "t_ns": START + 5 * DAY,
        "crossed_ns": START + 4 * DAY, "crps": 12_345.5, "held": True,
    }  # fmt: skip
    return ForecastScore(**(fields | changes))


def write(path: Path, *records: object, kind: str = "live") -> None:
    with Store.open(path) as store:
        run = store.begin_run(run_info(kind=kind))
        for record in records:
            store.write(run, [record])  # type: ignore[list-item]


def test_forecast_is_shown_with_its_times_family_and_code_version(path: Path) -> None:
    write(path, batch(5), forecast())
    (row,) = queries.forecasts(path, "press-7", "k1")
    promised = {
        "rig": "press-7", "parameter": "k1", "limit_value": 20.0, "made_at_ns": START,
        "made_at": "2026-01-01T00:00:00.000000000Z", "p10_at": "2026-01-04T00:00:00.000000000Z",
        "p50_at": "2026-01-06T00:00:00.000000000Z", "p90_at": "2026-01-09T00:00:00.000000000Z",
        "chance": 0.75,
        "status": "ok", "family": '{"constant": 1.0}', "code_version": "0.1.0", "scored_at": None,
        "crossed_at": None,
        "crps": None, "held": None,
    }  # fmt: skip
    assert {name: row[name] for name in promised} == promised
    assert json.loads(row["draws"]) == [259_200.0, 432_000.0, 691_200.0]


def test_trend_is_shown_with_its_time_and_slope(path: Path) -> None:
    write(path, batch(5), trend(), trend(START + DAY, slope_per_day=None, slope_sd=None, trend=False))
    columns = "rig, parameter, t_ns, time, value, sd, slope_per_day, slope_sd, trend"
    assert select(path, f"SELECT {columns} FROM v_trend ORDER BY id") == [
        ("press-7", "k1", START, "2026-01-01T00:00:00.000000000Z", 24.0, 0.1, -0.02, 0.003, 1),
        ("press-7", "k1", START + DAY, "2026-01-02T00:00:00.000000000Z", 24.0, 0.1, None, None, 0),
    ]
    names, rows = maintenance.export(path, "trend")
    assert [dict(zip(names, row, strict=True))["trend"] for row in rows] == [1, 0]


def test_forecast_that_can_say_nothing_has_nulls(path: Path) -> None:
    nothing = forecast(status="too short", p10_ns=None, p50_ns=None, p90_ns=None, chance=None, draws="[]")
    write(path, batch(5), nothing)
    (row,) = queries.forecasts(path)
    assert [row[name] for name in ("p10_at", "p50_at", "p90_at", "chance")] == [None] * 4


def test_forecast_is_scored_once_and_then_waits_no_more(path: Path) -> None:
    write(
        path,
        batch(5),
        forecast(),
        forecast(START + DAY),
        score(),
        score(held=False, crossed_ns=None, crps=None),
    )
    first, second = queries.forecasts(path)
    assert (first["crossed_at"], first["crps"], first["held"]) == (
        "2026-01-05T00:00:00.000000000Z",
        12_345.5,
        1,
    )
    assert second["scored_at"] is None
    assert [row["id"] for row in queries.forecasts(path, waiting=True)] == [second["id"]]
    assert maintenance.check(path).problems == []


def test_score_of_another_forecast_changes_nothing(path: Path) -> None:
    write(path, batch(5), forecast(), score(made_ns=START + 1), score(number=99))
    assert queries.forecasts(path)[0]["scored_at"] is None


def test_flipped_bit_in_a_forecast_is_damage_and_is_not_shown(path: Path) -> None:
    write(path, batch(5), forecast(), forecast(START + DAY))
    with Store.open(path) as store:
        store.connection.execute("UPDATE forecasts SET p50_ns = p50_ns + 1 WHERE seq = 1")
    shown = queries.forecasts(path)
    assert ([row["id"] for row in shown], shown.refused) == ([2], 1)
    assert maintenance.check(path).problems == ["1 rows of forecasts have a wrong checksum"]


def test_forecasts_outlive_a_torn_file(path: Path) -> None:
    made = [forecast(START + i) for i in range(40)]
    write(path, batch(30), *made)
    before = queries.forecasts(path)
    octets = bytearray(path.read_bytes())
    (page,) = select(path, "SELECT rootpage FROM sqlite_master WHERE name = ?", "forecasts")[0]
    octets[(page - 1) * 1024 : page * 1024] = b"\xa5" * 1024
    path.write_bytes(octets)
    assert maintenance.repair(path) is not None
    assert queries.forecasts(path) == before


def test_oldest_forecasts_go_beyond_a_number(path: Path) -> None:
    write(path, batch(5), *(forecast(START + i) for i in range(9)))
    with Store.open(path) as store, store.transaction() as connection:
        purge_logs(connection, kept=4)
    assert [row["id"] for row in queries.forecasts(path)] == [6, 7, 8, 9]


def test_forecasts_are_those_of_the_newest_run_that_covers_their_instant(path: Path) -> None:
    write(path, batch(40), forecast())
    write(path, batch(40), forecast(chance=0.5), kind="replay")
    assert [(row["run_id"], row["chance"]) for row in queries.forecasts(path)] == [(2, 0.5)]


@pytest.mark.parametrize("file", EARLIER, ids=lambda file: file.name)
def test_files_of_earlier_versions_take_forecasts(path: Path, file: Path) -> None:
    path.write_bytes(gzip.decompress(file.read_bytes()))
    write(path, batch(5, first=10**6), forecast())
    assert len(queries.forecasts(path)) == 1
    assert len(select(path, "SELECT 1 FROM v_estimates")) >= 173
    assert maintenance.check(path).problems == []
