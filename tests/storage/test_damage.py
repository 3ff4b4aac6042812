import os
import shutil
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from agent.errors import StoreError
from agent.storage.database.files import beside
from agent.storage.database.verify import problems
from agent.storage.read import queries
from agent.storage.recovery.salvage import recover
from agent.storage.write.store import Store
from agent.storage.write.writer import StoreWriter
from tests.figures import figure
from tests.storage.rows import HOP, START, batch, ledger, run_info, select, step, warming

Rows = set[tuple[object, ...]]
Mutate = Callable[[Path, np.random.Generator], None]


def build(path: Path, *, leave_log: bool) -> None:
    """Write a small database; leave_log: part of it only in the write-ahead log, as after a power cut."""
    folder = path.parent / "work"
    folder.mkdir()
    work = folder / path.name
    store = Store.open(work)
    run_id = store.begin_run(run_info())
    for i in range(8):
        store.write(run_id, [batch(12, first=12 * i), ledger(START + i)])
    store.write(run_id, [step("NORM", "UNACK"), step("UNACK", "ACKED", by="anna")])
    store.maintain()
    store.checkpoint()
    shutil.copy(beside(work, ".lock"), beside(path, ".lock-before"))
    store.write(run_id, [batch(20, first=96)])
    for suffix in ("", "-wal", ".lock"):
        if suffix != "-wal" or leave_log:
            shutil.copy(beside(work, suffix), beside(path, suffix))
    store.close()
    if not leave_log:
        shutil.copy(work, path)
    shutil.rmtree(folder)


def content(path: Path) -> tuple[Rows, Rows]:
    """Return every estimate, and every alarm, that readers are shown."""
    rows = select(
        path, "SELECT t_ns, parameter, unit, value, sd, lower, upper, delta, status, span_s FROM v_estimates"
    )
    return set(rows), set(
        select(path, "SELECT id, parameter, priority, state, delta, acked_by FROM v_alarms")
    )


def flip_bit(path: Path, rng: np.random.Generator) -> None:
    octets = bytearray(path.read_bytes())
    place = int(rng.integers(len(octets)))
    octets[place] ^= 1 << int(rng.integers(8))
    path.write_bytes(octets)


