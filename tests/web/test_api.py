"""The HTTP API: the same numbers as SQL and as --json, ETags, headers, sessions, nothing that breaks it."""

import json
import re
import shutil
import sqlite3
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.cli.app import app
from agent.cli.glance.files import several
from agent.cli.web.documents import DOCUMENTS, thinned
from agent.cli.web.forecasts import forecasts, spread, words_of
from agent.cli.web.secret import from_files
from agent.errors import StoreError, UsageError
from agent.storage.read import queries
from agent.storage.write.command_socket import CommandServer
from agent.storage.write.store import Store
from tests.storage.rows import run_info
from tests.web import files
from tests.web.server import PASSWORD, Client, password_file, serving


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("served")
    files.make(folder)
    password_file(folder)
    return folder


@pytest.fixture(scope="module")
def server(folder: Path) -> Iterator[Client]:
    with serving("--config", folder / "rig.toml", "--password-file", folder / "password") as client:
        yield client


@pytest.fixture
def client(server: Client) -> Client:
    return Client(server.port, server.pid)


def test_latest_is_what_sql_says(client: Client, folder: Path) -> None:
    rows = client.get("latest")["rows"]
    with sqlite3.connect(folder / "rig.db") as connection:
        connection.row_factory = sqlite3.Row
        said = [dict(row) for row in connection.execute("SELECT * FROM v_latest")]
    connection.close()
    assert len(rows) == 6
    assert [{k: v for k, v in row.items() if k != "db"} for row in rows] == said


