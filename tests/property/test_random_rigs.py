"""Whatever rig is written, `check` and `replay` end with 0, or with 2 and what is wrong at its key path."""

import json
import re
from collections import Counter
from pathlib import Path

import pytest
import typer

from agent.cli.app import app
from agent.cli.terminal.errors import guarded
from agent.numerics.paper import margins_box, region
from tests.property.random_rigs import written

COMMAND = typer.main.get_command(app)
"""Built once: the command line makes it anew for each call, which is one in a process."""
RIGS, SOAK = 48, 5000
REPLAYED = 16
"""Every so manieth rig is replayed in each run, every one when soaking: a fit costs a hundred times a check.
"""
FAULT = re.compile(r"deltak: error: (rig|model|channel|estimator)[\w.\[\]]*: \S.*")


@pytest.fixture(autouse=True)
def _without_what_takes_long(monkeypatch: pytest.MonkeyPatch) -> None:
    """Check as where the extra `design` is not installed, with few points of the region: both have their own
    tests."""

    def missing() -> None:
        raise margins_box.DesignToolsMissingError

    monkeypatch.setattr(margins_box, "_cvxpy", missing)
    monkeypatch.setattr(region, "MOST_VERTICES", 4)
    monkeypatch.setattr(region, "FLIPPED", 1)
    monkeypatch.setattr(region, "INSIDE", 2)


def run(arguments: list[str], capfd: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """Run one command and hold it against its promise; return exit code and standard output."""
    code = guarded(COMMAND, arguments)  # type: ignore[arg-type]
    out, err = capfd.readouterr()
    said = err.splitlines()
    assert code in (0, 2), f"{arguments}: {code} {err}"
    assert "nan" not in out.lower(), f"{arguments}: {out}"
    if code == 2:
        assert said, arguments
        assert all(FAULT.fullmatch(line) for line in said), f"{arguments}: {err}"
    else:
        assert not re.search(r"Warning|Traceback|PydanticUndefined", err), f"{arguments}: {err}"
    return code, out


def play(seeds: range, replayed: int, folder: Path, capfd: pytest.CaptureFixture[str]) -> Counter[str]:
    """Check the rigs of these seeds and replay every so manieth; return how many could be used and what rows
    said."""
    counts = Counter[str]()
    for seed in seeds:
        config, recording = written(folder, seed)
        code, _ = run(["check", str(config)], capfd)
        counts["usable"] += code == 0
        if seed % replayed:
            continue
        code_of_replay, out = run(["replay", str(config), str(recording), "--json"], capfd)
        assert code_of_replay == code, f"rig {seed}: check ends with {code}, replay with {code_of_replay}"
        if code == 0:
            counts["replayed"] += 1
            counts.update(row["status"] for row in json.loads(out)["estimates"].values())
        config.unlink()
        recording.unlink()
    return counts


@pytest.mark.timeout(300)
def test_random_rigs_are_checked_and_replayed_or_refused_by_name(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    counts = play(range(RIGS), REPLAYED, tmp_path, capfd)
    assert counts["usable"] > 0.8 * RIGS
    assert counts["replayed"] > 0.7 * RIGS / REPLAYED


@pytest.mark.soak
@pytest.mark.timeout(8 * 3600)
def test_random_rigs_five_thousand_are_checked_and_replayed_or_refused_by_name(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    counts = play(range(RIGS, RIGS + SOAK), 1, tmp_path, capfd)
    assert counts["usable"] > 0.8 * SOAK
    assert counts["valid"] > 0
