"""`sim` as a process: read by bare sockets and by mbpoll, paced, refused, stopped."""

import re
import struct
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests import peers
from tests.ports import free_port
from tests.sim.rigs import (
    LIMIT_S,
    MODEL,
    RawModbus,
    Simulator,
    int16,
    refused,
    ring_config,
    simulator,
    until,
)

SLOTS = 1024
REGISTERS = 3
Connect = Callable[[int], RawModbus]


def ring_slots(client: RawModbus, first: int, end: int) -> list[list[int]]:
    """Read samples first .. end − 1 out of the ring by plain requests."""
    out: list[list[int]] = []
    while first < end:
        slot = first % SLOTS
        count = min(41, end - first, SLOTS - slot)
        numbers = int16(client.registers(16 + slot * REGISTERS, count * REGISTERS))
        out += [numbers[start : start + REGISTERS] for start in range(0, len(numbers), REGISTERS)]
        first += count
    return out


def read_all(client: RawModbus, total: int) -> np.ndarray:
    """Follow the ring from sample 0 to the last."""
    rows: list[list[int]] = []
    deadline = time.monotonic() + LIMIT_S
    while len(rows) < total:
        assert time.monotonic() < deadline
        rows += ring_slots(client, len(rows), client.index())
    return np.array(rows)


def test_ring_whole_scenario_read_by_sockets_equals_the_truth(tmp_path: Path, connect: Connect) -> None:
    port = free_port()
    with simulator(tmp_path, ring_config(port), "--scenario", "default", "--duration", "0.6") as sim:
        rows = read_all(connect(port), 600)
        assert sim.end() == 0
    truth = sim.truth()
    assert len(truth["index"]) == 600
    expected = np.rint(truth["readings"] / [1e-3, 2e-6, 2e-3])
    np.testing.assert_array_equal(rows, expected)
    ledger = sim.ledger()
    assert (ledger["samples"], ledger["first"], ledger["last"]) == (600, 0, 599)
    assert ledger["sources"]["plc"]["saturated"] == {}