def spoil_page(path: Path, rng: np.random.Generator) -> None:
    octets = bytearray(path.read_bytes())
    page = int(rng.integers(len(octets) // 1024)) * 1024
    octets[page : page + 1024] = rng.bytes(1024) if rng.integers(2) else bytes(1024)
    path.write_bytes(octets)


def swap_pages(path: Path, rng: np.random.Generator) -> None:
    octets = bytearray(path.read_bytes())
    one, two = (int(n) * 1024 for n in rng.choice(np.arange(1, len(octets) // 1024), 2, replace=False))
    octets[one : one + 1024], octets[two : two + 1024] = octets[two : two + 1024], octets[one : one + 1024]
    path.write_bytes(octets)


def truncate(path: Path, rng: np.random.Generator) -> None:
    os.truncate(path, int(rng.integers(1, path.stat().st_size)))


def spoil_header(path: Path, rng: np.random.Generator) -> None:
    octets = bytearray(path.read_bytes())
    octets[int(rng.integers(100))] ^= int(rng.integers(1, 256))
    path.write_bytes(octets)


def spoil_log(path: Path, rng: np.random.Generator) -> None:
    mutate = (flip_bit, truncate)[int(rng.integers(2))]
    mutate(beside(path, "-wal"), rng)


MUTATIONS: dict[str, Mutate] = {
    "bit": flip_bit, "page": spoil_page, "swap": swap_pages, "cut": truncate, "header": spoil_header,
    "log": spoil_log,
}  # fmt: skip


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("whole") / "rig.db"
    build(path, leave_log=True)
    return path


def trial(
    whole: Path, folder: Path, mutate: Mutate, rng: np.random.Generator, truths: list[tuple[Rows, Rows]]
) -> str:
    """Damage a copy, start on it, and say what came of it."""
    path = folder / "rig.db"
    for old in folder.iterdir():
        old.unlink()
    shutil.copy(whole, path)
    logged = mutate is spoil_log or bool(rng.integers(2))
    truth = truths[logged]
    shutil.copy(beside(whole, ".lock" if logged else ".lock-before"), beside(path, ".lock"))
    if logged:
        shutil.copy(beside(whole, "-wal"), beside(path, "-wal"))
    before = [p.read_bytes() for p in (path, beside(path, "-wal")) if p.exists()]
    mutate(path, rng)
    if before == [p.read_bytes() for p in (path, beside(path, "-wal")) if p.exists()]:
        return "unharmed"
    with Store.open(path) as store:
        found = store.recovery is not None
        store.write(store.begin_run(run_info()), [batch(1, first=5000)])
        assert problems(store.connection) == []
    rows, alarms = content(path)
    new = {r for r in rows if r[0] == START + 5000 * HOP}
    assert len(new) == 4
    assert rows - new <= truth[0], "a damaged row was served as good"
    assert {a for a in alarms if a[1] != "store"} <= truth[1]
    if found:
        assert [e["cause"] for e in queries.events(path)] == ["damaged"]
        assert [a["state"] for a in queries.alarms(path) if a["parameter"] == "store"] == ["RTNUN"]
        assert list(folder.glob("rig.db.corrupt-*"))
        return "detected" if rows - new else "detected, all lost"
    if rows - new == truth[0]:
        return "harmless"
    reported = [e["cause"] for e in queries.events(path)] == ["rows missing"]  # there was nothing to be saved
    return "detected" if reported else "undetected"


@pytest.mark.parametrize(
    "count", [60, pytest.param(20_000, marks=[pytest.mark.soak, pytest.mark.timeout(3600)])]
)
def test_start_on_damaged_copies_finds_the_damage_and_serves_nothing_false(
    whole: Path, memory: Path, rng: np.random.Generator, count: int
) -> None:
    tmp_path = memory
    shutil.copy(whole, tmp_path / "rig.db")
    truths = [content(tmp_path / "rig.db")]
    shutil.copy(beside(whole, "-wal"), tmp_path / "rig.db-wal")
    truths.append(content(tmp_path / "rig.db"))
    seen: dict[str, Counter[str]] = {name: Counter() for name in MUTATIONS}
    for i in range(count):
        name = list(MUTATIONS)[i % len(MUTATIONS)]
        seen[name][trial(whole, tmp_path, MUTATIONS[name], rng, truths)] += 1
    total = sum(seen.values(), Counter())
    harmful = sum(n for what, n in total.items() if what not in {"unharmed", "harmless"})
    words = ", ".join(
        f"{name} {c['undetected']} of {c.total()}" for name, c in seen.items() if c["undetected"]
    )
    figure(f"damaged copies: {count}, {harmful} harmed, {total['undetected']} undetected ({words or 'none'})")
    assert total["undetected"] <= 0.1 * harmful
    assert seen["log"]["undetected"] <= 0.1 * seen["log"].total()
    assert total["detected"] >= 0.6 * harmful


def test_recovery_saves_every_row_that_is_sound(whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "rig.db"
    shutil.copy(whole, path)
    truth = content(path)
    result = recover(path, "tried out")
    assert result.refused == 0
    assert content(path) == truth
    assert result.aside.read_bytes() == whole.read_bytes()


def test_numbers_lost_with_damaged_rows_are_not_given_out_again(whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "rig.db"
    shutil.copy(whole, path)
    newest = select(path, "SELECT max(seq) FROM hops")[0][0]
    os.truncate(path, path.stat().st_size // 2)
    beside(path, ".lock").write_bytes(b"deltak 1\n")
    with Store.open(path) as store:
        assert store.recovery is not None
        store.write(store.begin_run(run_info()), [batch(1)])
    assert select(path, "SELECT max(seq) FROM hops")[0][0] > newest


@pytest.mark.parametrize("stage", ["salvaging", "log gone", "old aside", "both names"])
def test_replacement_cut_short_is_finished_by_the_next_start(whole: Path, tmp_path: Path, stage: str) -> None:
    """Every state that a power cut during the replacement of a damaged file can leave."""
    path, good = tmp_path / "rig.db", tmp_path / "good.db"
    build(good, leave_log=False)
    truth = content(good)
    shutil.copy(whole, path)
    if stage == "salvaging":
        shutil.copy(good, path)
        beside(path, ".salvaging").write_bytes(good.read_bytes()[:5000])
        beside(path, ".salvaging-wal").write_bytes(b"x")
    else:
        shutil.copy(good, beside(path, ".salvaged"))
    if stage in {"log gone", "both names"}:
        os.truncate(path, 3000)
    if stage == "both names":
        shutil.copy(beside(whole, "-wal"), beside(path, "-wal"))
    if stage == "old aside":
        path.rename(beside(path, ".corrupt-20260101T000000Z-000"))
        beside(path, "-wal").write_bytes(beside(whole, "-wal").read_bytes())
    with Store.open(path):
        pass
    assert content(path) == truth
    assert not [p.name for p in tmp_path.iterdir() if ".salvag" in p.name]


def test_log_of_a_lost_file_is_put_aside_and_not_read_into_a_new_one(whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "rig.db"
    shutil.copy(beside(whole, "-wal"), beside(path, "-wal"))
    with Store.open(path) as store:
        assert store.connection.execute("SELECT count(*) FROM hops").fetchone() == (0,)
    assert len(list(tmp_path.glob("rig.db.corrupt-*-wal"))) == 1


def test_damaged_files_put_aside_are_bounded(whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "rig.db"
    for _ in range(9):
        shutil.copy(whole, path)
        recover(path, "tried out")
    assert len(list(tmp_path.glob("*.corrupt-*"))) <= 6


def test_damage_met_while_running_is_replaced_and_nothing_waiting_is_lost(tmp_path: Path) -> None:
    path = tmp_path / "rig.db"
    writer = StoreWriter(lambda: Store.open(path), [run_info()], period_s=60.0)
    writer.start()
    writer.publish([warming(4), batch(3000, first=4), step("NORM", "UNACK")])
    assert writer.flush(30)
    store = writer._store
    assert store is not None
    store.checkpoint("TRUNCATE")
    octets = bytearray(path.read_bytes())
    leaf = octets.index(b"k1 fell") // 1024  # the page of the alarm, and every tenth of the others
    for page in range(20, len(octets) // 1024, 10):
        if page != leaf:
            octets[page * 1024 : page * 1024 + 1024] = b"\xa5" * 1024
    with path.open("r+b") as file:
        file.write(octets)
    store.reopen()
    assert store.recovery is not None
    writer.run_ids.clear()
    writer.publish([batch(50, first=4000), step("UNACK", "RTNUN", START + 4000 * HOP)])
    assert writer.flush(30)
    writer.stop(30)
    rows = queries.estimates(path, parameter="k1")
    assert [r["t_ns"] for r in rows[-50:]] == [START + i * HOP for i in range(4000, 4050)]
    assert len(rows) > 1500
    states = {a["parameter"]: a["state"] for a in queries.alarms(path)}
    assert states == {"k1": "RTNUN", "store": "RTNUN"}


def test_reader_of_a_damaged_file_is_told_what_to_do(whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "rig.db"
    octets = bytearray(whole.read_bytes())
    octets[:16] = bytes(16)
    path.write_bytes(octets)
    with pytest.raises(StoreError, match="damaged; run `deltak db repair`"):
        queries.latest(path)
