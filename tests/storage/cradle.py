"""Starts agents quickly: all that the agent imports is imported once, each line of arguments on stdin forks
one.

On stdout: "pid N", then what that agent tells (stdout and stderr), then "dead" once it has ended.
"""

import json
import os
import sys

from agent.cli import app as cli
from agent.cli.tables import results as commands_results  # noqa: F401 - imported once for all
from agent.runtime import service  # noqa: F401 - imported once for all
from drivers.modbus import driver as modbus  # noqa: F401


def main() -> None:
    for line in sys.stdin:
        pid = os.fork()
        if pid == 0:
            os.write(1, b"pid %d\n" % os.getpid())
            cli.main(json.loads(line))
        os.waitpid(pid, 0)
        os.write(1, b"dead\n")


if __name__ == "__main__":
    main()
