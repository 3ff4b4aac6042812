"""Serial lines: read-only, for one program alone, found again under another number."""

import errno
import fcntl
import os
import pty
import struct
import subprocess
import sys
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from agent.commissioning.check import check
from drivers import serial_port
from drivers.pipe import SerialPipe
from drivers.port import DriverConfigError, DriverIOError, SourceRequest
from drivers.serial.driver import SerialDriver, SerialSettings
from drivers.serial_port import SerialKeys, close_port, open_port, port_hint
from tests.peers import ROOT

GET_EXCLUSIVE = 0x80045440
HOLD = "import fcntl, os, sys; fd = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY); fcntl.flock(fd, 2); print('held', flush=True); sys.stdin.read()"  # noqa: E501 (one line of a child)

SPY = """
import os, sys
from drivers import serial_port

def spy(*_):
    print("serial" in sys.modules)
    raise FileNotFoundError(2, "none")

serial_port.os.open = spy
try:
    serial_port.open_port(serial_port.SerialKeys(port="x"), "x", read_only=True)
except serial_port.DriverIOError:
    pass
"""


class Wire:
    """A pty and the path at which its end is opened."""

    def __init__(self, link: Path) -> None:
        self.master, self.slave = pty.openpty()
        tty.setraw(self.slave)
        self.path = os.ttyname(self.slave)
        link.unlink(missing_ok=True)
        link.symlink_to(self.path)

    def close(self) -> None:
        for end in (self.master, self.slave):
            os.close(end)


@pytest.fixture
def wire(tmp_path: Path) -> Iterator[Wire]:
    made = Wire(tmp_path / "line")
    yield made
    made.close()


def keys(**more: object) -> SerialKeys:
    return SerialKeys.model_validate({"port": "line", **more})


def exclusive(descriptor: int) -> bool:
    return bool(struct.unpack("i", fcntl.ioctl(descriptor, GET_EXCLUSIVE, bytes(4)))[0])


def test_line_opened_to_read_refuses_a_write_by_the_kernel(wire: Wire) -> None:
    pipe = SerialPipe(keys(), wire.path, read_only=True)
    with pytest.raises(OSError, match="Bad file descriptor") as refused:
        os.write(pipe.fileno(), b"x")
    assert refused.value.errno == errno.EBADF
    pipe.close()


def test_driver_of_a_passive_line_holds_no_descriptor_that_can_write(wire: Wire, tmp_path: Path) -> None:
    settings = SerialSettings.model_validate({"port": "line", "format": "text", "columns": ["a"]})
    driver = SerialDriver(SourceRequest("line", settings, ("a",), None, tmp_path))
    driver.open()
    mine = [fd for fd in descriptors() if leads_to(fd, wire.path) and fd != wire.slave]
    assert [fcntl.fcntl(fd, fcntl.F_GETFL) & os.O_ACCMODE for fd in mine] == [os.O_RDONLY]
    driver.close()


def descriptors() -> list[int]:
    return [int(link.name) for link in Path("/proc/self/fd").iterdir()]


def leads_to(descriptor: int, path: str) -> bool:
    try:
        return str(Path(f"/proc/self/fd/{descriptor}").readlink()) == path
    except OSError:
        return False


def test_line_is_closed_to_others_while_open_and_free_afterwards(wire: Wire) -> None:
    descriptor = open_port(keys(), wire.path, read_only=True)
    assert exclusive(wire.slave)
    with pytest.raises(DriverIOError, match="has it open; a serial line has one reader"):
        open_port(keys(), wire.path, read_only=True)
    close_port(descriptor)
    assert not exclusive(wire.slave)
    close_port(open_port(keys(), wire.path, read_only=False))


def test_line_that_another_process_holds_is_refused_with_its_name(wire: Wire) -> None:
    command = [sys.executable, "-c", HOLD, wire.path]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        with pytest.raises(DriverIOError, match=rf"python\S* \({other.pid}\) has it open; .* stop that one"):
            open_port(keys(), wire.path, read_only=True)
        other.communicate("")
    close_port(open_port(keys(), wire.path, read_only=True))


def test_line_that_is_refused_leaves_no_descriptor(wire: Wire, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no terminal")
    before = len(descriptors())
    with pytest.raises(DriverIOError, match="No such file"):
        open_port(keys(), str(tmp_path / "none"), read_only=True)
    with pytest.raises(DriverIOError, match="file"):
        open_port(keys(), str(tmp_path / "file"), read_only=True)
    with pytest.raises((DriverIOError, DriverConfigError), match="line"):
        open_port(keys(baudrate=2**40), str(tmp_path / "line"), read_only=True)
    assert len(descriptors()) == before


def test_line_is_opened_when_all_is_ready_to_set_it_up() -> None:
    """What comes between opening and clearing is lost: nothing slow, such as an import, may lie between."""
    done = subprocess.run([sys.executable, "-c", SPY], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout == "True\n"


def test_line_of_another_user_is_refused_with_advice(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> int:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(serial_port.os, "open", refuse)
    with pytest.raises(
        DriverIOError, match=r"/dev/ttyUSB0: Permission denied; .* group of the device \(dialout\)"
    ):
        open_port(keys(), "/dev/ttyUSB0", read_only=True)


def test_adapter_that_comes_back_under_another_number_is_found_by_its_link(tmp_path: Path) -> None:
    settings = SerialSettings.model_validate({"port": "by-id", "format": "text", "columns": ["a"]})
    driver = SerialDriver(SourceRequest("line", settings, ("a",), None, tmp_path))
    first = Wire(tmp_path / "by-id")
    driver.open()
    os.write(first.master, b"\r\n1\r\n")
    assert driver.read(1.0).values.tolist() == [[1.0]]
    second = Wire(tmp_path / "by-id")  # the link leads to the new number while the old one is still open
    assert second.path != first.path
    first.close()
    with pytest.raises(DriverIOError):
        driver.read(1.0)
    driver.close()
    driver.open()
    os.write(second.master, b"\r\n2\r\n")
    assert driver.read(1.0).values.tolist() == [[2.0]]
    driver.close()
    second.close()


def test_port_that_a_replug_may_change_is_pointed_out_with_its_stable_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(serial_port, "BY_ID", tmp_path)
    words = (
        "/dev/ttyUSB7 is numbered in the order of plugging, a replug may change it; "
        "write port = its link under"
    )
    assert port_hint("/dev/ttyUSB7") == f"{words} {tmp_path}"
    (tmp_path / "usb-FTDI_A1-if00-port0").symlink_to("/dev/ttyUSB7")
    hint = port_hint("/dev/ttyUSB7")
    assert hint is not None
    assert hint.endswith(f"write port = {tmp_path}/usb-FTDI_A1-if00-port0")
    for port in ("/dev/serial/by-id/usb-FTDI_A1-if00-port0", "/dev/ttyS0", "/dev/deltak-press-7", "line"):
        assert port_hint(port) is None


def test_check_warns_of_a_port_that_a_replug_may_change(tmp_path: Path) -> None:
    text = (ROOT / "deploy/examples/serial.toml").read_text(encoding="utf-8")
    config = tmp_path / "rig.toml"
    config.write_text(text.replace("two-mass-rig.tty", "/dev/ttyACM0"), encoding="utf-8")
    document = check(config=config, recording=None, probe=False)
    (warning,) = [warning for warning in document["warnings"] if warning["path"] == "source[0]"]
    assert warning["message"] == "/dev/ttyACM0 is numbered in the order of plugging, a replug may change it"
    assert warning["advice"].startswith("write port = ")
