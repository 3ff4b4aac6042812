"""`deltak upgrade`: what a version would do is said beforehand; one without valid rows takes itself back."""

import gzip
import json
import os
import re
import sqlite3
import stat
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from agent.cli.app import app
from agent.cli.terminal.errors import guarded
from agent.cli.upgrade import check
from agent.cli.upgrade.agents import AgentsError, Commands, Units
from agent.cli.upgrade.releases import Releases
from agent.cli.upgrade.switch import Switch, TakenBackError, upgrade
from agent.errors import StoreError, UsageError
from agent.storage.database.schema import SCHEMA_VERSION, version_mark
from agent.storage.write.store import Store
from agent.types import Status
from tests.packages.played_rows import write_rows
from tests.peers import ROOT

FIXTURES = ROOT / "tests/storage/fixtures"
EXAMPLE = ROOT / "deploy/examples/modbus.toml"


def mark_newer(db: Path) -> None:
    """Do what a later version does at its start: bring the file to a version this program does not read."""
    with closing(sqlite3.connect(db, isolation_level=None)) as connection:
        connection.execute(f"PRAGMA user_version = {version_mark(SCHEMA_VERSION + 1)}")


@dataclass
class PlayedAgents:
    """Agents whose behaviour is that of the version that the link leads to."""

    releases: Releases
    behaviours: dict[str, Callable[[], None]]
    steps: list[str] = field(default_factory=list)

    def stop(self) -> None:
        self.steps.append("stop")

    def start(self, limit_s: float) -> None:
        self.steps.append(self.releases.current)
        self.behaviours[self.releases.current]()


@pytest.fixture
def db(tmp_path: Path) -> Path:
    path = tmp_path / "rig.db"
    write_rows(path)
    return path


def lay(home: Path, version: str, says: object) -> None:
    """Put a version there whose program only answers what it would do."""
    program = home / "releases" / version / "bin" / "deltak"
    program.parent.mkdir(parents=True)
    program.write_text(f"#!/bin/sh\ncat <<'END'\n{json.dumps(says)}\nEND\n")
    program.chmod(0o755)


def prepared(home: Path, db: Path, action: str, behaviour: Callable[[], None]) -> tuple[Switch, PlayedAgents]:
    lay(home, "1.0.0", {})
    lay(home, "2.0.0", {"errors": [], "databases": [{"db": str(db), "action": action}]})
    releases = Releases(home)
    releases.switch("1.0.0")
    agents = PlayedAgents(releases, {"1.0.0": lambda: write_rows(db), "2.0.0": behaviour})
    return Switch(releases, agents, "1.0.0", "2.0.0", within_s=0.3, poll_s=0.02), agents


def valid_runs(db: Path) -> list[int]:
    with closing(sqlite3.connect(db)) as connection:
        query = "SELECT DISTINCT run_id FROM v_estimates WHERE status = 'valid' ORDER BY run_id"
        return [run for (run,) in connection.execute(query)]


def test_version_that_gives_valid_rows_takes_over(tmp_path: Path, db: Path) -> None:
    switch, agents = prepared(tmp_path, db, "none", lambda: write_rows(db))
    found = upgrade(switch, [db])
    assert found == {"from": "1.0.0", "to": "2.0.0", "changed": True, "rigs": ["press-7"], "copies": []}
    assert agents.steps == ["stop", "2.0.0"]
    assert switch.releases.current == "2.0.0"


def test_version_whose_rows_are_not_valid_is_taken_back_and_it_is_said(tmp_path: Path, db: Path) -> None:
    switch, agents = prepared(tmp_path, db, "none", lambda: write_rows(db, Status.INVALID))
    with pytest.raises(TakenBackError) as raised:
        upgrade(switch, [db])
    assert str(raised.value) == (
        "upgrade to 2.0.0: taken back: no valid row of press-7 within 0.3 s; "
        "1.0.0 runs again and gives valid rows"
    )
    assert raised.value.exit_code == 1
    assert agents.steps == ["stop", "2.0.0", "stop", "1.0.0"]
    assert switch.releases.current == "1.0.0"
    assert valid_runs(db) == [1, 3]  # 2 is the run of the version that was taken back: its rows stay


def test_version_that_does_not_start_is_taken_back_at_once(tmp_path: Path, db: Path) -> None:
    def refuse() -> None:
        raise AgentsError.at(
            "systemctl start deltak.service", "failed with exit code 1", "see the agent's log"
        )

    switch, agents = prepared(tmp_path, db, "none", refuse)
    with pytest.raises(TakenBackError, match=r"taken back: failed with exit code 1; 1\.0\.0 runs again"):
        upgrade(switch, [db])
    assert agents.steps == ["stop", "2.0.0", "stop", "1.0.0"]


