"""How processes that share a test run divide the tests among them."""

import os
from collections.abc import Iterable
from pathlib import Path

import pytest
from xdist.scheduler import LoadScopeScheduling

LONGEST = ("tests/statistical/", "tests/property/")
"""Files here have few tests that compute for long; begun last, one of them would run on with nothing beside
it."""

BESIDE = (
    "tests/docs/", "tests/uml/", "tests/vcan/", "tests/scenario/test_no_write.py",
    "tests/scenario/test_wires.py",
)  # fmt: skip
"""What waits for processes and for guests, and has no clock to keep up with."""

BACKGROUND, LATE = "tests/statistical/", "tests/statistical/test_coverage_coloured.py"
"""What computes for long and waits for nothing; more than `LATE` leaves, the other lanes do not leave a
processor for."""
NICE = 10
"""A process as nice as this gives way at once to one that holds a pace."""


class Lanes(LoadScopeScheduling):
    """Tests that hold a pace on the wall clock, one after another; beside them, one after another, what has
    none; and file by file what computes, while the two wait and wherever one has ended."""

    def _split_scope(self, nodeid: str) -> str:
        if computes(nodeid):
            return nodeid.partition("::")[0]
        return "beside" if nodeid.startswith(BESIDE) else "pace"


def computes(nodeid: str) -> bool:
    """Tell whether a test has the lane of those that compute in the background."""
    return nodeid.startswith(BACKGROUND) and not nodeid.startswith(LATE)


def give_way(nodeid: str) -> None:
    """Lower the priority of a process that shares a run by lanes, once its lane is the background's."""
    if computes(nodeid) and "PYTEST_XDIST_WORKER" in os.environ:
        os.setpriority(os.PRIO_PROCESS, 0, max(NICE, os.getpriority(os.PRIO_PROCESS, 0)))


def in_order(items: Iterable[pytest.Item]) -> list[pytest.Item]:
    """Return tests with those of the longest files first, else as they were."""
    return sorted(items, key=lambda item: not item.nodeid.startswith(LONGEST))


def has_no_lane(path: Path, root: Path) -> bool | None:
    """Return True for a file of tests none of which is run by lanes; None leaves it to pytest."""
    is_tests = path.name.startswith("test_") and path.suffix == ".py"
    if not is_tests or computes(path.relative_to(root).as_posix()):
        return None
    return True if "realtime" not in path.read_text(encoding="utf-8") else None