def printed_by(capsys: pytest.CaptureFixture[str], *command: str) -> Any:
    """Return the document that a command prints."""
    capsys.readouterr()
    app([*command, "--json"], standalone_mode=False)
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("command", ["estimates", "alarms", "verdicts"])
def test_documents_are_those_of_the_command_line(
    client: Client, folder: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    printed = printed_by(capsys, command, str(folder / "rig.db"))
    served = client.get(command)
    for rows in served.values():
        for row in rows if isinstance(rows, list) else ():
            assert row.pop("db") == "rig"
    assert served == printed


def test_trend_is_that_of_the_command_line_with_points_thinned(
    client: Client, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    printed = printed_by(capsys, "trend", str(folder / "rig.db"), "k1", "--rig", "press-7", "--limit", "10")
    served = client.get("trend?rig=press-7&parameter=k1&limit=10")
    points = served.pop("points")
    assert [point[:3] for point in points] == printed.pop("points")
    assert {**served, "backward": 0} == {**printed, "backward": 0}


def test_every_document_is_described_and_answers(client: Client) -> None:
    described = client.get("openapi.json")
    assert described["openapi"] == "3.1.0"
    for name in DOCUMENTS:
        assert f"/api/v1/{name}" in described["paths"]
        assert client.get(f"{name}?rig=press-7&parameter=k1" if name in {"points", "trend"} else
                          f"{name}?rig=press-7" if name == "model" else name)  # fmt: skip


def test_overview_and_model_know_limits_and_places(client: Client) -> None:
    worst = client.get("overview")["rigs"][0]
    assert (worst["rig"], worst["parameters"][0]["limit"], worst["words"]) == (
        "press-7",
        15.0,
        "1 unacknowledged",
    )
    model = client.get("model?rig=press-7")
    assert [(mass["name"], mass["place"]) for mass in model["masses"]] == [("m1", 1), ("m2", 2)]
    assert [(e["name"], e["from"], e["to"], e["row"]) for e in model["elements"]] == [
        ("k1", 0, 1, 0), ("k2", 1, 2, 0), ("B1", 0, 1, 1), ("B2", 1, 2, 1),
    ]  # fmt: skip


def test_etag_answers_304_until_something_is_committed(client: Client, folder: Path) -> None:
    _, headers, body = client.ask("GET", "/api/v1/alarms")
    again = {"If-None-Match": headers["etag"]}
    status, _, nothing = client.ask("GET", "/api/v1/alarms", headers=again)
    assert (status, nothing) == (304, b"")
    files.plant(folder / "rig.db", "B2")
    status, _, more = client.ask("GET", "/api/v1/alarms", headers=again)
    assert status == 200
    assert len(json.loads(more)["alarms"]) == len(json.loads(body)["alarms"]) + 1


@pytest.mark.parametrize(
    "path", ["/", "/static/page.js", "/api/v1/rigs", "/api/v1/nothing", "/nowhere", "/api/v1/events"]
)
def test_every_answer_confines_the_page(client: Client, path: str) -> None:
    if path.endswith("events"):
        with client.events() as events:
            assert next(events)[1] == "hello"
        return
    _, headers, body = client.ask("GET", path)
    policy = headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "frame-ancestors 'none'" in policy
    assert "unsafe" not in policy
    assert "http" not in policy
    assert headers["x-content-type-options"] == "nosniff"
    assert "server" not in headers
    assert b"http://" not in body.replace(b"http://www.w3.org/2000/svg", b"")


@pytest.mark.parametrize(
    ("path", "status", "words"),
    [
        ("/api/v1/nothing", 404, "no such document"),
        ("/api/v1/alarms?what=1", 400, "it takes db, rig, active"),
        ("/api/v1/alarms?rig=press-9", 400, "rigs are press-7, press-8"),
        ("/api/v1/alarms?db=other", 400, "databases are rig"),
        ("/api/v1/estimates?since=soon", 400, '"path":"since","message":"\\"soon\\" is no time"'),
        ("/api/v1/points?rig=press-7&parameter=k9", 400, "parameters are k1"),
        ("/api/v1/points?rig=press-7", 400, "is needed"),
        ("/api/v1/points?rig=press-7&parameter=k1&points=0", 400, "not within 1"),
        ("/api/v1/model?rig=press-8", 400, "--config"),
        ("/static/..%2fapp.py", 404, "nothing to ask"),
        ("/static/app.py", 404, "no such file"),
    ],
)
def test_what_cannot_be_asked_is_said(client: Client, path: str, status: int, words: str) -> None:
    found, _, body = client.ask("GET", path)
    assert (found, words in body.decode()) == (status, True), body


def test_other_hosts_are_refused(client: Client) -> None:
    assert client.ask("GET", "/api/v1/rigs", headers={"Host": "evil.example"})[0] == 421
    assert client.ask("GET", "/api/v1/rigs", headers={"Host": "localhost:1"})[0] == 200


@pytest.fixture
def agent(folder: Path) -> Iterator[list[Mapping[str, Any]]]:
    """An agent's socket that takes down what it is asked and refuses alarm 99."""
    asked: list[Mapping[str, Any]] = []

    def act(line: Mapping[str, Any]) -> Mapping[str, Any]:
        asked.append(line)
        if line["ids"] == [99]:
            raise StoreError.at("alarm 99", "there is no such alarm", "see deltak alarms")
        return {"alarms": [{"id": line["ids"][0], "to_state": "ACKED"}]}

    made = CommandServer(folder / "rig.db", {"alarm": act})
    made.start()
    yield asked
    made.stop()


def test_acknowledging_reaches_the_agent_with_who_and_why(
    client: Client, agent: list[Mapping[str, Any]]
) -> None:
    assert client.sign_in("anna") == 200
    status, _, body = client.ask("POST", "/api/v1/alarms/rig/1/ack", {"comment": files.EVIL})
    assert (status, json.loads(body)["alarms"][0]["to_state"]) == (200, "ACKED")
    assert client.ask("POST", "/api/v1/alarms/rig/1/shelve", {"for": "8h"})[0] == 200
    asked = [
        {k: line[k] for k in ("command", "cause", "ids", "by", "comment", "length_ns")} for line in agent
    ]
    first = {
        "command": "alarm",
        "cause": "acknowledge",
        "ids": [1],
        "by": "anna",
        "comment": files.EVIL,
        "length_ns": None,
    }
    assert asked == [first, {**first, "cause": "shelve", "comment": None, "length_ns": 8 * 3600 * 10**9}]


@pytest.mark.parametrize(
    ("path", "body", "status", "words"),
    [
        ("/api/v1/alarms/rig/99/ack", {}, 409, "no such alarm"),
        ("/api/v1/alarms/rig/1/shelve", {}, 400, "is no length of time"),
        ("/api/v1/alarms/rig/1/shelve", {"for": "for ever"}, 400, "is no length of time"),
        ("/api/v1/alarms/rig/1/erase", {}, 404, "no such thing"),
        ("/api/v1/alarms/other/1/ack", {}, 404, "no such thing"),
        ("/api/v1/alarms/rig/1/ack", {"comment": 7}, 400, "no text"),
        ("/api/v1/alarms/rig/1/ack", b"[" * 10000, 400, "no JSON"),
        ("/api/v1/alarms/rig/1/ack", b" " * 20000, 413, "more than"),
        ("/api/v1/alarms/rig/1/ack", [], 400, "no object"),
    ],
)
def test_what_the_agent_or_reason_refuses_is_said(
    client: Client, agent: list[Mapping[str, Any]], path: str, body: Any, status: int, words: str
) -> None:
    client.sign_in()
    found, _, said = client.ask("POST", path, body)
    assert (found, words in said.decode()) == (status, True), said


def test_writes_need_a_session_its_token_and_json(client: Client, agent: list[Mapping[str, Any]]) -> None:
    path = "/api/v1/alarms/rig/1/ack"
    assert client.ask("POST", path, {})[0] == 401
    client.sign_in()
    signed = client.headers
    client.headers = {"Cookie": signed["Cookie"]}
    assert client.ask("POST", path, {})[0] == 403
    assert client.ask("POST", path, {}, {"X-CSRF-Token": "wrong"})[0] == 403
    client.headers = {"X-CSRF-Token": signed["X-CSRF-Token"]}
    assert client.ask("POST", path, {})[0] == 401
    client.headers = signed
    assert client.ask("POST", path, b"{}", {"Content-Type": "text/plain"})[0] == 415
    assert client.ask("DELETE", "/api/v1/session")[0] == 200
    assert client.ask("POST", path, {})[0] == 401
    assert agent == []


def test_session_cookie_is_for_this_site_and_no_script(client: Client) -> None:
    _, headers, _ = client.ask("POST", "/api/v1/session", {"name": "anna", "password": PASSWORD})
    cookie = headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie


def test_without_an_agent_an_acknowledgement_is_refused_and_nothing_is_written(
    client: Client, folder: Path
) -> None:
    client.sign_in()
    before = (folder / "rig.db").read_bytes()
    status, _, said = client.ask("POST", "/api/v1/alarms/rig/1/ack", {})
    assert (status, b"cannot be asked" in said) == (409, True)
    assert (folder / "rig.db").read_bytes() == before


def test_behind_a_proxy_wrong_passwords_are_counted_by_who_sent_them_and_reading_may_need_a_session(
    folder: Path,
) -> None:
    options = ("--proxy", "127.0.0.1", "--hostname", "deltak.example.org", "--private")
    with serving("--db", folder / "rig.db", "--password-file", folder / "password", *options) as client:
        client.headers = {"Host": "deltak.example.org", "X-Forwarded-For": "192.0.2.1"}
        assert client.ask("GET", "/api/v1/rigs")[0] == 401
        assert client.ask("GET", "/")[0] == 200
        assert [client.sign_in(password="wrong") for _ in range(6)] == [401] * 5 + [429]
        assert client.sign_in() == 429
        client.headers = {
            "Host": "deltak.example.org",
            "X-Forwarded-For": "192.0.2.2",
            "X-Forwarded-Proto": "https",
        }
        body = {"name": "anna", "password": PASSWORD}
        status, headers, _ = client.ask("POST", "/api/v1/session", body)
        assert (status, "; secure" in headers["set-cookie"].lower()) == (200, True)
        client.headers["Cookie"] = headers["set-cookie"].partition(";")[0]
        assert client.ask("GET", "/api/v1/rigs")[0] == 200


def test_rows_that_are_too_many_for_one_answer_are_refused(folder: Path) -> None:
    assert len(queries.estimates(folder / "rig.db", "press-8", most=100)) == 200
    with pytest.raises(UsageError, match="more than 99 instants in that time; ask for less"):
        queries.estimates(folder / "rig.db", "press-8", most=99)


def test_points_are_the_valid_rows_of_sql(client: Client, folder: Path) -> None:
    points = client.get("points?rig=press-7&parameter=B2&points=1000")
    query = (
        "SELECT t_ns, value, sd FROM v_estimates WHERE rig = 'press-7' AND parameter = 'B2' "
        "AND status = 'valid'"
    )
    connection = sqlite3.connect(folder / "rig.db")
    said = connection.execute(f"{query} ORDER BY t_ns").fetchall()
    connection.close()
    assert len(said) == 99
    assert [tuple(point[:3]) for point in points["points"]] == said
    assert tuple(points["newest"]) == said[-1]


def test_database_that_cannot_be_read_hides_no_other(folder: Path, tmp_path: Path) -> None:
    shutil.copy(folder / "rig.db", tmp_path / "other.db")
    with (
        serving("--db", folder / "rig.db", "--db", tmp_path / "other.db") as client,
        client.events() as events,
    ):
        assert next(events)[1] == "hello"
        assert len(client.get("overview")["rigs"]) == 4
        (tmp_path / "other.db").write_bytes(b"\0" * 8192)
        found = client.get("overview")
        assert {rig["db"] for rig in found["rigs"]} == {"rig"}
        assert "other.db" in found["errors"][0]
        files.plant(folder / "rig.db", "c9")
        assert next(events)[2]["db"] == "rig"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--host", "0.0.0.0"], "others can reach 0.0.0.0, and there is no password"),
        (["--proxy", "127.0.0.1"], "a proxy lets others in, and there is no password"),
        (["--private"], "needs a password"),
        (["--host", "192.0.2.1", "--token-file", "token"], "cannot be used"),
        (["--token-file", "open-token"], "may be used by others (mode 0644); chmod 600"),
        (["--token-file", "short-token"], "token of 3 characters"),
        (["--password-file", "token"], "holds no hash of a password; make it with"),
    ],
)
def test_serve_refuses_to_be_open_to_others(
    folder: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], words: str
) -> None:
    for name, content, mode in (
        ("token", "t" * 32, 0o600),
        ("open-token", "t" * 32, 0o644),
        ("short-token", "abc", 0o600),
    ):
        (folder / name).write_text(content)
        (folder / name).chmod(mode)
    monkeypatch.chdir(folder)
    with pytest.raises(UsageError, match=re.escape(words)):
        app(["serve", "--db", "rig.db", "--port", "0", *arguments], standalone_mode=False)


