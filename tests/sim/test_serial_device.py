"""Simulated serial lines and Modbus RTU on pseudo-terminals: read by bare descriptors, crccheck, socat and
mbpoll."""

import os
import re
import select
import struct
import subprocess
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import crccheck.crc
import numpy as np
import pytest
import sliplib
from cobs import cobs

from tests import peers
from tests.sim.rigs import INT16, LIMIT_S, MODEL, RING, int16, refused, simulator

BINARY = """
[[source]]
name = "line"
driver = "serial"
port = "line"
baudrate = 921600
format = "binary"
sync = "AA55"
byte_order = "little"
fields = [
  {{ name = "n", type = "uint16" }},
  {{ name = "F", type = "int32", scale = 1e-6 }},
  {{ name = "X1", type = "int32", scale = 5e-11 }},
  {{ name = "X2", type = "float32" }},
]
crc = "CRC-16/IBM-3740"
map = {{ force = "F", x1 = "X1", x2 = "X2" }}
counter = "n"
"""
TEXT = """
[[source]]
driver = "serial"
port = "line"
format = "text"
delimiter = ","
columns = ["n", "F", "spare", "X1"]
checksum = "{checksum}"
map = {{ force = "F", x1 = "X1" }}
counter = "n"
"""
RTU = (
    RING.replace('transport = "tcp"\nhost = "127.0.0.1"\nport = {port}', 'transport = "rtu"\nport = "line"')
    + INT16
)


@contextmanager
def opened(path: Path) -> Iterator[int]:
    """Open a line as a reader does: raw, nothing thrown away."""
    descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    tty.setraw(descriptor)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def read(descriptor: int, count: int) -> bytes:
    """Return at least that many bytes."""
    data = b""
    deadline = time.monotonic() + LIMIT_S
    while len(data) < count:
        ready, _, _ = select.select([descriptor], [], [], max(0.0, deadline - time.monotonic()))
        assert ready, f"{len(data)} of {count} bytes came"
        data += os.read(descriptor, 65536)
    return data


def test_binary_frames_checked_by_crccheck_are_the_truth(tmp_path: Path) -> None:
    text = (MODEL + BINARY).format(rate=1000.0)
    with simulator(tmp_path, text, "--scenario", "paper") as sim:
        with opened(tmp_path / "line") as line:
            data = read(line, 400 * 18)
        assert sim.stop() == 0
    readings = sim.truth()["readings"]
    for k in range(400):
        frame = data[18 * k : 18 * k + 18]
        assert frame[:2] == b"\xaa\x55"
        assert int.from_bytes(frame[-2:], "little") == crccheck.crc.Crc16Ibm3740.calc(frame[2:-2])
        n, force, x1, x2 = struct.unpack("<Hiif", frame[2:-2])
        assert (n, force, x1) == (k, 0, round(readings[k, 1] / 5e-11))
        assert x2 == pytest.approx(readings[k, 2], rel=1e-7)
    assert not (tmp_path / "line").is_symlink()


@pytest.mark.parametrize("framing", ["cobs", "slip"])
def test_frames_with_ends_read_by_others_packages_are_the_truth(tmp_path: Path, framing: str) -> None:
    text = (MODEL + BINARY.replace('sync = "AA55"', f'framing = "{framing}"')).format(rate=1000.0)
    with simulator(tmp_path, text, "--scenario", "paper") as sim:
        with opened(tmp_path / "line") as line:
            data = read(line, 300 * 18)
        assert sim.stop() == 0
    readings = sim.truth()["readings"]
    *frames, _ = data.split(b"\0" if framing == "cobs" else b"\xc0")
    assert len(frames) > 200
    for k, coded in enumerate(frames):
        frame = cobs.decode(coded) if framing == "cobs" else sliplib.decode(coded)
        assert int.from_bytes(frame[-2:], "little") == crccheck.crc.Crc16Ibm3740.calc(frame[:-2])
        assert struct.unpack_from("<Hii", frame) == (k, 0, round(readings[k, 1] / 5e-11))


@pytest.mark.parametrize("checksum", ["none", "nmea"])
def test_text_lines_give_every_digit_back(tmp_path: Path, checksum: str) -> None:
    text = (MODEL + TEXT).format(rate=1000.0, checksum=checksum)
    with simulator(tmp_path, text, "--scenario", "default") as sim:
        with opened(tmp_path / "line") as line:
            data = read(line, 12_000)
        assert sim.stop() == 0
    greeting, *lines, _ = data.decode().split("\r\n")
    assert greeting == ""
    readings = sim.truth()["readings"]
    for k, whole in enumerate(lines):
        body = whole
        if checksum == "nmea":
            match = re.fullmatch(r"\$(DKSIM,(.*))\*([0-9A-F]{2})", whole)
            assert match
            assert int(match[3], 16) == int(np.bitwise_xor.reduce(np.frombuffer(match[1].encode(), np.uint8)))
            body = match[2]
        n, force, spare, x1 = body.split(",")
        assert (int(n), float(force), float(spare), float(x1)) == (k, readings[k, 0], 0.0, readings[k, 1])
    assert len(lines) > 100


