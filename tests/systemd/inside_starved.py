"""Has the service log to a journal that is rotated, starve for long, and hang, with the unit's own watchdog.

What is found test_starved.py asserts.
"""

import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

from tests.systemd import inside
from tests.systemd.inside import flows, rows, shown, systemctl, until

QUOTA = "3%"
STARVED_S = 600.0
LOGGING = """
StandardError=journal
ExecStart=
ExecStart=/opt/deltak/bin/deltak run -v /etc/deltak/conf.d --db ${STATE_DIRECTORY}/deltak.db
"""
"""The unit as it is shipped, but that it says what it stores."""
STORED = re.compile(r"^deltak: info: (\w+): stored in run \d+: (\d+) instants up to (\d+)", re.MULTILINE)
JOURNALD = "systemd-journald"
TURNS = 3


def journal() -> str:
    return subprocess.run(
        ["journalctl", "-u", "deltak", "-o", "cat", "--no-pager", "-q"],
        check=True, capture_output=True, text=True,
    ).stdout  # fmt: skip


def told() -> dict[str, tuple[int, int]]:
    """Return how many instants of each rig the journal says are stored, and up to which."""
    found: dict[str, tuple[int, int]] = {}
    for rig, count, newest in STORED.findall(journal()):
        before = found.get(rig, (0, 0))
        found[rig] = before[0] + int(count), max(before[1], int(newest))
    return found


def unsaid() -> dict[str, int]:
    """Return how many instants of each rig are stored and not in the journal, up to the last that is."""
    query = "SELECT count(DISTINCT t_ns) FROM v_estimates WHERE rig = ? AND t_ns <= ?"
    return {rig: int(str(rows(query, rig, newest)[0][0])) - count for rig, (count, newest) in told().items()}


def kept_open() -> list[str]:
    """Return deleted files that the agent still holds."""
    links = [str(link.readlink()) for link in Path("/proc", shown("MainPID"), "fd").iterdir()]
    return [link for link in links if "(deleted)" in link and "memfd" not in link]


def rotate(found: dict[str, object]) -> None:
    """Rotate the journal, end journald and start it anew, and vacuum, while the agent logs."""
    for turn in range(TURNS):
        lines = len(STORED.findall(journal()))
        until(lambda n=lines: len(STORED.findall(journal())) > n + 5, "more lines")
        subprocess.run(["journalctl", "--rotate"], check=True)
        if turn == 1:
            systemctl("kill", "--signal=KILL", JOURNALD)
            until(lambda: systemctl("is-active", JOURNALD, check=False).strip() == "active", "journald again")
    found["journals"] = len([*Path("/run/log/journal").glob("*/system@*.journal")])
    found["unsaid"], found["lines"] = unsaid(), len(STORED.findall(journal()))
    newest = max(t_ns for _, t_ns in told().values())
    subprocess.run(["journalctl", "--vacuum-files=1", "-q"], check=True, stderr=subprocess.DEVNULL)
    until(lambda: max((t_ns for _, t_ns in told().values()), default=0) > newest, "lines after the vacuum")
    found["journals after"] = len([*Path("/run/log/journal").glob("*/system@*.journal")])
    found["kept open"] = kept_open()


def starve(found: dict[str, object]) -> None:
    """Leave the agent less of the processor than it needs, for long."""
    systemctl("set-property", "--runtime", "deltak", f"CPUQuota={QUOTA}")
    before, begun = int(shown("CPUUsageNSec")), time.monotonic()
    time.sleep(STARVED_S)  # the hunger itself
    found["starved_s"] = time.monotonic() - begun
    found["share"] = (int(shown("CPUUsageNSec")) - before) / 1e9 / (time.monotonic() - begun)
    found["restarts of the starved"] = shown("NRestarts")
    since = time.time_ns()
    systemctl("set-property", "--runtime", "deltak", "CPUQuota=")
    until(lambda: len(flows(since)) == 3, "rows again")


def hang(found: dict[str, object]) -> None:
    """Stop one thread for good."""
    had = int(shown("NRestarts"))
    inside.HANG.touch()
    found["killed_s"] = until(lambda: int(shown("NRestarts")) > had, "an end by the watchdog")
    found["named"] = "read line/hanging: the thread makes no progress" in journal()


def live(found: dict[str, object]) -> None:
    systemctl("start", JOURNALD)
    Path("/run/log/journal").mkdir(parents=True, exist_ok=True)
    systemctl("start", "deltak")
    until(lambda: len(flows()) == 3, "rows of all three buses")
    found["watchdog_s"] = int(shown("WatchdogUSec").removesuffix("min")) * 60
    for step in (rotate, starve, hang):
        step(found)
        sys.stdout.write(f"{step.__name__}: {found}\n")
        sys.stdout.flush()


def main(results: Path) -> None:
    inside.LIMIT_S = 240.0
    inside.OWN = LOGGING
    inside.install()
    systemctl("daemon-reload")
    found: dict[str, object] = {}
    with inside.playing():
        try:
            live(found)
        finally:
            (results / "found.json").write_text(json.dumps(found))


if __name__ == "__main__":
    main(Path(os.environ["RESULTS"]))
