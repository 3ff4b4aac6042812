"""Device, agent and can-utils on the kernel's virtual buses. A plain script: test_uml.py judges what it
leaves behind.

One agent watches three rigs: vcan0 carries ten seconds of a simulated device beside frames of cangen, with
candump taking everything down and the agent recording; on vcan1 canplayer plays the first three seconds of
that recording; vcan2 is set down and up, deleted and made anew, while a device sends. Nothing heavy is
imported, as a guest computes slowly.
"""

import json
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path

from agent.evaluation.demo.bus import COARSE, write_config

HERE = Path(__file__).parent
BUSES = {"played": "vcan0", "canplayer": "vcan1", "shaken": "vcan2"}
LIMIT_S = 60.0
SAME_ARITHMETIC = {"OPENBLAS_CORETYPE": "Prescott"}
"""A guest shows programs another processor than its host does; sums in another order would differ in the last
bits."""


def ip(*words: str) -> None:
    subprocess.run(["ip", "link", *words], check=True)


def bring_up(bus: str) -> None:
    if not Path("/sys/class/net", bus).exists():
        ip("add", "dev", bus, "type", "vcan")
    ip("set", bus, "up")


def configure(rig: str, bus: str, folder: Path) -> Path:
    """Write the demo's configuration for one of the kernel's buses."""
    own = folder / rig
    own.mkdir()
    path = write_config("can", COARSE, own).config
    text = path.read_text(encoding="utf-8").replace('"demo"', f'"{rig}"').replace('"vcan0"', f'"{bus}"')
    if rig == "played":
        text = text.replace('driver = "can"', 'driver = "can"\nrecord = true')
    path.write_text(text.replace("stale_s = 30.0", "stale_s = 300.0"), encoding="utf-8")
    return path


def until(condition: Callable[[], object], what: str) -> None:
    deadline = time.monotonic() + LIMIT_S
    while not condition():
        if time.monotonic() > deadline:
            raise SystemExit(f"after {LIMIT_S:g} s: not {what}")
        time.sleep(0.02)


def received(bus: str) -> bool:
    """Tell whether any program listens to a bus."""
    tables = [table.read_text(encoding="ascii") for table in Path("/proc/net/can").glob("rcvlist_*")]
    rows = [line.split() for table in tables for line in table.splitlines()]
    return any(row[0] == bus and len(row) > 4 for row in rows if row)


def count(db: Path, query: str, *values: object) -> int:
    """Return the number that a query of the agent's database finds; 0 while there is none."""
    if not db.exists():
        return 0
    with closing(sqlite3.connect(f"file:{db}?mode=ro", uri=True)) as connection:
        try:
            return int(connection.execute(query, values).fetchone()[0])
        except sqlite3.OperationalError:
            return 0  # it is being made


def rows(db: Path, rig: str) -> int:
    return count(db, "SELECT count(*) FROM v_estimates WHERE rig = ? AND parameter = 'k1'", rig)


@contextmanager
def running(command: Sequence[str], output: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run a program beside this one; it is ended by SIGTERM."""
    with output.open("wb") as file, subprocess.Popen(command, stdout=file) as process:
        try:
            yield process
        finally:
            process.send_signal(signal.SIGTERM)
            process.wait(LIMIT_S)


def deltak(*words: str | Path) -> list[str]:
    return [sys.executable, "-m", "agent", *map(str, words)]


def watch_and_play(folder: Path, db: Path) -> None:
    """vcan0: a device for ten seconds, cangen beside it, candump taking everything down."""
    sim = deltak(
        "sim", folder / "played/demo.toml", "--scenario", HERE / "ten.toml", "--truth", folder / "truth.npz"
    )
    noise = ["cangen", "vcan0", "-I", "5A5", "-L", "8", "-g", "20"]
    with (
        running(["candump", "-L", "-r", "8000000", "vcan0"], folder / "candump.log"),
        running(noise, folder / "cangen.out"),
        running(sim, folder / "sim.out"),
    ):
        until(lambda: rows(db, "played") >= 200, "200 rows of what was played")


def play_log(folder: Path, db: Path) -> None:
    """vcan1: canplayer plays what the agent recorded of the first three seconds."""
    (recording,) = (folder / "live.db.raw").glob("played-can-*.log")
    chosen = recording.read_text(encoding="ascii").splitlines()[:3000]
    (folder / "short.log").write_text("".join(f"{line}\n" for line in chosen), encoding="ascii")
    subprocess.run(["canplayer", "-I", folder / "short.log", "vcan1=vcan0"], check=True)
    until(lambda: rows(db, "canplayer") >= 60, "60 rows of what canplayer sent")


def shake(folder: Path, db: Path) -> dict[str, int]:
    """vcan2: down and up, deleted and made anew; return the wall time, ns, of each return."""
    back: dict[str, int] = {}
    sim = deltak("sim", folder / "shaken/demo.toml", "--scenario", "steady")
    with running(sim, folder / "sim2.out"):
        until(lambda: rows(db, "shaken") >= 10, "10 rows before the bus goes")
        for number, away in enumerate([("set", "vcan2", "down"), ("del", "vcan2")], 1):
            ip(*away)
            until(lambda: events(db, "lost") >= number, "lost")  # noqa: B023 (called within this turn)
            time.sleep(0.5)  # so that pauses between tries grow
            bring_up("vcan2")
            back[away[0]] = time.time_ns()
            until(lambda: events(db, "recovered") >= number, "recovered")  # noqa: B023 (called within this turn)
            settled = rows(db, "shaken") + 10
            until(lambda: rows(db, "shaken") >= settled, "rows again")  # noqa: B023 (called within this turn)
    return back


def events(db: Path, cause: str) -> int:
    return count(db, "SELECT count(*) FROM v_events WHERE rig = 'shaken' AND cause = ?", cause)


def main(results: Path) -> None:
    folder = Path(tempfile.mkdtemp(prefix="inside"))
    os.environ.update(SAME_ARITHMETIC)
    for bus in BUSES.values():
        bring_up(bus)
    configs = [configure(rig, bus, folder) for rig, bus in BUSES.items()]
    db = folder / "live.db"
    with running(deltak("run", *configs, "--db", db, "--json"), folder / "run.json"):
        until(lambda: all(map(received, BUSES.values())), "listening to every bus")
        watch_and_play(folder, db)
        play_log(folder, db)
        back = shake(folder, db)
    (folder / "back.json").write_text(json.dumps(back), encoding="ascii")
    for name in ("live.db", "run.json", "back.json", "truth.npz", "candump.log"):
        shutil.copy(folder / name, results)
    shutil.copytree(folder / "live.db.raw", results / "live.db.raw")
    shutil.rmtree(folder)


if __name__ == "__main__":
    main(Path(os.environ["RESULTS"]))
