"""Long: cuts and kills over 100,000 rows, thirteen hours without a consumer, and what thirty rigs cost."""

import json
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import psycopg
import pytest

from agent.storage.write.store import Store
from tests.bench.bench_capacity import measure
from tests.figures import figure
from tests.northbound.line import line_to, mosquitto, postgres
from tests.northbound.supply import numbers, supplied
from tests.northbound.test_mqtt import plant, subscriber
from tests.peers import ROOT
from tests.scenario.live import wait_until
from tests.storage.conftest import memory
from tests.storage.rows import batch, run_info

__all__ = ["memory"]
PASSWORD = "of-the-soak"
SECOND = 1_000_000_000


@pytest.mark.soak
@pytest.mark.timeout(600)
def test_hundred_cuts_and_twenty_kills_in_hundred_thousand_rows_lose_and_double_nothing(memory: Path) -> None:
    path, rng = memory / "rig.db", random.Random(16)
    (memory / "word").write_text(PASSWORD, encoding="utf-8")
    with (
        mosquitto(memory) as broker, postgres(memory, PASSWORD) as server, line_to(broker) as one,
        line_to(server) as two, subscriber(broker) as seen,
    ):  # fmt: skip
        given = json.dumps({"broker": one.port, "server": two.port, "total": 25_000, "pause_ms": 40})
        command = [sys.executable, "-m", "tests.northbound.storing", str(path), given]
        cuts, kills, ends = 0, 0, None
        while ends is None or ends != 0:
            with subprocess.Popen(command, cwd=ROOT) as agent:
                until = time.monotonic() + rng.uniform(2.5, 4.0)
                while agent.poll() is None and (kills == 20 or time.monotonic() < until):
                    time.sleep(rng.uniform(0.2, 0.8))
                    if cuts < 100:
                        line = rng.choice((one, two))
                        if rng.random() < 0.2:
                            line.freeze()
                            time.sleep(1.2)  # longer than a consumer's timeout_s
                            line.mend()
                        else:
                            line.cut()
                        cuts += 1
                if agent.poll() is None:
                    agent.kill()
                    kills += 1
                ends = agent.wait()
            assert ends in {0, -signal.SIGKILL}
        expected = numbers(path)
        wait_until(lambda: {row["seq"] for row in seen.rows()} == {*expected}, "every row at the broker", 60)
        where = {
            "host": "127.0.0.1",
            "port": server,
            "user": "deltak",
            "password": PASSWORD,
            "dbname": "postgres",
        }
        with psycopg.connect(**where) as asked:
            stored = [seq for (seq,) in asked.execute("SELECT seq FROM soaked_estimates ORDER BY seq")]
        assert stored == expected
        for backfill in (False, True):
            sent = list(dict.fromkeys(row["seq"] for row in seen.rows(backfill=backfill)))
            assert sent == sorted(sent)
        twice = len(seen.rows()) - len(expected)
    figure(f"northbound: {len(expected)} rows, {cuts} cuts, {kills} kills: 0 lost, 0 twice in PostgreSQL, "
           f"{twice} twice over MQTT")  # fmt: skip


@pytest.mark.soak
@pytest.mark.timeout(600)
def test_after_thirteen_hours_without_a_broker_what_is_new_comes_within_two_seconds(memory: Path) -> None:
    path, hops, late = memory / "rig.db", 13 * 3600, []
    with Store.open(path) as store:
        run_id = store.begin_run(run_info())
        for first in range(0, hops, 600):
            store.write(run_id, [batch(600, first=first, hop_ns=SECOND)])
    with mosquitto(memory) as port, subscriber(port) as seen:
        began = time.monotonic()
        with supplied(path, [plant(port, topics=("estimates",))], keep_s=5.0) as (writer, forwarders):
            wait_until(lambda: forwarders[0].sent > 0, "the first rows", 20)
            while forwarders[0].document()["backfill"]["estimates"]:
                writer.publish([batch(1, first=hops + len(late), hop_ns=SECOND)])
                writer.flush()
                begun, newest = time.monotonic(), numbers_after(path)
                wait_until(lambda n=newest: any(row["seq"] == n for row in seen.tail()), "the new row", 20)
                late.append(time.monotonic() - begun)
                time.sleep(0.5)
            seconds = time.monotonic() - began
        wait_until(lambda: len(seen.messages) >= 4 * (hops + len(late)), "all to arrive", 60)
    assert max(late) < 2.0
    figure(f"northbound: {4 * hops} rows of 13 h sent in {seconds:.0f} s beside new ones, which took at most "
                         f"{max(late):.2f} s")  # fmt: skip


def numbers_after(path: Path) -> int:
    from tests.storage.rows import select

    return int(select(path, "SELECT max(seq) FROM hops WHERE span = 0")[0][0]) * 1024 + 3


@pytest.mark.soak
@pytest.mark.timeout(300)
def test_thirty_rigs_forward_for_a_tenth_of_what_their_agent_takes(memory: Path) -> None:
    """Of rigs at 1 kHz over workers, as by default, with a database, a thread and a connection each."""
    with mosquitto(memory) as port:
        broker = f'kind = "mqtt"\nurl = "mqtt://127.0.0.1:{port}"\nclient_id = "rig-NUMBER"'
        found = measure("modbus", 30, f'\n[[north]]\nname = "plant"\n{broker}\n', workers=2)
    share = found.cost["northbound"] / sum(found.cost.values())
    whole = f"of the {100 * sum(found.cost.values()):.0f} % of a core that their agent takes"
    figure(f"northbound: 30 rigs, {found.sent:.0f} rows a second over MQTT: {100 * share:.1f} % {whole}")
    assert found.played
    assert not found.lost
    assert found.lag_s < 2.0  # as workers say it once a second
    assert 110 < found.sent < 160  # a row a second of each of four parameters, and ledgers: not every row
    assert share <= 0.1