def test_line_is_paced_and_what_nobody_heard_is_in_the_ledger(tmp_path: Path) -> None:
    text = (MODEL + BINARY).format(rate=1000.0)
    with simulator(tmp_path, text, "--scenario", "steady") as sim:
        with opened(tmp_path / "line") as line:
            first = read(line, 18)
            begun = time.monotonic()
            first += read(line, 500 * 18)
            took = time.monotonic() - begun
        time.sleep(0.1)  # nobody listens for a while
        with opened(tmp_path / "line") as line:
            second = read(line, 100 * 18)
        assert sim.stop() == 0
    assert 0.35 < took < 2.0
    start = second.index(b"\xaa\x55")
    resumed = struct.unpack_from("<H", second, start + 2)[0]
    received = len(first) // 18
    ledger = sim.ledger()["sources"]["line"]
    assert any(a >= received and b == resumed - 1 for a, b in ledger["unheard"])
    assert ledger["lost"] == []


def test_fast_line_is_held_back_by_a_reader_that_takes_its_time(tmp_path: Path) -> None:
    text = (MODEL + BINARY).format(rate=1000.0)
    options = ("--scenario", "steady", "--duration", "10", "--fast")
    with simulator(tmp_path, text, *options) as sim:
        begun = time.monotonic()
        with opened(tmp_path / "line") as line:
            data = b""
            while len(data) < 10_000 * 18:
                data += read(line, 1)
        took = time.monotonic() - begun
        assert sim.end() == 0
    numbers = np.frombuffer(data, np.uint8).reshape(10_000, 18)[:, 2:4].copy().view("<u2")[:, 0]
    np.testing.assert_array_equal(numbers, np.arange(10_000))
    assert took < 9.0


def test_line_carried_by_socat_arrives_whole(tmp_path: Path) -> None:
    socat = peers.program("socat", "socat")
    text = (MODEL + BINARY).format(rate=1000.0)
    with simulator(tmp_path, text, "--scenario", "steady") as sim:
        command = [socat, "-u", f"{tmp_path / 'line'},rawer", "STDOUT"]
        with subprocess.Popen(command, stdout=subprocess.PIPE) as carrier:
            assert carrier.stdout is not None
            data = carrier.stdout.read(200 * 18)
            carrier.terminate()
        assert sim.stop() == 0
    numbers = np.frombuffer(data, np.uint8).reshape(200, 18)[:, 2:4].copy().view("<u2")[:, 0]
    np.testing.assert_array_equal(np.diff(numbers), 1)


def test_rtu_read_by_mbpoll_holds_the_truth(tmp_path: Path) -> None:
    mbpoll = peers.program("mbpoll", "mbpoll")
    (tmp_path / "s.toml").write_text("duration_s = 0.04\n[initial]\nall = 0.01\n", encoding="utf-8")
    text = (MODEL + RTU).format(rate=1000.0, slots=1024)
    with simulator(tmp_path, text, "--scenario", str(tmp_path / "s.toml")) as sim:
        command = [mbpoll, "-m", "rtu", "-b", "19200", "-P", "none", "-a", "1", "-0", "-1", "-q", "-t"]

        def ask(kind: str, first: str, count: str) -> list[int]:
            words = [*command, kind, *(["-B"] if kind == "3:int" else []), "-r", first, "-c", count]
            done = subprocess.run(
                [*words, str(tmp_path / "line")], capture_output=True, text=True, timeout=LIMIT_S, check=True
            )
            return [int(number) for number in re.findall(r"\[\d+\]:\s+(-?\d+)", done.stdout)]

        deadline = time.monotonic() + LIMIT_S
        while ask("3:int", "0", "1") != [40]:
            assert time.monotonic() < deadline
        slots = ask("3", "16", "120")
        assert sim.stop() == 0
    expected = np.rint(sim.truth()["readings"] / [1e-3, 2e-6, 2e-3]).astype(int)
    assert int16(slots) == expected.ravel().tolist()


def test_sim_real_device_in_place_of_the_line_is_refused(tmp_path: Path) -> None:
    (tmp_path / "line").touch()
    sim = refused(tmp_path, (MODEL + BINARY).format(rate=1000.0))
    assert sim.code == 2
    assert "source[0].port: this looks like a real bus; sim never transmits on one" in sim.err
    assert (tmp_path / "line").is_file()