def test_ring_index_follows_the_monotonic_clock(tmp_path: Path, connect: Connect) -> None:
    port = free_port()
    with simulator(tmp_path, ring_config(port), "--scenario", "steady") as sim:
        client = connect(port)
        client.index()
        late, early = [], []
        begun = time.monotonic()
        while time.monotonic() < begun + 1.0:
            before = time.monotonic_ns()
            index = client.index()
            late.append((before, index))
            early.append((time.monotonic_ns(), index))
        assert sim.stop() == 0
    start = sim.ledger()["started_monotonic_ns"]
    # the reply's index was right at some instant between asking and hearing: to the sample, at every request
    assert all(index >= (t - start) * 1000 // 10**9 + 1 for t, index in late)
    assert all(index <= (t - start) * 1000 // 10**9 + 1 for t, index in early)
    assert len(late) > 50


def test_ring_first_request_starts_the_clock(tmp_path: Path, connect: Connect) -> None:
    port = free_port()
    with simulator(tmp_path, ring_config(port), "--scenario", "steady"):
        assert 1 <= connect(port).index() < 100


def test_ring_start_ready_does_not_wait_for_a_reader(tmp_path: Path, connect: Connect) -> None:
    port = free_port()
    (tmp_path / "now.toml").write_text('start = "ready"\nduration_s = 0.05\n', encoding="utf-8")
    with simulator(tmp_path, ring_config(port), "--scenario", str(tmp_path / "now.toml")):
        client = connect(port)
        until(lambda: client.index() == 50)


def test_ring_after_the_last_sample_the_device_keeps_answering(tmp_path: Path, connect: Connect) -> None:
    port = free_port()
    (tmp_path / "s.toml").write_text("duration_s = 0.02\n", encoding="utf-8")
    with simulator(tmp_path, ring_config(port), "--scenario", str(tmp_path / "s.toml")) as sim:
        client = connect(port)
        until(lambda: client.index() == 20)
        assert client.index() == 20
        assert sim.stop() == 0


def test_ring_fast_never_overtakes_a_slow_reader(tmp_path: Path, connect: Connect) -> None:
    port = free_port()
    options = ("--scenario", "default", "--duration", "8", "--fast")
    with simulator(tmp_path, ring_config(port), *options) as sim:
        begun = time.monotonic()
        client = connect(port)
        assert client.index() == (SLOTS - 1) // 2
        assert client.index() == (SLOTS - 1) // 2
        rows = read_all(client, 8000)
        took = time.monotonic() - begun
        assert sim.end() == 0
    expected = np.rint(sim.truth()["readings"] / [1e-3, 2e-6, 2e-3])
    np.testing.assert_array_equal(rows, expected)
    assert took < 8.0


def test_ring_two_runs_with_one_seed_are_alike_and_another_seed_is_not(
    tmp_path: Path, connect: Connect
) -> None:
    def run(name: str, seed: str) -> np.ndarray:
        folder = tmp_path / name
        folder.mkdir()
        port = free_port()
        options = ("--scenario", "random", "--duration", "0.1", "--fast")
        with simulator(folder, ring_config(port), *options, env={"DELTAK_SEED": seed}):
            return read_all(connect(port), 100)

    first = run("a", "11")
    np.testing.assert_array_equal(first, run("b", "11"))
    assert np.any(first != run("c", "12"))


def test_ring_read_by_mbpoll_holds_the_truth(tmp_path: Path, connect: Connect) -> None:
    mbpoll = peers.program("mbpoll", "mbpoll")
    port = free_port()
    (tmp_path / "s.toml").write_text("duration_s = 0.04\n[initial]\nall = 0.01\n", encoding="utf-8")
    with simulator(tmp_path, ring_config(port), "--scenario", str(tmp_path / "s.toml")) as sim:
        client = connect(port)
        until(lambda: client.index() == 40)
        command = [mbpoll, "-m", "tcp", "-p", str(port), "-a", "1", "-0", "-1", "-q"]
        index = subprocess.run(
            [*command, "-t", "3:int", "-B", "-r", "0", "-c", "1", "127.0.0.1"],
            capture_output=True, text=True, timeout=LIMIT_S, check=True,
        ).stdout  # fmt: skip
        slots = subprocess.run(
            [*command, "-t", "3", "-r", "16", "-c", "120", "127.0.0.1"],
            capture_output=True, text=True, timeout=LIMIT_S, check=True,
        ).stdout  # fmt: skip
        assert sim.stop() == 0
    assert re.findall(r"\[0\]:\s+(-?\d+)", index) == ["40"]
    numbers = [int(text) for text in re.findall(r"\[\d+\]:\s+(-?\d+)", slots)]
    expected = np.rint(sim.truth()["readings"] / [1e-3, 2e-6, 2e-3]).astype(int)
    assert int16(numbers) == expected.ravel().tolist()


def test_device_writes_and_foreign_addresses_are_refused(tmp_path: Path, connect: Connect) -> None:
    port = free_port()
    with simulator(tmp_path, ring_config(port)):
        client = connect(port)
        assert client.request(struct.pack(">BHH", 6, 0, 1)) == bytes([0x86, 1])
        assert client.request(struct.pack(">BHH", 4, 5, 2)) == bytes([0x84, 2])
        assert client.request(struct.pack(">BHH", 4, 65000, 2)) == bytes([0x84, 2])
        assert client.request(struct.pack(">BH", 24, 0)) == bytes([0x98, 2])


POLL = """
[[source]]
driver = "modbus"
port = {port}
device_id = 7
function = 3
word_order = "little"
mode = "poll"
period_s = 0.002
fields = [
  {{ name = "F", type = "int32", scale = 1e-6, address = 10 }},
  {{ name = "X1", type = "float32", address = 20 }},
  {{ name = "X2", type = "float64", address = 22 }},
  {{ name = "n", type = "uint16", address = 30 }},
]
counter = "n"
map = {{ force = "F", x1 = "X1", x2 = "X2" }}
"""


def test_poll_registers_hold_the_newest_sample_of_one_instant(tmp_path: Path, connect: Connect) -> None:
    port = free_port()
    seen: list[tuple[int, ...]] = []
    with simulator(tmp_path, (MODEL + POLL).format(port=port, rate=1000.0), "--scenario", "default") as sim:
        client = connect(port)
        for _ in range(50):
            low, high = struct.unpack(">HH", client.request(struct.pack(">BHH", 3, 10, 2), 7)[2:])
            seen.append(
                (
                    high << 16 | low,
                    struct.unpack(">H", client.request(struct.pack(">BHH", 3, 30, 1), 7)[2:])[0],
                )
            )
        x1 = client.request(struct.pack(">BHH", 3, 20, 2), 7)[2:]
        assert sim.stop() == 0
    readings = sim.truth()["readings"]
    swapped = struct.unpack(">f", x1[2:] + x1[:2])[0]
    assert np.min(np.abs(readings[:, 1] - swapped)) < 1e-9
    forces = {int(np.rint(r / 1e-6)) & 0xFFFFFFFF for r in readings[:, 0]}
    assert {force for force, _ in seen} <= forces


FIFO = """
[[source]]
driver = "modbus"
port = {port}
mode = "fifo"
address = 100
fields = [
  {{ name = "n", type = "uint16" }},
  {{ name = "F", type = "int16", scale = 1e-3 }},
  {{ name = "X1", type = "int32", scale = 1e-9 }},
]
counter = "n"
map = {{ force = "F", x1 = "X1" }}
"""


def test_fifo_function_24_hands_out_every_sample_once(tmp_path: Path, connect: Connect) -> None:
    port = free_port()
    rows: list[tuple[int, ...]] = []
    with simulator(tmp_path, (MODEL + FIFO).format(port=port, rate=1000.0), "--scenario", "default") as sim:
        client = connect(port)
        while len(rows) < 200:
            reply = client.request(struct.pack(">BH", 24, 100))
            size, count = struct.unpack(">HH", reply[1:5])
            assert (reply[0], size, len(reply)) == (24, 2 + 2 * count, 5 + 2 * count)
            assert count <= 31
            assert count % 4 == 0
            rows += [struct.unpack(">Hhi", reply[k : k + 8]) for k in range(5, len(reply), 8)]
        assert sim.stop() == 0
    readings = sim.truth()["readings"][: len(rows)]
    expected = np.column_stack([np.arange(len(rows)), np.rint(readings[:, :2] / [1e-3, 1e-9])])
    np.testing.assert_array_equal(rows, expected)


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        (('host = "127.0.0.1"', 'host = "192.168.0.5"'), 2,
         "source[0].host: this looks like a real bus; sim never transmits on one"),
        (('driver = "modbus"', 'driver = "opcua"'), 2, 'source[0].driver: "opcua" cannot be simulated'),
        (('mode = "ring"', 'mode = "rong"'), 2, "source[0]: mode"),
        (('x2 = "X2"', 'x2 = "X9"'), 2, "X9"),
        (('at = "m2"', 'at = "m9"'), 2, 'no mass is called "m9"'),
        (("sample_rate_hz = 1000.0", "sample_rate_hz = 0"), 2, "rig.sample_rate_hz"),
        (("[rig]", "[rig"), 2, "rig.toml"),
    ],
)  # fmt: skip
def test_sim_bad_configuration_is_refused_in_words(
    tmp_path: Path, change: tuple[str, str], code: int, words: str
) -> None:
    text = ring_config(free_port())
    assert change[0] in text
    sim = refused(tmp_path, text.replace(*change, 1))
    assert sim.code == code
    assert sim.out == ""
    assert all(line.startswith("deltak: error: ") for line in sim.err.splitlines())
    assert words in sim.err
    assert "Traceback" not in sim.err


def test_sim_port_in_use_is_said(tmp_path: Path) -> None:
    port = free_port()
    with simulator(tmp_path, ring_config(port)):
        (tmp_path / "b").mkdir()
        second = Simulator(tmp_path / "b", ring_config(port))
        assert second.end() == 4
        assert f"port {port} on 127.0.0.1 cannot be opened" in second.err


def test_sim_unknown_scenario_names_those_that_the_rig_can_play(tmp_path: Path) -> None:
    sim = refused(tmp_path, ring_config(free_port()), "--scenario", "nonsense")
    assert sim.code == 2
    shipped = {file.stem for file in (peers.ROOT / "sim_bus/scenarios").glob("*.toml")}
    named = sim.err.partition("one of ")[2].strip().split(", ")
    assert {"default", "paper", "random", "steady"} <= set(named) <= shipped


def test_sim_interrupt_writes_the_truth_and_says_130(tmp_path: Path, connect: Connect) -> None:
    import signal

    port = free_port()
    with simulator(tmp_path, ring_config(port), "--scenario", "default") as sim:
        client = connect(port)
        until(lambda: client.index() > 10)
        assert sim.stop(signal.SIGINT) == 130
    assert sim.ledger()["samples"] > 10
