"""What reaches a target, and what is said of one that cannot be reached."""

import json
import sys
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from agent.cli.app import app
from agent.cli.operator import notify
from agent.cli.terminal.errors import guarded
from agent.config import load
from agent.config.reading.secrets import Secret
from agent.config.sections.results import Notify
from agent.errors import ConfigError
from agent.notification.message import message_of
from agent.notification.routing import quiet_s
from agent.notification.senders import SendError, send
from agent.storage.write.store import Store
from tests.notification.targets import Post, webhook
from tests.peers import ROOT
from tests.storage.rows import run_info, step

FACTS: dict[str, Any] = {
    "rig": "press-7", "site": "hall 2", "labels": '{"line": "3"}', "event_id": 9, "alarm_id": 4,
    "kind": "level",
    "parameter": "k1", "priority": "high", "from_state": "NORM", "to_state": "UNACK", "cause": "raise",
    "by": None,
    "comment": "\x1b[31m\r\nBcc: x@example.org", "t_ns": 1_767_225_600_000_000_000,
    "message": "k1 fell\r\nTo: x",
    "delta": -16.0, "percent": -12.5, "advice": None,
}  # fmt: skip
MESSAGE = message_of(FACTS)
WRITES = (
    "import os, sys; open('got', 'w').write(os.environ['DELTAK_IDEMPOTENCY_KEY'] + '\\n' + sys.stdin.read())"
)


def command(*words: str, **keys: Any) -> Notify:
    return Notify(name="c", kind="command", command=words, **keys)


def test_command_gets_the_document_and_the_key(tmp_path: Path) -> None:
    send(command(sys.executable, "-c", WRITES), MESSAGE, tmp_path)
    key, document = (tmp_path / "got").read_text(encoding="utf-8").split("\n")
    assert key == MESSAGE.key == "press-7-9-1767225600000000000"
    assert json.loads(document)["labels"] == {"line": "3"}


@pytest.mark.parametrize(
    ("target", "words"),
    [
        (command("false"), "exit code 1"),
        (command("no-such-program"), "No such file"),
        (command("sleep", "60", timeout_s=0.05), "did not end within 0.05 s"),
        (Notify(name="w", kind="webhook", url="http://127.0.0.1:1/"), "refused"),
        (
            Notify(name="w", kind="webhook", url=Secret(env="NOT_SET")),
            "variable NOT_SET with the secret is not set",
        ),
        (Notify(name="w", kind="webhook", url=Secret(file=Path("none"))), "No such file"),
    ],
)
def test_attempt_that_fails_says_why(target: Notify, words: str, tmp_path: Path) -> None:
    with pytest.raises(SendError, match=words):
        send(target, MESSAGE, tmp_path)


PLANTED = "PLANTED-5ecret"