def test_database_that_was_migrated_is_as_before_when_the_version_is_taken_back(
    tmp_path: Path, db: Path
) -> None:
    def migrate_and_fail() -> None:
        write_rows(db, Status.INVALID)
        mark_newer(db)

    db.chmod(0o640)
    switch, _ = prepared(tmp_path, db, "migrate", migrate_and_fail)
    with pytest.raises(TakenBackError, match=r"what 2\.0\.0 wrote lies in .*rig\.db\.of-2\.0\.0"):
        upgrade(switch, [db])
    assert valid_runs(db) == [1, 2]  # as the former version left it, and its rows since
    assert stat.S_IMODE(db.stat().st_mode) == 0o640
    with pytest.raises(StoreError, match="newer version"), Store.open(tmp_path / "rig.db.of-2.0.0"):
        pass
    assert valid_runs(tmp_path / "rig.db.of-2.0.0") == [1]


def test_copy_from_before_stays_when_the_version_takes_over_and_is_one_at_most(
    tmp_path: Path, db: Path
) -> None:
    (tmp_path / "rig.db.before-1.0.0").touch()
    switch, _ = prepared(tmp_path, db, "migrate", lambda: write_rows(db))
    copy = tmp_path / "rig.db.before-2.0.0"
    assert upgrade(switch, [db])["copies"] == [str(copy)]
    assert valid_runs(db) == [1, 2]
    assert valid_runs(copy) == [1]
    assert sorted(tmp_path.glob("rig.db.before-*")) == [copy]


def test_interruption_takes_the_switch_back(tmp_path: Path, db: Path) -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    switch, _ = prepared(tmp_path, db, "none", interrupted)
    with pytest.raises(TakenBackError, match="KeyboardInterrupt"):
        upgrade(switch, [db])
    assert switch.releases.current == "1.0.0"


def test_power_cut_while_rows_are_waited_for_leaves_the_new_version_and_the_copies(
    tmp_path: Path, db: Path
) -> None:
    switch, _ = prepared(tmp_path, db, "migrate", lambda: os._exit(9))
    child = os.fork()
    if child == 0:
        upgrade(switch, [db])
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9
    assert switch.releases.current == "2.0.0"
    assert valid_runs(tmp_path / "rig.db.before-2.0.0") == valid_runs(db) == [1]


def test_database_in_use_is_not_copied_and_the_former_version_goes_on(tmp_path: Path, db: Path) -> None:
    switch, agents = prepared(tmp_path, db, "migrate", lambda: None)
    agents.behaviours["1.0.0"] = lambda: None
    with Store.open(db), pytest.raises(TakenBackError, match="is writing to this database"):
        upgrade(switch, [db])
    assert switch.releases.current == "1.0.0"
    assert not list(tmp_path.glob("*.before-*"))


def test_version_that_would_refuse_something_changes_nothing(tmp_path: Path, db: Path) -> None:
    switch, agents = prepared(tmp_path, db, "none", lambda: None)
    lay(
        tmp_path,
        "3.0.0",
        {"errors": [{"path": "rig.rate", "message": "unknown key", "advice": "see the changelog"}]},
    )
    switch.version = "3.0.0"
    with pytest.raises(UsageError, match=r"rig\.rate: unknown key; see the changelog"):
        upgrade(switch, [db])
    assert (agents.steps, switch.releases.current) == ([], "1.0.0")


def test_rig_that_gave_no_valid_rows_before_is_not_waited_for(tmp_path: Path) -> None:
    path = tmp_path / "rest.db"
    write_rows(path, Status.INVALID)
    switch, _ = prepared(tmp_path, path, "none", lambda: None)
    assert upgrade(switch, [path])["rigs"] == []


@pytest.mark.parametrize(
    "file", sorted(FIXTURES.glob("version-*.db.gz")), ids=lambda file: file.name.split(".")[0]
)
def test_check_says_through_which_steps_an_older_database_goes(tmp_path: Path, file: Path) -> None:
    path = tmp_path / "old.db"
    path.write_bytes(gzip.decompress(file.read_bytes()))
    before = path.read_bytes()
    version = int(file.name.split("-")[1].split(".")[0])
    (row,) = check.check([path])["databases"]
    assert row["version"] == version
    assert [int(step[:4]) for step in row["steps"]] == list(range(version + 1, SCHEMA_VERSION + 1))
    assert row["action"] == ("migrate" if version < SCHEMA_VERSION else "none")
    assert row["needs_bytes"] > len(before)
    assert (path.read_bytes(), list(tmp_path.iterdir())) == (before, [path])


def test_check_refuses_what_this_version_cannot_use_each_with_its_reason(tmp_path: Path, db: Path) -> None:
    mark_newer(db)
    foreign, wrong = tmp_path / "notes.db", tmp_path / "wrong.toml"
    foreign.write_text("shopping: milk, bread" * 99)
    wrong.write_text("[rig]\nname = 7\n")
    found = check.check([db, foreign, wrong, EXAMPLE])
    assert [(row["action"], bool(row["errors"])) for row in found["databases"]] == [("refuse", True)] * 2
    messages = "\n".join(error["message"] for error in found["errors"])
    assert "was written by a newer version" in messages
    assert "is not a deltak database" in messages
    assert [bool(row["errors"]) for row in found["configs"]] == [True, False]
    assert (found["ok"], check.exit_code(found)) == (False, 2)
    assert check.exit_code(check.check([db])) == 3


