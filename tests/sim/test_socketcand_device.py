"""Simulated CAN on a socketcand of our own: read by bare sockets and by python-can, decoded by cantools."""

import errno
import re
import select
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import can
import cantools
import numpy as np
import pytest

from sim_bus.player import Player
from sim_bus.rig.rigfile import read_rig
from sim_bus.rig.scenario import load_scenario
from tests.ports import free_port
from tests.sim.rigs import LIMIT_S, MODEL, Simulator, refused, simulator
from tests.unit.sim_bus.devices.test_can_packing import DBC

CLASSIC = """
[[source]]
name = "canbus"
driver = "can"
interface = "socketcand"
host = "127.0.0.1"
port = {port}
channel = "can0"
dbc = "rig.dbc"
map = {{ force = "RIG_SAMPLE.Force", x1 = "RIG_SAMPLE.X1", x2 = "RIG_SAMPLE.X2" }}
counter = "RIG_SAMPLE.Counter"
"""
LONG = """
[[source]]
name = "long"
driver = "can"
interface = "socketcand"
port = {port}
channel = "can1"
fd = true
dbc = "rig.dbc"
map = {{ force = "RIG_LONG.F" }}
counter = "RIG_LONG.N"
"""
FRAME = re.compile(rb"< frame ([0-9A-F]+) (\d+\.\d{6}) ([0-9A-F]*) >")


class Daemon:
    """A socketcand client of one socket."""

    def __init__(self, port: int, channel: str = "can0") -> None:
        self.socket = socket.create_connection(("127.0.0.1", port), LIMIT_S)
        self.rest = b""
        self.expect(b"< hi >")
        self.send(b"< open %s >" % channel.encode())
        self.expect(b"< ok >")
        self.send(b"< rawmode >")
        self.expect(b"< ok >")

    def send(self, data: bytes) -> None:
        self.socket.sendall(data)

    def expect(self, answer: bytes) -> None:
        while answer not in self.rest:
            self.rest += self.socket.recv(4096)
        self.rest = self.rest.partition(answer)[2]

    def frames(self, count: int) -> list[tuple[bytes, float, bytes]]:
        """Return that many frames: identifier's digits, time, data."""
        out: list[tuple[bytes, float, bytes]] = []
        while len(out) < count:
            piece = self.socket.recv(1 << 16)
            assert piece
            *whole, self.rest = (self.rest + piece).split(b">")
            for text in whole:
                match = FRAME.fullmatch(text + b">")
                assert match, text
                out.append((match[1], float(match[2]), bytes.fromhex(match[3].decode())))
        return out


@contextmanager
def daemon(port: int, channel: str = "can0") -> Iterator[Daemon]:
    client = Daemon(port, channel)
    try:
        yield client
    finally:
        client.socket.close()


@contextmanager
def played(folder: Path, *options: str) -> Iterator[tuple[Simulator, int]]:
    port = free_port()
    (folder / "rig.dbc").write_text(DBC, encoding="utf-8")
    text = (MODEL + CLASSIC + LONG).format(port=port, rate=1000.0)
    (folder / "now.toml").write_text(
        'start = "ready"\n[[force]]\nkind = "random"\nrms = 5.0\n', encoding="utf-8"
    )
    with simulator(folder, text, *options) as sim:
        yield sim, port


def test_daemon_frames_decoded_by_cantools_are_the_truth(tmp_path: Path) -> None:
    with (
        played(tmp_path, "--scenario", "default") as (sim, port),
        daemon(port) as one,
        daemon(port, "can1") as two,
    ):
        classic, long = one.frames(300), two.frames(300)
        assert sim.stop() == 0
    message = cantools.database.load_string(DBC, "dbc").get_message_by_name("RIG_SAMPLE")
    rows = [message.decode(data) for _, _, data in classic]
    assert [row["Counter"] for row in rows] == list(range(len(rows)))
    readings = sim.truth()["readings"][: len(rows)]
    table = np.array([[row[name] for name in ("Force", "X1", "X2")] for row in rows], dtype=float)
    assert np.all(np.abs(table - readings) <= np.array([0.501e-3, 1.001e-6, 1.001e-3]))
    assert {digits for digits, _, _ in classic} == {b"100"}
    assert {digits for digits, _, _ in long} == {b"18FEF100"}
    assert {len(data) for _, _, data in long} == {16}
    numbers = [int.from_bytes(data[:4], "big") for _, _, data in long]
    assert numbers == list(range(len(long)))
    times = np.array([t for _, t, _ in classic])
    np.testing.assert_allclose(np.diff(times), 1e-3, atol=2e-6)


def test_daemon_speaks_to_python_can_and_is_paced(tmp_path: Path) -> None:
    with played(tmp_path, "--scenario", str(tmp_path / "now.toml")) as (sim, port):
        bus = can.Bus("can0", "socketcand", host="127.0.0.1", port=port)
        begun = time.monotonic()
        messages = [bus.recv(LIMIT_S) for _ in range(1000)]
        took = time.monotonic() - begun
        bus.shutdown()
        assert sim.stop() == 0
    counters = [int.from_bytes(message.data[:2], "little") for message in messages if message]
    assert np.all(np.diff(counters) == 1)
    assert 0.75 < took < 4.0
    ledger = sim.ledger()["sources"]["canbus"]
    assert ledger["lateness"]["wake_ups"] > 100
    assert ledger["lateness"]["p50_us"] < 20_000


