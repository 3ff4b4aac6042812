"""Who may read may not command, stop or forge: what a second user, a member of the readers' group, can do."""

import os
import shutil
import stat
import subprocess
import sys
import textwrap
import zlib
from collections.abc import Iterator
from pathlib import Path

import pytest

from agent.errors import StoreError, UsageError
from agent.recording.blocks import BlockSegment
from agent.recording.event_files import EventFolder
from agent.recording.header import RawHeader
from agent.storage import maintenance
from agent.storage.database.files import beside
from agent.storage.read import queries
from agent.storage.write import command_socket
from agent.storage.write.command_socket import CommandServer
from agent.storage.write.store import Store
from agent.storage.write.watermark import _PLACE
from tests import peers
from tests.storage.rows import batch, run_info, step

READERS, COMMANDERS = 61_001, 61_002  # numbers that no group of this machine need have
READER = 61_003


BECOME = f"""
import fcntl, os, socket, sqlite3, sys
from pathlib import Path
from agent.storage import maintenance# before: the interpreter may lie where others cannot read
from agent.storage.read import queries# before: the interpreter may lie where others cannot read
os.setgroups([int(word) for word in sys.argv[2].split()])
os.setgid({READERS})
os.setuid({READER})
"""


def as_user(code: str, path: Path, *groups: int) -> str:
    """Run Python as the second user; returns what it prints, and its error where it fails."""
    if os.geteuid() != 0:
        peers.missing("a second user: the tests do not run as root, which alone may become another user")
    words = [sys.executable, "-c", BECOME + textwrap.dedent(code), str(path), " ".join(map(str, groups))]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=60, cwd=peers.ROOT)
    return done.stdout + done.stderr


@pytest.fixture
def folder(memory: Path) -> Path:
    """A folder as the systemd unit makes it, whose group may read."""
    if os.geteuid() == 0:
        os.chown(memory, 0, READERS)
    memory.chmod(0o2750)
    return memory


@pytest.fixture
def path(folder: Path) -> Iterator[Path]:
    """A database that an agent has open, with records beside it, made under the unit's mask."""
    before = os.umask(0o027)
    path = folder / "rig.db"
    with Store.open(path) as store:
        store.write(store.begin_run(run_info()), [batch(20), step("NORM", "UNACK")])
        EventFolder(beside(path, ".events"), "press-7").write("press-7-00000000-k1.npz", b"x")
        yield path
    os.umask(before)


ATTACK = """
    folder = Path(sys.argv[1])
    def tried(what, act):
        try:
            act()
        except OSError as error:
            return
        print("could", what)
    files = [p for p in folder.rglob("*")]
    assert len(files) > 5, files
    for file in files:
        if file.is_file():
            tried(f"write {file.name}", lambda: open(file, "r+b"))
        if file.is_dir():
            tried(f"make a file in {file.name}", lambda: (file / "new").touch())
        tried(f"delete {file.name}", lambda: file.rename(folder / "away"))
    tried("make a file", lambda: (folder / "new").touch())
    tried("hold the lock", lambda: fcntl.flock(os.open(folder / "rig.db.lock", os.O_RDONLY), fcntl.LOCK_EX))
    tried("command", lambda: socket.socket(socket.AF_UNIX).connect(str(folder / "rig.db.sock")))
    print("done")
"""


def test_reader_can_write_nothing_and_neither_hold_the_lock_nor_command(path: Path) -> None:
    server = CommandServer(path, {})
    server.start()
    try:
        assert as_user(ATTACK, path.parent) == "done\n"
    finally:
        server.stop()


PLAIN = """
    file = sqlite3.connect(f"file:{sys.argv[1]}?mode=ro", uri=True)
    print(file.execute("SELECT count(*) FROM v_estimates").fetchone()[0])
"""
OWN = """
    print(len(queries.estimates(sys.argv[1])), queries.alarms(sys.argv[1])[0]["state"])
"""


def test_reader_sees_every_row_while_the_agent_runs_after_its_end_and_after_its_death(path: Path) -> None:
    assert as_user(PLAIN, path) == "80\n"
    assert as_user(OWN, path) == "80 UNACK\n"
    dead = path.with_name("dead.db")
    for suffix in ("", "-wal", "-shm"):
        shutil.copy(beside(path, suffix), beside(dead, suffix))
        beside(dead, suffix).chmod(0o640)
    assert beside(dead, "-wal").stat().st_size > 0
    assert as_user(OWN, dead) == "80 UNACK\n"
    assert as_user(PLAIN, dead) == "80\n"
    ended = path.with_name("ended.db")
    with Store.open(ended) as store:
        store.write(store.begin_run(run_info()), [batch(20), step("NORM", "UNACK")])
    assert not beside(ended, "-wal").exists()
    assert as_user(OWN, ended) == "80 UNACK\n"


def test_member_of_the_commanding_group_has_the_agent_compact_the_file(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command_socket, "command_group", lambda: COMMANDERS if os.geteuid() == 0 else None)
    server = CommandServer(path, {"compact": lambda _: {"bytes_before": 2, "bytes_after": 1}})
    server.start()
    code = "print(maintenance.compact(sys.argv[1]))"
    try:
        assert as_user(code, path, COMMANDERS) == "(2, 1)\n"
        assert "join the group deltak-command" in as_user(code, path)
    finally:
        server.stop()


