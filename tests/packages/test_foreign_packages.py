"""A package of another distribution that bears the name of one of ours is named at the start, before it is
imported."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.peers import ROOT

PACKAGES = ("agent", "drivers", "sim_bus")


@pytest.fixture
def installed(tmp_path: Path) -> Path:
    """A folder as site-packages is: the command's file, and its packages, which only say that they were
    imported."""
    folder = tmp_path / "site-packages"
    for name in PACKAGES:
        (folder / name).mkdir(parents=True)
        shutil.copy(ROOT / name / "__init__.py", folder / name)
    (folder / "agent" / "cli").mkdir()
    (folder / "agent" / "cli" / "__init__.py").touch()
    (folder / "agent" / "cli" / "entry.py").write_text("def main():\n    print('ours runs')\n")
    shutil.copy(ROOT / "deltak.py", folder)
    return folder


def start(*path: Path) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, path))}
    command = [sys.executable, "-SP", "-c", "import deltak; deltak.main()"]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=60)


def test_command_starts_where_the_packages_are_its_own(installed: Path) -> None:
    done = start(installed)
    assert (done.returncode, done.stdout) == (0, "ours runs\n")


@pytest.mark.parametrize("name", PACKAGES)
def test_package_of_another_that_comes_before_ours_is_named_and_not_imported(
    installed: Path, name: str
) -> None:
    other = installed.parent / "other"
    (other / name).mkdir(parents=True)
    (other / name / "__init__.py").write_text("print('theirs runs')\n")
    done = start(other, installed)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == (
        f"deltak: error: {name}: {other / name / '__init__.py'} comes before deltak's own package; "
        "install deltak into an environment of its own, and unset PYTHONPATH\n"
    )


@pytest.mark.parametrize("name", PACKAGES)
def test_package_that_another_distribution_wrote_over_is_named(installed: Path, name: str) -> None:
    (installed / name / "__init__.py").write_text('"""Browses the web by itself."""\nprint("theirs runs")\n')
    done = start(installed)
    assert (done.returncode, done.stdout) == (1, "")
    assert f"{name}: {installed / name / '__init__.py'} is not deltak's" in done.stderr


def test_package_that_was_removed_with_another_distribution_is_named(installed: Path) -> None:
    shutil.rmtree(installed / "drivers")
    done = start(installed)
    assert (done.returncode, done.stdout) == (1, "")
    assert f"drivers: there is no such package in {installed}" in done.stderr
