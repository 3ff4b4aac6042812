"""What is handed out, built once a run: of the version at hand, and of one to upgrade to."""

import importlib.util
import shutil
from collections.abc import Mapping
from pathlib import Path

import pytest

import agent
from deploy.package import source
from tests import peers

OLD, NEW = agent.__version__, "99.0.0"


def built(folder: Path, version: str) -> Path:
    """Build every package of the last commit, as if it were of a version; return their folder."""
    from deploy.package.__main__ import make

    work, to = folder / "work", folder / "dist"
    to.mkdir(parents=True)
    tree = source.clean_tree(work / "tree")
    named = tree / "agent/__init__.py"
    named.write_text(named.read_text().replace(f'"{OLD}"', f'"{version}"'))
    for _ in make(work, to, source.epoch_of()):
        pass
    shutil.rmtree(work)
    return to


@pytest.fixture(scope="session")
def dists(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Path]:
    if importlib.util.find_spec("build") is None:
        peers.missing("Debian package: the extra `package` is not installed")
    if not Path("/usr/bin/python3.11").exists():
        peers.missing("Debian package: no /usr/bin/python3.11 (Debian 12)")
    folder = tmp_path_factory.mktemp("packages")
    return {version: built(folder / version, version) for version in (OLD, NEW)}
