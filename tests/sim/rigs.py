"""Configurations and peers for the tests of the simulator; they read what it plays by means of their own."""

import json
import os
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import typer
from typer.testing import CliRunner

from sim_bus.commands import sim
from sim_bus.rig.rigfile import RigFile, checked

ROOT = Path(__file__).resolve().parents[2]
LIMIT_S = 20.0

MODEL = """
[rig]
name = "bench"
sample_rate_hz = {rate}
[model]
kind = "mass-spring-damper"
mass = [{{ name = "m1", value = 5.0 }}, {{ name = "m2", value = 3.0 }}]
spring = [
  {{ name = "k1", between = ["ground", "m1"], nominal = 25.0 }},
  {{ name = "k2", between = ["m1", "m2"], nominal = 100.0 }},
]
damper = [
  {{ name = "B1", between = ["ground", "m1"], nominal = 5.0 }},
  {{ name = "B2", between = ["m1", "m2"], nominal = 5.0 }},
]
[[channel]]
name = "force"
quantity = "force"
at = "m2"
unit = "N"
[[channel]]
name = "x1"
quantity = "displacement"
at = "m1"
unit = "m"
noise_sd = 1e-6
[[channel]]
name = "x2"
quantity = "displacement"
at = "m2"
unit = "mm"
noise_sd = 1e-3
"""

INT16 = """fields = [
  {{ name = "F", type = "int16", scale = 1e-3 }},
  {{ name = "X1", type = "int16", scale = 2e-6 }},
  {{ name = "X2", type = "int16", scale = 2e-3 }},
]
map = {{ force = "F", x1 = "X1", x2 = "X2" }}
"""

RING = """
[[source]]
name = "plc"
driver = "modbus"
transport = "tcp"
host = "127.0.0.1"
port = {port}
mode = "ring"
index = {{ address = 0, type = "uint32" }}
ring = {{ address = 16, slots = {slots} }}
"""


def ring_config(port: int, rate: float = 1000.0, slots: int = 1024) -> str:
    """Return a configuration with one Modbus ring of int16 numbers."""
    return (MODEL + RING + INT16).format(port=port, rate=rate, slots=slots)


def rig(text: str) -> RigFile:
    """Return a configuration's text as the simulator reads it."""
    import tomllib

    return checked(RigFile, tomllib.loads(text), "test")


class Simulator:
    """`sim` in a process of its own."""

    def __init__(self, folder: Path, config: str, *options: str, env: dict[str, str] | None = None) -> None:
        self.config = folder / "rig.toml"
        self.config.write_text(config, encoding="utf-8")
        self.truth_file = folder / "truth.npz"
        command = [
            sys.executable,
            "-m",
            "sim_bus",
            str(self.config),
            "--truth",
            str(self.truth_file),
            *options,
        ]
        self.process = subprocess.Popen(
            command,
            cwd=ROOT,
            env=os.environ | {"DELTAK_SEED": ""} | (env or {}),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def ready(self) -> "Simulator":
        """Return when the devices can be read."""
        assert self.process.stdout is not None
        watchdog = threading.Timer(LIMIT_S, self.process.kill)
        watchdog.start()
        line = self.process.stdout.readline()
        watchdog.cancel()
        assert line == "ready\n", (line, self.process.communicate(timeout=LIMIT_S))
        return self

    def stop(self, number: int = signal.SIGTERM) -> int:
        """Send a signal and return the exit code."""
        self.process.send_signal(number)
        return self.end()

    def end(self) -> int:
        """Wait for the end and return the exit code."""
        self.out, self.err = self.process.communicate(timeout=LIMIT_S)
        return self.process.returncode

    def truth(self) -> dict[str, Any]:
        """Return the truth file's content."""
        with np.load(self.truth_file) as arrays:
            return {name: arrays[name] for name in arrays}

    def ledger(self) -> dict[str, Any]:
        """Return the ledger in the truth file."""
        return dict(json.loads(str(self.truth()["ledger"])))


@dataclass(frozen=True)
class Refusal:
    """How `sim` ended that never began."""

    code: int
    out: str
    err: str


def refused(folder: Path, config: str, *options: str) -> Refusal:
    """Run `sim` in this process on what it must refuse before it opens anything."""
    (folder / "rig.toml").write_text(config, encoding="utf-8")
    app = typer.Typer()
    app.command()(sim)
    result = CliRunner().invoke(app, [str(folder / "rig.toml"), *options])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return Refusal(result.exit_code, result.stdout, result.stderr)


@contextmanager
def simulator(
    folder: Path, config: str, *options: str, env: dict[str, str] | None = None
) -> Iterator[Simulator]:
    """Run `sim` and end it in any case."""
    running = Simulator(folder, config, *options, env=env)
    try:
        yield running.ready()
    finally:
        if running.process.poll() is None:
            running.process.kill()
            running.process.communicate()


class RawModbus:
    """A Modbus TCP client of sockets and struct only."""

    def __init__(self, port: int) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), LIMIT_S)
        self._number = 0

    def request(self, pdu: bytes, unit: int = 1) -> bytes:
        """Send a request and return the reply's PDU; the header is checked."""
        self._number += 1
        self._socket.sendall(struct.pack(">HHHB", self._number, 0, len(pdu) + 1, unit) + pdu)
        number, protocol, length, answered = struct.unpack(">HHHB", self._exactly(7))
        assert (number, protocol, answered) == (self._number, 0, unit)
        return self._exactly(length - 1)

    def registers(self, address: int, count: int, function: int = 4) -> list[int]:
        """Read registers."""
        reply = self.request(struct.pack(">BHH", function, address, count))
        assert reply[:2] == bytes([function, 2 * count]), reply
        return list(struct.unpack(f">{count}H", reply[2:]))

    def index(self, address: int = 0) -> int:
        """Read a 32-bit index, high word first."""
        high, low = self.registers(address, 2)
        return high << 16 | low

    def _exactly(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            piece = self._socket.recv(count - len(data))
            assert piece, "the device closed the connection"
            data += piece
        return data

    def close(self) -> None:
        """Hang up."""
        self._socket.close()


def int16(registers: list[int]) -> list[int]:
    """Return registers as signed numbers."""
    return [register - 65536 if register > 32767 else register for register in registers]


def until(condition: Any, limit_s: float = LIMIT_S) -> None:
    """Return when the condition holds; fail after limit_s."""
    deadline = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline, "the condition did not come true"
        time.sleep(0.002)
