"""What two processes gain where archives are estimated again, and what the command costs (make bench)."""

import os
from pathlib import Path

import pytest

from agent.runtime.reestimation.reestimate import Wanted, reestimate
from tests.figures import figure
from tests.replay.archives import SECOND, archive, configuration

RIGS, LENGTH_S = 4, 10.0


def silent(_words: str) -> None:
    pass


def spent_s() -> float:
    """Return the processor time of this process, which hands out parts and writes."""
    times = os.times()
    return times.user + times.system


@pytest.mark.bench
def test_two_processes_against_one(tmp_path: Path) -> None:
    configs = [configuration(tmp_path, f"press-{number}") for number in range(RIGS)]
    for seed, config in enumerate(configs):
        archive(tmp_path / "archive" / config.stem, config.stem, LENGTH_S, seed)
    rates, own = [], []
    for workers in (1, 2):
        before = spent_s()
        wanted = Wanted(
            [tmp_path / "archive"], configs, str(tmp_path / f"{workers}.db"), workers=workers,
            hour_ns=5 * SECOND,
        )  # fmt: skip
        rates.append(reestimate(wanted, silent)["samples_per_s"])
        own.append((spent_s() - before) / (RIGS * LENGTH_S * 1000.0) * 86.4e6)
    figure(
        f"reestimate: {rates[0]:,.0f} samples a second on one process, {rates[1]:,.0f} on two "
        f"({rates[1] / rates[0]:.2f} times); writing takes {min(own):.0f} s of the command for a day of a rig"
    )
    assert rates[1] > 1.2 * rates[0]
