"""Starts agents that raise alarms and notify of them until they are killed: a line "DB URL PORT FIRST" forks
one.

On stdout: "pid N", "raised" once its alarms are stored, then "dead" once it has ended.
"""

import os
import sys
import threading
from pathlib import Path

from agent.config.sections.results import Notify
from tests.notification.targets import LATE_S, agent
from tests.storage.rows import START, step

FRESH = 3


def targets(url: str, port: int) -> list[Notify]:
    """Return a webhook and a mail server, both of which may misbehave."""
    hook = Notify(name="hook", kind="webhook", url=url, timeout_s=LATE_S)
    mail = Notify(name="mail", kind="smtp", host="127.0.0.1", port=port, tls="none", sender="rig@example.org",
                  recipients=("shift@example.org",))  # fmt: skip
    return [hook, mail]


def live(path: Path, url: str, port: int, first: int) -> None:
    with agent(path, targets(url, port)) as (writer, _):
        names = range(first, first + FRESH)
        writer.publish([step("NORM", "UNACK", START + number, parameter=f"p{number}") for number in names])
        assert writer.flush()
        os.write(1, b"raised\n")
        threading.Event().wait()


def main() -> None:
    for line in sys.stdin:
        path, url, port, first = line.split()
        pid = os.fork()
        if pid == 0:
            os.write(1, b"pid %d\n" % os.getpid())
            live(Path(path), url, int(port), int(first))
        os.waitpid(pid, 0)
        os.write(1, b"dead\n")


if __name__ == "__main__":
    main()
