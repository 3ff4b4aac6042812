"""A process that writes to a store and says on its standard output what was acknowledged; for the tests that
kill it.

python -m tests.storage.powercut.workload DB PROFILE COUNT SYNCHRONOUS: each line "n" means that write n is
committed.
"""

import os
import sys
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from agent.records import Record
from agent.storage.database import connect
from agent.storage.write import store as store_module
from agent.storage.write.retention import Retention
from agent.storage.write.store import Store
from tests.storage.rows import HOP, START, batch, ledger, run_info, step

SECOND = 10**9


@dataclass(frozen=True)
class Profile:
    """How much a write holds, how far apart its rows are, how often the log is moved, and what is kept."""

    hops: int
    hop_ns: int
    commits_a_checkpoint: int
    keep: Retention


PROFILES = {
    "live": Profile(1, SECOND, 5, Retention()),
    "bulk": Profile(40, HOP, 2, Retention()),
    "defaults": Profile(1, SECOND, 300, Retention()),
    "keep": Profile(3, 120 * SECOND, 4, Retention(full_s=3600.0, minute_s=7200.0)),
}


@lru_cache(maxsize=1000)
def records(profile: Profile, number: int) -> list[Record]:
    """Return what write `number` holds: estimates, now and then a step of an alarm's life, a ledger row."""
    first = number * profile.hops
    made: list[Record] = [batch(profile.hops, first=first, hop_ns=profile.hop_ns)]
    t_ns = START + first * profile.hop_ns
    if profile is PROFILES["defaults"]:
        return [*made, ledger(t_ns)] if number % 10 == 0 else made
    if number % 4 == 0:
        made.append(step("NORM", "UNACK", t_ns))
    if number % 4 == 2:
        made.append(step("UNACK", "NORM", t_ns, cause="cleared"))
    if number % 5 == 0:
        made.append(ledger(t_ns))
    return made


def main(path: str, name: str, count: str, synchronous: str) -> None:
    profile = PROFILES[name]
    store_module.CHECKPOINT_EVERY = profile.commits_a_checkpoint
    if synchronous != "FULL":
        connect._WRITER = (*connect._WRITER, f"PRAGMA synchronous = {synchronous}")
    with Store.open(Path(path), profile.keep) as store:
        run_id = store.begin_run(run_info())
        os.write(1, b"run %d\n" % run_id)
        for number in range(int(count)):
            store.write(run_id, records(profile, number))
            os.write(1, b"%d\n" % number)
            if name in {"keep", "defaults"}:
                store.maintain()


if __name__ == "__main__":
    main(*sys.argv[1:])
