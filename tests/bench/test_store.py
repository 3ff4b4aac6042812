"""Measured figures of the store (make bench); each prints what it found beside what it must reach."""

import os
import sqlite3
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from agent.cli.prognosis import trend as commands_trend
from agent.storage.read.points import points_of
from agent.storage.tables.rows import Plan
from agent.storage.write.retention import Retention
from agent.storage.write.rollups import Groups, add_groups
from agent.storage.write.store import Store
from agent.units import HOUR_S, MINUTE_S
from tests import peers
from tests.figures import figure
from tests.storage.powercut.disk import read_log
from tests.storage.rows import START, batch, run_info

SECOND = 10**9
DAY = 86_400


def say(text: str) -> None:
    sys.stdout.write(f"\n{text}\n")
    figure(text)


def best_ms(act: Callable[[], object], tries: int = 5) -> float:
    """Return the shortest time that something took, ms."""
    took = []
    for _ in range(tries):
        begin = time.perf_counter()
        act()
        took.append(time.perf_counter() - begin)
    return 1e3 * min(took)


@pytest.mark.bench
def test_rate_of_estimates_with_full_sync_in_batches(tmp_path: Path) -> None:
    parts = [batch(6000, first=6000 * i) for i in range(40)]
    with Store.open(tmp_path / "rig.db") as store:
        run_id = store.begin_run(run_info())
        begin = time.perf_counter()
        for part in parts:
            store.write(run_id, [part])
        rate = 4 * 6000 * 40 / (time.perf_counter() - begin)
    say(f"store: {rate:,.0f} estimate rows a second with synchronous=FULL (at least 100,000)")
    assert rate >= 100_000


def year(path: Path) -> None:
    """Write a rig-year as the defaults leave it: 7 days of rows, 90 days of minutes, a year of hours."""
    with Store.open(path, Retention()) as store:
        run_id = store.begin_run(run_info())
        series = [
            store.names.series((run_id, p, "N/m", "window-ml", 25.0, None)) for p in ("k1", "k2", "B1", "B2")
        ]
        for span, days in ((HOUR_S, 365), (MINUTE_S, 90)):
            for first in range(0, days * DAY, 10 * DAY):
                length = min(10 * DAY, days * DAY - first)
                plan = Plan()
                add_groups(plan, groups(first + (365 - days) * DAY, length, span, series), run_id, span,
                           store.names, store.numbers)  # fmt: skip
                store.commit([plan])
        base = START + 358 * DAY * SECOND
        for first in range(0, 7 * DAY, 5000):
            size = min(5000, 7 * DAY - first)
            store.write(run_id, [batch(size, first=first, start=base, hop_ns=SECOND)])


def groups(first_s: int, length_s: int, span: int, series: list[int]) -> Groups:
    count = length_s // span
    period = np.repeat(START + (first_s + span * np.arange(count)) * SECOND, 4)
    n = len(period)
    value = 25.0 - 1e-8 * (period - START) / SECOND + np.random.default_rng(first_s).normal(0, 0.01, n)
    whole, small = np.full(n, span), np.full(n, 0.01)
    return Groups(period, np.tile(series, count), value, small, 0.7 * small, value - 0.1, value + 0.1, whole,
                  whole, np.full(n, 256), np.full(n, 0.25), 250 * whole,
                  np.zeros(n, dtype=np.int64))  # fmt: skip


def trend(path: Path, since: str) -> dict[str, object]:
    """Return what `deltak trend --json` prints."""
    return commands_trend.document(path, "k1", None, (since, None), None)


def flat_copy(path: Path) -> Path:
    """Write the same rows into one plain table with an index, as a script with pandas would keep them."""
    import pandas as pd

    flat = path.with_name("flat.db")
    with closing(sqlite3.connect(path)) as source, closing(sqlite3.connect(flat)) as target:
        rows = pd.read_sql_query("SELECT parameter, t_ns, value, sd, status FROM v_estimates", source)
        rows.to_sql("estimates", target, index=False)
        target.execute("CREATE INDEX by_time ON estimates (parameter, t_ns)")
        target.commit()
    return flat


def trend_by_pandas(path: Path, table: str) -> float:
    """Return the slope of a weighted line through the valid rows of a year, a day."""
    import pandas as pd

    query = f"SELECT t_ns, value, sd FROM {table} WHERE parameter = 'k1' AND status = 'valid' ORDER BY t_ns"
    with closing(sqlite3.connect(path)) as connection:
        rows = pd.read_sql_query(query, connection)
    days = (rows.t_ns - rows.t_ns.iloc[-1]) / (DAY * SECOND)
    return float(np.polyfit(days, rows.value, 1, w=1.0 / rows.sd)[0])


@pytest.mark.bench
@pytest.mark.timeout(600)
def test_rig_year_is_small_and_its_trend_quicker_than_pandas(tmp_path: Path) -> None:
    path = tmp_path / "rig.db"
    year(path)
    size = path.stat().st_size / 1e6
    flat = flat_copy(path)
    took = {s: (best_ms(partial(trend, path, s)), trend(path, s)["n"]) for s in ("1d", "30d", "365d")}
    ours = ", ".join(f"{since}: {n} points in {ms:.0f} ms" for since, (ms, n) in took.items())
    view, table = (best_ms(partial(trend_by_pandas, p, t), 2)
                   for p, t in ((path, "v_estimates"), (flat, "estimates")))  # fmt: skip
    say(f"rig-year of 4 parameters, all tiers: {size:.0f} MB (at most 210)")
    say(f"trend: {ours} (365d at most 100 ms); a line by pandas over the year's rows: "
        f"{view:.0f} ms from the view, {table:.0f} ms from one plain indexed table of "
        f"{flat.stat().st_size / 1e6:.0f} MB")  # fmt: skip
    assert size <= 210
    assert took["365d"][0] <= 100


