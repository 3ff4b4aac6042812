"""What outsiders read: units that look like others, noise in a channel's unit, refused lines, and where words
go."""

import io
import os
import subprocess
import sys
import threading
import zipfile
from pathlib import Path

import numpy as np
import pytest
from numpy.lib import format as npy

from agent.cli.tables.db import export
from agent.cli.terminal.output import print_faults, show
from agent.commissioning.evidence import Evidence
from agent.commissioning.probe import listen
from agent.commissioning.readings import noise_of
from agent.commissioning.recording_summary import read_recording
from agent.config import load
from agent.config.reading.units import near_miss
from agent.errors import Fault, RecordingError, UsageError
from agent.text import printable
from drivers.port import Counts, DriverConfigError
from drivers.serial.text import TextDecoder
from tests.unit.drivers.files.test_driver import driver, everything

RIG = """
[rig]
name = "press"
sample_rate_hz = 1000.0
clock = "{clock}"
[model]
kind = "mass-spring-damper"
mass   = [{{ name = "m", value = 5.0 }}]
spring = [{{ name = "k", between = ["ground", "m"], nominal = 5000.0 }}]
damper = [{{ name = "B", between = ["ground", "m"], nominal = 50.0 }}]
[[channel]]
name = "force"
quantity = "force"
at = "m"
unit = "N"
[[channel]]
name = "a"
quantity = "acceleration"
at = "m"
unit = "g"
"""
SERIAL = """
[[source]]
driver = "serial"
name = "scale"
port = "{port}"
baudrate = 115200
format = "text"
delimiter = ","
columns = ["n", "force", "a", "t"]
counter = "n"
map = {{ force = "force", a = "a" }}
"""


@pytest.mark.parametrize(("quantity", "unit", "meant"), [
    ("displacement", "MM", "mm"), ("displacement", "milimeter", "mm"), ("displacement", "millimetres", "mm"),
    ("force", "kn", "kN"), ("force", "newton", "N"), ("force", "mn", "MN or mN"), ("acceleration", "G", "g"),
    ("displacement", "mm", ""), ("displacement", "counts", ""), ("force", "V", ""), ("force", "LSB", ""),
    ("output", "MM", ""),
])  # fmt: skip
def test_unit_that_looks_like_a_known_one_is_told(quantity, unit: str, meant: str) -> None:
    assert near_miss(quantity, unit) == meant


def accelerated(folder: Path, noise_g: float) -> Path:
    """A mass on a spring under a force that changes from sample to sample, and what an accelerometer shows of
    it."""
    rng, h, g = np.random.default_rng(3), 1e-4, 9.80665
    force, x, v, rows = rng.normal(0.0, 20.0, 4001), 0.0, 0.0, []
    for i in range(4000):
        rows.append((i / 1000, force[i], (force[i] - 5000.0 * x - 50.0 * v) / 5.0 / g))
        for part in range(10):
            now = force[i] + (force[i + 1] - force[i]) * part / 10
            v += h * (now - 5000.0 * x - 50.0 * v) / 5.0
            x += h * v
    table = np.array(rows)
    table[:, 2] += noise_g * rng.standard_normal(len(table))
    path = folder / "shaken.csv"
    np.savetxt(path, table, delimiter=",", header="t,force,a", comments="", fmt="%.9g")
    return path


def test_noise_of_an_accelerometer_is_told_without_the_motion_and_in_its_own_unit(tmp_path: Path) -> None:
    config = tmp_path / "rig.toml"
    config.write_text(RIG.format(clock="device"), encoding="utf-8")
    recorded = read_recording(load(config), accelerated(tmp_path, 2e-3))
    _, shown = recorded.facts["channels"]
    assert shown["unit"] == "g"
    assert shown["noise_sd"] == pytest.approx(2e-3, rel=0.25)
    assert shown["max"] == pytest.approx(recorded.y.max() / 9.80665)
    assert noise_of(recorded.y[:, 0]) / 9.80665 > 10 * shown["noise_sd"]  # the force itself


@pytest.mark.parametrize(("line", "reason", "words"), [
    (b"1,2,3\n", "columns", "3 cells; columns has 4"),
    (b"$A,1,2,3,4*45\n", "columns", '5 cells; columns has 4; of $ADDRESS,cells*HH take checksum = "nmea"'),
    (b"1,2,x,4\n", "text", "a cell is no decimal number"),
    (b"1.5,2,3,4\n", "counter", "the counter is no whole number"),
])  # fmt: skip
def test_first_line_that_is_refused_is_kept_with_its_reason(line: bytes, reason: str, words: str) -> None:
    counts = Counts()
    decoder = TextDecoder(("n", "force", "a", "t"), ",", None, False, ["force"], "n", counts)
    decoder.feed(b"\n" + line + line.replace(b"1", b"9"))
    assert counts.copy().rejected[reason] == 2
    assert counts.copy().first[reason].startswith(f'"{line.decode().strip()}": ')
    assert words in counts.copy().first[reason]


