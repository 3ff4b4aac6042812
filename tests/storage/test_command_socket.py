import socket
import stat
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from agent.errors import StoreError
from agent.storage.command_socket import CommandServer, ask
from agent.storage.files import beside


def twice(asked: Mapping[str, Any]) -> Mapping[str, Any]:
    return {"answer": 2 * asked["number"]}


def refuse(asked: Mapping[str, Any]) -> Mapping[str, Any]:
    raise StoreError.at("alarm 7", "there is no such alarm", "see deltak alarms")


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Path]:
    path = tmp_path / "rig.db"
    made = CommandServer(path, {"twice": twice, "refuse": refuse})
    made.start()
    yield path
    made.stop()
    assert not beside(path, ".sock").exists()


def test_ask_returns_what_the_agent_answers(server: Path) -> None:
    assert ask(server, "twice", number=21) == {"answer": 42}
    assert ask(server, "ping")["pid"] > 0


@pytest.mark.parametrize(
    ("command", "arguments", "words"),
    [
        ("refuse", {}, "alarm 7: there is no such alarm; see deltak alarms"),
        ("nothing", {}, "not a command; commands are ping, refuse, twice"),
        ("twice", {}, "KeyError"),
    ],
)
def test_ask_tells_of_what_was_refused(server: Path, command: str, arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(StoreError, match=words) as caught:
        ask(server, command, **arguments)
    assert caught.value.exit_code == 3


def test_socket_may_be_used_by_owner_and_group_only(server: Path) -> None:
    assert stat.S_IMODE(beside(server, ".sock").stat().st_mode) == 0o660


@pytest.mark.parametrize("line", [b"\n", b"[]\n", b'{"command": 3}\n', b"\xff\xfe\n", b"x" * 70_000, b"[" * 60_000])
def test_server_survives_lines_that_are_no_commands(server: Path, line: bytes) -> None:
    with socket.socket(socket.AF_UNIX) as peer:
        peer.connect(str(beside(server, ".sock")))
        peer.sendall(line)
        peer.shutdown(socket.SHUT_WR)
        assert b"not a command" in peer.recv(4096)
    assert ask(server, "twice", number=1) == {"answer": 2}


def test_ask_without_an_agent_and_with_a_silent_one_fails_in_time(tmp_path: Path) -> None:
    path = tmp_path / "rig.db"
    with pytest.raises(StoreError, match="cannot be asked"):
        ask(path, "ping")
    release = threading.Event()
    made = CommandServer(path, {"wait": lambda _: {"over": release.wait(20)}})
    made.start()
    with pytest.raises(StoreError, match=r"did not answer in 0\.2 s"):
        ask(path, "wait", timeout_s=0.2)
    release.set()
    made.stop()


def test_socket_left_by_a_killed_agent_is_replaced_and_long_paths_work(tmp_path: Path) -> None:
    folder = tmp_path / ("long-" * 20)
    folder.mkdir()
    path = folder / "rig.db"
    beside(path, ".sock").write_bytes(b"")
    made = CommandServer(path, {"twice": twice})
    made.start()
    assert ask(path, "twice", number=3) == {"answer": 6}
    made.stop()