@pytest.mark.bench
@pytest.mark.timeout(300)
def test_bytes_written_to_disk_in_a_day_at_defaults(tmp_path: Path) -> None:
    """A commit a second of one row of four parameters, a ledger row every 10 s, checkpoints and aggregates
    included."""
    compiler = peers.program("cc", "gcc")
    library = tmp_path / "oplog.so"
    source = peers.ROOT / "tests" / "storage" / "powercut" / "oplog.c"
    subprocess.run([compiler, "-O2", "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True)
    work = tmp_path / "work"
    work.mkdir()
    seconds = 1800
    environment = {
        **os.environ,
        "LD_PRELOAD": str(library),
        "DELTAK_OPLOG": str(tmp_path / "log"),
        "DELTAK_OPLOG_ROOT": str(work),
    }
    command = [
        sys.executable,
        "-m",
        "tests.storage.powercut.workload",
        str(work / "rig.db"),
        "defaults",
        str(seconds),
        "FULL",
    ]
    subprocess.run(command, env=environment, cwd=peers.ROOT, stdout=subprocess.DEVNULL, check=True)
    written = [len(o.content) for o in read_log(tmp_path / "log") if o.kind == "W"]
    daily = (sum(written) - 3 * 2**20) / seconds * DAY / 1e9
    say(f"bytes written at defaults: {daily:.2f} GB a day (at most 0.5)")
    assert daily <= 0.5


@pytest.mark.bench
@pytest.mark.timeout(600)
def test_trend_and_forecast_of_a_rig_year_are_quick(tmp_path: Path) -> None:
    """Beside the same in pandas and statsmodels: a local linear trend fitted to the year's daily means."""
    from statsmodels.tsa.statespace.structural import UnobservedComponents

    path = tmp_path / "rig.db"
    year(path)
    found = points_of(path, None, "k1")
    asked = best_ms(lambda: commands_trend.document(path, "k1", None, (None, None), None))
    ahead = best_ms(lambda: commands_trend.document(path, "k1", None, (None, None), 20.0))
    daily = found.value[:: len(found.value) // 365]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # whether the rival converges is its own affair
        rival = best_ms(lambda: UnobservedComponents(daily, "local linear trend").fit(disp=False), 1)
    say(f"rig-year: trend {asked:.0f} ms (at most 100), with forecast {ahead:.0f} ms (at most 1000); "
        f"statsmodels' local linear trend of 365 means {rival:.0f} ms")  # fmt: skip
    assert asked <= 100
    assert ahead <= 1000


def years(path: Path, count: int) -> None:
    """Write the hours of some years in which four parameters fall faster and faster."""
    hours = count * 365 * 24
    rng = np.random.default_rng(0)
    with Store.open(path, Retention()) as store:
        run_id = store.begin_run(run_info())
        series = [
            store.names.series((run_id, p, "N/m", "window-ml", 25.0, None)) for p in ("k1", "k2", "B1", "B2")
        ]
        for first in range(0, hours, 240):
            day = np.repeat(np.arange(first, min(first + 240, hours)) / 24.0, 4)
            n = len(day)
            value = 25.0 - 0.8 * day / 365 - 0.1 * (day / 365) ** 2 + 0.05 * rng.standard_normal(n)
            whole, small = np.full(n, HOUR_S), np.full(n, 0.05)
            rows = Groups(
                START + np.rint(day * 24).astype(np.int64) * HOUR_S * SECOND, np.tile(series, n // 4), value,
                small,
                0.7 * small, value - 0.1, value + 0.1, whole, whole, np.full(n, 256), np.full(n, 0.25),
                250 * whole,
                np.zeros(n, dtype=np.int64),
            )  # fmt: skip
            plan = Plan()
            add_groups(plan, rows, run_id, HOUR_S, store.names, store.numbers)
            store.commit([plan])


@pytest.mark.bench
@pytest.mark.timeout(600)
def test_fleet_of_twenty_machines_over_five_years_is_quick(tmp_path: Path) -> None:
    """Beside the same in pandas and statsmodels: a local linear trend fitted to the monthly means of each
    parameter."""
    import pandas as pd
    from statsmodels.tsa.statespace.structural import UnobservedComponents

    from agent.cli.prognosis.fleet import fleet

    path = tmp_path / "rig.db"
    years(path, 5)
    ours = best_ms(lambda: fleet([path] * 20, "90d", None, 35.0), 2)
    assert all(row["status"] == "ok" for row in fleet([path], "90d", None, 35.0)["rows"])

    def rival() -> None:
        with closing(sqlite3.connect(path)) as connection:
            query = "SELECT t_ns, value FROM v_tiers WHERE parameter = 'k1' AND span_s = 3600"
            rows = pd.read_sql_query(query, connection)
        monthly = rows.groupby(rows.t_ns // (30 * DAY * SECOND)).value.mean()
        UnobservedComponents(monthly.to_numpy(), "local linear trend").fit(disp=False).forecast(12)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # whether the rival converges is its own affair
        other = 80.0 * best_ms(rival, 1)
    say(f"fleet: 20 machines of four parameters over five years {ours / 1e3:.1f} s (at most 3); "
        f"pandas and statsmodels without a first passage {other / 1e3:.1f} s")  # fmt: skip
    assert ours <= 3000