def test_serve_without_its_extra_says_how_to_install_it(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    with pytest.raises(UsageError, match=r"needs the extra web .*; pip install 'deltak\[web\]'"):
        app(["serve", "--db", str(folder / "rig.db")], standalone_mode=False)


def test_thinned_points_keep_every_spike_and_the_mean() -> None:
    value = np.sin(np.arange(10_007) / 500.0)
    value[4321] = 9.0
    table = np.column_stack((np.arange(10_007), value, np.ones(10_007))).astype(object)
    found = np.array(thinned(table, 100))
    assert found.shape == (100, 5)
    assert found[:, 4].max() == 9.0
    assert (np.diff(found[:, 0]) > 0).all()
    assert abs(found[:, 1].mean() - value.mean()) < 1e-3
    assert thinned(table[:7], 100) == [[*row, row[1], row[1]] for row in table[:7].tolist()]
    assert thinned(table[:0], 100) == []


def test_reading_holds_nothing_of_the_file(client: Client, folder: Path) -> None:
    client.get("latest")
    with Store.open(folder / "rig.db") as store:
        store.begin_run(run_info(started_ns=time.time_ns()))
        assert store.connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()[0] == 0


def test_forecasts_are_those_of_sql_with_their_record_in_words(client: Client, folder: Path) -> None:
    found = client.get("forecasts?rig=press-7")
    with sqlite3.connect(folder / "rig.db") as connection:
        connection.row_factory = sqlite3.Row
        said = [dict(row) for row in connection.execute("SELECT * FROM v_forecast WHERE rig = 'press-7'")]
    connection.close()
    assert [{**row, "draws": said[0]["draws"]} for row in found["forecasts"]] == [
        {**r, "db": "rig"} for r in said
    ]
    (record,) = found["records"]
    assert record["words"] == "reached in 5 days (80 %: 3 days … 8 days); chance within 6 days 75 %"
    assert record["record_words"] == ["of 2 made here, 1 held within the 80 % band; CRPS 3.43 hours"]
    assert (record["parameter"], record["made"], record["held"], record["waiting"]) == ("k1", 2, 1, 1)


def test_forecast_without_a_band_says_why(client: Client, folder: Path) -> None:
    row = queries.forecasts(folder / "rig.db")[-1]
    nothing = dict.fromkeys(("p10_ns", "p50_ns", "p90_ns", "chance"))
    assert (
        words_of({**row, **nothing, "status": "too short"}) == "no forecast: the history is too short to say"
    )
    assert words_of({**row, "p90_ns": None}).startswith("not reached in twenty times the history's span")


def test_forecasts_are_read_anew_once_one_is_made_or_scored(tmp_path: Path) -> None:
    path = tmp_path / "rig.db"
    (watched,) = several([path], [])
    newest = time.time_ns()
    with Store.open(path) as store:
        run = store.begin_run(run_info())
        counts = []
        for records in (files.forecasts(newest)[:1], files.forecasts(newest)[1:], files.scores(newest)):
            store.write(run, records)
            (record,) = forecasts([watched], "press-7", "k1")["records"]
            counts.append((record["waiting"], record["made"]))
    assert counts == [(1, 0), (3, 0), (1, 2)]


def test_many_forecasts_are_spread_and_the_newest_is_always_there() -> None:
    rows = [{"id": n} for n in range(1050)]
    found = [row["id"] for row in spread(rows, 100)]
    assert (len(found), found[-1], set(np.diff(found))) == (96, 1049, {11})
    assert spread(rows[:7], 100) == rows[:7]


def test_overview_says_what_could_be_known_now(client: Client) -> None:
    rig = next(one for one in client.get("overview")["rigs"] if one["rig"] == "press-7")
    assert rig["known"] == "resolved now: k1, k2, B1; not B2: nothing moves"
    known = {row["parameter"]: row["known"] for row in rig["parameters"]}
    row = next(one for one in rig["parameters"] if one["parameter"] == "k1")
    half = (row["upper"] - row["lower"]) / 2.0
    assert known["k1"]["words"] == f"known to ± {half:.2g} N/m, {100.0 * half / 15.0:.2g} % of its limit"
    assert not known["B2"]["resolved"]
    assert known["B2"]["words"].startswith("not known: nothing moves; ± ")


def test_folder_of_configurations_belongs_to_the_database_that_is_named(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "conf.d").mkdir()
    (tmp_path / "conf.d" / "press-7.toml").write_text(files.CONFIG)  # it names a rig.db that nobody writes
    (database,) = several([folder / "rig.db"], [tmp_path / "conf.d"])
    assert (database.path, list(database.configs)) == (folder / "rig.db", ["press-7"])
    (tmp_path / "conf.d" / "rig.db").touch()
    assert len(several([folder / "rig.db"], [tmp_path / "conf.d"])) == 2


def test_password_that_the_service_manager_hands_over_may_be_readable_to_its_group(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "page.password"
    shutil.copy(folder / "password", path)
    path.chmod(0o440)  # so it looks where an access list names the user
    with pytest.raises(UsageError, match="may be used by others"):
        from_files(path, None)
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(tmp_path))
    assert from_files(path, None) is not None
    path.chmod(0o444)
    with pytest.raises(UsageError, match="may be used by others"):
        from_files(path, None)
