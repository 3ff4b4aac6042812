"""What the commands on a database refuse: a message, exit code 3 or 2, and not a byte changed."""

import os
import shutil
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from agent.cli.app import app
from agent.cli.terminal.errors import guarded
from agent.storage.database.files import beside
from agent.storage.write.store import Store
from tests import peers
from tests.scenario.live import example
from tests.storage.rows import batch, ledger, run_info, step

EVIL = "x'; DROP TABLE hops; --"
NOBODY = 65534
Place = Callable[[Path], None]


def deltak(*arguments: object) -> tuple[int, str]:
    """Run the command as a process that may write to nothing of others; returns its exit code and what it
    told.

    As root without the capabilities that let root pass by permissions.
    """
    drop = "-dac_override,-dac_read_search,-fowner"
    command = [
        peers.program("setpriv", "util-linux"),
        f"--bounding-set={drop}",
        f"--inh-caps={drop}",
        sys.executable,
    ]
    done = subprocess.run([*command, "-m", "agent", *map(str, arguments)], cwd=peers.ROOT,
                          capture_output=True, text=True, check=False, timeout=100)  # fmt: skip
    return done.returncode, done.stderr


@pytest.fixture
def folder() -> Iterator[Path]:
    """A folder that everybody may enter and only its owner may write to."""
    made = Path(tempfile.mkdtemp(prefix="deltak-"))
    made.chmod(0o755)
    yield made
    shutil.rmtree(made)


def good(path: Path) -> None:
    with Store.open(path) as store:
        store.write(store.begin_run(run_info()), [batch(10), step("NORM", "UNACK"), ledger()])


def state(folder: Path) -> dict[str, bytes]:
    """Return every file's content by its path, but for the log (empty) and its index that readers of SQLite
    leave."""
    assert not any(path.stat().st_size for path in folder.glob("*-wal"))
    files = [
        path
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not path.name.endswith(("-wal", "-shm"))
    ]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def give_away(folder: Path) -> None:
    """Make a folder and what is in it somebody else's."""
    if os.geteuid() != 0:
        peers.missing("commands without permission: only root can give files to somebody else")
    for path in (folder, *folder.iterdir()):
        os.chown(path, NOBODY, NOBODY)


def directory(path: Path) -> None:
    path.mkdir()


def foreign(path: Path) -> None:
    connection = sqlite3.connect(path)
    connection.execute("CREATE TABLE t (x)")
    connection.close()


def text(path: Path) -> None:
    path.write_text("t,force\n0,1\n", encoding="utf-8")


def nothing(_: Path) -> None:
    pass


PLACES: dict[str, tuple[Place, str]] = {
    "directory": (directory, "is a directory"),
    "pipe": (os.mkfifo, "is a pipe or a device"),
    "foreign": (foreign, "this file is not a deltak database"),
    "text": (text, "this file is not a deltak database"),
    "nothing": (nothing, "there is no such database"),
}
COMMANDS: dict[str, tuple[str, ...]] = {
    "check": ("db", "check", "{db}"),
    "repair": ("db", "repair", "{db}"),
    "compact": ("db", "compact", "{db}"),
    "backup": ("db", "backup", "{db}", "{folder}/copy.db"),
    "export": ("export", "{db}"),
    "estimates": ("estimates", "{db}"),
    "alarms": ("alarms", "{db}"),
    "trend": ("trend", "{db}", "k1"),
}


def asked(command: str, folder: Path) -> list[str]:
    return [word.format(db=folder / "rig.db", folder=folder) for word in COMMANDS[command]]


@pytest.mark.parametrize("what", PLACES)
@pytest.mark.parametrize("command", COMMANDS)
def test_commands_on_what_is_no_database_say_so_and_change_nothing(
    folder: Path, what: str, command: str, capfd: pytest.CaptureFixture[str]
) -> None:
    make, words = PLACES[what]
    make(folder / "rig.db")
    before = state(folder)
    assert guarded(app, asked(command, folder)) == 3
    out, reported = capfd.readouterr()
    assert reported.startswith("deltak: error: ")
    assert words in reported
    assert "; " in reported
    assert out == ""
    assert state(folder) == before


@pytest.mark.parametrize("command", ["compact"])
def test_command_without_permission_says_so_and_changes_nothing(folder: Path, command: str) -> None:
    good(folder / "rig.db")
    give_away(folder)
    before = state(folder)
    code, reported = deltak(*asked(command, folder))
    assert code == 3, reported
    assert reported.startswith("deltak: error: ")
    assert "permission denied" in reported.lower()
    assert state(folder) == before


def test_run_without_permission_ends_with_3_and_changes_nothing(folder: Path) -> None:
    config = example("modbus", folder)
    good(folder / "rig.db")
    give_away(folder)
    for lock, mode, expected, words in (
        (0o666, 0o644, 3, "permission denied"), (0o666, 0o600, 2, "is not readable"),
    ):  # fmt: skip
        beside(folder / "rig.db", ".lock").chmod(lock)
        (folder / "rig.db").chmod(mode)
        before = state(folder)
        code, reported = deltak("run", config, "--db", folder / "rig.db", "--duration", "5")
        assert (code, words in reported) == (expected, True), reported
        assert state(folder) == before


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("estimates", "{db}", "--rig", EVIL), "the database has no rig"),
        (("estimates", "{db}", "--parameter", EVIL), "no parameter"),
        (("estimates", "{db}", "--since", EVIL), "is no time"),
        (("trend", "{db}", EVIL), "no parameter"),
        (("alarms", "{db}", "--rig", EVIL), "the database has no rig"),
        (("export", "{db}", EVIL), "cannot be exported"),
        (("export", "{db}", "estimates", "--rig", EVIL), "the database has no rig"),
    ],
)  # fmt: skip
def test_sql_in_a_name_is_only_a_name_that_is_not_there(
    folder: Path, arguments: tuple[str, ...], words: str, capfd: pytest.CaptureFixture[str]
) -> None:
    good(folder / "rig.db")
    before = state(folder)
    assert (
        guarded(app, [word.format(db=folder / "rig.db") if "{db}" in word else word for word in arguments])
        == 2
    )
    reported = capfd.readouterr().err
    assert words in reported
    assert EVIL in reported
    assert state(folder) == before
