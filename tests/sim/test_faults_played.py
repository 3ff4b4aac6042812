"""Faults on real lines: what a reader meets, and that the ledger agrees with it to the sample."""

import io
import json
import socket
import struct
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from sim_bus import commands
from sim_bus.commands import sim as sim_command
from sim_bus.player import Player
from sim_bus.rig.fault_names import names
from sim_bus.rig.rigfile import read_rig
from sim_bus.rig.scenario import load_scenario
from tests.ports import free_port
from tests.sim.rigs import LIMIT_S, MODEL, RawModbus, refused, ring_config, simulator, until
from tests.sim.test_serial_device import BINARY, opened, read
from tests.sim.test_socketcand_device import daemon, played

Connect = Callable[[int], RawModbus]
FRAME = 18


def numbers(data: bytes) -> np.ndarray:
    """Return the counters of whole frames."""
    return (
        np.frombuffer(data[: len(data) // FRAME * FRAME], np.uint8)
        .reshape(-1, FRAME)[:, 2:4]
        .copy()
        .view("<u2")[:, 0]
    )


def test_serial_dropped_samples_are_missing_and_in_the_ledger(tmp_path: Path) -> None:
    text = (MODEL + BINARY).format(rate=1000.0)
    with simulator(tmp_path, text, "--fault", "serial.drop@0.1s+0.02s", "--fault", "serial.drop@0.2") as sim:
        with opened(tmp_path / "line") as line:
            data = read(line, 300 * FRAME)
        assert sim.stop() == 0
    missing = sorted(set(range(300)) - set(numbers(data).tolist()))
    assert missing == [*range(100, 120), 200]
    ledger = sim.ledger()["sources"]["line"]
    assert ledger["faults"] == [
        {"fault": "drop", "samples": [[100, 119]]},
        {"fault": "drop", "samples": [[200, 200]]},
    ]


def test_serial_line_that_is_unplugged_comes_back_under_its_name(tmp_path: Path) -> None:
    text = (MODEL + BINARY).format(rate=1000.0)
    with simulator(tmp_path, text, "--fault", "serial.disconnect@0.1+0.2") as sim:
        with opened(tmp_path / "line") as line:
            before = read(line, 50 * FRAME)
            until(lambda: not (tmp_path / "line").is_symlink())
        until((tmp_path / "line").exists)
        with opened(tmp_path / "line") as line:
            after = read(line, 50 * FRAME)
        assert sim.stop() == 0
    start = after.index(b"\xaa\x55")
    resumed = int(numbers(after[start:])[0])
    assert numbers(before)[0] == 0
    assert resumed > 300
    assert any(last == resumed - 1 for _, last in sim.ledger()["sources"]["line"]["unheard"])


def test_socketcand_that_dies_refuses_and_comes_back(tmp_path: Path) -> None:
    options = ("--scenario", "steady", "--fault", "can.disconnect@0.1+0.2")
    with played(tmp_path, *options) as (sim, port):
        with daemon(port) as one, daemon(port, "can1"):
            one.frames(50)
            one.socket.settimeout(LIMIT_S)
            while one.socket.recv(1 << 16):
                pass

        def back() -> bool:
            try:
                socket.create_connection(("127.0.0.1", port), LIMIT_S).close()
            except ConnectionRefusedError:
                return False
            return True

        until(back)
        with daemon(port) as again:
            resumed = int.from_bytes(again.frames(1)[0][2][:2], "little")
        assert sim.stop() == 0
    assert resumed >= 290
    assert any(last == resumed - 1 for _, last in sim.ledger()["sources"]["canbus"]["unheard"])


def index_or_none(connect: Connect, port: int) -> int | None:
    try:
        return connect(port).index()
    except (OSError, AssertionError):
        return None


def test_modbus_server_that_dies_refuses_and_comes_back_with_its_ring(
    tmp_path: Path, connect: Connect
) -> None:
    port = free_port()
    with simulator(tmp_path, ring_config(port), "--fault", "modbus.disconnect@0.1+0.3") as sim:
        assert connect(port).index() >= 1
        until(lambda: index_or_none(connect, port) is None)
        until(lambda: index_or_none(connect, port) is not None)
        index = connect(port).index()
        first = connect(port).registers(16, 3)
        assert sim.stop() == 0
    assert index >= 390
    truth = np.rint(sim.truth()["readings"][0] / [1e-3, 2e-6, 2e-3]).astype(int)
    assert first == (truth & 0xFFFF).tolist()


def test_modbus_busy_answers_exception_6_and_recovers(tmp_path: Path, connect: Connect) -> None:
    port = free_port()
    with simulator(tmp_path, ring_config(port), "--fault", "modbus.busy@0.1+0.2") as sim:
        client = connect(port)
        ask = struct.pack(">BHH", 4, 0, 2)
        until(lambda: client.request(ask) == bytes([0x84, 6]))
        until(lambda: client.request(ask)[0] == 4)
        assert client.index() >= 300
        assert sim.stop() == 0
    assert sim.ledger()["sources"]["plc"]["faults"] == [{"fault": "busy", "samples": [[100, 299]]}]


def test_modbus_hanging_device_shows_old_registers(tmp_path: Path, connect: Connect) -> None:
    port = free_port()
    with simulator(tmp_path, ring_config(port), "--fault", "modbus.hang@0.1+0.2") as sim:
        client = connect(port)
        seen = [client.index()]
        while seen[-1] < 310:
            seen.append(client.index())
        assert sim.stop() == 0
    assert not any(105 < index < 295 for index in seen)


def test_modbus_silent_device_does_not_answer(tmp_path: Path, connect: Connect) -> None:
    port = free_port()
    with simulator(tmp_path, ring_config(port), "--fault", "modbus.silent@0.1+0.3") as sim:
        client, longest, index = connect(port), 0.0, 0
        while index < 450:
            begun = time.monotonic()
            client._socket.settimeout(0.15)
            try:
                index = client.index()
            except TimeoutError:
                client = connect(port)
            longest = max(longest, time.monotonic() - begun)
        assert sim.stop() == 0
    assert longest > 0.14


def test_sim_unknown_fault_names_those_there_are(tmp_path: Path) -> None:
    sim = refused(tmp_path, ring_config(free_port()), "--fault", "modbus.melt@1")
    assert sim.code == 2
    assert 'no fault is called "modbus.melt"' in sim.err
    assert "--list-faults" in sim.err


def test_modbus_answers_that_are_wrong_are_so_while_the_fault_lasts(tmp_path: Path) -> None:
    """One live server, one wrong byte: the header's unit; before and after it answers as it should."""
    port = free_port()
    with simulator(tmp_path, ring_config(port), "--fault", "modbus.wrong-unit@0.1+0.2") as sim:
        units: list[int] = []
        with socket.create_connection(("127.0.0.1", port), LIMIT_S) as line:

            def unit() -> int:
                line.sendall(struct.pack(">HHHBBHH", 1, 0, 6, 1, 4, 0, 2))
                reply = line.recv(64)
                assert len(reply) == 13
                return reply[6]

            until(lambda: units.append(unit()) or (2 in units and units[-1] == 1))
        assert sim.stop() == 0
    assert set(units) == {1, 2}


def test_modbus_answers_come_byte_by_byte_or_late(tmp_path: Path) -> None:
    port = free_port()
    options = ("--fault", "modbus.dribble@0.05+0.2", "--fault", "modbus.slow@0.3+5")
    with simulator(tmp_path, ring_config(port), *options) as sim:
        pieces, waited = [], 0.0
        with socket.create_connection(("127.0.0.1", port), LIMIT_S) as line:
            while waited < 0.2:
                begun = time.monotonic()
                line.sendall(struct.pack(">HHHBBHH", 1, 0, 6, 1, 4, 0, 2))
                reply = [line.recv(64)]
                while sum(map(len, reply)) < 13:
                    reply.append(line.recv(64))
                pieces.append(len(reply))
                waited = time.monotonic() - begun
        assert sim.stop() == 0
    assert max(pieces) >= 4
    assert pieces[0] == pieces[-1] == 1


def test_sim_lists_every_fault_with_what_is_told_of_it() -> None:
    app = typer.Typer()
    app.command()(sim_command)
    result = CliRunner().invoke(app, ["--list-faults"])
    assert result.exit_code == 0
    assert [line.partition(":")[0] for line in result.stdout.splitlines()] == names()
    assert (
        "serial.baud: every byte is another one, as at a wrong bit rate (0.5 s); the agent" in result.stdout
    )


def answers(line: socket.socket) -> bytes:
    """Ask for the index and return what comes until it is whole; raises OSError if the connection breaks."""
    line.sendall(struct.pack(">HHHBBHH", 1, 0, 6, 1, 4, 0, 2))
    reply = b""
    while len(reply) < 13:
        piece = line.recv(64)
        if not piece:
            raise ConnectionError(f"closed after {len(reply)} bytes")
        reply += piece
    return reply


def ask_on(line: socket.socket) -> None:
    """Ask until there is no answer."""
    while answers(line):
        pass


@pytest.mark.parametrize(
    ("fault", "possible"),
    [
        ("reset", {"ConnectionResetError"}),
        # a question that crosses the end of a connection is answered by a reset
        ("hang-up", {"ConnectionError", "ConnectionResetError", "BrokenPipeError"}),
    ],
)
def test_modbus_connection_ends_in_or_after_an_answer_and_can_be_made_anew(
    fault: str, possible: set[str], tmp_path: Path
) -> None:
    port = free_port()
    with simulator(tmp_path, ring_config(port), "--fault", f"modbus.{fault}@0.1+0.2") as sim:
        ends: list[str] = []
        while not ends or ends[-1] != "whole":
            with socket.create_connection(("127.0.0.1", port), LIMIT_S) as line:
                line.settimeout(LIMIT_S)
                try:
                    while not (answers(line) and ends):
                        pass
                    ends.append("whole")
                except OSError as error:
                    ends.append(type(error).__name__)
        assert sim.stop() == 0
    assert ends[:-1]
    assert set(ends[:-1]) <= possible


def test_modbus_black_hole_answers_nobody_and_lets_nobody_in(tmp_path: Path) -> None:
    port = free_port()
    with simulator(tmp_path, ring_config(port), "--fault", "modbus.black-hole@0.1+0.4") as sim:
        with socket.create_connection(("127.0.0.1", port), LIMIT_S) as line:
            line.settimeout(0.2)
            with pytest.raises(TimeoutError):
                ask_on(line)
            with pytest.raises(TimeoutError):
                socket.create_connection(("127.0.0.1", port), 0.1)

        def index() -> int:
            try:
                with socket.create_connection(("127.0.0.1", port), 0.1) as again:
                    again.settimeout(LIMIT_S)
                    return int.from_bytes(answers(again)[9:], "big")
            except OSError:
                return 0

        until(lambda: index() >= 500)
        assert sim.stop() == 0


def test_sim_lists_every_fault_as_json_where_that_is_asked_for() -> None:
    app = typer.Typer()
    app.command()(sim_command)
    result = CliRunner().invoke(app, ["--list-faults", "--json"])
    listed = json.loads(result.stdout)["faults"]
    assert [fault["name"] for fault in listed] == names()
    assert listed[0] == {
        "name": "can.drop",
        "words": "the sample is not sent",
        "lasts_s": 0.0,
        "cause": "gap",
    }


def test_sim_errors_are_a_json_document_where_that_is_asked_for(tmp_path: Path) -> None:
    sim = refused(
        tmp_path, ring_config(free_port()), "--json", "--fault", "can.drop@1", "--fault", "modbus.silent:x@1"
    )
    assert sim.code == 2
    errors = json.loads(sim.out)["errors"]
    assert [error["path"] for error in errors] == ["--fault", "--fault"]
    assert errors[1] == {
        "path": "--fault",
        "message": 'modbus.silent: no modbus source is called "x"',
        "advice": "sources are plc (modbus)",
    }
    assert len(sim.err.splitlines()) == 2


def test_sim_without_a_configuration_says_so() -> None:
    app = typer.Typer()
    app.command()(sim_command)
    result = CliRunner().invoke(app, [])
    assert (result.exit_code, result.stdout) == (2, "")
    assert "missing argument 'CONFIG'" in result.stderr


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--duration", "inf"), "duration"),
        (("--truth", "/no/such/folder/truth.npz"), "/no/such/folder is no folder that can be written to"),
        (("--truth", "/tmp"), "/tmp is a folder"),
        (("--scenario", "nowhere"), 'scenario: "nowhere" is neither a file nor one of'),
        (("--fault", "modbus.silent@8s", "--duration", "2"), "at 8 s all is over, after 2 s"),
    ],
)
def test_sim_what_cannot_be_played_is_refused_before_anything_is(
    options: tuple[str, ...], words: str, tmp_path: Path
) -> None:
    sim = refused(tmp_path, ring_config(free_port()), *options)
    assert sim.code == 2
    assert words in sim.err
    assert "ready" not in sim.out


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("durations = 3", 'durations: there is no such key; did you mean "duration_s"?'),
        ("[[change]]\nat_s = 1\nvalue = { m1 = -5.0 }", "change: m1: -5 kg: a mass stays above 0"),
        ("[[change]]\nat_s = 1\ndelta = { k9 = 1.0 }", "change: k9: the configuration has no such thing"),
        ('[[force]]\nkind = "recorded"\nfile = "empty.csv"\ncolumn = "a"', "has no numbers, or gaps"),
        ('[[force]]\nkind = "recorded"\nfile = "no.csv"\ncolumn = "a"', "cannot be read: No such file"),
        ("a = \udcff", "is no text in UTF-8 (byte 4)"),
    ],
)
def test_sim_scenario_that_cannot_be_is_refused_in_words(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "empty.csv").write_text("t,a\n0,nan\n", encoding="utf-8")
    scenario = tmp_path / "odd.toml"
    scenario.write_bytes(text.encode("utf-8", "surrogateescape"))
    sim = refused(tmp_path, ring_config(free_port()), "--scenario", str(scenario))
    assert sim.code == 2
    assert words in sim.err


def test_sim_that_nobody_reads_says_what_it_waits_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(commands, "ALONE_S", 0.1)
    said = io.StringIO()
    monkeypatch.setattr("sys.stderr", said)
    (tmp_path / "rig.toml").write_text((MODEL + BINARY).format(rate=1000.0), encoding="utf-8")
    player = Player(read_rig(tmp_path / "rig.toml"), load_scenario("steady"))
    commands._wait_for_readers(player, threading.Event())
    assert said.getvalue() == "deltak: note: the clock starts when line is read; nobody reads it yet\n"
