"""How long the command line takes to start, beside that of sqlite-utils."""

import subprocess
import sys
import time
from pathlib import Path

import pytest

pytestmark = [pytest.mark.bench, pytest.mark.realtime]
TURNS = 5


def least_s(name: str) -> float:
    """Return the shortest time of some turns that the installed program NAME takes to print its help, s."""
    command = [str(Path(sys.executable).with_name(name)), "--help"]
    took = []
    for _ in range(TURNS):
        begun = time.perf_counter()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        took.append(time.perf_counter() - begun)
    return min(took)


def test_help_is_there_in_half_of_the_time_that_sqlite_utils_takes() -> None:
    ours, theirs = least_s("deltak"), least_s("sqlite-utils")
    print(f"\nhelp: deltak {ours:.2f} s, sqlite-utils {theirs:.2f} s")
    assert ours < 0.5 * theirs
