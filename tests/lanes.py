"""How processes that share a test run divide the tests among them."""

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


class Lanes(LoadScopeScheduling):
    """Tests that hold a pace on the wall clock, one after another; beside them, one after another, what has
    none."""

    def _split_scope(self, nodeid: str) -> str:
        return "beside" if nodeid.startswith(BESIDE) else "pace"


def in_order(items: Iterable[pytest.Item]) -> list[pytest.Item]:
    """Return tests with those of the longest files first, else as they were."""
    return sorted(items, key=lambda item: not item.nodeid.startswith(LONGEST))


def has_no_pace(path: Path) -> bool | None:
    """Return True for a file of tests none of which is marked realtime; None leaves it to pytest."""
    is_tests = path.name.startswith("test_") and path.suffix == ".py"
    return True if is_tests and "realtime" not in path.read_text(encoding="utf-8") else None
