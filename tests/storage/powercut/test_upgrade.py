"""Files of every earlier version become files of this one: whole, or not at all, wherever the power goes."""

import gzip
import shutil
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from sqlite_utils import Database

from agent.storage import maintenance
from agent.storage.database.connect import create
from agent.storage.database.schema import SCHEMA_VERSION, migrations, version_of
from agent.storage.write.store import Store
from tests import peers
from tests.figures import figure
from tests.storage.powercut.disk import cuts
from tests.storage.powercut.test_powercut import laid_before, lay, record
from tests.storage.rows import batch, ledger, run_info, step

FIXTURES = {
    int(path.name[8:-6]): path for path in (Path(__file__).parents[1] / "fixtures").glob("version-*.db.gz")
}
"""Files as the migrations of their time left them."""
Content = dict[str, list[tuple[object, ...]]]
KEPT = {
    "v_estimates": "t_ns, parameter, value, sd, lower, upper, status, reason, span_s, method",
    "v_alarms": "id, rig, parameter, state, raised_at, acked_by, message",
    "v_alarm_events": "id, alarm_id, t_ns, from_state, to_state",
    "v_health": "rig, source, t_ns, received, used, rejected, dropped, gaps",
    "v_events": "id, rig, cause, message",
    "v_runs": "run_id, rig, kind, started_at, code_version, config_sha256, boot_id",
    "consumers": "name, last_seq",
}


def content(connection: sqlite3.Connection) -> Content:
    """Return what the views that every version has show."""
    return {
        view: connection.execute(f"SELECT {columns} FROM {view}").fetchall() for view, columns in KEPT.items()
    }


def of_version(version: int, path: Path) -> Content:
    """Lay a file of an earlier version; return what it shows."""
    path.write_bytes(gzip.decompress(FIXTURES[version].read_bytes()))
    connection = sqlite3.connect(path)
    shown = content(connection)
    connection.close()
    for suffix in ("-wal", "-shm"):
        path.with_name(path.name + suffix).unlink(missing_ok=True)
    return shown


def shape(path: Path) -> dict[str, str]:
    """Return every object of the schema with its text, but for the spaces."""
    connection = sqlite3.connect(path)
    found = connection.execute("SELECT name, sql FROM sqlite_master WHERE sql IS NOT NULL").fetchall()
    connection.close()
    return {name: "".join(sql.split()) for name, sql in found}


def test_every_earlier_version_has_a_fixture() -> None:
    versions = [int(step.name[:4]) for step in migrations().pending(Database(memory=True))]
    assert versions[-1] == SCHEMA_VERSION
    assert sorted(FIXTURES) == versions[:-1], "make a file with the program before the migration"


def test_new_file_is_what_the_migrations_make_of_an_empty_one(memory: Path) -> None:
    new, migrated = memory / "new.db", memory / "migrated.db"
    create(new)
    database = Database(migrated)
    migrations().apply(database)
    assert shape(new) == shape(migrated)
    with closing(sqlite3.connect(new)) as connection:
        assert version_of(connection) == SCHEMA_VERSION
        assert migrations().pending(Database(connection)) == []


def test_new_file_is_made_without_the_library_of_the_migrations(memory: Path) -> None:
    words = "import sys; from pathlib import Path; from agent.storage.database.connect import create; "
    words += "create(Path(sys.argv[1])); assert 'sqlite_utils' not in sys.modules"
    done = subprocess.run(
        [sys.executable, "-c", words, str(memory / "new.db")], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("version", FIXTURES)
def test_upgrade_of_an_earlier_version_keeps_every_row_and_ends_as_a_new_file_does(
    version: int, memory: Path
) -> None:
    path, fresh = memory / "rig.db", memory / "fresh.db"
    before = of_version(version, path)
    assert len(before["v_estimates"]) == 168
    with Store.open(path) as store:
        assert store.recovery is None
        assert content(store.connection) == before
        store.write(store.begin_run(run_info()), [batch(3, first=10**6), step("NORM", "UNACK"), ledger()])
    create(fresh)
    assert shape(path) == shape(fresh)
    assert maintenance.check(path).problems == []


@pytest.mark.parametrize("version", FIXTURES)
@pytest.mark.parametrize(
    "count", [25, pytest.param(5000, marks=[pytest.mark.soak, pytest.mark.timeout(7200)])]
)
def test_power_cut_during_an_upgrade_leaves_the_old_file_or_the_new_one(
    shim: Path, memory: Path, rng: np.random.Generator, version: int, count: int
) -> None:
    path = memory / "old.db"
    before = of_version(version, path)
    old = path.read_bytes()
    operations = record(shim, memory, "live", prepare=old)
    writes = next(i for i, operation in enumerate(operations) if operation.kind == "A")
    first = laid_before(memory / "work" / "rig.db", int((memory / "inode").read_text()), old)
    left = []
    for moment, files, _ in cuts(first + operations[: writes + 20], count, rng):
        if moment < len(first):
            continue  # before the old file itself was there
        path = lay(files, memory / "cut")
        left.append(looked_at(path))
        with Store.open(path) as store:
            assert store.recovery is None, f"cut at {moment}: {store.recovery}"
            assert version_of(store.connection) == SCHEMA_VERSION
            shown = content(store.connection)
            for view in before:
                assert shown[view][: len(before[view])] == before[view], f"cut at {moment}: {view}"
    assert {version, SCHEMA_VERSION} <= set(left)
    figure(f"power cuts during an upgrade from version {version}: {len(left)}, no half state, nothing lost")


def looked_at(path: Path) -> int:
    """Return the version of a file as it lies there, without changing it."""
    copy = path.parent.with_name("look")
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(path.parent, copy)
    connection = sqlite3.connect(copy / path.name)
    version = version_of(connection)
    connection.close()
    return version


def test_first_start_loads_neither_the_library_of_the_migrations_nor_pandas(memory: Path) -> None:
    code = (
        "import sys; from agent.storage.write.store import Store; Store.open(sys.argv[1]); "
        "print(sorted(sys.modules))"
    )
    command = [sys.executable, "-c", code, memory / "rig.db"]
    done = subprocess.run(command, cwd=peers.ROOT, capture_output=True, text=True, check=True)
    assert "'sqlite3'" in done.stdout
    assert "'sqlite_utils'" not in done.stdout
    assert "'pandas'" not in done.stdout
