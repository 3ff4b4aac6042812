"""Whatever a consumer or the agent does, what the database has arrives, in order, and cursors follow what
arrived."""

import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from agent.config.sections.north import North
from agent.northbound.interface.peer import Batch
from agent.northbound.position import Position
from agent.northbound.tuning import MOST_GAPS
from agent.storage.read.forward import Feed
from agent.storage.write.consumers.cursors import begin, edges_of, forget_others, keep
from agent.storage.write.retention import Retention
from agent.storage.write.store import Store
from tests.northbound.supply import Archive, events, numbers, supplied
from tests.peers import ROOT
from tests.scenario.live import wait_until
from tests.storage.conftest import memory
from tests.storage.rows import START, batch, ledger, run_info, select, step

__all__ = ["memory"]
SECOND = 1_000_000_000
PLANT = North(name="plant", kind="mqtt", topics=("estimates",), batch=20)


def test_position_fills_gaps_from_the_oldest_while_live_goes_on() -> None:
    position = Position((100,)).left_behind(200)
    assert (position.live, position.gap) == (200, (100, 200))
    position = position.advanced(220).left_behind(300).advanced(310)
    assert (position.live, position.gap) == (310, (100, 200))
    assert position.filled(150).gap == (150, 200)
    assert position.filled(200).gap == (220, 300)
    assert position.filled(200).filled(300) == Position((310,))
    assert position.left_behind(300) == position


def test_position_lags_by_what_lies_in_its_gaps_and_after_its_newest() -> None:
    assert Position((0,)).lag(0) == 0
    assert Position((100, 200, 220, 300, 310)).lag(315) == 100 + 80 + 5
    assert Position((100,)).lag(90) == 0  # a database that was begun anew


def test_position_left_behind_again_before_any_live_row_makes_the_gap_longer() -> None:
    assert Position((100,)).left_behind(200).left_behind(300) == Position((100, 300, 300))


def test_position_with_many_gaps_sends_the_shortest_stretch_again() -> None:
    position = Position((0,))
    for i in range(1, 2 * MOST_GAPS):
        position = position.left_behind(100 * i).advanced(100 * i + (1 if i == 7 else 50))
    assert len(position.edges) == 2 * MOST_GAPS + 1
    assert 700 not in position.edges
    assert position.edges == tuple(sorted(position.edges))


def test_cursors_are_kept_with_their_gaps_and_dropped_with_their_consumer(memory: Path) -> None:
    with Store.open(memory / "rig.db") as store:
        assert begin(store, "plant", {"estimates": 0, "events": 7}) == {"estimates": (0,), "events": (7,)}
        keep(store, "plant", {"estimates": (5, 9, 12), "events": (8,)}, {"bdSeq": 3})
        assert edges_of(store.connection, "plant", "estimates") == (5, 9, 12)
        keep(store, "plant", {"estimates": (9,)}, {})
        assert edges_of(store.connection, "plant", "estimates") == (9,)
        assert edges_of(store.connection, "plant", "bdSeq") == (3,)
        assert begin(store, "plant", {"estimates": 0}) == {"estimates": (9,)}
        assert edges_of(store.connection, "plant", "events") is None
        assert forget_others(store, ["other"]) == ["plant"]
        assert edges_of(store.connection, "plant", "estimates") is None


def test_rows_of_every_topic_arrive_with_their_numbers(memory: Path) -> None:
    path, archive = memory / "rig.db", Archive()
    everything = North(name="plant", kind="mqtt")
    with supplied(path, [everything], archive.make) as (writer, _):
        writer.publish([batch(30), ledger(), step("NORM", "UNACK"), step("UNACK", "RTNUN", START + 5)])
        wait_until(lambda: len(archive.taken) == 4 * 30 + 1 + 2, "all to arrive", 10)
    assert archive.seqs() == numbers(path)
    assert archive.seqs("alarms") == [1, 2]
    assert archive.seqs("health") == [1]


def test_rows_a_consumer_asks_for_are_of_its_parameters_only(memory: Path) -> None:
    path, archive = memory / "rig.db", Archive()
    chosen = PLANT.model_copy(update={"parameters": ("k2",), "topics": ("alarms", "estimates")})
    with supplied(path, [chosen], archive.make) as (writer, _):
        writer.publish([batch(30), step("NORM", "UNACK"), step("NORM", "UNACK", parameter="k2")])
        wait_until(lambda: len(archive.taken) == 31, "all to arrive", 10)
    assert archive.seqs() == [seq for seq in numbers(path) if seq % 1024 == 1]
    assert archive.seqs("alarms") == [2]


