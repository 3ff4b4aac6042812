"""`deltak listen`: units as they come beside what they decode to, rates, every rejection with its bytes."""

import json
import os
import pty
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from agent.cli.app import app
from agent.cli.terminal.errors import guarded
from agent.commissioning.setup import listen as body
from tests.peers import ROOT

pytestmark = pytest.mark.realtime

TEXT_LINE = """
[rig]
name = "bench"
sample_rate_hz = 100.0
clock = "counter"
[model]
mass = [{ name = "m1", value = 5.0 }]
spring = [{ name = "k1", between = ["ground", "m1"] }]
[[channel]]
name = "x1"
quantity = "displacement"
at = "m1"
unit = "mm"
scale = 2.0
[[source]]
driver = "serial"
port = "PORT"
format = "text"
columns = ["n", "x1"]
map = { x1 = "x1" }
counter = "n"
"""
DEVICES = {
    "can": ("can.dlc", "29536", "RIG_SAMPLE 100#", "dlc", "100#"),
    "modbus": ("modbus.exception-6", "1502", "registers ", "exception 6 (device busy)", "84 06"),
}


@contextmanager
def line(folder: Path, *lines: bytes) -> Iterator[str]:
    """A configuration on a pseudo-terminal on which lines come again and again, a hundredth of a second
    apart."""
    ours, theirs = pty.openpty()
    tty.setraw(theirs)
    over = threading.Event()

    def play() -> None:
        for number in range(100_000):
            os.write(ours, lines[number % len(lines)].replace(b"N", b"%d" % number))
            if over.wait(0.01):
                return

    config = folder / "rig.toml"
    config.write_text(TEXT_LINE.replace("PORT", os.ttyname(theirs)), encoding="utf-8")
    player = threading.Thread(target=play)
    player.start()
    try:
        yield str(config)
    finally:
        over.set()
        player.join()
        os.close(ours)
        os.close(theirs)