@pytest.mark.filterwarnings("ignore:.imghdr.:DeprecationWarning")  # of what apprise imports
@pytest.mark.parametrize(
    ("kind", "url", "token"),
    [
        ("webhook", f"http://anna:{PLANTED}@127.0.0.1/", None),
        ("webhook", f"http://127.0.0.1:1/a {PLANTED}", None),
        ("webhook", f"http://127.0.0.1:1/{PLANTED}\nb", None),
        ("webhook", "http://127.0.0.1:1/", f"{PLANTED}\nb"),
        ("apprise", f"tgram://{PLANTED}/1", None),
        ("apprise", PLANTED, None),
    ],
)
def test_secret_that_makes_no_address_nor_header_is_said_to_nobody(
    kind: Any, url: str, token: str | None, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("DEBUG")
    secrets = {"url": url} | ({} if token is None else {"token": token})
    for name, text in secrets.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    target = Notify(name="w", kind=kind, **{name: Secret(file=Path(name)) for name in secrets})
    with pytest.raises(SendError) as error:
        send(target, MESSAGE, tmp_path)
    assert PLANTED not in str(error.value) + caplog.text


def test_address_of_a_webhook_may_stand_in_a_file(tmp_path: Path) -> None:
    post = Post()
    with webhook(post) as url:
        (tmp_path / "url").write_text(f"{url}\n", encoding="utf-8")
        send(Notify(name="w", kind="webhook", url=Secret(file=Path("url"))), MESSAGE, tmp_path)
    assert post.accepted == [MESSAGE.key]


@pytest.mark.filterwarnings("ignore:.imghdr.:DeprecationWarning")  # of what it imports
def test_service_that_apprise_knows_gets_the_text(tmp_path: Path) -> None:
    post = Post()
    with webhook(post) as url:
        send(Notify(name="s", kind="apprise", url=url.replace("http", "json")), MESSAGE, tmp_path)
    assert len(post.attempts) == 1
    with pytest.raises(SendError, match="none that apprise knows"):
        send(Notify(name="s", kind="apprise", url="nonsense"), MESSAGE, tmp_path)


def test_text_of_others_makes_no_lines_nor_orders_of_its_own() -> None:
    assert "\n" not in MESSAGE.subject
    assert "\x1b" not in MESSAGE.text
    assert len(MESSAGE.text.splitlines()) == 5
    assert "k1 fell To: x (-12.5 %)" in MESSAGE.text


@pytest.mark.parametrize(("hour", "left"), [(21, 0.0), (22, 8 * 3600.0), (5, 3600.0), (6, 0.0)])
def test_quiet_hours_end_at_their_hour_over_midnight(hour: int, left: float) -> None:
    target = command("true").model_copy(update={"quiet": (22 * 60, 6 * 60)})
    assert quiet_s(target, datetime(2026, 1, 1, hour).astimezone()) == left


def configured(tmp_path: Path, table: str) -> Any:
    text = (ROOT / "deploy/examples/modbus.toml").read_text(encoding="utf-8")
    (tmp_path / "rig.toml").write_text(f"{text}\n{table}", encoding="utf-8")
    return load(tmp_path / "rig.toml")


def test_target_is_read_from_the_configuration(tmp_path: Path) -> None:
    table = (
        '[[notify]]\nname = "mail"\nkind = "smtp"\nhost = "mail.example.org"\nsender = "rig@example.org"\n'
        'recipients = ["shift@example.org"]\nuser = "rig"\npassword = { file = "mail.secret" }\n'
        'quiet = "22:00-06:00"\npriority = "high"\nkinds = ["level"]\n'
    )
    (target,) = configured(tmp_path, table).notify
    assert (target.quiet, target.password, target.kinds) == (
        (1320, 360), Secret(file=Path("mail.secret")), ("level",)
    )  # fmt: skip


@pytest.mark.parametrize(
    ("keys", "path", "words"),
    [
        ('kind = "command"', "notify[0].command", "is missing"),
        ('kind = "webhook"\nurl = "ftp://anna:hush@x"', "notify[0].url", "is no address"),
        (
            'kind = "webhook"\nurl = "http://x"\ntoken = "abc"',
            "notify[0].token",
            "must not stand in a configuration",
        ),
        ('kind = "command"\ncommand = ["true"]\nhost = "x"', "notify[0].host", 'belongs to kind = "smtp"'),
        ('kind = "command"\ncommand = ["true"]\nquiet = "22-6"', "notify[0].quiet", "hours of the local day"),
        ('kind = "webhook"\nurl = "http://x"\ntoken = { }', "notify[0].token", "must name one place"),
    ],
)
def test_target_that_makes_no_sense_is_refused_by_its_key(
    tmp_path: Path, keys: str, path: str, words: str
) -> None:
    with pytest.raises(ConfigError) as error:
        configured(tmp_path, f'[[notify]]\nname = "a"\n{keys}\n')
    assert any(fault.path == path and words in fault.message for fault in error.value.faults), (
        error.value.faults
    )


def test_test_message_reaches_every_target_and_says_which_it_does_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = '[[notify]]\nname = "a"\nkind = "command"\ncommand = ["true"]\n'
    configured(tmp_path, table + table.replace('"a"', '"b"').replace("true", "false"))
    config = str(tmp_path / "rig.toml")
    assert guarded(app, ["notify", "test", config, "--json"]) == 2
    said = capsys.readouterr()
    found = json.loads(said.out)
    assert [(one["target"], one["error"]) for one in found["targets"]] == [
        ("a", None),
        ("b", "exit code 1: "),
    ]
    assert not found["ok"]
    assert [error["path"] for error in found["errors"]] == ["notify[1]"]
    assert said.err.startswith('deltak: error: notify[1]: "b" has not got the message: exit code 1')
    assert guarded(app, ["notify", "test", config]) == 2
    said = capsys.readouterr()
    assert "has the message" in said.out
    assert said.err.startswith("deltak: error: notify[1]: ")


def test_notifications_are_listed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "rig.db"
    with Store.open(path, route=lambda _: ["shift"]) as store:
        store.write(store.begin_run(run_info()), [step("NORM", "UNACK")])
    notify.listed(path, "json", dead=False)
    (row,) = json.loads(capsys.readouterr().out)["notifications"]
    assert row == {"id": 1, "alarm_event_id": 1, "target": "shift", "state": "pending", "attempts": 0,
                   "last_error": None, "done_at": None}  # fmt: skip
    notify.listed(path, "table", dead=True)
    assert "no notifications" in capsys.readouterr().out
