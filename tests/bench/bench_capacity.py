"""How many rigs of 1 kHz one core sustains, the whole agent, live on each bus; which stage limits.

python -m tests.bench.bench_capacity BUS RIGS (part of make bench). The devices play in real time in a process
of their own on another core; the agent runs on one core, its database included. Its cost is read from the
threads' processor time, so that other work on the machine blurs it little; to keep up it needs a core of its
own. Whether the devices held their pace is told by what came of their samples, and by their own ledgers.
With workers the agent has all cores, and what workers take is one stage.
"""

import os

# small products are ten times slower on two threads; must stand before numpy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import json
import logging
import math
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from agent.blocks.acquisition.single_source import SingleSource
from agent.blocks.estimation import Estimation
from agent.blocks.level_alarms import LevelAlarms
from agent.blocks.quality import Quality
from agent.config import load_many
from agent.evaluation.demo.bus import COARSE, Wire, write_config
from agent.runtime.service import Service
from agent.runtime.workers.service import SpreadService
from sim_bus.player import Player
from sim_bus.rig.rigfile import read_rig
from sim_bus.rig.scenario import load_scenario

BEGINNING_S, MOST_BEGINNING_S, MEASURED_S = 16.0, 90.0, 10.0
"""Rigs that begin together learn from window after window: how late they are then is one figure; what one
core carries, measured once they keep up, another."""
SPREAD_WARM_S = 15.0
"""With workers: so many rigs learn their first windows at once that all cores are needed for some seconds."""
KEEPS_UP_S = 1.0
RATE_HZ = 1000.0
GRAIN_S = 0.01
"""For so long samples gather in a device, as in those that fill a frame or a packet before they send it."""
WIDE = Wire(32, "1e-6", "1e-9")
"""Numbers of 32 bits: one sample is an FD frame of 16 bytes. Finer steps would clip the motion at their ends.
"""
STAGES: dict[str, tuple[type, str]] = {
    "acquisition": (SingleSource, "step"),
    "quality": (Quality, "step"),
    "estimation": (Estimation, "step"),
    "alarms": (LevelAlarms, "step"),
}
KINDS = (("read ", "read and decode"), ("north-", "northbound"), ("paho-", "northbound"))
OTHERS = "store and others"
"""What threads do, by how their names begin; libraries that serve consumers are counted with them."""
TICKS = os.sysconf("SC_CLK_TCK")
CORES = sorted(os.sched_getaffinity(0))


@dataclass(frozen=True, slots=True)
class Capacity:
    """What was measured.

    Attributes:
        rigs: how many ran.
        cost: processor seconds a second, by stage.
        lost: samples that the agent lost or refused, and gaps, by reason.
        lag_s: age of the newest sample that was computed, of the latest rig;  late_s: after BEGINNING_S.
        begun_s: when none was late any more.
        pace: samples that came, as a share of those that were due.
        unsent: samples that the devices could not send.
        devices: processor seconds a second of the devices' process.
        sent: rows a second that consumers beyond the gateway acknowledged.
    """

    rigs: int
    cost: dict[str, float]
    lost: dict[str, int]
    lag_s: float
    pace: float
    unsent: int
    devices: float
    sent: float = 0.0
    late_s: float = 0.0
    begun_s: float = 0.0

    @property
    def played(self) -> bool:
        """The devices sent all that was due; otherwise nothing was measured."""
        return self.unsent == 0 and self.pace > 0.99

    @property
    def kept_up(self) -> bool:
        """Nothing was lost and nothing waits."""
        return self.played and not self.lost and self.lag_s < KEEPS_UP_S

    @property
    def sustained(self) -> float:
        """Rigs that fill one core."""
        return self.rigs / sum(self.cost.values())

    @property
    def limit(self) -> str:
        """The stage that costs most."""
        return max(self.cost, key=lambda stage: self.cost[stage])


def configure(bus: str, rigs: int, folder: Path, more: str = "") -> list[Path]:
    """Write the demo's rig so many times, each with a device of its own; CAN carries FD frames.

    more: further tables of each file, in which NUMBER stands for the rig's.
    """
    paths = []
    for number in range(rigs):
        own = folder / f"{bus}{number}"
        own.mkdir()
        path = write_config(bus, WIDE if bus == "can" else COARSE, own, fast=True).config
        text = path.read_text(encoding="utf-8").replace('name = "demo"', f'name = "rig-{number}"')
        path.write_text(text.replace("every_s = 0", "every_s = 1.0"), encoding="utf-8")
        with path.open("a", encoding="utf-8") as file:
            file.write(more.replace("NUMBER", str(number)))
        paths.append(path)
    return paths


