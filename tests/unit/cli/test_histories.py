"""`deltak trend` on tables, with like machines and limits; `deltak fleet` on databases that the real store
wrote."""

import csv
import json
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from agent.cli.prognosis.fleet import fleet, learn_prior
from agent.cli.prognosis.trend import Ahead, trend
from agent.errors import UsageError
from agent.records import Baseline, CovariateMean, ForecastRecord, ForecastScore
from agent.reference.covariates.dependence import Dependence, written
from agent.storage.maintenance import store_baselines
from agent.storage.read.points import points_of
from agent.storage.read.tables import table_points
from agent.storage.write.store import Store
from tests.storage.rows import START, batch, run_info

DAY = 86_400
HOUR_NS = 3600 * 10**9
WARMED = Dependence(
    "hall", "degC", -0.1, 0.001, -0.102, -0.098, "none", 0.0, 0.0, 0.0, 20.0, 15.0, 35.0, 5.0, 600.0,
    used=True,
)  # fmt: skip
OPEN = (None, None)
Said = Callable[..., str]


@pytest.fixture
def said(capsys: pytest.CaptureFixture[str]) -> Said:
    def run(command: Callable[..., Any], *args: Any, **kwargs: Any) -> str:
        capsys.readouterr()
        command(*args, **kwargs)
        return capsys.readouterr().out

    return run


def table(path: Path, value: np.ndarray, sd: float | None = 0.05, begin: int = 1_700_000_000) -> Path:
    with path.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow(["time", "value"] + (["sd"] if sd else []))
        rows.writerows([begin + DAY * i, v] + ([sd] if sd else []) for i, v in enumerate(value.tolist()))
    return path


def falling(rng: np.random.Generator, n: int = 120) -> np.ndarray:
    t = np.arange(float(n))
    return 25.0 - 0.01 * t - 1.5e-4 * t * t + 0.05 * rng.standard_normal(n)


def asked(said: Said, path: Path, limit: float | None = None, **ahead: Any) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(
        said(trend, path, None, None, OPEN, limit, "json", None, Ahead(**ahead))
    )
    return found


def test_trend_of_a_table_says_that_it_falls_faster_and_when(
    tmp_path: Path, rng: np.random.Generator, said: Said
) -> None:
    path = table(tmp_path / "press.csv", falling(rng))
    found = asked(said, path, 18.0, horizon="30d")
    assert (found["rig"], found["n"], found["trend"]) == ("press", 120, True)
    assert found["words"] == "falls, and faster each month"
    ahead = found["forecast"]
    assert ahead["status"] == "ok"
    assert 0 < ahead["p10_s"] < ahead["p50_s"] < ahead["p90_s"]
    assert ahead["horizon_s"] == 30 * DAY
    words = said(trend, path, None, None, OPEN, 18.0, "table", None)
    assert "a trend: falls, and faster each month" in words
    assert "(80 %: " in words


def test_trend_of_parquet_equals_that_of_csv(tmp_path: Path, rng: np.random.Generator, said: Said) -> None:
    value = falling(rng)
    one = asked(said, table(tmp_path / "a.csv", value), 18.0)
    columns = {
        "time": [1_700_000_000 + DAY * i for i in range(120)],
        "value": value,
        "sd": np.full(120, 0.05),
    }
    pq.write_table(pa.table(columns), tmp_path / "a.parquet")
    assert asked(said, tmp_path / "a.parquet", 18.0) == one


def test_trend_of_iso_times_without_sd_is_the_same_history(tmp_path: Path, said: Said) -> None:
    path = tmp_path / "a.csv"
    rows = [f"2026-01-{day:02d}T00:00:00Z,{30 - day}" for day in range(1, 20)]
    path.write_text("\n".join(["time,value", *rows]) + "\n", encoding="utf-8")
    found = asked(said, path)
    assert (found["since"], found["n"]) == ("2026-01-01T00:00:00.000000000Z", 19)
    assert found["slope_per_day"] == pytest.approx(-1.0)
    assert found["forecast"] is None


def test_trend_limit_from_a_reference_is_a_change(
    tmp_path: Path, rng: np.random.Generator, said: Said
) -> None:
    path = table(tmp_path / "a.csv", falling(rng))
    assert asked(said, path, -7.0, reference=25.0)["forecast"] == asked(said, path, 18.0)["forecast"]


