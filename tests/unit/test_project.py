"""The project's own promises: what is installed by which name, what the test run says when something is
missing."""

import re
import shutil
import subprocess
import sys
import tomllib
from importlib.metadata import entry_points, version
from pathlib import Path

import pytest

import agent
from tests import peers

PROJECT = tomllib.loads((peers.ROOT / "pyproject.toml").read_text())


def test_distribution_is_installed_with_the_version_of_the_code() -> None:
    assert version("deltak") == agent.__version__


def test_entry_points_are_those_of_the_project_file() -> None:
    for group, declared in PROJECT["project"]["entry-points"].items():
        there = {entry.name: entry.value for entry in entry_points(group=group)}
        assert declared.items() <= there.items(), f"{group}: install again after a change of pyproject.toml"


@pytest.mark.parametrize(
    ("name", "value"),
    [(n, v) for group in PROJECT["project"]["entry-points"].values() for n, v in group.items()]
    + list(PROJECT["project"]["scripts"].items()),
)
def test_entry_point_names_a_thing_that_exists(name: str, value: str) -> None:
    module, _, attribute = value.partition(":")
    thing = f"importlib.import_module({module!r})"
    code = f"import importlib; {f'assert callable(getattr({thing}, {attribute!r}))' if attribute else thing}"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 0, f"{name} = {value}: {done.stderr[-300:]}"


def test_licence_is_the_whole_apache_licence() -> None:
    text = (peers.ROOT / "LICENSE").read_text()
    assert "Apache License" in text
    assert "END OF TERMS AND CONDITIONS" in text
    assert len(text) > 11_000


def test_every_ignored_lint_rule_is_explained_on_its_line() -> None:
    lines = (peers.ROOT / "pyproject.toml").read_text().splitlines()
    ignored = [line for line in lines if re.fullmatch(r'\s+"[A-Z]+\d*",.*', line)]
    assert len(ignored) > 10
    assert [line for line in ignored if "#" not in line and '", "' not in line] == []


def test_missing_peer_is_told_and_fails_only_in_ci(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peers, "NOT_TESTED", [])
    monkeypatch.delenv("CI", raising=False)
    with pytest.raises(pytest.skip.Exception, match="no line"):
        peers.missing("no line to speak on")
    monkeypatch.setenv("CI", "true")
    with pytest.raises(pytest.fail.Exception, match="CI=true and not tested: no line"):
        peers.missing("no line to speak on")
    assert peers.NOT_TESTED == ["no line to speak on"] * 2


def test_missing_data_is_told_and_fails_where_it_was_promised(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(peers, "NOT_TESTED", [])
    monkeypatch.setenv("CI", "true")
    monkeypatch.setenv("DELTAK_DATA", str(tmp_path))
    with pytest.raises(pytest.fail.Exception, match=r"no measured data emps\.csv"):
        peers.data("emps.csv")
    (tmp_path / "emps.csv").touch()
    assert peers.data("emps.csv") == tmp_path / "emps.csv"
    monkeypatch.delenv("DELTAK_DATA")
    monkeypatch.setattr(peers, "ROOT", tmp_path / "nowhere" / "repository")
    with pytest.raises(pytest.skip.Exception, match="set DELTAK_DATA"):
        peers.data("emps.csv")
    assert len(peers.NOT_TESTED) == 2


def test_import_contracts_name_what_an_import_breaks(tmp_path: Path) -> None:
    """An import of the simulator in the agent turns lint red."""
    for package in ("agent", "drivers", "sim_bus"):
        shutil.copytree(peers.ROOT / package, tmp_path / package)
    (tmp_path / "pyproject.toml").write_text((peers.ROOT / "pyproject.toml").read_text())
    (tmp_path / "agent" / "blocks" / "wrong.py").write_text("import sim_bus\nimport drivers.modbus.driver\n")
    lint = Path(sys.executable).with_name("lint-imports")
    env = {"PYTHONPATH": str(tmp_path), "COLUMNS": "200"}
    command = [lint, "--no-logo", "--no-cache"]
    done = subprocess.run(
        command, cwd=tmp_path, env=env, capture_output=True, text=True, check=False, timeout=100
    )
    assert done.returncode == 1
    assert "agent.blocks.wrong -> sim_bus" in done.stdout
    assert "agent.blocks.wrong -> drivers.modbus.driver" in done.stdout


def test_make_demo_says_what_it_does_while_it_installs(tmp_path: Path) -> None:
    command = ["make", "--dry-run", f"VENV={tmp_path / 'venv'}", "demo"]
    steps = subprocess.run(
        command, cwd=peers.ROOT, capture_output=True, text=True, check=True, timeout=60
    ).stdout
    said, install = steps.index("installing deltak"), steps.index("pip --python")
    assert steps.index("making ") < steps.index("-m venv") < said < install
    assert " -q" not in steps[install:].splitlines()[0]
