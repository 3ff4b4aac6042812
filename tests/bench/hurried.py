"""An agent whose clocks stand still while it computes and run ahead while it waits: days in minutes.

python -m tests.bench.hurried FOLDER DAYS RATE_HZ. It is `deltak run` of the Modbus example but for its
device, which hands over so many seconds of readings as soon as those before have been computed, and but for
clocks, which tell how much was handed over. What waits for the disk or for a thread waits in true time. The
spring k1 is 40 N/m too stiff for a minute of each three hours. An hour of played time is a line of JSON.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import ctypes
import json
import sys
import threading
import time
from pathlib import Path

import numpy as np

from agent.config import load_many
from agent.runtime.process.memory import keep_heap_small
from agent.runtime.service import Service
from drivers.modbus.driver import ModbusDriver
from drivers.port import SampleBlock, SourceRequest
from sim_bus.rig.plant import Graph, Link, equations, propagate, step
from tests.peers import ROOT

STEP_S, RECORD_S, HOUR_S = 5, 200, 3600
ODD_EVERY_S, ODD_S = 3 * HOUR_S, 60
WRAP = 1 << 32


class Clock:
    """Played time, which stands in for the machine's clocks."""

    def __init__(self) -> None:
        self.played_ns = 0
        self._monotonic, self._wall = time.monotonic_ns(), time.time_ns()

    def rule(self) -> None:
        """Have everybody here go by it."""
        time.monotonic_ns = lambda: self._monotonic + self.played_ns
        time.time_ns = lambda: self._wall + self.played_ns


def readings(k1: float, rate: int) -> np.ndarray:
    """Return force and displacements (N, 3) of the example's rig, which go on where they began."""
    rng, n = np.random.default_rng(5), RECORD_S * rate
    springs = (Link("k1", ("ground", "m1")), Link("k2", ("m1", "m2")))
    dampers = (Link("B1", ("ground", "m1")), Link("B2", ("m1", "m2")))
    values = {"m1": 5.0, "m2": 3.0, "k1": k1, "k2": 100.0, "B1": 5.0, "B2": 5.0}
    motion = equations(Graph(("m1", "m2"), springs, dampers), values)
    u = 5.0 * rng.standard_normal((n, 1))
    forces = np.hstack([np.zeros((2 * n + 1, 1)), np.vstack([u, u, u[:1]])])
    states = propagate(step(motion, 1 / rate), np.zeros(4), forces)
    return np.hstack([u, states[n : 2 * n, :2]])


class Device(ModbusDriver):
    """Hands over the next seconds once the agent waits for them."""

    clock: Clock
    service: Service
    rate: int

    def __init__(self, request: SourceRequest) -> None:
        super().__init__(request)
        self.counter_modulus = WRAP
        self._right, self._odd = readings(25.0, self.rate), readings(65.0, self.rate)
        self._rng = np.random.default_rng(6)
        self._at = 0

    def open(self) -> None:
        """Nothing is to be opened."""

    def close(self) -> None:
        """Nor closed."""

    def read(self, timeout_s: float) -> SampleBlock:
        """Return the next readings, or none where earlier ones still wait."""
        if not self._is_waited_for():
            time.sleep(min(timeout_s, 0.001))
            return SampleBlock(np.empty((0, 3)), time.monotonic_ns())
        index = np.arange(self._at, self._at + STEP_S * self.rate)
        is_odd = self._at // self.rate % ODD_EVERY_S >= ODD_EVERY_S - ODD_S
        values = (self._odd if is_odd else self._right)[index % (RECORD_S * self.rate)]
        values[:, 1:] += 1e-6 * self._rng.standard_normal((len(index), 2))
        self._at += len(index)
        self.clock.played_ns += STEP_S * 10**9
        self.counts.received += len(index)
        return SampleBlock(values, time.monotonic_ns(), counter=index % WRAP)

    def _is_waited_for(self) -> bool:
        connections, rigs = self.service.connections, self.service.rigs.values()
        return not any(one._waiting for one in connections) and not any(rig.waiting for rig in rigs)


def memory_mb() -> dict[str, float]:
    """Return this process's private memory, what SQLite holds of it, and Python's blocks in thousands."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    (anonymous,) = [line.split()[1] for line in lines if line.startswith("RssAnon")]
    used = ctypes.CDLL("libsqlite3.so.0").sqlite3_memory_used
    used.restype = ctypes.c_int64
    return {
        "anonymous": int(anonymous) / 1024, "sqlite": used() / 2**20,
        "blocks": sys.getallocatedblocks() / 1000,
    }  # fmt: skip


def write_config(folder: Path, rate: int) -> Path:
    """Write the example for a rig of this rate, with windows of 200 samples and a hop of 50."""
    text = (ROOT / "deploy" / "examples" / "modbus.toml").read_text(encoding="utf-8")
    for old, new in (
        ("sample_rate_hz = 1000.0", f"sample_rate_hz = {rate}.0"),
        ("window_s = 0.25", f"window_s = {200 / rate}"), ("hop_s = 0.05", f"hop_s = {50 / rate}"),
        ('mode = "ring"', 'mode = "ring"\nstale_s = 600.0'),  # of true time
        ('type = "int16", scale = 1e-3', 'type = "int32", scale = 1e-6'),
        ('type = "int16", scale = 2e-6', 'type = "int32", scale = 1e-10'),
    ):  # fmt: skip
        assert old in text
        text = text.replace(old, new)
    path = folder / "rig.toml"
    path.write_text(f"{text}\n[agent]\nround_s = 0.005\n", encoding="utf-8")
    return path


def look(service: Service, clock: Clock, days: float) -> None:
    """Tell of each hour; end the agent after so many days."""
    hour = 0
    while clock.played_ns < days * 24 * HOUR_S * 1e9:
        time.sleep(0.05)
        if clock.played_ns >= hour * HOUR_S * 1e9:
            (rig,) = service.rigs.values()
            document = {"hour": hour, **memory_mb(), "rows": rig.summary.windows}
            print(json.dumps(document), flush=True)
            hour += 1
    service.stop()


def main(folder: Path, days: float, rate: int) -> None:
    """Run it."""
    keep_heap_small()
    clock = Clock()
    clock.rule()
    Device.clock, Device.rate = clock, rate
    setattr(sys.modules["drivers.modbus.driver"], "ModbusDriver", Device)  # noqa: B010 - what the entry names
    service = Service(load_many([write_config(folder, rate)]), None, "live")
    Device.service = service
    threading.Thread(target=look, args=(service, clock, days), daemon=True).start()
    service.run(None)
    (document,) = service.documents(1.0)
    print(json.dumps({"samples": document["samples"], "alarms": len(document["alarms"])}), flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3]))