@pytest.mark.parametrize(
    ("rows", "limit", "words"),
    [
        (0, 18.0, "no valid rows"),
        (1, 18.0, "too short to say"),
        (4, 18.0, "too short to say"),
        (120, 24.0, "crossed already"),
        (120, 30.0, "moves away from the limit"),
    ],
)
def test_trend_of_what_cannot_be_forecast_is_a_sentence(
    tmp_path: Path, rng: np.random.Generator, said: Said, rows: int, limit: float, words: str
) -> None:
    path = table(tmp_path / "a.csv", falling(rng)[:rows])
    assert words in said(trend, path, None, None, OPEN, limit, "table", None)
    found = asked(said, path, limit)
    assert found["forecast"] is None or found["forecast"]["p50_s"] is None


def test_trend_of_rows_out_of_order_says_so_and_is_the_same(
    tmp_path: Path, rng: np.random.Generator, said: Said
) -> None:
    value = falling(rng)
    straight = asked(said, table(tmp_path / "a.csv", value), 18.0)
    lines = (tmp_path / "a.csv").read_text(encoding="utf-8").splitlines()
    (tmp_path / "b.csv").write_text("\n".join([lines[0], *lines[61:], *lines[1:61]]), encoding="utf-8")
    stepped = asked(said, tmp_path / "b.csv", 18.0)
    assert stepped["backward"] == 1
    assert stepped["forecast"] == straight["forecast"]
    assert "as after a step of a clock" in said(
        trend, tmp_path / "b.csv", None, None, OPEN, None, "table", None
    )


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.csv", "when,what\n1,2\n", "a history has the columns time"),
        ("a.csv", "time,value\nsoon,2\n", '"soon" is no time'),
        ("a.csv", "time,value\n1,two\n", "holds what is no number"),
        ("a.parquet", "no parquet", "cannot be read"),
        ("none.csv", None, "cannot be read"),
    ],
)
def test_trend_of_what_is_no_history_is_a_usage_error(
    tmp_path: Path, name: str, content: str | None, words: str
) -> None:
    if content is not None:
        (tmp_path / name).write_text(content, encoding="utf-8")
    with pytest.raises(UsageError, match=words):
        trend(tmp_path / name, None, None, OPEN, None, "json", None)


def test_prior_file_says_what_its_histories_say(tmp_path: Path, rng: np.random.Generator, said: Said) -> None:
    others = [table(tmp_path / f"{i}.csv", falling(rng, 200)) for i in range(4)]
    learnt = learn_prior(others, None, 17.0, tmp_path / "prior.json")
    assert learnt["histories"] == 4
    path = table(tmp_path / "mine.csv", falling(rng, 60))
    by_file = asked(said, path, 17.0, like=(tmp_path / "prior.json",))["forecast"]
    by_histories = asked(said, path, 17.0, like=tuple(others))["forecast"]
    assert by_file == by_histories
    assert by_file["like"] == {"histories": 4}
    (tmp_path / "odd.json").write_text("{}", encoding="utf-8")
    with pytest.raises(UsageError, match="holds no prior"):
        asked(said, path, 17.0, like=(tmp_path / "odd.json",))


@pytest.fixture
def machines(tmp_path: Path) -> Path:
    """Two databases in a folder: k1 of one falls, all else stays."""
    folder = tmp_path / "fleet"
    folder.mkdir()
    for name, fall in (("press-1", 0.0), ("press-2", 4.0)):
        rows = batch(400, rig=name)
        value = rows.value.copy()
        value[:, 0] -= fall * np.linspace(0.0, 1.0, 400) ** 2
        with Store.open(folder / f"{name}.db") as store:
            store.write(store.begin_run(replace(run_info(), rig=name)), [replace(rows, value=value)])
    return folder


def test_fleet_shows_the_part_that_changes_first(machines: Path) -> None:
    found = fleet([machines], "90d", None, 30.0)["rows"]
    assert {row["rig"] for row in found} == {"press-1", "press-2"}
    assert (found[0]["rig"], found[0]["parameter"], found[0]["trend"]) == ("press-2", "k1", True)
    assert found[0]["slope_percent_per_year"] < 0.0
    assert {"rig", "parameter", "slope_percent_per_year", "p50_at", "chance", "record"} <= set(found[0])
    only = fleet([machines / "press-1.db"], "90d", "k1", 30.0)["rows"]
    assert [(row["rig"], row["parameter"]) for row in only] == [("press-1", "k1")]


