"""Wheel and sdist: what they hold, and that two builds of one commit are the same bytes."""

import hashlib
import importlib.util
import os
import subprocess
import zipfile
from pathlib import Path

import pytest

from deploy.package import source
from tests import figures, peers

pytestmark = [pytest.mark.soak, pytest.mark.timeout(300)]
WANTED = {
    "deltak.py", "agent/py.typed", "agent/examples/can.toml", "agent/examples/two-mass-rig.dbc",
    "drivers/port.py",
    "agent/cli/web/static/index.html", "agent/evaluation/demo/files/rig.toml",
    "sim_bus/scenarios/default.toml",
    "sim_bus/scenarios/rigs/bench.dbc",
}  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def _needs() -> None:
    if importlib.util.find_spec("build") is None:
        peers.missing("wheel and sdist: the extra `package` is not installed")


@pytest.fixture(scope="module")
def commit() -> str:
    """The commit that all is built of, whatever is committed meanwhile."""
    asked = ["git", "-C", str(peers.ROOT), "rev-parse", "HEAD"]
    return subprocess.run(asked, check=True, capture_output=True, text=True).stdout.strip()


def built(folder: Path, umask: int, commit: str) -> source.Built:
    before = os.umask(umask)
    try:
        epoch = source.epoch_of(commit=commit)
        tree = source.clean_tree(folder / "tree", commit=commit)
        (tree / "agent" / "__pycache__").mkdir()
        (tree / "agent" / "__pycache__" / "junk.pyc").touch()
        return source.build(tree, folder / "dist", epoch)
    finally:
        os.umask(before)


@pytest.fixture(scope="module")
def twice(tmp_path_factory: pytest.TempPathFactory, commit: str) -> list[source.Built]:
    umasks = {"first": 0o022, "second": 0o077}
    return [built(tmp_path_factory.mktemp(name), umask, commit) for name, umask in umasks.items()]


def digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def test_two_builds_of_one_commit_are_the_same_bytes(twice: list[source.Built]) -> None:
    first, second = twice
    assert digest(first.wheel) == digest(second.wheel)
    assert digest(first.sdist) == digest(second.sdist)
    wheel, sdist = first.wheel.stat().st_size, first.sdist.stat().st_size
    figures.figure(f"wheel {wheel} bytes, sdist {sdist} bytes, built twice: the same")


def test_sdist_gives_the_same_wheel(twice: list[source.Built], tmp_path: Path, commit: str) -> None:
    again = source.wheel_of(twice[0].sdist, tmp_path, source.epoch_of(commit=commit))
    assert digest(again) == digest(twice[0].wheel)


def test_wheel_holds_the_packages_with_their_files_and_nothing_of_tests(twice: list[source.Built]) -> None:
    with zipfile.ZipFile(twice[0].wheel) as wheel:
        names = set(wheel.namelist())
    assert names >= WANTED
    tops = {name.split("/")[0] for name in names}
    assert {top for top in tops if not top.endswith(".dist-info")} == {
        "agent",
        "drivers",
        "sim_bus",
        "deltak.py",
    }
    assert [name for name in names if "__pycache__" in name or "test" in Path(name).stem.split("_")] == []
    # what git knows of the packages is in the wheel, whatever its kind
    listed = ["git", "-C", str(peers.ROOT), "ls-files", "agent", "drivers", "sim_bus", "deploy/examples"]
    tracked = subprocess.run(listed, check=True, capture_output=True, text=True).stdout.split()
    wanted = {name.replace("deploy/", "agent/") for name in tracked} - {"agent/examples"}
    assert wanted - names == set()
