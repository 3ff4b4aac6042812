"""Has a version without valid rows take over, under a real systemd; test_upgrade.py asserts what is found.

The agents of both versions are played: they are ready at once and write rows, the first one's valid, the
other's not.
"""

import json
import os
import socket
import sys
import time
from pathlib import Path

from tests.systemd import inside

HOME = Path("/opt/deltak")
UNIT = "deltak-upgrade@2.0.0.service"
PROGRAM = """#!/bin/sh
[ "$1" = run ] && exec /opt/python/bin/{python} -m tests.systemd.inside_upgrade {status} \
"$STATE_DIRECTORY/deltak.db"
exec /opt/python/bin/{python} -m agent "$@"
"""
DROP_IN = """
[Service]
{environment}
ExecStart=
ExecStart=/opt/deltak/releases/%i/bin/deltak upgrade --to %i --within 30
StandardOutput=append:/run/upgrade.log
StandardError=append:/run/upgrade.log
"""
VALID = "SELECT count(DISTINCT run_id) FROM v_estimates WHERE status = 'valid'"


def play(status: str, db: Path) -> None:
    """Be an agent: say ready, then write a row's worth of rows each second."""
    from agent.clock import wall_ns
    from agent.storage.write.store import Store
    from agent.types import Status
    from tests.packages.played_rows import rows
    from tests.storage.rows import run_info

    with Store.open(db) as store, socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as peer:
        run = store.begin_run(run_info(started_ns=wall_ns()))
        peer.connect(os.environ["NOTIFY_SOCKET"])
        while True:
            store.write(run, [rows(Status[status])])
            peer.send(b"READY=1\nWATCHDOG=1")
            time.sleep(1.5)


def lay() -> None:
    """Lay two versions side by side where the package does, and the unit that switches them."""
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    for name, status in (("1.0.0", "VALID"), ("2.0.0", "INVALID")):
        program = HOME / "releases" / name / "bin" / "deltak"
        program.parent.mkdir(parents=True)
        program.write_text(PROGRAM.format(python=version, status=status))
        program.chmod(0o755)
    (HOME / "current").symlink_to("releases/1.0.0")
    (HOME / "bin" / "deltak").unlink()
    (HOME / "bin").rmdir()
    (HOME / "bin").symlink_to("current/bin")
    environment = next(line for line in inside.PYTHON.splitlines() if line.startswith("Environment="))
    text = (inside.ROOT / "deploy/systemd/deltak-upgrade@.service").read_text()
    Path("/etc/systemd/system/deltak-upgrade@.service").write_text(text)
    drop_in = Path("/etc/systemd/system/deltak-upgrade@.service.d/test.conf")
    drop_in.parent.mkdir()
    drop_in.write_text(DROP_IN.format(environment=environment))


def live(found: dict[str, object]) -> None:
    """Go through it and note what is found."""
    for file in inside.CONFIGS.iterdir():
        file.unlink()
    inside.systemctl("start", "deltak")
    inside.until(lambda: inside.rows(VALID) == [(1,)], "valid rows")
    begun = time.monotonic()
    inside.systemctl("start", UNIT, check=False)
    found["seconds"] = time.monotonic() - begun
    found["said"] = Path("/run/upgrade.log").read_text()
    found["unit"] = inside.systemctl("show", UNIT, "--property=Result,ExecMainStatus", "--value").split()
    found["current"] = (HOME / "current").readlink().name
    found["state"] = inside.shown("ActiveState")
    found["runs"] = inside.rows("SELECT count(*) FROM v_runs") + inside.rows(VALID)


def main(results: Path) -> None:
    inside.install()
    lay()
    inside.systemctl("daemon-reload")
    found: dict[str, object] = {}
    try:
        live(found)
    finally:
        sys.stdout.write(f"{found}\n")
        (results / "found.json").write_text(json.dumps(found))


if __name__ == "__main__":
    if len(sys.argv) > 1:
        play(sys.argv[1], Path(sys.argv[2]))
    main(Path(os.environ["RESULTS"]))