def listened(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    # imported before a line plays: the suite's trace of writes looks into the drivers
    assert callable(body.listen)
    code = guarded(app, ["listen", *arguments])
    return code, *capsys.readouterr()


def test_listen_shows_lines_values_and_rejections_without_orders_to_the_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with line(tmp_path, b"N,1.5\n", b"N,-2.0\n", b"N,\x1b[31mred\n", b"N\n") as config:
        code, out, _ = listened(capsys, config, "--duration", "0.4")
    assert code == 0
    assert "\x1b" not in out
    assert any(",1.5  ->  x1 3 mm" in text or ",-2.0  ->  x1 -4 mm" in text for text in out.splitlines())
    assert "\\x1b[31mred" in out
    assert "a cell is no decimal number" in out
    assert "1 cells; columns has 2" in out


def test_listen_json_counts_each_reason_and_the_rate_of_each_channel(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with line(tmp_path, b"N,1.5\n", b"N,\n", b"N,x\n") as config:
        code, out, _ = listened(capsys, config, "--duration", "0.5", "--json")
    document: dict[str, Any] = json.loads(out)
    (source,) = document["sources"]
    (channel,) = document["channels"]
    assert code == 0
    assert 0.2 < source["rejected"]["text"] / source["received"] < 0.45
    assert channel["rate_hz"] == pytest.approx(source["rate_hz"] / 2, rel=0.25)
    assert (channel["last"], channel["unit"]) == (3.0, "mm")
    assert {row["reason"] for row in document["lines"] if row["values"] is None} == {"text"}


def test_listen_shows_covariates_and_names_a_source_of_theirs_that_is_absent(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hall = '\n[[channel]]\nname = "{0}"\nrole = "covariate"\nunit = "degC"\n'
    alone = '[[source]]\nname = "wall"\ndriver = "serial"\nport = "none"\nformat = "text"\ncolumns = ["W"]\n'
    with line(tmp_path, b"N,1.5,21.5\n") as config:
        text = Path(config).read_text().replace('"x1"]\nmap = { ', '"x1", "T"]\nmap = { hall = "T", ')
        text += hall.format("hall")
        Path(config).write_text(text, encoding="utf-8")
        code, out, _ = listened(capsys, config, "--duration", "0.4", "--json")
        Path(config).write_text(
            text + hall.format("wall") + alone + 'map = { wall = "W" }\n', encoding="utf-8"
        )
        absent, _, err = listened(capsys, config, "--duration", "0.4")
    document: dict[str, Any] = json.loads(out)
    assert code == 0
    found = {row["name"]: (row["source"], row["last"], row["unit"]) for row in document["channels"]}
    assert found == {"x1": ("serial", 3.0, "mm"), "hall": ("serial", 21.5, "degC")}
    assert [source["name"] for source in document["sources"]] == ["serial"]
    assert absent == 4
    assert "wall" in err


@pytest.mark.parametrize("bus", DEVICES)
def test_listen_on_each_bus_shows_units_and_the_bytes_of_what_is_rejected(
    bus: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fault, place, unit, reason, bytes_shown = DEVICES[bus]
    for name in (f"{bus}.toml", "two-mass-rig.dbc"):
        shutil.copy(ROOT / "deploy/examples" / name, tmp_path)
    config = tmp_path / f"{bus}.toml"
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = str(free.getsockname()[1])
    own = port if place.isdigit() else place
    config.write_text(config.read_text(encoding="utf-8").replace(place, own), encoding="utf-8")
    play = [sys.executable, "-m", "agent", "sim", str(config), "--fault", f"{fault}@0.2s"]
    with subprocess.Popen(play, stdout=subprocess.PIPE, text=True) as device:
        assert device.stdout is not None
        assert device.stdout.readline() == "ready\n"
        code, out, err = listened(capsys, str(config), "--duration", "0.8", "--json")
        device.terminate()
    assert code == 0, err
    document = json.loads(out)
    (source,) = document["sources"]
    assert [c["name"] for c in document["channels"] if abs(c["rate_hz"] - 1000) < 150] == [
        "force",
        "x1",
        "x2",
    ]
    good = [row for row in document["lines"] if row["values"]]
    assert all(row["raw"].startswith(unit) and set(row["values"]) == {"force", "x1", "x2"} for row in good)
    assert good
    assert reason in source["rejected"] | source["faults"]
    assert bytes_shown in source["first_rejected"][reason]


def test_listen_shows_a_frame_of_each_message(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = str(free.getsockname()[1])
    text = (ROOT / "deploy/examples/can.toml").read_text(encoding="utf-8")
    config = tmp_path / "can.toml"
    config.write_text(text.replace("29536", port).replace("RIG_SAMPLE.X2", "ARM.X2"), encoding="utf-8")
    frames = (ROOT / "deploy/examples/two-mass-rig.dbc").read_text(encoding="utf-8")
    arm = "BO_ 257 ARM: 8 RIG\n" + "".join(
        f"{line}\n" for line in frames.splitlines() if line.startswith((" SG_ Counter", " SG_ X2"))
    )
    (tmp_path / "two-mass-rig.dbc").write_text(
        frames.replace("CM_ BO_", f"{arm}\nCM_ BO_", 1), encoding="utf-8"
    )
    play = [sys.executable, "-m", "agent", "sim", str(config)]
    with subprocess.Popen(play, stdout=subprocess.PIPE, text=True) as device:
        assert device.stdout is not None
        assert device.stdout.readline() == "ready\n"
        code, out, err = listened(capsys, str(config), "--duration", "0.8", "--json")
        device.terminate()
    assert code == 0, err
    good = [row for row in json.loads(out)["lines"] if row["values"]]
    shown = {(row["raw"].split()[0], *sorted(row["values"])) for row in good}
    assert {("RIG_SAMPLE", "force", "x1"), ("ARM", "x2")} <= shown


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 0)])
def test_listen_ends_with_a_signal_and_tells_what_it_saw(tmp_path: Path, number: int, code: int) -> None:
    with line(tmp_path, b"N,1.5\n") as config:
        command = [sys.executable, "-m", "agent", "listen", config]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, stderr=subprocess.PIPE) as process:
            assert process.stdout is not None
            first = process.stdout.readline()
            time.sleep(0.2)
            process.send_signal(number)
            out, _ = process.communicate(timeout=30)
    assert "x1 3 mm" in first
    assert "samples a second" in out
    assert process.returncode == code


def test_listen_where_nothing_can_be_opened_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "rig.toml"
    config.write_text(TEXT_LINE.replace("PORT", "nowhere.tty"), encoding="utf-8")
    code, _, err = listened(capsys, str(config), "--duration", "0.3", "--json")
    assert code == 4
    assert "nowhere.tty" in err
    config.write_text(TEXT_LINE.replace('{ x1 = "x1" }', '{ x1 = "x9" }'), encoding="utf-8")
    code, _, err = listened(capsys, str(config), "--duration", "0.3")
    assert code == 2
    assert 'no column is called "x9"' in err
    config.write_text(TEXT_LINE.partition("[[source]]")[0], encoding="utf-8")
    code, _, err = listened(capsys, str(config))
    assert code == 2
    assert "source: there is none to listen to" in err