def test_consumer_that_refuses_loses_and_hangs_has_every_row_in_order_and_is_announced_once_each_way(
    memory: Path,
) -> None:
    path = memory / "rig.db"
    archive = Archive(["refused", "down", "refused", "fine", "lost", "refused", "fine"])
    with supplied(path, [PLANT], archive.make, late_s=0.0) as (writer, forwarders):
        for i in range(10):
            writer.publish([batch(50, first=50 * i)])
        wait_until(
            lambda: {*archive.seqs()} == {*numbers(path)} and len(numbers(path)) == 2000, "all to arrive", 20
        )
        wait_until(lambda: len(events(path)) == 4, "the events", 5)
        assert forwarders[0].document()["state"] == "ok"
    for backfill in (False, True):
        sent = archive.seqs(backfill=backfill)
        again = [seq for seq, before in zip(sent[1:], sent[:-1], strict=True) if seq <= before]
        assert len(again) <= 1  # the batch whose answer was lost
    causes = [cause for cause, _ in events(path)]
    assert causes == ["consumer failed", "consumer recovered"] * 2


@pytest.mark.realtime
def test_consumer_that_hangs_holds_up_neither_another_nor_the_writer_nor_the_end(memory: Path) -> None:
    path, stuck, fine = memory / "rig.db", Archive(["hang"]), Archive()
    others = {"plant": stuck, "fine": fine}
    two = [PLANT, PLANT.model_copy(update={"name": "fine"})]
    with supplied(path, two, lambda c, p: others[c.name].make(c, p)) as (writer, forwarders):
        writer.publish([batch(100)])
        wait_until(lambda: len(fine.taken) == 400, "the other to be supplied", 10)
        before = forwarders[0].progress
        wait_until(lambda: forwarders[0].progress > before, "progress while it waits", 5)
        begun = time.monotonic()
    assert time.monotonic() - begun < 3
    assert stuck.taken == []
    assert events(path) == []  # the agent's end is no failure of the consumer


def test_backfill_does_not_overtake_what_is_new(memory: Path) -> None:
    path = memory / "rig.db"
    with Store.open(path) as store:
        run_id = store.begin_run(run_info())
        for i in range(2):
            store.write(run_id, [batch(500, first=500 * i)])
    allowed = threading.Semaphore(0)

    def before(found: Batch) -> None:
        if found.backfill:
            assert allowed.acquire(timeout=20.0)

    archive, slowly = Archive(before=before), PLANT.model_copy(update={"batch": 5})
    with supplied(path, [slowly], archive.make, keep_s=0.5) as (writer, forwarders):
        allowed.release()
        wait_until(lambda: bool(archive.seqs(backfill=True)), "backfill to begin", 5)
        for i in range(5):
            writer.publish([batch(1, first=5000 + i)])
            writer.flush()
            allowed.release()  # of the batch under way, and of no other
            newest = numbers(path)[-1]
            wait_until(lambda n=newest: n in archive.seqs(backfill=False), "the new row", 5)
        assert forwarders[0].document()["backfill"] == {"estimates": True}
        allowed.release(1000)
    archive.before = lambda _: None
    with supplied(path, [PLANT.model_copy(update={"batch": 500})], archive.make):
        wait_until(lambda: {*archive.seqs()} == {*numbers(path)}, "all to arrive", 20)
    assert archive.doubles == 0
    assert archive.seqs(backfill=True) == numbers(path)[: 4 * 1000]
    assert archive.seqs(backfill=False) == numbers(path)[4 * 1000 :]


def test_steps_of_alarms_come_in_order_and_late_ones_are_marked(memory: Path) -> None:
    path, archive = memory / "rig.db", Archive()
    with Store.open(path) as store:
        run_id = store.begin_run(run_info())
        for i in range(50):
            store.write(run_id, [step("NORM", "UNACK", START + i, parameter=f"p{i}")])
    alarms = PLANT.model_copy(update={"topics": ("alarms", "estimates")})
    with supplied(path, [alarms], archive.make) as (writer, forwarders):
        wait_until(lambda: not forwarders[0]._behind_ns, "the consumer to be there", 5)
        writer.publish([step("NORM", "UNACK", START + 60, parameter="new")])
        wait_until(lambda: len(archive.taken) == 51, "all to arrive", 5)
    assert archive.taken == [("alarms", seq, seq <= 50) for seq in range(1, 52)]


