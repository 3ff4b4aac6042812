"""Our driver against libmodbus, an independent server, over TCP and over a serial line of two ptys joined by
socat."""

import re
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from drivers.modbus.driver import ModbusDriver
from drivers.modbus.settings import ModbusSettings
from drivers.port import DriverIOError, SourceRequest
from tests import peers
from tests.ports import free_port

SOURCE = Path(__file__).with_name("libmodbus_server.c")
RING = {
    "mode": "ring",
    "index": {"address": 0},
    "fields": [{"name": "a", "type": "uint16"}, {"name": "b", "type": "uint16"}],
}


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Path:
    compiler = peers.program("gcc", "gcc")
    built = tmp_path_factory.mktemp("libmodbus") / "server"
    done = subprocess.run(
        [compiler, "-I/usr/include/modbus", "-o", built, SOURCE, "-lmodbus"],
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        peers.missing(
            f"libmodbus cannot be compiled against (Debian package libmodbus-dev): {done.stderr[-200:]}"
        )
    return built


@contextmanager
def running(*command: str | Path) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def read_hundred(driver: ModbusDriver) -> None:
    """Hold a ring that lies in registers 16 on against what the server put there."""
    driver.open()
    block = driver.read(1.0)
    assert block.counter is not None
    assert block.counter.tolist() == list(range(100))
    address = 16 + 2 * np.arange(100)
    np.testing.assert_array_equal(block.values, np.column_stack([3 * address, 3 * (address + 1)]))


def driver_of(**keys: object) -> ModbusDriver:
    settings = ModbusSettings.model_validate({**RING, "ring": {"address": 16, "slots": 500}, **keys})
    return ModbusDriver(SourceRequest("peer", settings, ("a", "b")))


def test_ring_in_a_libmodbus_server_over_tcp_is_read(server: Path) -> None:
    port = free_port()
    with running(server, "tcp", str(port)) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        driver = driver_of(port=port)
        read_hundred(driver)
        driver.close()
        beyond = driver_of(port=port, ring={"address": 1990, "slots": 500})
        beyond.open()
        with pytest.raises(DriverIOError, match=r"exception 2 \(illegal data address\)"):
            beyond.read(1.0)
        beyond.close()


def test_ring_in_a_libmodbus_server_over_rtu_is_read(server: Path, tmp_path: Path) -> None:
    socat = peers.program("socat", "socat")
    ends = [tmp_path / "device", tmp_path / "reader"]
    with running(socat, "-d", "-d", *(f"pty,raw,echo=0,link={end}" for end in ends)) as joined:
        assert joined.stderr is not None
        while not re.search("starting data transfer", joined.stderr.readline()):
            assert joined.poll() is None
        with running(server, "rtu", str(ends[0])) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            driver = driver_of(transport="rtu", port=str(ends[1]), baudrate=115200, timeout_s=2.0)
            read_hundred(driver)
            driver.close()
