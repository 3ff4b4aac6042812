"""Starts processes on a failing disk: each JSON line on stdin forks one, in which chosen operations fail
(oplog.c).

Tells on stdout: each "n" that write n is acknowledged, "failed KIND PATH", "seen KIND N ...", "end DROPPED"
and "dead CODE".
"""

import ctypes
import json
import os
import sys
from pathlib import Path
from typing import Any

from scipy import special  # noqa: F401 - imported once for all
from sqlite_utils import migrations  # noqa: F401

from agent.storage.write import backlog
from agent.storage.write import store as store_module
from agent.storage.write.retention import Retention
from agent.storage.write.store import Store
from agent.storage.write.writer import StoreWriter
from tests.storage.powercut.workload import PROFILES, records
from tests.storage.rows import run_info

KINDS = "WSDORUT"
PATIENCE_S = 10.0


def tell(text: str) -> None:
    os.write(1, text.encode() + b"\n")


def shim() -> Any:
    library = ctypes.CDLL(None)
    library.oplog_failed.restype = ctypes.c_char_p
    library.oplog_seen.restype = ctypes.c_long
    library.oplog_fail.argtypes = [ctypes.c_char, ctypes.c_int, ctypes.c_long, ctypes.c_long]
    return library


def life(  # noqa: PLR0917 - the arguments are what a line of JSON says
    path: str,
    kind: str,
    error: int,
    first: int,
    count: int,
    writes: int,
    number: int,
    stop: bool,
    patience_s: float,
) -> None:
    """Write as the agent does: through the writer's thread, which must live on whatever the disk does."""
    library, profile = shim(), PROFILES["live"]
    library.oplog_fail(kind.encode(), error, first, count)
    writer = StoreWriter(lambda: Store.open(Path(path), Retention()), [run_info()], period_s=PATIENCE_S)
    writer.start()
    last = number + writes - 1
    for n in range(number, last + 1):
        writer.publish(records(profile, n))
        if writer.flush(patience_s if n == last else 0.02):
            for acknowledged in range(number, n + 1):
                tell(str(acknowledged))
            number = n + 1
    tell(f"failed {library.oplog_failed().decode()}")
    if stop:
        writer.stop()
    tell("seen " + " ".join(f"{k} {library.oplog_seen(k.encode()[0])}" for k in KINDS))
    tell(f"end {sum(writer.dropped.values())}")
    os._exit(0)


def main() -> None:
    store_module.CHECKPOINT_EVERY = 5
    backlog.SHORTEST_S, backlog.LONGEST_S = 0.005, 0.02
    for line in sys.stdin:
        pid = os.fork()
        if pid == 0:
            life(**json.loads(line))
        _, status = os.waitpid(pid, 0)
        tell(f"dead {status}")


if __name__ == "__main__":
    main()
