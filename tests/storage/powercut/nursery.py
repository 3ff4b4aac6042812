"""Starts writing processes quickly: everything is imported once, each line "DB PROFILE" on stdin forks one of
them.

On stdout: "pid N", then what that process tells, then "dead" once it has ended.
"""

import os
import sys

from scipy import special  # noqa: F401 - imported once for all

from tests.storage.powercut import workload


def main() -> None:
    for line in sys.stdin:
        path, profile = line.split()
        pid = os.fork()
        if pid == 0:
            os.write(1, b"pid %d\n" % os.getpid())
            workload.main(path, profile, "1000000", "FULL")
            os._exit(0)
        os.waitpid(pid, 0)
        os.write(1, b"dead\n")


if __name__ == "__main__":
    main()
