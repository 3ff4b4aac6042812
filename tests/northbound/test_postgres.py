"""PostgreSQL: what arrived equals v_estimates, each row once, whatever is cut, and nobody hears a secret."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psycopg
import pytest
from typer.testing import CliRunner

from agent.cli.app import app
from agent.cli.prognosis.fleet import fleet
from agent.config.reading.secrets import Secret
from agent.config.sections.north import North
from agent.errors import UsageError
from agent.northbound.interface.peer import Place
from agent.northbound.postgres.peer import PostgresPeer
from agent.storage.read import queries
from tests.northbound.forwarded import TOPICS, forwarded, same, worn
from tests.northbound.line import disturb, line_to, postgres
from tests.northbound.supply import events, numbers, supplied
from tests.northbound.test_mqtt import said_of
from tests.scenario.live import wait_until
from tests.storage.conftest import memory
from tests.storage.rows import START, batch, ledger, step

__all__ = ["memory"]
PLANTED = "PLANTED-5ecret-0f-the-database"


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    folder = tmp_path_factory.mktemp("server")
    with postgres(folder, PLANTED) as port:
        yield port


def asked(port: int, query: str, *values: object) -> list[Any]:
    with psycopg.connect(
        host="127.0.0.1", port=port, user="deltak", password=PLANTED, dbname="postgres"
    ) as connection:
        cursor = connection.execute(query, values)  # type: ignore[arg-type]
        return cursor.fetchall() if cursor.description else []


def plant(port: int, name: str, folder: Path, **keys: Any) -> North:
    (folder / "word").write_text(PLANTED, encoding="utf-8")
    url = f"postgresql://127.0.0.1:{port}/postgres"
    given: dict[str, Any] = {"user": "deltak", "password": Secret(file=Path("word")), "prefix": name} | keys
    return North(name="history", kind="postgres", url=url, **given)


def test_rows_of_every_topic_arrive_with_their_columns(memory: Path, server: int) -> None:
    path = memory / "rig.db"
    with supplied(path, [plant(server, "whole", memory)]) as (writer, forwarders):
        writer.publish([batch(10), ledger(), step("NORM", "UNACK"), step("UNACK", "RTNUN", START + 5)])
        wait_until(lambda: forwarders[0].sent == 43, "all to arrive", 20)
    stored = {(row["parameter"], row["t_ns"]): row for row in queries.estimates(path)}
    columns = ["parameter", "t_ns", "value", "sd", "lower", "status", "reason", "n_used", "method", "unit"]
    found = asked(server, f"SELECT {', '.join(columns)} FROM whole_estimates ORDER BY seq")
    assert found == [tuple(row[name] for name in columns) for row in stored.values()]
    assert asked(server, 'SELECT seq, to_state, "by", kind FROM whole_alarm_events ORDER BY seq') == [
        (1, "UNACK", None, "level"), (2, "RTNUN", None, "level"),
    ]  # fmt: skip
    assert asked(server, "SELECT source, received, time = to_timestamp(t_ns / 1e9) FROM whole_health") == [
        ("can", 1000, True)
    ]


def _has_all(path: Path, head: int) -> bool:
    from tests.storage.rows import select

    found = select(
        path, "SELECT topic, last_seq FROM consumers WHERE name = 'history' AND topic GLOB 'estimates*'"
    )
    return len(found) == 1 and found[0][1] >= head


def test_line_cut_and_frozen_leaves_each_row_there_once(memory: Path, server: int) -> None:
    path = memory / "rig.db"
    with line_to(server) as line:
        consumer = plant(line.port, "cut", memory, topics=("estimates",), batch=50, timeout_s=0.4)
        with supplied(path, [consumer], late_s=0.2) as (writer, forwarders):
            disturb(line, writer, forwarders[0], 400, 5)
            wait_until(lambda: _has_all(path, numbers(path)[-1]), "every row", 60)
    assert [seq for (seq,) in asked(server, "SELECT seq FROM cut_estimates ORDER BY seq")] == numbers(path)
    causes = [cause for cause, _ in events(path)]
    assert causes == (["consumer failed", "consumer recovered"] * len(causes))[: len(causes)]
    assert causes


def test_rows_that_are_there_already_are_left_and_those_of_another_database_refused(
    memory: Path, server: int
) -> None:
    consumer = plant(server, "twice", memory, topics=("estimates",))
    first, again, other = (memory / f"{name}.db" for name in ("first", "again", "other"))
    for path, start in ((first, START), (again, START), (other, START + 7)):
        with supplied(path, [consumer]) as (writer, forwarders):
            writer.publish([batch(10, start=start)])
            wait_until(lambda p=path, f=forwarders[0]: f.sent == 40 or bool(said_of(p)), "an end", 20)
    assert said_of(first) == said_of(again) == []
    assert len(asked(server, "SELECT seq FROM twice_estimates")) == 40
    (words,) = said_of(other)
    assert "has another row of rig press-7" in words


def test_wrong_password_table_that_is_full_and_server_that_is_gone_are_one_event_each(
    memory: Path, server: int, caplog: pytest.LogCaptureFixture
) -> None:
    (memory / "wrong").write_text(f"not-{PLANTED}", encoding="utf-8")
    asked(server, "CREATE TABLE full_estimates (LIKE pg_class)")
    asked(server, "DROP TABLE full_estimates")
    refusing = """CREATE FUNCTION refuse() RETURNS trigger LANGUAGE plpgsql AS $$
 BEGIN RAISE EXCEPTION 'could not extend file: No space left on device' USING ERRCODE = '53100'; END $$"""
    consumer = plant(server, "full", memory, topics=("estimates",))
    with supplied(memory / "make.db", [consumer]) as (writer, forwarders):
        wait_until(
            lambda: forwarders[0].document()["state"] == "ok" and not forwarders[0]._behind_ns, "tables", 20
        )
    asked(server, refusing)
    asked(server, "CREATE TRIGGER t BEFORE INSERT ON full_estimates FOR EACH ROW EXECUTE FUNCTION refuse()")
    cases = {
        "credentials": plant(server, "full", memory, password=Secret(file=Path("wrong"))),
        "full": consumer,
        "refused": consumer.model_copy(update={"url": "postgresql://127.0.0.1:1/postgres"}),
    }
    for cause, one in cases.items():
        path = memory / f"{cause}.db"
        with supplied(path, [one]) as (writer, forwarders):
            writer.publish([batch(2)])
            wait_until(lambda f=forwarders[0]: f._failures > 2, f"attempts of {cause}", 20)
            assert PLANTED not in str(forwarders[0].document())
        (words,) = said_of(path)
        assert f"({cause}: " in words
        assert len(numbers(path)) == 8
    assert PLANTED not in caplog.text
    kept = b"".join(file.read_bytes() for file in memory.glob("*.db*"))
    assert PLANTED.encode() not in kept


def test_fleet_of_a_server_says_what_it_says_of_the_database(memory: Path, server: int) -> None:
    path = worn(memory, "press-0", 90, 60)
    consumer = plant(server, "fleet", memory, topics=TOPICS)
    forwarded(path, PostgresPeer(consumer, Place(path, memory)))
    address = f"postgresql://deltak:{PLANTED}@127.0.0.1:{server}/postgres"
    answer = CliRunner().invoke(app, ["fleet", f"{address}#fleet", "--json"])
    assert same(json.loads(answer.stdout)["rows"], path)
    for wrong in (f"{address}#other", f"{address.replace(PLANTED, PLANTED[::-1])}#fleet"):
        with pytest.raises(UsageError, match="cannot be read: ") as error:
            fleet([wrong], "90d", None, 20.0)
        assert PLANTED not in str(error.value)
        assert PLANTED[::-1] not in str(error.value)


@pytest.mark.parametrize("address", [
    "postgresql://deltak:{}%zz@127.0.0.1:1/db", "postgresql://127.0.0.1:1/db?password={}%zz",
    "postgresql://deltak:a@{}@127.0.0.1:1/db", "postgresql://deltak:a/{}@127.0.0.1:1/db",
    "postgresql://deltak:{}@127.0.0.1:1/db",
])  # fmt: skip
def test_address_that_is_none_is_refused_without_the_password_in_it(address: str) -> None:
    with pytest.raises(UsageError) as error:
        fleet([address.format(PLANTED)], "90d", None, 20.0)
    assert PLANTED not in str(error.value)
