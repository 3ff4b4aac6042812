"""Archives of raw recordings as agents leave them, and what a database says of rigs."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from agent.recording.blocks import BlockSegment
from agent.recording.header import RawHeader
from agent.runtime.reestimation.pools import LocalPool
from agent.types import FloatArray
from drivers.port import SampleBlock
from tests.peers import ROOT
from tests.rigs import step_matrices
from tests.storage.rows import START, select

SECOND = 1_000_000_000
ROWS = 50
FIELDS = ("force", "x1", "x2")
TABLES = {
    "v_estimates": "rig, t_ns, parameter, value, delta, sd, lower, upper, status, reason, held, held_age_s, "
    "window_s, n_used, n_missing",
    "v_alarms": "rig, kind, parameter, state, raised_at, cleared_at, delta, sd, probability, message",
    "v_health": "rig, source, t_ns, received, used, rejected, dropped, gaps",
    "v_verdicts": "rig, t_ns, hypothesis, size, sd, probability",
    "v_forecast": "rig, parameter, made_at_ns, status, p50_at, chance",
}


class Here(LocalPool):
    """Threads of this process in place of processes."""

    def _made(self) -> ThreadPoolExecutor:
        return ThreadPoolExecutor(1)


def said(db: Path) -> dict[str, list[tuple[Any, ...]]]:
    """Return what a database says of all rigs, to the last bit, whichever run said it."""
    return {view: sorted(map(repr, select(db, f"SELECT {columns} FROM {view}")))  # type: ignore[misc]
            for view, columns in TABLES.items()}  # fmt: skip


def configuration(folder: Path, name: str = "press-1") -> Path:
    """Write the serial example, whose samples are recorded as samples, under another name."""
    text = (ROOT / "deploy" / "examples" / "serial.toml").read_text(encoding="utf-8")
    path = folder / f"{name}.toml"
    path.write_text(text.replace('name = "two-mass-rig"', f'name = "{name}"'), encoding="utf-8")
    return path


def readings(rng: np.random.Generator, count: int) -> FloatArray:
    """Return (count, 3) force and displacements of the healthy example at 1 kHz under a random force."""
    F, G0, G1 = step_matrices(25.0, 100.0, 5.0, 5.0, 1e-3)
    force = np.round(rng.normal(0.0, 5.0, count + 1), 3)
    x, found = np.zeros(4), np.empty((count, 3))
    for i in range(count):
        found[i] = force[i], *x[:2]
        x = F @ x + G0 * force[i] + G1 * force[i + 1]
    found[:, 1:] = np.round((found[:, 1:] + rng.normal(0.0, 1e-6, (count, 2))) / 2e-6) * 2e-6
    return found


def archive(folder: Path, rig: str, seconds: float = 1.0, seed: int = 0, *, files: int = 2) -> list[Path]:
    """Write what an agent recorded of a rig: so many files, one behind the other."""
    folder.mkdir(parents=True, exist_ok=True)
    values = readings(np.random.default_rng(seed), round(1000 * seconds))
    paths = [folder / f"{rig}-{rig}-{number:08d}.raw" for number in range(files)]
    header = RawHeader("line", FIELDS, 65536, "ab" * 32, "0.1.0", START, rig=rig)
    for path, part in zip(paths, np.array_split(np.arange(0, len(values), ROWS), files), strict=True):
        segment = BlockSegment(path, header)
        for first in part.tolist():
            rows = np.arange(first, first + ROWS)
            arrival = int(first + ROWS) * 1_000_000
            segment.add(SampleBlock(values[rows], arrival, rows % 65536, wall_offset_ns=START), None)
        segment.close()
    return paths
