import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agent.storage.read import queries
from agent.storage.write import rollups
from agent.storage.write.retention import Retention, bytes_per_rig_year
from agent.storage.write.rollups import grouped
from agent.storage.write.store import Store
from agent.types import EstimateBatch, Reason, Status
from agent.units import MINUTE_S
from tests.storage.rows import START, batch, ledger, run_info, select, warming

SECOND = 10**9
FOR_EVER = float("inf")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "rig.db"


def fill(
    path: Path, batches: Sequence[EstimateBatch], keep: Retention, kind: str = "live", finish: bool = True
) -> None:
    with Store.open(path, keep) as store:
        run_id = store.begin_run(run_info(kind=kind))
        for one in batches:
            store.write(run_id, [one])
            store.maintain()
        store.maintain(finish=finish)


def spaced(seconds: int, every: int, chunk: int = 600, **changes: object) -> list[EstimateBatch]:
    """Rows every so many seconds, in chunks."""
    hops = seconds // every
    sizes = range(0, hops, chunk)
    return [batch(min(chunk, hops - i), first=i, hop_ns=every * SECOND, **changes) for i in sizes]


def test_minute_is_the_information_weighted_mean_of_its_valid_rows(path: Path) -> None:
    one = batch(60, hop_ns=SECOND)
    one = replace(one, sd_repeat=one.sd)
    one.status[10:20, 0] = Status.UNEXCITED
    one.reason[10:20, 0] = Reason.STANDSTILL
    fill(path, [one], Retention())
    rows = select(path, "SELECT * FROM v_tiers WHERE span_s = 60 AND parameter = 'k1'")
    (rig, _, time, t_ns, parameter, unit, span, n, n_valid, value, sd, low, high, worst, reason, repeat) = (
        rows[0]
    )
    good = one.status[:, 0] == Status.VALID
    weight = 1 / one.sd[good, 0] ** 2
    assert (rig, time, t_ns, parameter, unit, span) == (
        "press-7", "2026-01-01T00:00:00.000000000Z", START, "k1", "N/m", 60,
    )  # fmt: skip
    assert (n, n_valid, worst, reason) == (60, 50, "unexcited", "standstill")
    assert value == pytest.approx(np.average(one.value[good, 0], weights=weight), rel=1e-14)
    assert sd == pytest.approx(1 / np.sqrt(weight.sum()), rel=1e-12)
    assert repeat == pytest.approx(sd, rel=1e-12)
    assert (low, high) == (one.value[good, 0].min(), one.value[good, 0].max())


def test_hour_from_minutes_is_the_hour_from_rows(path: Path) -> None:
    batches = [replace(b, sd_repeat=b.sd) for b in spaced(3600, 1)]
    fill(path, batches, Retention())
    (row,) = select(
        path, "SELECT value, sd, n, n_valid, low, high FROM v_tiers WHERE span_s = 3600 AND parameter = 'k2'"
    )
    value, sd = (np.concatenate([getattr(b, name)[:, 1] for b in batches]) for name in ("value", "sd"))
    assert row[0] == pytest.approx(np.average(value, weights=sd**-2.0), rel=1e-13)
    assert row[1] == pytest.approx(1 / np.sqrt(np.sum(sd**-2.0)), rel=1e-12)
    assert row[2:] == (3600, 3600, value.min(), value.max())


def test_minute_of_overlapping_windows_claims_no_more_than_independent_ones() -> None:
    def claim(step_s: float) -> float:
        n = round(60 / step_s)
        t_ns = (np.arange(n) * step_s * 1e9).astype(np.int64)
        plain = [np.full(n, c) for c in (1, 256, 25.0, 0.1, 0.25, 250, 0, 0.1, 1, 1, 25.0, 25.0, 256)]
        found = grouped([t_ns, *plain], MINUTE_S, 0, 0)
        assert found is not None
        return float(found.sd[0])

    assert claim(0.05) == pytest.approx(claim(0.25), rel=0.01)
    assert claim(1.0) == pytest.approx(0.1 / np.sqrt(60))
    assert claim(0.25) == pytest.approx(0.1 / np.sqrt(240))


@pytest.mark.parametrize("chunk", [60, 97])
def test_aggregates_do_not_depend_on_when_rows_were_written(path: Path, chunk: int) -> None:
    """Windows of 250 s, a row every 10 s: each row but the run's first says little that is new."""
    (rows,) = spaced(5400, 10)
    rows = replace(rows, window_s=np.full_like(rows.sd, 250.0))
    pieces = [rows.part(slice(i, i + chunk)) for i in range(0, len(rows), chunk)]
    fill(path, [rows], Retention())
    fill(path.with_name("pieces.db"), pieces, Retention())
    query = "SELECT t_ns, span_s, parameter, value, sd FROM v_tiers WHERE span_s > 0 ORDER BY 1, 2, 3"
    whole = select(path, query)
    assert len(whole) == 4 * (90 + 2)
    assert select(path.with_name("pieces.db"), query) == whole