def devices(configs: list[str]) -> None:
    """Play the devices in real time until told to end; print what they could not send, and what they cost."""
    os.sched_setaffinity(0, CORES[-1:])
    scenario = load_scenario("steady", {})
    with ExitStack() as stack:
        players = [Player(read_rig(Path(config)), scenario, grain_s=GRAIN_S) for config in configs]
        for player in players:
            player.start()
            stack.callback(player.stop)
        print("ready", flush=True)
        sys.stdin.readline()
        begun, spent = time.monotonic(), time.process_time()
        sys.stdin.readline()
        cost = (time.process_time() - spent) / (time.monotonic() - begun)
        ledgers = [player.ledger(player.clock.played())["sources"] for player in players]
    runs = [run for ledger in ledgers for source in ledger.values() for run in source["lost"]]
    print(json.dumps({"cost": cost, "unsent": sum(last - first + 1 for first, last in runs)}), flush=True)


def agent(configs: list[str], folder: Path, workers: int) -> None:
    """Run the whole agent, on one core if it computes itself; print what its threads and stages cost."""
    if workers == 1:
        os.sched_setaffinity(0, CORES[:1])
    logging.disable(logging.CRITICAL)
    spent = _measured_stages()
    rigs = load_many([Path(config) for config in configs])
    own = bool(rigs[0].north)  # a database each, and so a thread and a connection each: what costs most
    db = None if own else folder / "agent.db"
    service = Service(rigs, db, "live") if workers == 1 else SpreadService(rigs, db, "live", workers)
    main = threading.get_native_id()
    found: dict[str, Any] = {}
    act = _watch if workers == 1 else _watch_workers
    watch = threading.Thread(target=act, args=(service, main, spent, found), daemon=True)
    watch.start()
    service.run(None)
    watch.join()
    found["samples"] = [document["samples"] for document in service.documents(1.0)]
    if "pace" not in found:  # at least: those of before all had begun count too
        came = sum(samples["received"] for samples in found["samples"])
        found["pace"] = came / (RATE_HZ * found["all_s"] * len(rigs))
    print(json.dumps(found), flush=True)


def _measured_stages() -> Counter[str]:
    """Have every stage of the pipeline note the processor time of its thread, ns."""
    spent: Counter[str] = Counter()

    def noted(name: str, method: Callable[..., Any]) -> Callable[..., Any]:
        def step(*args: Any, **named: Any) -> Any:
            begun = time.thread_time_ns()
            try:
                return method(*args, **named)
            finally:
                spent[name] += time.thread_time_ns() - begun

        return step

    for name, (owner, method) in STAGES.items():
        setattr(owner, method, noted(name, getattr(owner, method)))
    return spent


def _watch(service: Service, main: int, spent: Counter[str], found: dict[str, Any]) -> None:
    started = time.monotonic()
    time.sleep(BEGINNING_S)
    found["late_s"] = _late_s(service)
    while _late_s(service) > KEEPS_UP_S and time.monotonic() - started < MOST_BEGINNING_S:
        time.sleep(0.2)
    found["begun_s"] = time.monotonic() - started
    before, stages, came, begun = _threads(main), Counter(spent), _received(service), time.monotonic()
    sent = _sent(service)
    print("warm", flush=True)
    time.sleep(MEASURED_S)
    seconds = time.monotonic() - begun
    found["pace"] = (_received(service) - came) / (RATE_HZ * seconds * len(service.rigs))
    cost = {name: spend / 1e9 / seconds for name, spend in (_threads(main) - before).items()}
    inner = {name: spend / 1e9 / seconds for name, spend in (spent - stages).items()}
    cost["hand over"] = max(0.0, cost.pop("main", 0.0) - sum(inner.values()))
    found["cost"] = cost | inner
    found["sent"] = (_sent(service) - sent) / seconds
    found["lag_s"] = _late_s(service)
    service.stop()


def _watch_workers(service: Service, main: int, spent: Counter[str], found: dict[str, Any]) -> None:
    del spent
    while not (rigs := service.status.elsewhere()) or any(rig["lag_s"] is None for rig in rigs):
        time.sleep(0.1)
    all_begun = time.monotonic()
    time.sleep(SPREAD_WARM_S)
    workers = [worker["pid"] for worker in service.status.workers()]
    before, computed, begun = _threads(main), sum(map(spent_s, workers)), time.monotonic()
    sent = _sent(service)
    print("warm", flush=True)
    time.sleep(MEASURED_S)
    seconds = time.monotonic() - begun
    cost = {name: spend / 1e9 / seconds for name, spend in (_threads(main) - before).items()}
    cost["look after workers"] = cost.pop("main", 0.0)
    found["cost"] = cost | {"workers": (sum(map(spent_s, workers)) - computed) / seconds}
    found["sent"] = (_sent(service) - sent) / seconds
    found["lag_s"] = max(rig["lag_s"] for rig in service.status.elsewhere())
    found["all_s"] = time.monotonic() - all_begun
    service.stop()


