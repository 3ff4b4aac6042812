"""What rigs at 1 kHz cost in one process and over workers, and how many one and two cores would carry.

python -m tests.bench.bench_workers BUS RIGS WORKERS (part of make bench). The agent is `deltak run`; its cost
is the processor time of all its processes, so that other work on the machine blurs it little. What two cores
carry is bounded by the two costliest processes: each fills a core at most.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import sys
import time
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from agent.cli.gateway.status import status
from tests.bench.bench_capacity import _line, _part, _report, configure, spent_s
from tests.scenario.live import agent, hops, wait_until

WARM_S, MEASURED_S = 15.0, 15.0


@dataclass(frozen=True, slots=True)
class Spread:
    """What was measured.

    Attributes:
        rigs: how many ran.
        cores: processor seconds a second, by process: the agent's own first, then its workers'.
        mb: proportional memory of each, MB.
        lost: samples refused or dropped, and gaps, by reason.
    """

    rigs: int
    cores: tuple[float, ...]
    mb: tuple[float, ...]
    lost: dict[str, int]

    def carried(self, cores: int) -> float:
        """Return how many such rigs fill so many cores; a process fills one at most."""
        return self.rigs / max(sum(self.cores) / cores, *self.cores)


def measure(bus: str, rigs: int, workers: int) -> Spread:
    """Run so many rigs in so many workers and return what they cost."""
    with TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        configs = configure(bus, rigs, folder)
        for config in configs:
            config.write_text(f"{config.read_text()}\n[agent]\nworkers = {workers}\n", encoding="utf-8")
        player = _part(stack, "devices", *map(str, configs))
        assert _line(player) == "ready\n"
        db = folder / "agent.db"
        running = stack.enter_context(agent(*configs, options=["--db", str(db)]))
        names = [f"rig-{number}" for number in range(rigs)]
        wait_until(lambda: min(hops(db, name) for name in names) > 0, "rows of all")
        _report(player)
        time.sleep(WARM_S)
        pids = [running.process.pid, *(worker["pid"] for worker in status(db)["workers"])]
        before, begun = [spent_s(pid) for pid in pids], time.monotonic()
        time.sleep(MEASURED_S)
        seconds = time.monotonic() - begun
        cores = tuple((spent_s(pid) - then) / seconds for pid, then in zip(pids, before, strict=True))
        mb = tuple(map(proportional_mb, pids))
        document = running.document()
        _report(player)
    runs: list[dict[str, Any]] = document.get("runs", [document])
    lost: Counter[str] = Counter()
    for samples in (run["samples"] for run in runs):
        lost += Counter(samples["dropped"]) + Counter(samples["rejected"]) + Counter(gaps=samples["gaps"])
    return Spread(rigs, cores, mb, dict(lost))


def proportional_mb(pid: int) -> float:
    """Return the memory of a process, of what it shares with others its part, MB."""
    (line,) = [
        line for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines() if line.startswith("Pss:")
    ]
    return int(line.split()[1]) / 1024


def reported(bus: str, found: Spread) -> str:
    """Return a measurement in words."""
    cores = " + ".join(f"{100 * one:.0f}" for one in found.cores)
    mb = " + ".join(f"{one:.0f}" for one in found.mb)
    return (
        f"{bus}: {found.rigs} rigs at 1 kHz in {max(1, len(found.cores) - 1)} processes that compute: "
        f"{cores} % of a "
        f"core, {mb} MB; one core would carry {found.carried(1):.0f}, two {found.carried(2):.0f}; "
        f"lost: {found.lost or 'none'}"
    )


if __name__ == "__main__":
    print(reported(sys.argv[1], measure(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))))
