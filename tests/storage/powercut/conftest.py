import subprocess
from pathlib import Path

import pytest

from tests import peers


@pytest.fixture(scope="session")
def shim(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The library that records file operations and makes them fail, compiled here."""
    compiler = peers.program("cc", "gcc")
    library = tmp_path_factory.mktemp("shim") / "oplog.so"
    source = Path(__file__).parent / "oplog.c"
    command = [compiler, "-O2", "-Wall", "-Werror", "-shared", "-fPIC", "-o", library, source, "-ldl"]
    subprocess.run(command, check=True)
    return library


@pytest.fixture(autouse=True)
def light(monkeypatch: pytest.MonkeyPatch) -> None:
    """A ballast that is laid in no time; no test here fills a disk."""
    monkeypatch.setattr("agent.storage.database.files.BALLAST_BYTES", 64 * 1024)
