"""`deltak estimates`, `alarms` and `trend` on a file that the real store wrote."""

import csv
import io
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.cli.operator.alarms import ALARM_COLUMNS, alarms, statistics
from agent.cli.prognosis.trend import trend
from agent.cli.tables.queries import ESTIMATE_COLUMNS, VERDICT_COLUMNS, estimates, verdicts
from agent.cli.terminal.errors import faults_of
from agent.cli.tuning import TABLE_ROWS
from agent.errors import UsageError
from agent.records import RunInfo
from agent.storage.read import queries
from agent.storage.write.store import Store
from agent.types import AlarmTransition, EstimateBatch, Reason, Status, Verdict

START = 1_770_000_000_000_000_000
HOP_NS = 50_000_000
ROWS = 200


def rows_of(rig: str, rng: np.random.Generator, drift: float = 0.0) -> EstimateBatch:
    """200 rows of k1 and B1 every 0.05 s: the first two warming, ten in the middle unexcited; k1 drifts by 10
    s."""
    t = np.arange(ROWS) * 0.05
    sd = np.tile([0.5, 0.05], (ROWS, 1))
    value = np.column_stack([25 + drift * t, np.full(ROWS, 5.0)]) + sd * rng.standard_normal((ROWS, 2))
    status = np.full((ROWS, 2), Status.VALID, np.uint8)
    status[:2], status[100:110] = Status.WARMING, Status.UNEXCITED
    value[:2], sd[:2] = np.nan, np.nan
    held = np.where(status == Status.UNEXCITED, 25.0, np.nan)
    return EstimateBatch(
        rig, "window-ml", ("k1", "B1"), ("N/m", "N s/m"), np.array([25.0, 5.0]), None,
        np.arange(ROWS) * 50 + 249, START + np.arange(ROWS) * HOP_NS, value, sd, value - 2 * sd,
        value + 2 * sd,
        0.5 * sd, status, np.full((ROWS, 2), Reason.NONE, np.uint8), held, held * 0.1,
        np.full((ROWS, 2), 0.25),
        np.full(ROWS, 250), np.zeros(ROWS, int), np.full(ROWS, 400.0),
    )  # fmt: skip


def step(rig: str, second: int, before: Any, after: Any, cause: str) -> AlarmTransition:
    return AlarmTransition(
        rig, "level", "k1", "high", START + second * 10**9, before, after, cause,
        "k1 is 25.1 ± 0.9 N/m above nominal",
        delta=25.1, sd=0.9, limit_value=15.0, probability=0.999,
    )  # fmt: skip


@pytest.fixture
def db(tmp_path: Path, rng: np.random.Generator) -> Path:
    """Two rigs: press-7 with two alarms, one of them cleared, and press-8 whose k1 drifts."""
    path = tmp_path / "rigs.db"
    store = Store.open(path)
    try:
        for rig, drift in (("press-7", 0.0), ("press-8", 2.0)):
            run_id = store.begin_run(RunInfo(rig, "replay", START, "0.1.0", "0" * 64))
            records: list[Any] = [rows_of(rig, rng, drift)]
            if rig == "press-7":
                records += [
                    step(rig, 2, "NORM", "UNACK", "raise"),
                    step(rig, 4, "UNACK", "RTNUN", "clear"),
                    step(rig, 6, "RTNUN", "UNACK", "raise"),
                ]
                records.append(Verdict(rig, START + 10**9, "m1", 4.2, 0.6, "%", 0.97))
            store.write(run_id, records)
    finally:
        store.close()
    return path


