"""Every command and every query that the documents show is run, in the order in which a reader would."""

import os
import shutil
import socket
import sqlite3
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.docs.documents import Block, blocks
from tests.peers import ROOT
from tests.rigs import two_mass_recording

pytestmark = pytest.mark.realtime

SHELL = blocks("sh")


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A reader's folder: the examples on a free port, a recording, and the demo's database once it has been
    run."""
    folder = tmp_path_factory.mktemp("reader")
    shutil.copytree(ROOT / "deploy", folder / "deploy")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    example = folder / "deploy/examples/modbus.toml"
    example.write_text(
        example.read_text(encoding="utf-8").replace("port = 1502", f"port = {port}"), encoding="utf-8"
    )
    two_mass_recording(folder / "recording.csv", np.random.default_rng(5))
    return folder


def run(text: str, folder: Path) -> subprocess.CompletedProcess[str]:
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    return subprocess.run(
        ["bash", "-euo", "pipefail", "-c", text],
        cwd=folder, env=os.environ | {"PATH": path}, capture_output=True, text=True, timeout=100, check=False,
    )  # fmt: skip


@pytest.mark.parametrize("block", [block for block in SHELL if block.text.startswith("make ")], ids=str)
def test_make_targets_in_the_documents_exist(block: Block) -> None:
    """The targets themselves are what runs this suite, and what a fresh clone is tried with."""
    for line in block.text.splitlines():
        done = run(f"make --dry-run {line.split()[1]}", ROOT)
        assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("block", [block for block in SHELL if not block.text.startswith("make ")], ids=str)
def test_commands_in_the_documents_run(block: Block, reader: Path) -> None:
    done = run(block.text, reader)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "error" not in done.stderr


@pytest.mark.parametrize("block", blocks("sql"), ids=str)
def test_queries_in_the_documents_find_rows(block: Block, reader: Path) -> None:
    if not (reader / "demo.db").exists():
        assert run("deltak demo --fast --db demo.db", reader).returncode == 0
    database = sqlite3.connect(f"file:{reader / 'demo.db'}?mode=ro", uri=True)
    try:
        found = database.execute(block.text).fetchall()
        # in the demo nothing goes wrong that an event could tell of
        assert bool(found) == ("v_events" not in block.text)
    finally:
        database.close()
