"""Memory of an agent over a week, played as fast as it is computed, with an alarm each three hours."""

import json
import subprocess
import sys
from pathlib import Path
from statistics import median
from typing import Any

import pytest

from tests.figures import figure
from tests.peers import ROOT

DAYS, RATE_HZ = 7, 200
MOST_MB = 2.0
"""What a day may hold more than the second: three times what the median of a day moves by from day to day."""


def lived(folder: Path, days: int) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Return what an agent told of each hour, and at its end."""
    command = [sys.executable, "-m", "tests.bench.hurried", str(folder), str(days), str(RATE_HZ)]
    found = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True).stdout
    *hours, end = map(json.loads, found.splitlines())
    return hours, end


def daily(hours: list[dict[str, Any]], what: str) -> list[float]:
    """Return the median of each whole day."""
    return [median(hour[what] for hour in hours[24 * day : 24 * day + 24]) for day in range(len(hours) // 24)]


@pytest.mark.soak
@pytest.mark.timeout(4 * 3600)
def test_agent_holds_no_more_memory_after_a_week_than_after_a_day(tmp_path: Path) -> None:
    hours, end = lived(tmp_path, DAYS)
    days = daily(hours, "anonymous")
    words = ", ".join(f"{mb:.1f}" for mb in days)
    figure(f"memory: private, {hours[0]['anonymous']:.0f} MB at the start, medians of seven days {words} MB")
    assert end["samples"]["used"] >= DAYS * 86_400 * RATE_HZ
    assert not end["samples"]["gaps"]
    assert end["alarms"] >= 8 * DAYS
    assert max(days[2:]) - days[1] < MOST_MB
    blocks = daily(hours, "blocks")
    assert max(blocks[2:]) < 1.05 * blocks[1]
