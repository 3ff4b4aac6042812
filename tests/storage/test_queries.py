from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.errors import UsageError
from agent.storage.read import queries
from agent.storage.read.instants import newest_instants, oldest_instants
from agent.storage.read.points import points_of
from agent.storage.read.selection import reading, stretches_of
from agent.storage.read.times import age_ns, parse_time
from agent.storage.write.retention import Retention
from agent.storage.write.store import Store
from agent.text import iso_time
from tests.storage.rows import HOP, START, batch, ledger, run_info, step, warming


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Two rigs: press-7 with 5 warming and 95 valid hops, press-8 with 10 hops a day earlier."""
    path = tmp_path / "rig.db"
    with Store.open(path) as store:
        one = store.begin_run(run_info())
        store.write(one, [warming(5), batch(95, first=5), step("NORM", "UNACK"), ledger()])
        two = store.begin_run(run_info("press-8"))
        store.write(two, [batch(10, rig="press-8", start=START - 86_400 * 10**9, parameters=("k1", "c9"))])
    return path


@pytest.mark.parametrize(
    ("text", "t_ns"),
    [
        ("1970-01-01T00:00:00Z", 0),
        ("1970-01-01", 0),
        ("1970-01-01T00:00:01.000000001Z", 1_000_000_001),
        ("1970-01-01 01:00+01:00", 0),
        ("1970-01-01T00:00:00.5", 500_000_000),
        ("2026-01-01T00:00:00.000000000Z", START),
        ("30d", START - 30 * 86_400 * 10**9),
        ("12h", START - 12 * 3600 * 10**9),
        ("1.5 h", START - 5400 * 10**9),
        ("250ms", START - 250_000_000),
    ],
)
def test_parse_time_reads_iso_and_ages(text: str, t_ns: int) -> None:
    assert parse_time(text, START) == t_ns


@pytest.mark.parametrize(
    "text", ["", "yesterday", "30x", "-3d", "2026-13-01", "2026-01-01T25:00", "12", "1e3s", "nan"]
)
def test_parse_time_of_nonsense_says_what_to_write(text: str) -> None:
    with pytest.raises(UsageError, match="is no time") as caught:
        parse_time(text, START)
    assert caught.value.exit_code == 2


def test_iso_is_the_inverse_of_parse_time() -> None:
    for t_ns in (0, -1, START + 123_456_789, 9_223_372_036_854_775_807):
        assert parse_time(iso_time(t_ns), None) == t_ns
    assert age_ns("2w") == 14 * 86_400 * 10**9


def test_estimates_can_be_narrowed(path: Path) -> None:
    assert len(queries.estimates(path)) == 420
    assert {r["rig"] for r in queries.estimates(path, rig="press-8")} == {"press-8"}
    assert len(queries.estimates(path, rig="press-7", parameter="B1")) == 100
    assert len(queries.estimates(path, parameter="c9")) == 10
    ages = queries.estimates(path, rig="press-7", parameter="k1", since="1s")
    assert [r["t_ns"] for r in ages] == [START + i * HOP for i in range(79, 100)]
    both = queries.estimates(path, "press-7", "k1", iso_time(START + 3 * HOP), iso_time(START + 4 * HOP))
    assert [r["t_ns"] for r in both] == [START + 3 * HOP, START + 4 * HOP]


def test_estimates_by_age_count_back_from_each_rigs_newest_row(path: Path) -> None:
    rows = queries.estimates(path, parameter="k1", since="0.2s")
    assert [r["rig"] for r in rows] == ["press-8"] * 5 + ["press-7"] * 5


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"rig": "press-9"}, 'no rig "press-9"; rigs are press-7, press-8'),
        ({"rig": "press-8", "parameter": "B1"}, 'no parameter "B1"; parameters are k1, c9'),
        ({"parameter": "k9"}, 'no parameter "k9"; parameters are k1, k2, B1, B2, c9'),
        ({"since": "1h", "until": "2h"}, "later than"),
        ({"since": "soon"}, "--since: .*is no time"),
        ({"until": "soon"}, "--until: .*is no time"),
    ],
)
def test_estimates_of_what_is_not_there_says_what_is(
    path: Path, arguments: dict[str, str], words: str
) -> None:
    with pytest.raises(UsageError, match=words):
        queries.estimates(path, **arguments)


def test_estimates_until_long_before_the_first_row_are_none(path: Path) -> None:
    assert list(queries.estimates(path, until="99999999d")) == []
    assert list(queries.estimates(path, since="9999-12-31")) == []


def test_points_are_the_valid_rows_as_arrays(path: Path) -> None:
    got = points_of(path, "press-7", "k1")
    sent = batch(95, first=5)
    assert np.array_equal(got.t_ns, sent.t_ns)
    assert np.array_equal(got.value, sent.value[:, 0])
    assert np.array_equal(got.sd, sent.sd[:, 0])
    assert (got.unit, got.reference, got.rig) == ("N/m", 25.0, "press-7")
    assert (got.since_ns, got.until_ns) == (None, None)
    assert len(points_of(path, "press-7", "k1", since="1s").t_ns) == 21


def test_points_need_a_rig_where_there_are_several(path: Path) -> None:
    with pytest.raises(UsageError, match="several rigs; name one of press-7, press-8"):
        points_of(path, None, "k1")
    with pytest.raises(UsageError, match="no parameter"):
        points_of(path, "press-7", "nothing")


def test_points_outside_of_what_there_is_are_none(path: Path) -> None:
    got = points_of(path, "press-7", "k1", until="2020-01-01")
    assert (len(got.t_ns), got.value.dtype, got.t_ns.dtype) == (0, np.dtype("float64"), np.dtype("int64"))


def test_lists_name_what_there_is(path: Path) -> None:
    assert queries.rigs(path) == ["press-7", "press-8"]
    assert queries.parameters(path) == ["k1", "k2", "B1", "B2", "c9"]
    assert queries.parameters(path, "press-8") == ["k1", "c9"]
    assert [r["rig"] for r in queries.runs(path)] == ["press-7", "press-8"]
    assert queries.runs(path)[0]["started_at"] == "2026-01-01T00:00:00.000000000Z"
    assert queries.health(path)[0]["reasons"]["rejected"] == {"crc": 3, "duplicate": 2}
    assert [a["parameter"] for a in queries.alarms(path, rig="press-7", active=True)] == ["k1"]
    assert queries.alarms(path, rig="press-8") == []


@pytest.fixture(scope="module")
def ages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two rigs that ran at once, one of them twice; hours and minutes of what is older than a few minutes."""
    path = tmp_path_factory.mktemp("ages") / "ages.db"
    second = 10**9
    with Store.open(path, Retention(600, 3600, float("inf"))) as store:
        for rig, start, every in (("press-7", 0, 1), ("press-8", 3000, 7), ("press-7", 9000, 1)):
            run = store.begin_run(run_info(rig))
            for first in range(0, 7200 // every, 600):
                at = START + start * second
                store.write(run, [batch(600, rig=rig, first=first, start=at, hop_ns=every * second)])
        store.maintain(finish=True)
    return path


@pytest.mark.parametrize(
    ("rig", "parameter", "since"),
    [(None, None, None), (None, "k2", "2h"), ("press-8", None, None), ("press-7", "B1", "1d")],
)
@pytest.mark.parametrize("instants", [1, 7, 100, 10**6])
def test_estimates_in_pieces_are_those_of_one_answer(
    ages: Path, rig: str | None, parameter: str | None, since: str | None, instants: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(queries, "INSTANTS_READ", max(instants, 40))
    whole = queries.estimates(ages, rig, parameter, since)
    assert len({row["span_s"] for row in whole}) > 1
    assert list(queries.each_estimate(ages, rig, parameter, since, None)) == whole
    assert queries.newest_estimates(ages, rig, parameter, since, None, instants) == whole[-instants:]


def test_newest_estimates_and_those_one_by_one_read_little_at_a_time(
    ages: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(queries, "INSTANTS_READ", 50)
    read: list[int] = []
    plain = queries.view_rows

    def counted(*arguments: Any, **named: Any) -> queries.Rows:
        rows = plain(*arguments, **named)
        read.append(len(rows))
        return rows

    monkeypatch.setattr(queries, "view_rows", counted)
    assert len(queries.newest_estimates(ages, None, None, None, None, 40)) == 40
    assert sum(read) <= 2 * 40 * 4  # of each rig 40 instants of four parameters
    assert len(list(queries.each_estimate(ages, None, None, None, None))) > 4000
    assert max(read) <= 3 * 50 * 4  # of each tier so many instants


@pytest.mark.parametrize("cut", [newest_instants, oldest_instants])
def test_pieces_of_stretches_leave_nothing_out_and_have_nothing_twice(ages: Path, cut: Any) -> None:
    with reading(ages) as connection:
        asked = {rig: stretches_of(connection, rig, None, None)[0] for rig in ("press-7", "press-8")}
        one, other = cut(connection, asked, 50)
    assert any(one.values())
    assert any(other.values())
    for rig, stretches in asked.items():
        for whole in stretches:
            pieces = sorted(s for s in (*one[rig], *other[rig]) if s.part == whole.part)
            assert (pieces[0].first, pieces[-1].last) == (whole.first, whole.last)
            assert all(before.last + 1 == after.first for before, after in pairwise(pieces))


def test_estimates_one_by_one_refuse_an_unknown_parameter_before_the_first(ages: Path) -> None:
    with pytest.raises(UsageError, match="k9"):
        next(queries.each_estimate(ages, None, "k9", None, None))