def test_daemon_samples_without_a_reader_are_in_the_ledger(tmp_path: Path) -> None:
    with played(tmp_path, "--scenario", str(tmp_path / "now.toml")) as (sim, port):
        with daemon(port) as client:
            first = client.frames(50)
        time.sleep(0.1)  # nobody listens for a while
        with daemon(port) as again:
            second = again.frames(50)
        assert sim.stop() == 0
    unheard = sim.ledger()["sources"]["canbus"]["unheard"]
    received = [int.from_bytes(data[:2], "little") for _, _, data in (*first, *second)]
    assert unheard[0][0] == 0
    assert unheard[0][1] == received[0] - 1
    assert any(last == received[len(first)] - 1 for _, last in unheard)
    assert not any(first <= number <= last for number in received for first, last in unheard)


def test_daemon_fast_is_held_back_by_its_reader(tmp_path: Path) -> None:
    options = ("--scenario", "steady", "--duration", "20", "--fast")
    with played(tmp_path, *options) as (sim, port), daemon(port) as one, daemon(port, "can1") as two:
        begun = time.monotonic()
        numbers: list[int] = []
        long = 0
        while len(numbers) < 20_000 or long < 20_000:
            ready, _, _ = select.select([one.socket, two.socket], [], [], LIMIT_S)
            assert ready
            if one.socket in ready:
                numbers += [int.from_bytes(data[:2], "little") for _, _, data in one.frames(1)]
            if two.socket in ready:
                long += len(two.frames(1))
        took = time.monotonic() - begun
        assert sim.end() == 0
    assert numbers == list(range(20_000))
    assert took < 15.0
    assert sim.ledger()["sources"]["canbus"]["lost"] == []


def test_daemon_counts_frames_that_clients_send(tmp_path: Path) -> None:
    with played(tmp_path) as (sim, port):
        with daemon(port) as client:
            client.send(b"< send 123 2 11 22 >< echo >")
            client.expect(b"< echo >")
        assert sim.stop() == 0
    assert sim.ledger()["sources"]["canbus"]["frames_from_clients"] == 1


def test_daemon_unknown_bus_is_refused(tmp_path: Path) -> None:
    with played(tmp_path) as (_, port), socket.create_connection(("127.0.0.1", port), LIMIT_S) as client:
        assert client.recv(100) == b"< hi >"
        client.sendall(b"< open can7 >")
        assert client.recv(100).startswith(b"< error")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('host = "127.0.0.1"', 'host = "10.0.0.1"'), "source[0].host: this looks like a real bus"),
        (
            ('interface = "socketcand"', 'interface = "socketcan"'),
            "source[0].channel: this looks like a real bus",
        ),
        (('dbc = "rig.dbc"', 'dbc = "none.dbc"'), "source[0].dbc"),
        (("RIG_SAMPLE.X1", "RIG_SAMPLE.X9"), "RIG_SAMPLE.X9"),
    ],
)
def test_sim_can_source_that_cannot_be_played_is_refused(
    tmp_path: Path, change: tuple[str, str], words: str
) -> None:
    (tmp_path / "rig.dbc").write_text(DBC, encoding="utf-8")
    sim = refused(tmp_path, (MODEL + CLASSIC).format(port=free_port(), rate=1000.0).replace(*change, 1))
    assert sim.code == 2
    assert words in sim.err
    assert "Traceback" not in sim.err


def test_virtual_bus_is_played_to_readers_of_the_same_process(tmp_path: Path) -> None:
    (tmp_path / "rig.dbc").write_text(DBC, encoding="utf-8")
    text = (
        (MODEL + CLASSIC).format(port=0, rate=1000.0).replace("socketcand", "virtual").replace("port = 0", "")
    )
    (tmp_path / "rig.toml").write_text(text, encoding="utf-8")
    player = Player(read_rig(tmp_path / "rig.toml"), load_scenario("steady"), duration_s=0.1)
    player.start()
    try:
        with can.Bus("can0", "virtual") as reader:
            frames = [reader.recv(LIMIT_S) for _ in range(50)]
    finally:
        player.finish()
    assert {frame.arbitration_id for frame in frames if frame} == {0x100}
    message = cantools.database.load_string(DBC, "dbc").get_message_by_name("RIG_SAMPLE")
    assert [message.decode(frame.data)["Counter"] for frame in frames if frame] == list(range(50))


def test_virtual_bus_of_the_command_is_ready_and_says_that_nobody_else_sees_it(tmp_path: Path) -> None:
    (tmp_path / "rig.dbc").write_text(DBC, encoding="utf-8")
    text = (
        (MODEL + CLASSIC).format(port=0, rate=1000.0).replace("socketcand", "virtual").replace("port = 0", "")
    )
    with simulator(tmp_path, text) as sim:
        assert sim.stop() == 0
    assert "a virtual bus does not leave its process" in sim.err


def test_sim_vcan_without_can_in_the_kernel_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_can(*_: object) -> socket.socket:
        raise OSError(errno.EAFNOSUPPORT, "Address family not supported by protocol")

    (tmp_path / "rig.dbc").write_text(DBC, encoding="utf-8")
    text = (MODEL + CLASSIC).format(port=free_port(), rate=1000.0)
    monkeypatch.setattr("sim_bus.devices.can.kernel.socket.socket", no_can)
    sim = refused(tmp_path, text.replace("socketcand", "socketcan").replace("can0", "vcan0"))
    assert sim.code == 4
    assert "this kernel has no CAN" in sim.err
