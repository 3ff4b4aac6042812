"""Memory of an agent over a week, played as fast as it is computed, with an alarm each three hours."""

import json
import subprocess
import sys
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import pytest

from tests.figures import figure
from tests.peers import ROOT

DAYS, RATE_HZ = 7, 200
MOST_MB, MOST_BLOCKS = 2.0, 20.0
"""What the median of a day may be more than the second's, MB and thousands: twice what it moves by."""


def lived(folder: Path, days: int) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Return what an agent told of each hour, and at its end."""
    command = [sys.executable, "-m", "tests.bench.hurried", str(folder), str(days), str(RATE_HZ)]
    found = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True).stdout
    *hours, end = map(json.loads, found.splitlines())
    return hours, end


def daily(hours: list[dict[str, Any]], what: str) -> list[float]:
    """Return the median of each whole day."""
    return [median(hour[what] for hour in hours[24 * day : 24 * day + 24]) for day in range(len(hours) // 24)]


def grown(days: list[float]) -> float:
    """Return what the week's later days hold more than its second at most."""
    return max(days[2:]) - days[1]


@pytest.mark.parametrize(("leak_mb_a_day", "is_seen"), [(0.0, False), (0.1, False), (0.6, True)])
def test_growth_of_half_a_megabyte_a_day_is_seen_and_scatter_is_none(
    rng: np.random.Generator, leak_mb_a_day: float, is_seen: bool
) -> None:
    hours = [
        {"anonymous": 73.5 + rng.uniform(-2.0, 2.0) + leak_mb_a_day * n / 24} for n in range(24 * DAYS + 1)
    ]
    assert (grown(daily(hours, "anonymous")) > MOST_MB) is is_seen


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
    assert grown(days) < MOST_MB
    assert grown(daily(hours, "blocks")) < MOST_BLOCKS