def _sent(service: Service) -> int:
    """Return how many rows consumers have acknowledged."""
    return sum(one.sent for one in service.rig_set.forwarding.forwarders)


def spent_s(pid: int) -> float:
    """Return the processor time of a process, s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def _received(service: Service) -> int:
    """Return how many samples the drivers have read."""
    return sum(connection._driver.counts.received for connection in service.connections)


def _late_s(service: Service) -> float:
    """Return the age of the newest sample that was computed, of the rig that is latest."""
    ages = [rig.lag_s() for rig in service.rigs.values()]
    return max(age for age in ages if age is not None) if any(ages) else math.inf


def _threads(main: int) -> Counter[str]:
    """Return the processor time of this process's threads, ns: main, those of KINDS, the others together."""
    names = {thread.native_id: thread.name for thread in threading.enumerate()}
    spent: Counter[str] = Counter()
    for task in Path("/proc/self/task").iterdir():
        try:
            fields = (task / "stat").read_text().rpartition(")")[2].split()
        except OSError:  # it has ended meanwhile
            continue
        number, name = int(task.name), names.get(int(task.name), "")
        kind = "main" if number == main else next((k for start, k in KINDS if name.startswith(start)), OTHERS)
        spent[kind] += (int(fields[11]) + int(fields[12])) * 10**9 // TICKS
    return spent


def measure(bus: str, rigs: int, more: str = "", workers: int = 1) -> Capacity:
    """Run so many rigs on one bus and return what they cost; more: further tables of each file.

    workers: processes that compute, 1 for the agent's own.
    """
    with TemporaryDirectory() as name, ExitStack() as stack:
        configs = [str(path) for path in configure(bus, rigs, Path(name), more)]
        player = _part(stack, "devices", *configs)
        assert _line(player) == "ready\n"
        listener = _part(stack, "agent", str(workers), name, *configs)
        assert _line(listener) == "warm\n"
        _report(player)
        found = json.loads(_line(listener))
        _report(player)
        played = json.loads(_line(player))
    lost: Counter[str] = Counter()
    for one in found["samples"]:
        lost += Counter(one["dropped"]) + Counter(one["rejected"]) + Counter(gaps=one["gaps"])
    return Capacity(
        rigs, found["cost"], dict(lost), found["lag_s"], found["pace"], played["unsent"], played["cost"],
        found["sent"], found.get("late_s", 0.0), found.get("begun_s", 0.0),
    )  # fmt: skip


def _part(stack: ExitStack, *arguments: str) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "tests.bench.bench_capacity", *arguments]
    process = stack.enter_context(
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    )  # fmt: skip
    stack.callback(process.kill)
    return process


def _line(process: "subprocess.Popen[str]") -> str:
    assert process.stdout is not None
    return process.stdout.readline()


def _report(process: "subprocess.Popen[str]") -> None:
    assert process.stdin is not None
    process.stdin.write("\n")
    process.stdin.flush()


def reported(bus: str, found: Capacity) -> str:
    """Return a measurement in words."""
    ranked = sorted(found.cost.items(), key=lambda item: -item[1])
    costs = ", ".join(f"{stage} {100 * cost:.1f} %" for stage, cost in ranked)
    kept = (
        "kept up" if found.kept_up else "did NOT keep up" if found.played else "were NOT played at their pace"
    )
    lost = ", ".join(f"{count} {reason}" for reason, count in found.lost.items()) or "none"
    share = f"{100 * sum(found.cost.values()):.0f} % of a core"
    head = f"{bus}: {found.rigs} rigs at 1 kHz {kept}: {share}; one core would carry {found.sustained:.0f}"
    sent = (
        f"the devices sent {100 * found.pace:.1f} % of what was due, "
        f"at {100 * found.devices:.0f} % of another core"
    )
    return (
        f"{head}, limited by {found.limit}\n  lost: {lost}; {found.lag_s:.2f} s behind\n"
        f"  begun together: {found.late_s:.2f} s behind after {BEGINNING_S:.0f} s, none after "
        f"{found.begun_s:.0f} s\n"
        f"  of a core: {costs}\n  {sent}"
    )


def main(arguments: list[str]) -> None:
    """Play a part, or measure."""
    if arguments[0] == "devices":
        devices(arguments[1:])
    elif arguments[0] == "agent":
        agent(arguments[3:], Path(arguments[2]), int(arguments[1]))
    else:
        print(reported(arguments[0], measure(arguments[0], int(arguments[1]))))


if __name__ == "__main__":
    main(sys.argv[1:])
