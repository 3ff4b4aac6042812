"""How soon after its newest sample a row, and a step of an alarm, is on the disk, and what being sooner
costs.

python -m tests.bench.bench_latency BUS SETTING (part of make bench). One rig at 1 kHz, live; the devices play
in a process of their own. A sample waits for the end of its hop at most before the figures begin. Time stamps
are those of the rows: they count from the most punctual arrivals. The whole agent runs as it is, but that
alarms, where they are measured, change their state each fifth batch of rows. Where another setting than the
default is measured every row is stored. The default is measured once the first 32 windows, which are all
learnt from, are past: they come once in the life of a rig.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import json
import logging
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from agent.blocks.level_alarms import LevelAlarms
from agent.clock import wall_ns
from agent.config import load
from agent.runtime.service import Service
from agent.storage.write.writer import StoreWriter
from agent.types import AlarmTransition, EstimateBatch
from tests.bench.bench_capacity import TICKS, _line, _part, _report, configure

WARM_S, SETTLED_S, MEASURED_S = 6.0, 42.0, 20.0
DAY_S: Final = 86_400.0
SETTINGS: Final[dict[str, dict[str, str]]] = {
    "default": {},
    "thrifty": {"commit_s": "5.0", "round_s": "0.25", "period_s": "0.25"},
    "prompt": {"commit_s": "0.02", "round_s": "0.01", "period_s": "0.01"},
}
"""Keys of [store], [agent] and of the source, by the name of the setting; only a ring waits for long."""


@dataclass(frozen=True, slots=True)
class Latency:
    """What was measured: quantiles of the delay of rows or of alarms, s; cores; bytes written a day; how
    many."""

    p50: float
    p99: float
    cpu: float
    bytes_a_day: float
    n: int


def written(bus: str, setting: str, folder: Path) -> Path:
    """Write the rig's configuration with a setting; with all but the default every row is stored."""
    (path,) = configure(bus, 1, folder)
    keys = SETTINGS[setting]
    text = path.read_text(encoding="utf-8")
    if keys:
        text = text.replace("every_s = 1.0", "every_s = 0")
        text = text.replace("[store]\n", f"[store]\ncommit_s = {keys['commit_s']}\n")
        text += f"\n[agent]\nround_s = {keys['round_s']}\n"
        if bus == "modbus" or setting == "prompt":
            text = text.replace("[[source]]\n", f"[[source]]\nperiod_s = {keys['period_s']}\n")
    path.write_text(text, encoding="utf-8")
    return path


def agent(config: Path, what: str, warm_s: float) -> None:
    """Run the agent, and print the delays of what is measured: "rows" or "alarms", after so many seconds."""
    logging.disable(logging.CRITICAL)
    if what == "alarms":
        _restless_alarms()
    found: list[int] = []
    _noted_commits(found, AlarmTransition if what == "alarms" else EstimateBatch)
    service = Service([load(config)], config.with_name("agent.db"), "live")
    threading.Thread(target=_measured, args=(service, found, warm_s), daemon=True).start()
    service.run(None)


def _restless_alarms() -> None:
    """Let an alarm take a step at each fifth batch of rows, instead of what the rows say."""
    numbers = count()

    def step(self: LevelAlarms, batch: EstimateBatch) -> list[AlarmTransition]:
        number = next(numbers)
        if number % 5:
            return []
        states: tuple[Any, Any] = ("NORM", "UNACK") if number % 10 == 0 else ("UNACK", "RTNUN")
        cause = "raise" if number % 10 == 0 else "clear"
        t_ns = int(batch.t_ns[-1])
        return [AlarmTransition(batch.rig, "level", "k1", "high", t_ns, *states, cause, "measured")]

    LevelAlarms.step = step  # type: ignore[method-assign]  # for the measurement


def _noted_commits(found: list[int], kind: type) -> None:
    """Have every commit note how old each row of a kind is by now, ns."""
    noted = StoreWriter._note_latency

    def note(self: StoreWriter) -> None:
        noted(self)
        now = wall_ns()
        for records in self._flight.values():
            found.extend(
                now - t_ns for record in records if isinstance(record, kind) for t_ns in _stamps(record)
            )

    StoreWriter._note_latency = note  # type: ignore[method-assign]  # for the measurement


def _stamps(record: Any) -> Sequence[int]:
    return record.t_ns.tolist() if isinstance(record, EstimateBatch) else [record.t_ns]


def _measured(service: Service, found: list[int], warm_s: float) -> None:
    time.sleep(warm_s)
    del found[:]
    before, begun = _spent(), time.monotonic()
    print("warm", flush=True)
    time.sleep(MEASURED_S)
    seconds = time.monotonic() - begun
    cpu, octets = ((now - then) / seconds for now, then in zip(_spent(), before, strict=True))
    delays = np.array(found, dtype=np.float64) / 1e9
    p50, p99 = np.quantile(delays, [0.5, 0.99])
    print(json.dumps([p50, p99, cpu, octets * DAY_S, len(delays)]), flush=True)
    service.stop()


def _spent() -> tuple[float, float]:
    """Return the processor seconds of this process, and the bytes that it has sent to the disk."""
    fields = Path("/proc/self/stat").read_text().rpartition(")")[2].split()
    lines = dict(line.split(": ") for line in Path("/proc/self/io").read_text().splitlines())
    return (int(fields[11]) + int(fields[12])) / TICKS, float(lines["write_bytes"])


def measure(bus: str, setting: str, what: str) -> Latency:
    """Run one rig on a bus under a setting and return how late rows or alarms are, and what it costs."""
    warm_s = str(SETTLED_S if setting == "default" else WARM_S)
    with TemporaryDirectory() as name, ExitStack() as stack:
        config = written(bus, setting, Path(name))
        player = _part(stack, "devices", str(config))
        assert _line(player) == "ready\n"
        command = [sys.executable, "-m", "tests.bench.bench_latency", "agent", str(config), what, warm_s]
        running = stack.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        stack.callback(running.kill)
        assert _line(running) == "warm\n"
        _report(player)
        found = json.loads(_line(running))
        _report(player)
    return Latency(*found)


def reported(bus: str, setting: str, what: str, found: Latency) -> str:
    """Return a measurement in words."""
    return (
        f"{bus}, {setting}: {found.n} {what}, {1e3 * found.p50:.0f} ms after their newest sample at p50, "
        f"{1e3 * found.p99:.0f} ms at p99; {100 * found.cpu:.1f} % of a core, "
        f"{found.bytes_a_day / 1e9:.2f} GB a day"
    )


def main(arguments: list[str]) -> None:
    """Play a part, or measure rows and alarms."""
    if arguments[0] == "agent":
        agent(Path(arguments[1]), arguments[2], float(arguments[3]))
        return
    bus, setting = arguments
    for what in ("rows", "alarms"):
        print(reported(bus, setting, what, measure(bus, setting, what)))


if __name__ == "__main__":
    main(sys.argv[1:])
