"""Files for the gateway: the unit is one systemd takes and finds tight, the runbook names what exists."""

import json
import re
import subprocess
from pathlib import Path

import pytest

from tests import peers

DEPLOY = peers.ROOT / "deploy"
UNITS = {
    "deltak@.service": ("deltak@press-7.service", "run"), "deltak.service": ("deltak.service", "run"),
    "deltak-page.service": ("deltak-page.service", "serve"),
    "deltak-opcua.service": ("deltak-opcua.service", "opcua"),
}  # fmt: skip
"""By file: what an instance is called, and the command that it runs."""


def analyze(*arguments: str) -> subprocess.CompletedProcess[str]:
    tool = peers.program("systemd-analyze", "systemd")
    return subprocess.run([tool, *arguments], capture_output=True, text=True, check=False, timeout=60)


def test_unit_that_switches_versions_is_taken_without_a_word_and_has_few_rights(tmp_path: Path) -> None:
    path = tmp_path / "deltak-upgrade@0.2.0.service"
    text = (DEPLOY / "systemd" / "deltak-upgrade@.service").read_text()
    path.write_text(text.replace("/opt/deltak/releases/%i/bin/deltak", "/bin/true"))
    done = analyze("verify", "--man=no", "--recursive-errors=no", str(path))
    assert (done.returncode, done.stderr) == (0, "")
    assert analyze("security", "--offline=yes", "--threshold=19", "--no-pager", str(path)).returncode == 0


@pytest.fixture(params=UNITS)
def unit(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    """Each unit, the template as an instance, with programs that exist."""
    name, command = UNITS[request.param]
    path = tmp_path / name
    text = (DEPLOY / "systemd" / request.param).read_text()
    assert f"/opt/deltak/bin/deltak {command} " in text
    path.write_text(text.replace("/opt/deltak/bin/deltak", "/bin/true"))
    return path


def test_every_unit_is_looked_at() -> None:
    assert {file.name for file in (DEPLOY / "systemd").glob("*.service")} == {
        *UNITS,
        "deltak-upgrade@.service",
    }


def test_unit_is_taken_without_a_word(unit: Path) -> None:
    done = analyze("verify", "--man=no", "--recursive-errors=no", str(unit))
    assert (done.returncode, done.stderr) == (0, "")


def test_unit_is_rated_safe(unit: Path) -> None:
    done = analyze("security", "--offline=yes", "--threshold=16", "--no-pager", str(unit))
    assert done.returncode == 0, done.stdout[-2000:]


def test_runbook_names_files_that_exist() -> None:
    named = set(re.findall(r"deploy/[a-z/@.0-9-]*\w", (DEPLOY / "RUNBOOK.md").read_text()))
    assert len(named) >= 4
    assert [name for name in sorted(named) if not (peers.ROOT / name).exists()] == []


def test_alarm_table_names_the_states_of_the_agent() -> None:
    text = (DEPLOY / "ALARMS.md").read_text()
    assert [state for state in ("NORM", "UNACK", "ACKED", "RTNUN") if f"| {state} |" not in text] == []


def test_examples_are_configurations_without_fault() -> None:
    from agent.config import load

    files = sorted((DEPLOY / "examples").glob("*.toml"))
    assert files
    assert json.dumps([load(file).rig.name for file in files])
