"""Starts writers that answer commands quickly: a path on stdin forks one, whose database then has fresh
alarms.

On stdout: "pid N", "ready N" with the number of the newest alarm, then "dead" once it has ended.
"""

import os
import sys
import threading
from pathlib import Path

from agent.storage.write.store import Store
from agent.storage.write.writer import StoreWriter
from tests.storage.rows import run_info, step

FRESH = 20


def serve(path: Path, first: int) -> None:
    """Raise alarms of names that no life before raised, then answer until killed."""
    writer = StoreWriter(lambda: Store.open(path), [run_info()], served={})
    writer.start()
    writer.publish([step("NORM", "UNACK", parameter=f"p{first + n}") for n in range(FRESH)])
    assert writer.flush()
    os.write(1, b"ready\n")
    threading.Event().wait()


def main() -> None:
    for number, line in enumerate(sys.stdin):
        pid = os.fork()
        if pid == 0:
            os.write(1, b"pid %d\n" % os.getpid())
            serve(Path(line.strip()), number * FRESH)
        os.waitpid(pid, 0)
        os.write(1, b"dead\n")


if __name__ == "__main__":
    main()