def test_minutes_of_rows_at_hand_are_those_of_rows_read_back(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first rows are warming, some windows have no length, and some rows come late."""
    (rows,) = spaced(5400, 10)
    rows.window_s[100:200] = np.nan
    others = [rows.part(slice(*ends)) for ends in ((60, 250), (253, 500), (250, 253), (500, 540))]
    pieces = [warming(60, hop_ns=10 * SECOND), *others]
    fill(path, pieces, Retention())
    monkeypatch.setattr(rollups, "MOST_RECENT", 0)
    fill(path.with_name("read.db"), pieces, Retention())
    query = "SELECT * FROM v_tiers WHERE span_s > 0 ORDER BY t_ns, span_s, parameter"
    at_hand = select(path, query)
    assert len(at_hand) == 4 * (90 + 2)
    assert select(path.with_name("read.db"), query) == at_hand


def test_minutes_do_not_need_rows_at_hand(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run is read back from where more of its rows wait than may."""
    (rows,) = spaced(1800, 10)
    pieces = [rows.part(slice(i, i + 30)) for i in range(0, 180, 30)]
    fill(path, pieces, Retention())
    monkeypatch.setattr(rollups, "MOST_RECENT", 130)
    fill(path.with_name("many.db"), pieces, Retention())
    query = "SELECT * FROM v_tiers WHERE span_s > 0 ORDER BY t_ns, span_s, parameter"
    assert select(path.with_name("many.db"), query) == select(path, query)


def test_what_the_constants_leave_open_is_not_averaged_away(path: Path) -> None:
    """3/5 of the sd is of this window alone; the other share is of the masses, the same in every window."""
    batches = [
        replace(b, sd=np.full_like(b.sd, 0.5), sd_repeat=np.full_like(b.sd, 0.3)) for b in spaced(3600, 1)
    ]
    fill(path, batches, Retention())
    shown = select(
        path, "SELECT span_s, sd_repeat, sd FROM v_tiers WHERE parameter = 'k1' ORDER BY span_s DESC, t_ns"
    )
    expected = {span: 0.3 / np.sqrt(span) for span in (60, 3600)}
    assert len(shown) == 61
    for span, repeat, sd in shown:
        assert repeat == pytest.approx(expected[span], rel=5e-3)
        assert sd == pytest.approx(np.hypot(0.4, expected[span]), rel=1e-3)


def test_minute_without_a_valid_row_has_no_number(path: Path) -> None:
    one = batch(60, hop_ns=SECOND)
    one.status[:] = Status.INVALID
    one.reason[:] = Reason.SENSOR
    fill(path, [one], Retention())
    rows = select(
        path, "SELECT value, sd, low, n_valid, worst_status, worst_reason FROM v_tiers WHERE span_s = 60"
    )
    assert rows == [(None, None, None, 0, "invalid", "sensor")] * 4


def test_minute_of_noise_free_rows_has_a_mean(path: Path) -> None:
    one = batch(60, hop_ns=SECOND, sd=np.zeros((60, 4)))
    fill(path, [one], Retention())
    got = select(path, "SELECT value FROM v_tiers WHERE span_s = 60 AND parameter = 'k1'")[0][0]
    assert got == pytest.approx(one.value[:, 0].mean())


def test_views_show_each_period_once_from_the_finest_rows_left(path: Path) -> None:
    fill(path, spaced(36 * 3600, 10), Retention(full_s=4 * 3600, minute_s=12 * 3600))
    rows = queries.estimates(path, parameter="k1")
    spans = [r["span_s"] for r in rows]
    assert spans == sorted(spans, reverse=True)
    ends = [(r["t_ns"], r["t_ns"] + (r["span_s"] or 10) * SECOND) for r in rows]
    assert all(a[1] == b[0] for a, b in itertools.pairwise(ends))
    assert [ends[0][0], ends[-1][1]] == [START, START + 36 * 3600 * SECOND]
    full, minutes = (sum(1 for s in spans if s == span) for span in (0, 60))
    assert 4 * 360 <= full <= 5 * 360
    assert 7 * 60 <= minutes <= 9 * 60
    assert select(path, "SELECT count(*) FROM estimates WHERE seq >> 10 NOT IN (SELECT seq FROM hops)") == [
        (0,)
    ]
    assert select(path, "SELECT count(*) FROM spreads WHERE seq NOT IN (SELECT seq FROM estimates)") == [(0,)]


def test_run_cut_short_is_aggregated_by_the_next_start(path: Path) -> None:
    fill(path, spaced(1000, 1), Retention(), finish=False)
    assert select(path, "SELECT count(*), max(t_ns) FROM v_tiers WHERE span_s = 60 AND parameter = 'k1'") == [
        (16, START + 15 * 60 * SECOND)
    ]
    with Store.open(path) as store:
        store.maintain()
    assert select(path, "SELECT count(*) FROM v_tiers WHERE span_s = 60 AND parameter = 'k1'") == [(17,)]
    assert select(path, "SELECT n FROM v_tiers WHERE span_s = 3600 AND parameter = 'k1'") == [(1000,)]
    with Store.open(path) as store:
        store.maintain()
    assert select(path, "SELECT count(*) FROM v_tiers") == [(4 * 18,)]


def test_pause_of_a_year_costs_nothing(path: Path) -> None:
    late = batch(100, first=10_000, hop_ns=SECOND, start=START + 365 * 86_400 * SECOND)
    fill(path, [batch(100, hop_ns=SECOND), late], Retention(FOR_EVER, FOR_EVER))
    assert select(path, "SELECT n FROM v_tiers WHERE span_s = 60 AND parameter = 'k1' ORDER BY t_ns") == [
        (60,), (40,), (20,), (60,), (20,),
    ]  # fmt: skip


def test_purge_keeps_what_was_not_sent_unless_the_file_grows_too_large(path: Path) -> None:
    keep = Retention(full_s=3600.0)
    with Store.open(path, keep) as store:
        store.connection.execute(
            "INSERT INTO consumers (name, last_seq) VALUES ('mqtt', ?)", (100 << 10 | 3,)
        )
        run_id = store.begin_run(run_info())
        for one in spaced(6 * 3600, 10):
            store.write(run_id, [one])
            store.maintain()
        low = store.connection.execute("SELECT min(seq) FROM hops WHERE span = 0").fetchone()[0]
        assert low == 101
        assert sum(1 for r in queries.estimates(path, parameter="k1") if r["span_s"] == 0) == 6 * 360 - 100
    with Store.open(path, Retention(max_bytes=400e3)) as store:
        store.maintain()
        assert store._tiers.used_bytes() <= 380e3
        unsent = store.connection.execute(
            "SELECT count FROM counters WHERE name = 'purged unsent'"
        ).fetchone()[0]
        assert unsent > 0


def test_size_of_the_file_is_bounded(path: Path) -> None:
    fill(path, spaced(30 * 3600, 3), Retention(full_s=FOR_EVER, minute_s=FOR_EVER, max_bytes=1e6))
    # a file without rows is 1 kB a table and index; rows are purged by the hour, and each is a large share of
    # so little
    assert path.stat().st_size <= 1.12e6
    rows = queries.estimates(path, parameter="k1")
    assert rows[-1]["t_ns"] == START + (30 * 3600 - 3) * SECOND
    assert rows[-1]["span_s"] == 0


def test_health_rows_are_thinned_to_the_last_of_each_hour(path: Path) -> None:
    with Store.open(path, Retention(full_s=3600.0)) as store:
        run_id = store.begin_run(run_info())
        for minute in range(0, 6 * 60, 5):
            t_ns = START + minute * 60 * SECOND
            store.write(run_id, [batch(1, start=t_ns), ledger(t_ns)])
            store.maintain()
    kept = [(t - START) // (60 * SECOND) for (t,) in select(path, "SELECT t_ns FROM v_health")]
    assert kept[:4] == [55, 115, 175, 235]
    assert kept[-12:] == list(range(300, 360, 5))


def test_replay_is_not_purged_by_a_later_live_run(path: Path) -> None:
    keep = Retention(full_s=3600.0)
    fill(path, spaced(1800, 10, start=START), keep, kind="replay")
    fill(path, spaced(4 * 3600, 10, start=START + 86_400 * 10 * SECOND), keep)
    fill(path, spaced(600, 10, start=START + 86_400 * 20 * SECOND), keep)
    spans = select(path, "SELECT r.kind, e.span_s, count(*) FROM v_estimates e JOIN v_runs r USING (run_id) "
                         "WHERE parameter = 'k1' GROUP BY e.run_id, e.span_s "
                         "ORDER BY e.run_id, e.span_s")  # fmt: skip
    assert spans == [("replay", 0, 180), ("live", 0, 360), ("live", 60, 180), ("live", 0, 60)]


@pytest.mark.parametrize(("parameters", "every"), [(4, 2), (1, 5), (9, 20)])
def test_bytes_per_rig_year_is_what_a_file_takes(path: Path, parameters: int, every: int) -> None:
    """A year scaled down: the tiers' lengths in the same proportion to one another as the rows of each."""
    names = tuple(f"p{i}" for i in range(parameters))
    keep = Retention(full_s=6 * 3600, minute_s=20 * 3600)
    fill(path, spaced(40 * 3600, every, 1800, parameters=names), keep)
    rows = dict(select(path, "SELECT span, count(*) FROM hops GROUP BY span"))
    scaled = Retention(rows[0] * every, rows[60] * 60, rows[3600] * 3600)
    predicted = bytes_per_rig_year(parameters, every, 0.05, scaled, sources=0)
    with Store.open(path) as store:
        used = store._tiers.used_bytes() - 60_000  # an empty file
    assert predicted == pytest.approx(used, rel=0.12)


def test_rig_year_at_defaults_is_within_200_mb() -> None:
    assert bytes_per_rig_year(4, 1.0, 0.05, Retention()) < 200e6