def test_lock_left_by_an_earlier_version_is_closed_to_others(tmp_path: Path) -> None:
    path = tmp_path / "rig.db"
    beside(path, ".lock").touch(0o660)
    beside(path, ".lock").chmod(0o660)
    with Store.open(path):
        assert stat.S_IMODE(beside(path, ".lock").stat().st_mode) == 0o600


def forge(path: Path, highs: dict[str, int]) -> None:
    """Write a note into DB.lock that says that more was acknowledged."""
    text = " ".join(f"{table} {high}" for table, high in highs.items())
    with beside(path, ".lock").open("r+b") as file:
        file.seek(_PLACE)
        file.write(f"{zlib.crc32(text.encode()):08x} {text}".ljust(160).encode() + b"\n")


@pytest.mark.parametrize("mode", [0o600, 0o660])
@pytest.mark.parametrize("ahead", [7, 10**15])
def test_forged_note_of_what_was_acknowledged_is_no_damage(tmp_path: Path, mode: int, ahead: int) -> None:
    path = tmp_path / "rig.db"
    with Store.open(path) as store:
        store.write(store.begin_run(run_info()), [batch(20)])
    forge(path, {"hops": 20 + ahead, "events": ahead})
    beside(path, ".lock").chmod(mode)
    assert maintenance.repair(path) is None
    forge(path, {"hops": 20 + ahead, "events": ahead})
    beside(path, ".lock").chmod(mode)
    for _ in range(2):
        with Store.open(path) as store:
            assert store.recovery is None
            store.write(store.begin_run(run_info()), [batch(20, first=20)])
    assert not list(tmp_path.glob("*.corrupt-*"))
    assert [a["kind"] for a in queries.alarms(path)] == []
    words = [(e["cause"], e["message"]) for e in queries.events(path)]
    reported = [("rows missing", "7 instants, 7 events that were acknowledged are missing")]
    assert words == (reported if (mode, ahead) == (0o600, 7) else [])


@pytest.mark.parametrize("suffix", ["", "-wal", "-shm", "-journal", ".lock"])
def test_agent_writes_through_no_symbolic_link(tmp_path: Path, suffix: str) -> None:
    precious, path = tmp_path / "precious", tmp_path / "rig.db"
    precious.write_bytes(b"")
    if suffix:
        Store.open(path).close()
        beside(path, suffix).unlink(missing_ok=True)
    beside(path, suffix).symlink_to(precious)
    with pytest.raises(StoreError, match=f"rig.db{suffix}: is a symbolic link"):
        Store.open(path)
    assert precious.read_bytes() == b""


@pytest.mark.parametrize("suffix", [".ballast", ".sock", ".new", ".salvaging", ".spill"])
def test_link_in_the_place_of_a_file_beside_the_database_is_not_followed(tmp_path: Path, suffix: str) -> None:
    precious, path = tmp_path / "precious", tmp_path / "rig.db"
    precious.write_bytes(b"mine")
    beside(path, suffix).symlink_to(precious)
    try:
        with Store.open(path) as store:
            store.write(store.begin_run(run_info()), [batch(1)])
            CommandServer(path, {}).stop()
    except (OSError, StoreError):
        pass  # refused is as good
    assert precious.read_bytes() == b"mine"
    assert stat.S_IMODE(precious.stat().st_mode) & 0o600 == 0o600


def test_backup_and_records_follow_no_link(tmp_path: Path) -> None:
    path, precious = tmp_path / "rig.db", tmp_path / "precious"
    Store.open(path).close()
    (tmp_path / "copy.db").symlink_to(precious)
    with pytest.raises(UsageError, match="exists already"):
        maintenance.backup(path, tmp_path / "copy.db")
    (tmp_path / "other.db.part").symlink_to(precious)
    assert maintenance.backup(path, tmp_path / "other.db") > 1000
    (tmp_path / "events").mkdir()
    (tmp_path / "events" / "one.npz.part").symlink_to(precious)
    EventFolder(tmp_path / "events", "press-7").write("one.npz", b"x")
    (tmp_path / "one.raw").symlink_to(precious)
    with pytest.raises(FileExistsError):
        BlockSegment(tmp_path / "one.raw", RawHeader("can", ("x1",), None, "0" * 64, "0.1.0", 0))
    assert not precious.exists()


def test_database_removed_by_hand_leaves_no_story_of_damage(tmp_path: Path) -> None:
    path = tmp_path / "rig.db"
    store = Store.open(path)
    store.write(store.begin_run(run_info()), [batch(20)])
    left = {suffix: beside(path, suffix).read_bytes() for suffix in ("-wal", "-shm", ".lock", ".ballast")}
    store.close()
    path.unlink()
    for suffix, octets in left.items():
        beside(path, suffix).write_bytes(octets)
    with Store.open(path) as store:
        assert store.recovery is None
        store.write(store.begin_run(run_info()), [batch(3)])
    assert queries.events(path) == []
    assert queries.alarms(path) == []
    assert len(queries.estimates(path)) == 12