def test_fleet_takes_out_what_a_covariate_does(tmp_path: Path, rng: np.random.Generator) -> None:
    """A hall that warms by 10 K makes a spring softer by 4 %: no part falls."""
    path = tmp_path / "rig.db"
    hours = np.arange(120)
    temperature = 20.0 + hours / 12.0
    rows = batch(120, parameters=("k1",), hop_ns=HOUR_NS)
    value = 25.0 - 0.1 * (temperature - 20.0) + 0.02 * rng.standard_normal(120)
    exact = np.full((120, 1), 0.02)
    means = [
        CovariateMean("press-7", "hall", "degC", START + hour * HOUR_NS, 20.0 + hour / 12.0, 60, 3600)
        for hour in hours.tolist()
    ]
    with Store.open(path) as store:
        run = store.begin_run(run_info())
        store.write(run, [replace(rows, value=value[:, None], sd=exact, sd_repeat=exact), *means])
    assert fleet([path], "90d", None, 20.0)["rows"][0]["trend"]
    figures = (25.0, 0.01, 0.04, 0.01, None, 3600.0, 100.0, written([WARMED]), 0, 1, 100)
    store_baselines(path, [Baseline("press-7", "k1", "N/m", "", *figures)])
    (row,) = fleet([path], "90d", None, 20.0)["rows"]
    assert (row["trend"], row["status"]) == (False, "no trend")


def test_fleet_reads_tables_and_folders_of_them(tmp_path: Path, rng: np.random.Generator) -> None:
    falls = table(tmp_path / "falls.csv", falling(rng))
    level = table(tmp_path / "level.csv", 25.0 + 0.05 * rng.standard_normal(120))
    for places in ([falls, level], [tmp_path]):
        first, second = fleet(places, "90d", None, 20.0)["rows"]
        assert (first["rig"], first["trend"], second["rig"], second["trend"]) == (
            "falls",
            True,
            "level",
            False,
        )
        assert first["p50_at"] is not None
        assert first["limit"] == pytest.approx(20.0, abs=0.2)
    assert fleet([falls], "90d", "k1", 20.0)["rows"][0]["parameter"] == "k1"
    (short,) = fleet([table(tmp_path / "short.csv", np.array([25.0]))], "90d", None, 20.0)["rows"]
    assert (short["status"], short["chance"]) == ("too short", None)


def test_fleet_of_an_empty_folder_says_so(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"no \.db file and no table"):
        fleet([tmp_path], "90d", None, 20.0)


def test_trend_without_a_parameter_lists_all(machines: Path, said: Said) -> None:
    shown = said(trend, machines / "press-2.db", None, None, OPEN, None, "table", None)
    lines = [line for line in shown.splitlines() if "press-2" in line]
    assert "k1" in lines[0]
    assert "falls" in lines[0]
    rows = json.loads(said(trend, machines / "press-2.db", None, None, OPEN, None, "json", None))["rows"]
    assert rows[0]["parameter"] == "k1"


@pytest.fixture
def scored(tmp_path: Path) -> Path:
    """A database with four forecasts: two held, one did not, one waits."""
    rng, day, begin = np.random.default_rng(5), 86_400 * 10**9, 1_700_000_000 * 10**9
    value = np.tile(falling(rng)[:, None], (1, 4))
    rows = replace(batch(120, start=begin, hop_ns=day), value=value, sd=np.full((120, 4), 0.05))
    past: list[Any] = [
        ForecastRecord(
            "press-7", "k1", begin + (i + 20) * day, 24.0, 22.0, "ok",
            *(begin + (i + p) * day for p in (40, 50, 60)), 0.5, 1e6, "{}", "[1.0, 2.0]", "due",
        )
        for i in range(4)
    ]  # fmt: skip
    crossed = begin + 52 * day
    scores = [
        ForecastScore("press-7", "k1", i + 1, past[i].t_ns, crossed, crossed, 86_400.0 * (i + 1), i < 2)
        for i in range(3)
    ]  # fmt: skip
    path = tmp_path / "past.db"
    with Store.open(path) as store:
        run = store.begin_run(run_info())
        store.write(run, [rows, *past])
        store.write(run, scores)
    return path


def test_trend_shows_the_record_of_past_forecasts(scored: Path, said: Said, tmp_path: Path) -> None:
    picture = tmp_path / "k1.png"
    text = said(trend, scored, "k1", None, OPEN, 18.0, "table", picture)
    assert "of 3 made here, 2 held within the 80 % band; CRPS 2 days" in text
    assert picture.stat().st_size > 10_000
    record = json.loads(said(trend, scored, "k1", None, OPEN, 18.0, "json", None))["forecast"]["record"]
    assert record["made"] == 3
    assert record["held"] == 2
    assert record["crps"] == pytest.approx(2 * 86_400.0)
    assert record["waiting"] == 1
    assert record["bias_s"] == pytest.approx(-1.0 * 86_400.0)
    assert record["alpha_lambda"] == 1.0
    assert record["horizon_s"] == pytest.approx(32 * 86_400.0)


