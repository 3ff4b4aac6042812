"""Has the service live through hunger, too little memory and a power cut; test_hardship.py asserts what is
found.

Two boots: the first ends without a sync, so that of its disk only what was synced is there in the second.
"""

import json
import os
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

from tests.systemd import inside
from tests.systemd.inside import flows, rows, shown, systemctl, until

QUOTA = "5%"
WATCHDOG_S = 15
INTERVALS = 6
"""For so many intervals of the watchdog the agent starves."""
STATE = "/var/lib/deltak"
ROWS = "SELECT rig, t_ns, parameter, value FROM v_estimates ORDER BY rig, t_ns, parameter"


def mount_disk() -> None:
    """Let the service keep its state on the guest's disk, which has a cache of its own, as real ones do."""
    subprocess.run(["mknod", "/run/disk", "b", "98", "0"], check=True)
    Path(STATE).mkdir(exist_ok=True)
    subprocess.run(["mount", "-t", "ext4", "/run/disk", STATE], check=True)


def flow_again() -> None:
    """Wait for rows that are newer than this moment; a pty is let go of by nobody but its first reader."""
    since = time.time_ns()
    until(lambda: {"can", "plc"} <= set(flows(since)), "rows again")


def starve(found: dict[str, object]) -> None:
    """Leave the agent a twentieth of the processor for long."""
    systemctl("set-property", "--runtime", "deltak", f"CPUQuota={QUOTA}")
    before, begun = int(shown("CPUUsageNSec")), time.monotonic()
    time.sleep(INTERVALS * WATCHDOG_S)  # the hunger itself
    found["share"] = (int(shown("CPUUsageNSec")) - before) / 1e9 / (time.monotonic() - begun)
    found["restarts of the starved"] = shown("NRestarts")
    systemctl("set-property", "--runtime", "deltak", "CPUQuota=")
    flow_again()


def lack_memory(found: dict[str, object]) -> None:
    """Take memory away until the kernel ends the agent, and give it back."""
    before, had = rows(ROWS), int(shown("NRestarts"))
    systemctl("set-property", "--runtime", "deltak", "MemoryMax=16M")
    until(lambda: int(shown("NRestarts")) > had, "an end for lack of memory")
    systemctl("set-property", "--runtime", "deltak", "MemoryMax=1G")
    begun = time.monotonic()
    flow_again()
    found["back after s"] = time.monotonic() - begun
    found["rows before memory"] = len(before)
    found["lost by memory"] = len(set(before) - set(rows(ROWS)))


def cut(results: Path) -> None:
    """Note what is committed, on the host, and switch off without a sync."""
    file = os.open(results / "acknowledged.json", os.O_WRONLY | os.O_CREAT)
    os.write(file, json.dumps(rows(ROWS)).encode())
    os.fsync(file)  # of this file alone
    Path("/proc/sysrq-trigger").write_text("o")
    time.sleep(60)  # until the guest is gone


def wake(results: Path, found: dict[str, object]) -> None:
    """Say what is left after the cut, with the agent running again."""
    acknowledged = [tuple(row) for row in json.loads((results / "acknowledged.json").read_text())]
    flow_again()
    found["rows before cut"] = len(acknowledged)
    found["lost by cut"] = len(set(acknowledged) - set(rows(ROWS)))
    found["runs"] = rows("SELECT rig, count(*) FROM v_runs GROUP BY rig ORDER BY rig")
    with closing(sqlite3.connect(f"file:{inside.DB}?mode=ro", uri=True)) as connection:
        found["integrity"] = connection.execute("PRAGMA integrity_check").fetchone()[0]


def live(results: Path, found: dict[str, object]) -> None:
    """Start the service and go through the first boot, or the second."""
    systemctl("start", "deltak")
    if (results / "acknowledged.json").exists():
        wake(results, found)
        return
    until(lambda: len(flows()) == 3, "rows of all three buses")
    starve(found)
    lack_memory(found)
    (results / "first.json").write_text(json.dumps(found))
    cut(results)


def main(results: Path) -> None:
    mount_disk()
    inside.WATCHDOG_S = WATCHDOG_S
    inside.install()
    systemctl("daemon-reload")
    found: dict[str, object] = {"watchdog_s": WATCHDOG_S}
    with inside.playing():
        try:
            live(results, found)
        finally:
            sys.stdout.write(f"{found}\n")
            (results / "found.json").write_text(json.dumps(found))


if __name__ == "__main__":
    main(Path(os.environ["RESULTS"]))
