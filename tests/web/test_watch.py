"""The terminal at a glance: one frame for pipes, a live one that q ends, nothing of the file held."""

import io
import os
import pty
import select
import subprocess
import sys
import termios
import time
from pathlib import Path

import pytest
from rich.console import Console

from agent.cli.glance.files import one, several
from agent.cli.glance.frame import bar, frame
from agent.cli.glance.state import overview
from agent.errors import UsageError
from agent.storage.read import queries
from agent.text import with_sd
from tests.web import files


@pytest.fixture
def path(memory: Path) -> Path:
    return files.make(memory)


def test_overview_puts_the_worst_rig_first_and_takes_limits_from_the_configuration(path: Path) -> None:
    found = overview([one(path.with_suffix(".toml"))], time.time_ns())
    assert [(rig["rig"], rig["words"]) for rig in found["rigs"]] == [
        ("press-7", "1 unacknowledged"), ("press-8", "normal"),
    ]  # fmt: skip
    parameters = {row["parameter"]: row for row in found["rigs"][0]["parameters"]}
    assert parameters["k1"]["limit"] == 15.0
    assert parameters["k2"]["limit"] == pytest.approx(2.6)
    assert parameters["k1"]["used"] == pytest.approx(abs(parameters["k1"]["delta"]) / 15.0)
    assert (parameters["B1"]["limit"], parameters["B1"]["used"], parameters["k1"]["alarm"]) == (
        None,
        None,
        "UNACK",
    )
    assert found["rigs"][0]["sources"][0]["rate_hz"] == 200.0


def test_overview_without_a_configuration_takes_the_limit_of_the_alarm(path: Path) -> None:
    (worst, _) = overview([one(path)], time.time_ns())["rigs"]
    assert [row["limit"] for row in worst["parameters"]] == [15.0, None, None, None]


def test_overview_of_a_parameter_that_was_alarmed_twice_shows_the_alarm_that_stands(memory: Path) -> None:
    (rig,) = overview([one(files.restless(memory))], time.time_ns())["rigs"]
    assert [alarm["state"] for alarm in rig["alarms"]] == ["UNACK", "RTNUN"]
    assert {row["parameter"]: row["alarm"] for row in rig["parameters"]}["k1"] == "UNACK"


@pytest.mark.parametrize(
    ("row", "drawn"),
    [
        ({"value": 25.0, "lower": 24.0, "upper": 26.0, "reference": 25.0, "limit": 4.0}, "·│··━●━··│·"),
        ({"value": 90.0, "lower": 80.0, "upper": 99.0, "reference": 25.0, "limit": 4.0}, "·│···│···│●"),
        ({"value": None, "lower": None, "upper": None, "reference": 25.0, "limit": 4.0}, "···········"),
        ({"value": 25.0, "lower": 25.0, "upper": 25.0, "reference": 25.0, "limit": None}, "·····●·····"),
    ],
)
def test_bar_shows_the_interval_between_the_limits(row: dict[str, float | None], drawn: str) -> None:
    assert bar(row, 11) == drawn


def test_databases_of_one_name_are_told_apart(tmp_path: Path) -> None:
    names = [watched.name for watched in several([tmp_path / "a" / "rig.db", tmp_path / "b" / "rig.db"], [])]
    assert names == ["rig", "rig-2"]


def test_watch_without_a_target_needs_exactly_one_database(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match="no database; name a configuration or a database"):
        one(None)


def test_once_prints_one_frame_with_the_numbers_of_the_database_and_no_orders_to_a_terminal(
    path: Path,
) -> None:
    command = [sys.executable, "-m", "agent", "watch", str(path), "--once"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    for row in queries.latest(path):
        assert f"{row['value']:.2f}"[:-1] in done.stdout
    assert "unexcited: standstill" in done.stdout
    assert "UNACK" in done.stdout
    assert "\x1b" not in done.stdout
    assert "\\x1b[31m" in done.stdout


def output_until(terminal: int, wanted: bytes) -> bytes:
    """Return what a terminal shows until some bytes have come, for at most 30 s."""
    seen, end = b"", time.monotonic() + 30.0
    while wanted not in seen and time.monotonic() < end:
        if select.select([terminal], [], [], 1.0)[0]:
            seen += os.read(terminal, 65536)
    assert wanted in seen
    return seen


def test_frame_of_eighty_columns_shows_every_figure_whole(path: Path) -> None:
    console = Console(width=80, file=io.StringIO(), record=True)
    found = overview([one(path.with_suffix(".toml"))], time.time_ns())
    console.print(frame(found, "12:00"))
    text = console.export_text()
    assert max(map(len, text.splitlines())) <= 80
    for row in queries.latest(path):
        assert f"{with_sd(row['value'], row['sd'])} {row['unit']}" in text
    assert "UNACK" in text
    assert text.count("●") == 6


def test_live_frames_turn_to_the_next_rig_and_end_with_q(path: Path) -> None:
    parent, child = pty.openpty()
    termios.tcsetwinsize(parent, (24, 80))
    before = termios.tcgetattr(child)
    command = [sys.executable, "-m", "agent", "watch", str(path)]
    process = subprocess.Popen(command, stdin=child, stdout=child, stderr=child)
    try:
        assert b"\x1b[?1049h" in output_until(parent, b"press-7: 1 unacknowledged")
        os.write(parent, b"nq")  # at once, as they come over a slow line
        assert b"press-8: normal" in output_until(parent, b"\x1b[?1049l")
        assert process.wait(30) == 0
        assert termios.tcgetattr(child) == before
    finally:
        process.kill()
        process.wait()
        os.close(child)
        os.close(parent)