@pytest.mark.parametrize("options", [[], ["--json"]])
def test_check_says_every_fault_on_stderr_beside_a_document_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str]
) -> None:
    foreign = tmp_path / "notes.db"
    foreign.write_text("shopping: milk, bread" * 99)
    assert guarded(app, ["upgrade", "--check", str(foreign), *options]) == 3
    said = capsys.readouterr()
    assert "this file is not a deltak database" in said.err
    assert not options or json.loads(said.out)["ok"] is False


def test_check_of_a_database_that_is_not_there_is_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert guarded(app, ["upgrade", "--check", str(tmp_path / "typo.db")]) == 3
    assert "typo.db: there is no such database" in capsys.readouterr().err


def test_check_says_when_there_is_no_room(monkeypatch: pytest.MonkeyPatch, db: Path) -> None:
    monkeypatch.setattr(check, "_free", lambda _: 1000)
    (error,) = check.check([db])["errors"]
    assert "17 MB are wanted beside it and 0 MB are free" in error["message"]


@pytest.mark.parametrize(("words", "said"), [
    ((), "asks for nothing; say --check, or --to VERSION"),
    (("--check", "--to", "2"), "cannot go with --to"),
    (("--to", "9.9.9"), "there is no version 9.9.9"),
    (("--to", "../1.0.0"), "there is no version ../1.0.0"),
    (("--to", "1.0.0", "--stop", "true"), "--start go together"),
])  # fmt: skip
def test_command_line_that_makes_no_sense_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], said: str
) -> None:
    lay(tmp_path, "1.0.0", {})
    Releases(tmp_path).switch("1.0.0")
    assert guarded(app, ["upgrade", *words, "--home", str(tmp_path)]) == 2
    assert said in capsys.readouterr().err


@pytest.fixture
def systemctl(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A systemctl that lists units and takes down what else it is asked."""
    program = tmp_path / "bin" / "systemctl"
    program.parent.mkdir()
    listed = "".join(
        f"{name}.service loaded active running x\\n"
        for name in ("deltak", "deltak-page", "deltak-upgrade@2.0.0")
    )
    program.write_text(
        f"#!/bin/sh\n[ $1 = list-units ] && printf '{listed}' || echo $* >> {tmp_path}/asked\n"
    )
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}:/usr/bin:/bin")
    return tmp_path / "asked"


def test_units_that_run_are_stopped_and_started_but_the_one_that_switches(systemctl: Path) -> None:
    units = Units()
    units.stop()
    units.start(10.0)
    wanted = "deltak.service deltak-page.service"
    assert systemctl.read_text() == f"stop {wanted}\nstart {wanted}\n"


@pytest.mark.parametrize(("command", "said"), [
    (["false"], "false: failed with exit code 1: no word"),
    (["sh", "-c", "echo no bus >&2; exit 3"], "failed with exit code 3: no bus"),
    (["sleep", "60"], "sleep 60: was not done after 0.05 s"),
    (["deltak-nowhere"], "deltak-nowhere: cannot be run: No such file or directory"),
])  # fmt: skip
def test_command_that_does_not_start_the_agents_is_named_with_its_last_word(
    command: list[str], said: str
) -> None:
    with pytest.raises(AgentsError, match=re.escape(said)):
        Commands(["true"], command).start(0.05 if command[0] == "sleep" else 10.0)


AGENT = f"""#!{sys.executable}
import sys
sys.path.insert(0, {str(ROOT)!r})
if "--check" in sys.argv:
    from agent.__main__ import main
    main()
from pathlib import Path
from agent.types import Status
from tests.packages.played_rows import write_rows
write_rows(Path(sys.argv[2]), Status.STATUS)
"""


@pytest.mark.soak
def test_command_takes_a_version_back_whose_process_writes_no_valid_rows(tmp_path: Path, db: Path) -> None:
    """Two programs that write to the real database; what starts them follows the link, as the unit does."""
    for version, status in (("1.0.0", "VALID"), ("2.0.0", "INVALID")):
        lay(tmp_path, version, {})
        (tmp_path / "releases" / version / "bin" / "deltak").write_text(AGENT.replace("STATUS", status))
    Releases(tmp_path).switch("1.0.0")
    start = f"sh -c '{tmp_path / 'current/bin/deltak'} run {db} >/dev/null 2>&1 &'"
    words = ["--to", "2.0.0", "--home", tmp_path, "--within", "10", "--stop", "true", "--start", start, db]
    command = [sys.executable, "-m", "agent", "upgrade", *map(str, words)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == (
        "deltak: error: upgrade to 2.0.0: taken back: no valid row of press-7 within 10 s; "
        "1.0.0 runs again and gives valid rows\n"
    )
    assert Releases(tmp_path).current == "1.0.0"
    assert valid_runs(db) == [1, 3]
