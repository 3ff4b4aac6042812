"""Readers that others bring: one that never ends, Datasette, plain connections while rows are written."""

import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import pytest

from agent.storage.database.connect import connect_reader
from agent.storage.database.files import beside
from agent.storage.read import queries
from agent.storage.tuning import WAL_BOUND
from agent.storage.write import store as store_module
from agent.storage.write.spill import spill_path
from agent.storage.write.store import Store
from agent.storage.write.writer import StoreWriter
from tests.storage.rows import HOP, START, batch, run_info, step


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "rig.db"


@pytest.mark.parametrize(("batches", "part"), [(14, 8), pytest.param(90, 1, marks=pytest.mark.soak)])
def test_reader_that_never_ends_bounds_the_log_and_costs_no_row(
    path: Path, monkeypatch: pytest.MonkeyPatch, batches: int, part: int
) -> None:
    """Part: the bound, and all that follows from it, divided by this."""
    monkeypatch.setattr(store_module, "_FRAMES_BEFORE_SPILL", store_module._FRAMES_BEFORE_SPILL // part)
    writer = StoreWriter(lambda: Store.open(path), [run_info()], period_s=0.02, most_cells=60_000)
    writer.start()
    writer.publish([batch(100)])
    assert writer.flush(30)
    reader = connect_reader(path)
    reader.execute("BEGIN")
    assert reader.execute("SELECT count(*) FROM v_estimates").fetchone() == (400,)
    largest = 0
    for i in range(1, batches):
        writer.publish([batch(1000, first=1000 * i)])
        assert writer.flush(30)
        largest = max(largest, beside(path, "-wal").stat().st_size,
                      beside(spill_path(path), "-wal").stat().st_size
                      if spill_path(path).exists() else 0)  # fmt: skip
    writer.publish([step("NORM", "UNACK")])
    assert writer.flush(30)
    assert writer.written >= 400 + (batches - 1) * 4000 + 1
    assert reader.execute("SELECT count(*) FROM v_estimates").fetchone() == (400,)
    assert largest <= WAL_BOUND // min(part, 4)
    assert spill_path(path).exists()
    reader.close()
    writer.publish([batch(6000, first=100_000)])
    assert writer.flush(30)
    writer.stop(30)
    assert not spill_path(path).exists()
    assert writer.dropped == {}
    assert len(queries.estimates(path, parameter="k1")) == 100 + (batches - 1) * 1000 + 6000
    assert len(queries.alarms(path)) == 1
    assert [e["cause"] for e in queries.events(path)][:2] == ["reader", "reader ended"]


def test_side_file_left_by_a_kill_is_taken_in_at_the_next_start(path: Path) -> None:
    with Store.open(path) as store:
        run_id = store.begin_run(run_info())
        store.write(run_id, [step("NORM", "UNACK"), batch(10)])
        other = path.with_name("other.db")
        with Store.open(other) as scratch:
            scratch.numbers, scratch.names = store.numbers, store.names
            scratch._run_rows = store._run_rows
            scratch.write(run_id, [batch(10, first=10), step("UNACK", "RTNUN", START + 5)])
    other.rename(spill_path(path))
    for _ in range(2):
        Store.open(path).close()
    assert [r["t_ns"] for r in queries.estimates(path, parameter="k1")] == [
        START + i * HOP for i in range(20)
    ]
    assert [a["state"] for a in queries.alarms(path)] == ["RTNUN"]
    assert not spill_path(path).exists()


def test_datasette_serves_the_views_while_rows_are_written(path: Path) -> None:
    with Store.open(path) as store:
        run_id = store.begin_run(run_info())
        store.write(run_id, [batch(50)])
        server = subprocess.Popen(
            [sys.executable, "-W", "ignore", "-m", "datasette", path, "-p", "0", "--host", "127.0.0.1"],
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        try:
            address = _address(server)
            for i in range(1, 4):
                store.write(run_id, [batch(50, first=50 * i)])
                url = f"{address}/rig.json?sql=select+count(*)+as+n+from+v_estimates&_shape=array"
                with urllib.request.urlopen(url, timeout=20) as answer:
                    assert answer.read() == f'[{{"n": {200 * (i + 1)}}}]'.encode()
        finally:
            server.terminate()
            server.wait(20)
            assert server.stderr is not None
            server.stderr.close()


def _address(server: "subprocess.Popen[str]") -> str:
    """Return the address that Datasette says it listens on."""
    assert server.stderr is not None
    end = time.monotonic() + 40
    while time.monotonic() < end:
        line = server.stderr.readline()
        assert line, "datasette ended"
        if "http://" in line:
            return line[line.index("http://") :].split()[0]
    raise AssertionError("datasette did not start in time")