def test_trend_without_past_forecasts_says_nothing_of_them(scored: Path, said: Said) -> None:
    assert "made here" not in said(trend, scored, "k2", None, OPEN, 18.0, "table", None)


def test_fleet_shows_which_forecasts_held(scored: Path) -> None:
    rows = {row["parameter"]: row["record"] for row in fleet([scored], "90d", None, 20.0)["rows"]}
    assert (rows["k1"]["made"], rows["k1"]["held"], rows["k2"]["made"]) == (3, 2, 0)


def test_trend_over_rows_of_two_references_and_a_set_clock_says_so(
    tmp_path: Path, rng: np.random.Generator, said: Said, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, day = tmp_path / "two.db", 86_400 * 10**9
    value = np.tile(falling(rng)[:, None], (1, 4))
    with Store.open(path) as store:
        run = store.begin_run(run_info())
        for first, reference in ((0, 25.0), (60, 24.5)):
            rows = {"value": value[first : first + 60], "sd": np.full((60, 4), 0.05)}
            store.write(run, [batch(60, first=first, hop_ns=day, reference=np.full(4, reference), **rows)])
    points = points_of(path, None, "k1")
    monkeypatch.setattr("agent.cli.prognosis.trend.points_of", lambda *_: replace(points, clock_steps=2))
    text = said(trend, path, "k1", None, OPEN, None, "table", None)
    assert "rows of 2 references (25, then 24.5): their values are compared" in text
    assert "the wall clock was set otherwise 2 times: instants follow it as it is set now" in text
    assert "a trend: falls" in text  # what is counted from elsewhere moves no value


@pytest.mark.parametrize(
    ("head", "row", "words"),
    [
        ("time,value,value", "{t},25,24", "has the column value more than once"),
        ("time,value,sd", "{t},25,-0.1", "the column sd holds -0.1, which is no deviation"),
        ("time,value", "{t},1e308", "past what is measured"),
        ("time,value", "9900-01-01T00:00:00Z,25", "is no time; seconds, or ISO 8601, from 1678 to 2261"),
        ("time,parameter,value", "{t},B1,25", "holds no k1; it holds B1"),
    ],
)
def test_table_that_is_no_history_is_a_sentence(tmp_path: Path, head: str, row: str, words: str) -> None:
    path = tmp_path / "odd.csv"
    path.write_text("\n".join([head, *(row.format(t=DAY * i) for i in range(20))]), encoding="utf-8")
    with pytest.raises(UsageError, match=words):
        table_points(path, parameter="k1")


def test_row_without_sd_is_not_exact_and_one_of_infinite_sd_is_none(tmp_path: Path) -> None:
    path = tmp_path / "mixed.csv"
    cells = ["0.1", "", "inf", "0.3", "nan"]
    rows = [f"{DAY * i},25,{sd}" for i, sd in enumerate(cells)]
    path.write_text("\n".join(["time,value,sd", *rows]), encoding="utf-8")
    assert table_points(path)[0].sd.tolist() == pytest.approx([0.1, 0.2, 0.3, 0.2])


def test_constant_rows_without_sd_have_a_level_in_few_digits(tmp_path: Path, said: Said) -> None:
    text = said(
        trend, table(tmp_path / "still.csv", np.full(60, 25.0), None), None, None, OPEN, None, "table", None
    )
    assert "line there: 25; " in text


def test_prior_beside_histories_and_a_limit_that_is_no_number_are_refused(tmp_path: Path) -> None:
    path = table(tmp_path / "still.csv", np.full(60, 25.0))
    ahead = Ahead(like=(tmp_path / "prior.json", path))
    with pytest.raises(UsageError, match="a prior stands alone"):
        trend(path, None, None, OPEN, 18.0, "table", None, ahead)
    with pytest.raises(UsageError, match="--limit: must be a number, not nan"):
        learn_prior([path], None, float("nan"), tmp_path / "prior.json")


def test_endless_row_of_a_history_is_refused_and_not_read(tmp_path: Path) -> None:
    path = tmp_path / "endless.csv"
    for head in ("", "time,value\n"):
        path.write_text(head + "1" * (32 << 20), encoding="utf-8")
        tracemalloc.start()
        try:
            with pytest.raises(UsageError, match=r"endless\.csv: has a row of 4194304 characters or more"):
                table_points(path)
            assert tracemalloc.get_traced_memory()[1] < 30e6
        finally:
            tracemalloc.stop()