@pytest.fixture
def said(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    def call(command: Callable[..., None], *args: Any, **named: Any) -> str:
        command(*args, **named)
        return capsys.readouterr().out

    return call


Said = Callable[..., str]


def test_estimates_json_has_the_columns_of_the_view_and_null_for_none(db: Path, said: Said) -> None:
    rows = json.loads(said(estimates, db, "press-7", None, None, None, "json"), parse_constant=pytest.fail)[
        "rows"
    ]
    assert len(rows) == 2 * ROWS
    assert set(rows[0]) == set(ESTIMATE_COLUMNS)
    assert (rows[0]["status"], rows[0]["value"], rows[0]["sd"]) == ("warming", None, None)
    assert rows[-1]["time"] == "2026-02-02T02:40:09.950000000Z"


def test_estimates_csv_equals_json_digit_for_digit(db: Path, said: Said) -> None:
    rows = json.loads(said(estimates, db, "press-8", "k1", None, None, "json"))["rows"]
    found = list(csv.DictReader(io.StringIO(said(estimates, db, "press-8", "k1", None, None, "csv"))))
    assert [row["value"] for row in found] == ["" if r["value"] is None else repr(r["value"]) for r in rows]


def test_trend_takes_what_the_constants_leave_open_for_part_of_the_level_not_of_the_slope(
    db: Path, tmp_path: Path, rng: np.random.Generator, said: Said
) -> None:
    """k1 is as it is against nominal to 0.5; that of it which the masses leave open moves with no row."""
    plain = rows_of("press-7", rng, 0.01)
    answers = []
    for name, share in (("same", 1.0), ("masses", 0.1)):
        path = tmp_path / f"{name}.db"
        with Store.open(path) as store:
            run_id = store.begin_run(RunInfo("press-7", "replay", START, "0.1.0", "0" * 64))
            store.write(run_id, [replace(plain, sd_repeat=share * plain.sd)])
        answers.append(json.loads(said(trend, path, "k1", None, (None, None), None, "json", None)))
    same, masses = answers
    assert masses["slope_per_day"] == pytest.approx(same["slope_per_day"], rel=0.05)
    assert (
        masses["slope_sd"] <= 1.3 * same["slope_sd"]
    )  # a little wider: the rows scatter by more than they state
    assert masses["sd"] > 0.95 * np.sqrt(0.5**2 - 0.05**2)
    assert same["sd"] < 0.5


def test_statistics_of_a_replay_without_alarms_are_of_its_rows_though_it_ran_later(tmp_path: Path) -> None:
    path = tmp_path / "replayed.db"
    info = RunInfo("press-7", "replay", 2 * START, "0.1.0", "ab" * 32)
    with Store.open(path) as store:
        store.write(store.begin_run(info), [rows_of("press-7", np.random.default_rng(1))])
    found = statistics(path, None, None)["stats"]
    assert (found["announced"], found["since"]) == (0, found["until"])


def test_verdicts_say_what_is_off_by_how_much_and_how_surely(db: Path, said: Said) -> None:
    (row,) = json.loads(said(verdicts, db, "press-7", "json"))["verdicts"]
    assert (row["hypothesis"], row["size"], row["sd"], row["unit"], row["probability"]) == (
        "m1",
        4.2,
        0.6,
        "%",
        0.97,
    )
    (same,) = csv.DictReader(io.StringIO(said(verdicts, db, None, "csv")))
    assert tuple(same) == VERDICT_COLUMNS == tuple(row)
    table = said(verdicts, db, None, "table")
    assert "m1" in table
    assert "4.2 ± 0.6" in table
    assert said(verdicts, db, "press-8", "table") == "no verdicts\n"


@pytest.mark.parametrize(
    ("since", "until", "count"),
    [
        ("1s", None, 21),  # both ends belong to the answer
        ("2026-02-02T02:40:09.950000000Z", None, 1),
        (None, "2026-02-02T02:40:00Z", 1),
        ("2026-02-02T03:40:00+01:00", "9.9s", 2),
        ("1d", "2026-02-02 02:40:01", 21),
    ],
)
def test_estimates_since_and_until_bound_the_rows(
    db: Path, said: Said, since: str | None, until: str | None, count: int
) -> None:
    rows = json.loads(said(estimates, db, "press-7", "k1", since, until, "json"))["rows"]
    assert len(rows) == count


def test_estimates_table_shows_the_newest_and_says_so(db: Path, capsys: pytest.CaptureFixture[str]) -> None:
    estimates(db, None, None, None, None, "table")
    out, err = capsys.readouterr()
    assert out.count("press-") == TABLE_ROWS
    assert f"the newest {TABLE_ROWS} rows; --csv" in err
    assert "2026-02-02 02:40:09.950Z" in out


def test_estimates_table_tells_what_is_held(db: Path, said: Said) -> None:
    assert "unexcited, held 25 since 2.5 s" in said(estimates, db, "press-7", "k1", "4.9s", "4.9s", "table")


def test_alarms_lists_activations_and_active_only_what_stands(db: Path, said: Said) -> None:
    every = json.loads(said(alarms, db, None, "json", active=False))["alarms"]
    standing = json.loads(said(alarms, db, "press-7", "json", active=True))["alarms"]
    assert set(every[0]) == set(ALARM_COLUMNS)
    assert [alarm["state"] for alarm in every] == ["RTNUN", "UNACK"]
    assert [alarm["raised_at"] for alarm in standing] == ["2026-02-02T02:40:06.000000000Z"]
    assert every[0]["cleared_at"] == "2026-02-02T02:40:04.000000000Z"


def test_alarms_active_shows_of_a_parameter_the_newest_that_stands(
    db: Path, said: Said, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As after two replays of one rig, each of which ended with the alarm standing."""
    same = dict.fromkeys(ALARM_COLUMNS) | {"rig": "r", "kind": "level", "parameter": "k2"}
    standing = [same | {"id": i, "run_id": run} for i, run in ((2, 1), (3, 2), (7, 3))]
    runs = [{"run_id": run, "kind": kind} for run, kind in ((1, "live"), (2, "replay"), (3, "replay"))]
    monkeypatch.setattr("agent.storage.read.queries.alarms", lambda *_: queries.Rows(standing))
    monkeypatch.setattr("agent.storage.read.queries.runs", lambda *_: runs)
    # that of the live machine is not hidden by what recordings of it ended with
    assert [a["id"] for a in json.loads(said(alarms, db, None, "json", active=True))["alarms"]] == [2, 7]


def test_alarms_table_and_csv_carry_the_message(db: Path, said: Said) -> None:
    assert "k1 is 25.1 ± 0.9 N/m above nominal" in said(alarms, db, None, "table", active=False)
    assert said(alarms, db, None, "csv", active=False).splitlines()[0] == ",".join(ALARM_COLUMNS)
    assert said(alarms, db, "press-8", "table", active=False) == "no alarms\n"


def test_trend_json_has_every_key_and_finds_the_drift(db: Path, said: Said) -> None:
    found = json.loads(said(trend, db, "k1", "press-8", (None, None), 50.0, "json", None))
    assert {
        "rig", "parameter", "unit", "n", "since", "until", "value", "sd", "slope_per_day", "slope_sd",
        "slope_lower",
        "slope_upper", "trend", "words", "curvature_per_day2", "changes", "limit", "forecast", "points",
    } <= set(found)  # fmt: skip
    assert (found["n"], found["unit"], found["limit"]) == (ROWS - 12, "N/m", 50.0)
    ahead = found["forecast"]
    ahead_keys = {
        "status",
        "p10_s",
        "p50_s",
        "p90_s",
        "p10_at",
        "p50_at",
        "p90_at",
        "chance",
        "family",
        "record",
    }
    assert ahead_keys <= set(ahead)
    assert ahead["status"] == "ok"
    assert ahead["p10_s"] < 2.5 < ahead["p90_s"]  # 2 N/m a second, 5 N/m away
    assert len(found["points"]) == ROWS - 12
    assert found["slope_lower"] < 2.0 * 86400 < found["slope_upper"]
    assert found["trend"] is True
    assert found["value"] == pytest.approx(45.0, abs=4 * found["sd"])
    assert found["n_disjoint"] < found["n"] / 4  # windows of 0.25 s every 0.05 s


def test_trend_limit_that_was_crossed_is_said_to_be(db: Path, said: Said) -> None:
    points = json.loads(said(trend, db, "k1", "press-8", (None, None), None, "json", None))["points"]
    first = points[0][1]
    newest = points[-1][1]
    between, past = 0.5 * (newest + first), newest + 2 * (newest - first)
    assert ": crossed, " in said(trend, db, "k1", "press-8", (None, None), between, "table", None)
    assert "N/m away" in said(trend, db, "k1", "press-8", (None, None), past, "table", None)
    with pytest.raises(UsageError, match="must be a number, not nan; give a value of the parameter"):
        said(trend, db, "k1", "press-8", (None, None), float("nan"), "table", None)


def test_trend_sentences_say_whether_there_is_one(db: Path, said: Said) -> None:
    drifting = said(trend, db, "k1", "press-8", (None, None), 50.0, "table", None)
    steady = said(trend, db, "B1", "press-7", (None, None), None, "table", None)
    assert "a trend" in drifting
    assert "limit 50 N/m" in drifting
    assert "no trend: the interval holds 0" in steady


def test_trend_of_no_rows_is_no_error(db: Path, said: Said) -> None:
    times = ("2020-01-01", "2020-01-02")
    found = json.loads(said(trend, db, "k1", "press-8", times, None, "json", None))
    assert (found["n"], found["value"], found["trend"], found["points"]) == (0, None, False, [])
    assert "no valid rows" in said(trend, db, "k1", "press-8", times, None, "table", None)


@pytest.mark.parametrize("limit", [None, 5.0])
def test_database_without_any_row_knows_no_parameter_to_be_wrong(
    limit: float | None, tmp_path: Path, said: Said
) -> None:
    db = tmp_path / "new.db"
    store = Store.open(db)
    store.begin_run(RunInfo("press-9", "live", START, "0.1.0", "0" * 64))
    store.close()
    found = json.loads(said(trend, db, "k1", None, (None, None), limit, "json", None))
    assert (found["n"], found["rig"], found["parameter"]) == (0, "press-9", "k1")
    assert "no valid rows" in said(trend, db, "k1", None, (None, None), limit, "table", None)
    assert json.loads(said(estimates, db, None, "k1", None, None, "json"))["rows"] == []


def test_trend_of_few_rows_says_too_few(db: Path, said: Said) -> None:
    assert "too few rows" in said(trend, db, "k1", "press-8", ("0.1s", None), None, "table", None)


def test_trend_csv_gives_the_points(db: Path, said: Said) -> None:
    found = list(
        csv.DictReader(io.StringIO(said(trend, db, "k1", "press-8", (None, None), None, "csv", None)))
    )
    assert len(found) == ROWS - 12
    assert list(found[0]) == ["t_ns", "time", "value", "sd"]


@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
def test_trend_plot_writes_a_picture(db: Path, said: Said, tmp_path: Path, ending: str) -> None:
    said(trend, db, "k1", "press-8", (None, None), 50.0, "json", tmp_path / f"k1.{ending}")
    assert (tmp_path / f"k1.{ending}").stat().st_size > 3000


def test_estimates_of_a_time_without_rows_say_so(db: Path, said: Said) -> None:
    assert said(estimates, db, None, None, "2099-01-01", None, "table") == "no rows\n"


@pytest.mark.parametrize(
    ("command", "code", "words"),
    [
        (lambda db: estimates(db, "press-9", None, None, None, "json"), 2, "press-7, press-8"),
        (lambda db: estimates(db, None, "k9", None, None, "json"), 2, "k1, B1"),
        (lambda db: estimates(db, None, None, "soon", None, "json"), 2, '"soon" is no time'),
        (lambda db: estimates(db, None, None, "2026-02-30", None, "json"), 2, "is no time"),
        (lambda db: alarms(db, "press-9", "json", active=False), 2, "press-7, press-8"),
        (lambda db: trend(db, "k9", "press-7", (None, None), None, "json", None), 2, "k1, B1"),
        (lambda db: trend(db, "k1", None, (None, None), None, "json", None), 2, "press-7, press-8"),
        (lambda db: trend(db, "k1", "press-7", (None, None), None, "json", db / "no.png"), 2, "cannot write"),
        (
            lambda db: trend(db, "k1", "press-7", (None, None), None, "json", db.with_name("k.txt")),
            2,
            "cannot write",
        ),
        (lambda db: estimates(db.with_name("none.db"), None, None, None, None, "json"), 3, "none.db"),
        (lambda _: alarms(Path(__file__), None, "json", active=False), 3, "test_queries.py"),
    ],
)
def test_queries_that_cannot_be_answered_say_why(
    db: Path, capsys: pytest.CaptureFixture[str], command: Callable[[Path], None], code: int, words: str
) -> None:
    before = db.read_bytes()
    with pytest.raises(Exception) as caught:  # noqa: PT011 its kind is what faults_of tells
        command(db)
    faults, found = faults_of(caught.value)
    assert (found, capsys.readouterr().out) == (code, "")
    assert words in str(faults[0])
    assert db.read_bytes() == before
    assert not db.with_name("none.db").exists()