def test_agent_killed_before_its_cursor_was_stored_sends_again_and_leaves_nothing_out(memory: Path) -> None:
    path, file = memory / "rig.db", memory / "taken"
    command = [sys.executable, "-m", "tests.northbound.killed", str(path), str(file)]
    assert subprocess.run(command, cwd=ROOT, timeout=60, check=False).returncode == -signal.SIGKILL
    archive = Archive()
    with supplied(path, [PLANT], archive.make):
        wait_until(lambda: bool(archive.seqs()) and archive.seqs()[-1] == numbers(path)[-1], "the rest", 20)
    before = {int(word) for word in file.read_text(encoding="utf-8").split()}
    assert before | {*archive.seqs()} == {*numbers(path)}


def test_new_consumer_without_backfill_begins_with_what_is_new(memory: Path) -> None:
    path, archive = memory / "rig.db", Archive()
    with Store.open(path) as store:
        store.write(store.begin_run(run_info()), [batch(50)])
    fresh = PLANT.model_copy(update={"backfill": False})
    with supplied(path, [fresh], archive.make) as (writer, forwarders):
        wait_until(lambda: forwarders[0].document()["state"] == "ok", "the consumer to be there", 5)
        writer.publish([batch(1, first=100)])
        wait_until(lambda: len(archive.seqs()) == 4, "the new rows", 5)
    assert archive.seqs() == numbers(path)[-4:]


def test_rows_purged_before_they_were_sent_are_counted_and_said_once(memory: Path) -> None:
    path = memory / "rig.db"
    with Store.open(path) as store:
        run_id = store.begin_run(run_info())
        begin(store, "plant", {"estimates": 0})
        keep(store, "plant", {"estimates": (100 << 10 | 1023,)}, {})
        for i in range(6):
            store.write(run_id, [batch(120, first=120 * i, hop_ns=30 * SECOND)])
        store.retain(Retention(full_s=3600.0, max_bytes=170e3))
        store.maintain()
        first = store.connection.execute("SELECT min(seq) FROM hops WHERE span = 0").fetchone()[0]
        assert first > 101
    with supplied(path, [PLANT], Archive().make):
        wait_until(lambda: bool(events(path)), "the event", 10)
    lost = (
        f"plant: {first - 101} instants or rows were purged before it had them; "
        "the database had reached its bound"
    )
    assert events(path) == [("purged unsent", lost)]
    with supplied(path, [PLANT], Archive().make) as (writer, _):
        writer.publish([batch(1, first=9000)])
        writer.flush()
    assert len(events(path)) == 1


def test_health_that_was_not_sent_is_not_thinned(memory: Path) -> None:
    path = memory / "rig.db"
    with Store.open(path, Retention(full_s=3600.0)) as store:
        begin(store, "plant", {"health": 0})
        keep(store, "plant", {"health": (5,)}, {})
        run_id = store.begin_run(run_info())
        for minute in range(0, 6 * 60, 10):
            t_ns = START + minute * 60 * SECOND
            store.write(run_id, [batch(1, start=t_ns), ledger(t_ns)])
            store.maintain()
    assert len(select(path, "SELECT t_ns FROM v_health")) == 36 - 5


def test_file_that_was_replaced_is_read_anew(memory: Path) -> None:
    path = memory / "rig.db"
    feed = Feed(path)
    for count in (10, 20):
        path.unlink(missing_ok=True)
        with Store.open(path) as store:
            store.write(store.begin_run(run_info()), [batch(count)])
        assert len(feed.after("estimates", 0, None, 100).rows) == 4 * count
    feed.close()


@pytest.mark.parametrize("topic", ["alarms", "estimates", "events", "health"])
def test_nothing_new_leaves_the_cursor_where_it_is(memory: Path, topic: str) -> None:
    with Store.open(memory / "rig.db"):
        feed = Feed(memory / "rig.db")
        head = feed.head(topic)
        assert feed.after(topic, head, None, 10) == ([], head, False)
        feed.close()