def test_probe_of_a_line_whose_every_row_is_refused_shows_the_first_of_them(tmp_path: Path) -> None:
    ours, theirs = os.openpty()
    config = tmp_path / "rig.toml"
    config.write_text(RIG.format(clock="counter") + SERIAL.format(port=os.ttyname(theirs)), encoding="utf-8")
    stop = threading.Event()

    def send() -> None:
        while not stop.wait(0.02):
            os.write(ours, b"7;1.5;2.5;0\r\n")

    sender = threading.Thread(target=send)
    sender.start()
    try:
        source = listen(load(config), lambda _words: None, listen_s=-4.0).sources()[0]
    finally:
        stop.set()
        sender.join()
        os.close(ours)
        os.close(theirs)
    assert source["rejected"]["columns"] > 5
    assert source["first_rejected"]["columns"].startswith('"7;1.5;2.5;0": 1 cells; columns has')


def test_check_says_of_a_source_all_of_whose_lines_are_refused_which_and_why(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    source = {
        "name": "scale", "received": 9, "rejected": {"columns": 9},
        "first_rejected": {"columns": '"7;1" is short'},
        "rate_hz": None, "nominal_hz": 1000.0, "drift_ppm": None,
    }  # fmt: skip
    gathering = type("Silent", (), {"recorded": lambda *_: None, "sources": lambda _: [source]})()
    monkeypatch.setattr("agent.commissioning.evidence.listen", lambda *_: gathering)
    config = type("Config", (), {"source": [type("Source", (), {"name": "scale"})]})()
    first, last = map(str, Evidence(probe=True).gather(config).warnings)
    assert first.startswith(
        'source[0]: scale: all of 9 that came were rejected (columns 9); the first: "7;1" is short'
    )
    assert "see that the devices send" not in last


def test_export_refuses_a_form_that_it_cannot_write(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"x\.xlsx: \.xlsx cannot be written; .*\.csv or \.parquet"):
        export(tmp_path / "x.db", "estimates", None, tmp_path / "x.xlsx")
    assert not (tmp_path / "x.xlsx").exists()


def test_orders_to_a_terminal_are_shown_and_not_given(capsys: pytest.CaptureFixture[str]) -> None:
    assert printable("a\x1b[2Jb\x9bc\td\n") == "a\\x1b[2Jb\\x9bc\td\n"
    print_faults([Fault("x.csv:1", "\x1b]0;owned\x07", "see")])
    show("name \x1b[31m")
    out, err = capsys.readouterr()
    assert "\x1b" not in out + err
    assert "\\x1b]0;owned\\x07" in err


def cli(*argv: str, stdout: object) -> tuple[int, str]:
    command = [sys.executable, "-m", "agent", *argv]
    done = subprocess.run(command, stdout=stdout, stderr=subprocess.PIPE, text=True, check=False, timeout=60)
    return done.returncode, done.stderr


def test_full_disk_behind_stdout_is_said_in_words() -> None:
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        code, err = cli("--version", stdout=full)
    assert (code, err.count("\n")) == (2, 1)
    assert err.startswith("deltak: error: stdout: cannot be written: No space left on device; ")


def test_pipe_that_is_closed_is_no_error() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    try:
        assert cli("--help", stdout=writer) == (0, "")
    finally:
        os.close(writer)


def test_endless_row_of_a_csv_is_refused_and_not_read(tmp_path: Path) -> None:
    path = tmp_path / "endless.csv"
    for head, line in (("t,force,x1\n", 2), ("t,force,x1\n0,1,2\n", 3)):
        path.write_text(head + "1" * (9 << 20), encoding="utf-8")
        recording = driver(path)
        with pytest.raises(
            DriverConfigError, match=rf"endless\.csv:{line}: a row of more than 4194304 characters"
        ):
            everything(recording)
        recording.close()


def test_npz_that_unpacks_to_what_no_measurement_packs_so_well_is_refused_unread(tmp_path: Path) -> None:
    path, header, block = tmp_path / "bomb.npz", io.BytesIO(), bytes(1 << 22)
    npy.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (1 << 26,)})
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name in ("t", "force", "x1"):
            with file.open(f"{name}.npy", "w") as array:
                array.write(header.getvalue())
                for _ in range(23):
                    array.write(block)
    with pytest.raises(
        DriverConfigError, match=r"bytes that unpack to \d+, \d+ times as many, are no measurement"
    ):
        driver(path).open()


def test_npz_whose_array_is_described_without_end_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name in ("t", "force", "x1"):
            file.writestr(f"{name}.npy", b"\x93NUMPY\x02\x00" + (1 << 31).to_bytes(4, "little") + bytes(1000))
    with pytest.raises(DriverConfigError, match="is described in 2147483648 bytes"):
        driver(path).open()


def test_pipe_as_a_recording_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    config = tmp_path / "rig.toml"
    config.write_text(RIG.format(clock="device"), encoding="utf-8")
    os.mkfifo(tmp_path / "pipe.csv")
    with pytest.raises(RecordingError, match=r"pipe\.csv: is a pipe or a device, whose end may never come"):
        read_recording(load(config), tmp_path / "pipe.csv")
