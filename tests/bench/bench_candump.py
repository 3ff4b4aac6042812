"""What a candump log costs from its text to the estimates in the database: frames a second of one core, and
where to.

python -m tests.bench.bench_candump (part of make bench). The rig of deploy/examples/can.toml: one frame to a
sample, or two that carry its force and its motion, joined by their counters. Counted is the processor time of
`deltak replay` as a process of its own, from its start to its end, as it is installed without extras:
asammdf, which python-can loads where it finds it, would add half a second.
"""

import os

# small products are ten times slower on two threads; must stand before numpy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import json
import resource
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_bus.rig.rigfile import read_rig
from sim_bus.rig.scenario import load_scenario
from sim_bus.rig.trajectory import Rig, Trajectory
from sim_bus.tuning import CHUNK
from tests.peers import ROOT

EXAMPLES = ROOT / "deploy" / "examples"
FRAMES = 1_000_000
FEW = 2_000
STEPS = (1e-3, 2e-6, 2e-6)
PARTS = (1, 2)
"""Frames to a sample."""


WITHOUT_EXTRAS = "import sys; sys.modules['asammdf'] = None; from agent.cli.app import main; main()"


@dataclass(frozen=True, slots=True)
class Cost:
    """A replay: frames and samples read, rows made, processor seconds, and those of a replay of next to
    nothing."""

    frames: int
    samples: int
    rows: int
    seconds: float
    start: float

    @property
    def rate(self) -> float:
        """Frames a second of one core, the start of the process included."""
        return self.frames / self.seconds

    @property
    def steady(self) -> float:
        """Frames a second of one core, without the start."""
        return self.frames / (self.seconds - self.start)


def dbc(each: int) -> str:
    """Return the description of the frames: the example's, or two messages."""
    text = (EXAMPLES / "two-mass-rig.dbc").read_text(encoding="utf-8")
    if each == 1:
        return text
    head, rest = text.split(" SG_ X1")
    head, tail = head.replace("8 RIG", "4 RIG"), " SG_ X1" + rest.partition("CM_")[0]
    counter = next(line for line in head.splitlines() if "Counter" in line)
    moved = tail.replace("32|16", "16|16").replace("48|16", "32|16")
    return f"{head}\nBO_ 257 RIG_MOTION: 6 RIG\n{counter}\n{moved}"


def configure(folder: Path, each: int) -> Path:
    """Write the rig's configuration, keeping what live runs keep."""
    text = (EXAMPLES / "can.toml").read_text(encoding="utf-8").replace("two-mass-rig.dbc", "bench.dbc")
    if each == 2:
        text = text.replace("RIG_SAMPLE.X", "RIG_MOTION.X")
    (folder / "bench.dbc").write_text(dbc(each), encoding="utf-8")
    path = folder / "bench.toml"
    path.write_text(text, encoding="utf-8")
    return path


def readings(config: Path, samples: int) -> NDArray[np.int64]:
    """Return (samples, 3) raw numbers of a healthy rig under a random force."""
    trajectory = Trajectory(Rig(read_rig(config), load_scenario("steady", {})))
    values = np.concatenate([trajectory.chunk(number).readings for number in range(-(-samples // CHUNK))])[
        :samples
    ]
    return np.clip(np.rint(values / STEPS), -(2**15), 2**15 - 1).astype(np.int64)


def lines(raw: NDArray[np.int64], each: int) -> Iterator[str]:
    """Yield the text of `candump -L`."""
    count = np.arange(len(raw))[:, None]
    table = np.concatenate([count % 2**16, raw], axis=1).astype("<u2")
    bodies = [("100", table)] if each == 1 else [("100", table[:, :2]), ("101", table[:, [0, 2, 3]])]
    datas = [(name, np.ascontiguousarray(body).view(np.uint8).reshape(len(raw), -1)) for name, body in bodies]
    for row in range(len(raw)):
        for place, (name, data) in enumerate(datas):
            stamp = f"{1_600_000_000 + row // 1000}.{row % 1000:03d}{place}00"
            yield f"({stamp}) can0 {name}#{data[row].tobytes().hex().upper()}\n"


def measure(each: int, frames: int = FRAMES) -> Cost:
    """Replay a log of so many frames, `each` to a sample, into a database."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        config = configure(folder, each)
        raw = readings(config, frames // each)
        _, start = replayed(config, raw[:FEW], each)
        document, seconds = replayed(config, raw, each)
    assert document["samples"]["used"] == len(raw), document["samples"]
    return Cost(each * len(raw), len(raw), document["windows"], seconds, start)


def replayed(config: Path, raw: NDArray[np.int64], each: int) -> tuple[dict[str, Any], float]:
    """Return a replay's document, and the processor seconds of its process."""
    log, db = config.with_name(f"{len(raw)}.log"), config.with_name(f"{len(raw)}.db")
    with log.open("w", encoding="ascii") as file:
        file.writelines(lines(raw, each))
    command = [
        sys.executable,
        "-c",
        WITHOUT_EXTRAS,
        "replay",
        str(config),
        str(log),
        "--db",
        str(db),
        "--json",
    ]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    document: dict[str, Any] = json.loads(done.stdout)
    return document, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def reported(found: Cost) -> str:
    """Return a measurement in words."""
    counted = f"{found.frames:,} frames, {found.samples:,} samples, {found.rows:,} rows"
    start = f"the start of {found.start:.1f} s"
    rates = f"{found.rate:,.0f} frames a second of one core, {found.steady:,.0f} without {start}"
    return f"candump log into SQLite, {found.frames // found.samples} to a sample: {rates} ({counted})"


if __name__ == "__main__":
    for some in PARTS:
        print(reported(measure(some)), flush=True)
