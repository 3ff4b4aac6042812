import os
import socket
import stat
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import pytest

from agent.cli.gateway.agent_of import database_of
from agent.config import load
from agent.errors import StoreError
from agent.storage.database.files import beside
from agent.storage.write import command_socket
from agent.storage.write.command_socket import CommandServer, ask
from tests.peers import ROOT

RIGS = [{"rig": f"press-{number}", "sources": ["x" * 300]} for number in range(2000)]
"""More than any agent has."""


def twice(asked: Mapping[str, Any]) -> Mapping[str, Any]:
    return {"answer": 2 * asked["number"]}


def refuse(asked: Mapping[str, Any]) -> Mapping[str, Any]:
    raise StoreError.at("alarm 7", "there is no such alarm", "see deltak alarms")


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Path]:
    path = tmp_path / "rig.db"
    made = CommandServer(path, {"twice": twice, "refuse": refuse, "many": lambda _: {"rigs": RIGS}})
    made.start()
    yield path
    made.stop()
    assert not beside(path, ".sock").exists()


def test_ask_returns_what_the_agent_answers(server: Path) -> None:
    assert ask(server, "twice", number=21) == {"answer": 42}
    assert ask(server, "ping")["pid"] > 0


@pytest.mark.parametrize("configured", [True, False])
def test_agent_that_was_started_with_another_database_is_found_by_its_configuration(
    tmp_path: Path, configured: bool
) -> None:
    config = tmp_path / "rig.toml"
    config.write_bytes((ROOT / "deploy/examples/modbus.toml").read_bytes())
    listed = [str(config)] if configured else [str(tmp_path / "other.toml")]
    agent = CommandServer(tmp_path / "elsewhere.db", {"status": lambda _: {"configs": listed}})
    agent.start()
    try:
        own = load(config).store.path
        assert database_of(config) == (tmp_path / "elsewhere.db" if configured else own)
    finally:
        agent.stop()


def test_status_of_hundreds_of_rigs_arrives_whole(server: Path) -> None:
    assert ask(server, "many") == {"rigs": RIGS}
    assert ask(server, "many", brief=True) == {"rigs": RIGS}


@pytest.mark.parametrize(
    ("command", "arguments", "words"),
    [
        ("refuse", {}, "alarm 7: there is no such alarm; see deltak alarms"),
        ("nothing", {}, "not a command; commands are many, ping, refuse, twice"),
        ("twice", {}, "KeyError"),
    ],
)
def test_ask_tells_of_what_was_refused(
    server: Path, command: str, arguments: dict[str, Any], words: str
) -> None:
    with pytest.raises(StoreError, match=words) as caught:
        ask(server, command, **arguments)
    assert caught.value.exit_code == 3


def test_brief_command_is_given_up_in_time_though_the_agent_shows_signs_of_life(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command_socket, "LIFE_SIGN_S", 0.05)
    release = threading.Event()
    made = CommandServer(tmp_path / "rig.db", {"wait": lambda _: {"over": release.wait(20)}})
    made.start()
    with pytest.raises(
        StoreError, match=r"did not answer in 0.3 s; it may still be done: look, then try again"
    ):
        ask(tmp_path / "rig.db", "wait", 0.3, brief=True)
    release.set()
    assert ask(tmp_path / "rig.db", "wait", 0.3, brief=True) == {"over": True}
    made.stop()


def test_socket_is_the_owners_and_that_of_the_group_that_commands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for group, mode in ((None, 0o600), (os.getegid(), 0o660)):
        monkeypatch.setattr(command_socket, "command_group", lambda group=group: group)
        made = CommandServer(tmp_path / "rig.db", {"twice": twice})
        made.start()
        found = beside(tmp_path / "rig.db", ".sock").stat()
        assert (stat.S_IMODE(found.st_mode), found.st_gid) == (mode, os.getegid())
        made.stop()


def test_clients_that_dribble_keep_nobody_waiting(server: Path) -> None:
    """Each says a little now and then, so that no time-out of a single reading ever passes."""
    stop = threading.Event()
    peers = [socket.socket(socket.AF_UNIX) for _ in range(20)]
    for peer in peers:
        peer.connect(str(beside(server, ".sock")))

    def dribble() -> None:
        while not stop.wait(0.05):
            for peer in peers:
                with suppress(OSError):
                    peer.send(b"{")

    thread = threading.Thread(target=dribble)
    thread.start()
    try:
        begin = time.monotonic()
        assert ask(server, "twice", number=4) == {"answer": 8}
        assert time.monotonic() - begin < 20.0
    finally:
        stop.set()
        thread.join()
        for peer in peers:
            peer.close()


def test_client_waits_to_be_let_in_where_others_wait_already(tmp_path: Path) -> None:
    path = tmp_path / "rig.db"
    with ExitStack() as held, held.enter_context(socket.socket(socket.AF_UNIX)) as listener:
        listener.bind(str(beside(path, ".sock")))
        listener.listen(0)
        count = 0
        with suppress(BlockingIOError):  # until nobody more may wait
            while count < 100:
                peer = held.enter_context(socket.socket(socket.AF_UNIX))
                peer.setblocking(False)
                peer.connect(str(beside(path, ".sock")))
                count += 1
        assert count < 100
        with pytest.raises(StoreError, match=r"did not answer in 0\.05 s"):
            ask(path, "twice", timeout_s=0.05)

        def let_in() -> None:
            for _ in range(count):
                listener.accept()[0].close()
            with listener.accept()[0] as asking:
                asking.recv(100)
                asking.sendall(b'{"ok": true, "answer": 8}\n')

        thread = threading.Thread(target=let_in)
        thread.start()
        assert ask(path, "twice", timeout_s=10) == {"answer": 8}
        thread.join()


def test_client_that_dribbles_is_cut_off_in_the_end(server: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command_socket, "PATIENCE_S", 0.2)
    with socket.socket(socket.AF_UNIX) as peer:
        peer.connect(str(beside(server, ".sock")))
        peer.send(b"{")
        peer.settimeout(5.0)
        assert peer.recv(100) == b""


def test_more_commands_than_are_done_at_a_time_are_told_so(tmp_path: Path) -> None:
    release = threading.Event()
    made = CommandServer(tmp_path / "rig.db", {"wait": lambda _: {"over": release.wait(20)}})
    made.start()
    peers = [socket.socket(socket.AF_UNIX) for _ in range(4)]
    for peer in peers:
        peer.connect(str(beside(tmp_path / "rig.db", ".sock")))
        peer.sendall(b'{"command": "wait"}\n')
    with pytest.raises(StoreError, match="4 commands are being done; try again"):
        ask(tmp_path / "rig.db", "ping")
    release.set()
    assert all(b"true" in peer.recv(100) for peer in peers)
    for peer in peers:
        peer.close()
    made.stop()


@pytest.mark.parametrize(
    "line", [b"\n", b"[]\n", b'{"command": 3}\n', b"\xff\xfe\n", b"x" * 70_000, b"[" * 60_000]
)
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


def test_group_is_let_in_where_no_file_may_be_given_away(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError

    file = tmp_path / "x.sock"
    file.touch(mode=0o600)
    monkeypatch.setattr(os, "chown", refuse)
    command_socket._let_in(file, 4711)
    assert stat.S_IMODE(file.stat().st_mode) == 0o660
    assert os.getxattr(file, "system.posix_acl_access") == command_socket.access_list(4711)
