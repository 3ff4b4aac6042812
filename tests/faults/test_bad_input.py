"""What a user can get wrong: exit code, key path and words, and that no row of any table changes by it."""

import json
import re
import shutil
import socket
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.runtime.replay import replay
from agent.storage.database.schema import SCHEMA_VERSION, version_mark
from tests.ports import free_port
from tests.scenario.live import LIMIT_S, agent, counts, example, hops, rows, wait_until
from tests.sim.rigs import simulator
from tests.unit.cli.test_app import Run, deltak

__all__ = ["deltak"]
HEADER = "t,force,x1,x2"
RIG = "two-mass-rig"


def samples(count: int = 400) -> list[list[float]]:
    """Time and readings that make a recording, excited and plausible."""
    rng = np.random.default_rng(3)
    values = np.column_stack(
        [np.arange(count) * 1e-3, rng.normal(size=count), rng.normal(size=(count, 2)) * 1e-3]
    )
    return [[round(value, 6) for value in row] for row in values.tolist()]


def csv(path: Path, lines: list[list[float]] | list[str], header: str = HEADER) -> Path:
    body = [line if isinstance(line, str) else ",".join(map(str, line)) for line in lines]
    path.write_text("\n".join([header, *body] if header else body) + "\n", encoding="utf-8")
    return path


@dataclass(frozen=True)
class Place:
    """A folder with a good configuration, a good recording and a database that holds a run of them."""

    folder: Path
    config: Path
    recording: Path
    db: Path
    before: dict[str, int]

    def unchanged(self) -> bool:
        """Whether every table has as many rows as before."""
        return counts(self.db) == self.before


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> Place:
    folder = tmp_path_factory.mktemp("filled")
    config, recording, db = example("modbus", folder), csv(folder / "good.csv", samples()), folder / "rig.db"
    assert replay(config=config, recordings=[recording], db=db)["samples"]["used"] == 400
    return Place(folder, config, recording, db, counts(db))


@pytest.fixture
def place(filled: Place, tmp_path: Path) -> Place:
    for item in filled.folder.iterdir():
        if item.is_file():
            shutil.copy(item, tmp_path)
    db = tmp_path / filled.db.name
    return Place(tmp_path, tmp_path / filled.config.name, tmp_path / filled.recording.name, db, counts(db))


SPRING = "nominal = 25.0 }"
CONFIG_FAULTS = [
    ("unknown key", "hop_s = 0.05", "hop_s = 0.05\nhops = 1",
     "estimator.hops", 'unknown key; the nearest known key is "hop_s"'),
    ("unit of the wrong kind", 'unit = "N"', 'unit = "m"',
     "channel[0].unit", '"m" is a unit of displacement, not of force; units of force are N, '),
    ("unknown mass", 'at = "m1"', 'at = "m3"', "channel[1].at", 'no mass is called "m3"; masses are m1, m2'),
    ("duplicate name", 'name = "x2"', 'name = "x1"', "channel[2].name", '"x1" is the name of channel[1]'),
    ("duplicate element", 'name = "k2", b', 'name = "k1", b', "model.spring[1].name", '"k1"'),
    ("negative mass", "value = 5.0", "value = -5.0", "model.mass[0].value", "must"),
    ("rate 0", "sample_rate_hz = 1000.0", "sample_rate_hz = 0", "rig.sample_rate_hz", "must"),
    ("both limits", "limit = 15.0", "limit_percent = 10\nlimit = 15.0", "alarm[0]",
     "both limit and limit_percent"),
    ("no limit", "limit = 15.0", "", "alarm[0]", "has no limit"),
    ("channel that no source maps", ', x2 = "x2" }', " }", "channel[2]", 'no source maps "x2"'),
    ("alarm on what is not estimated", "hop_s = 0.05", 'hop_s = 0.05\nestimate = ["k2", "B1", "B2"]',
     "alarm[0].parameter", '"k1" is not estimated'),
    ("noise_sd 0", "noise_sd = 1e-6", "noise_sd = 0",
     "channel[1].noise_sd", "leave it out where the noise is not known"),
    ("parallel springs", SPRING, f'{SPRING}, {{ name = "k3", between = ["m1", "ground"], nominal = 9.0 }}',
     "estimator.estimate", '"k1" and "k3" cannot be told apart'),
    ("gains of everything", "unit = ", "gain = true\nunit = ",
     "estimator.estimate", '"force.gain", "x1.gain" and "x2.gain" cannot be told apart'),
    ("window without readings", "window_s = 0.25\nhop_s = 0.05", "window_s = 0.003\nhop_s = 0.003",
     "estimator.window_s", "at least"),
    ("driver that does not exist", 'driver = "modbus"', 'driver = "modbos"', "source[0].driver", "modbos"),
]  # fmt: skip
FAULT_NAMES = [fault[0] for fault in CONFIG_FAULTS]


def broken(place: Place, old: str, new: str) -> Path:
    """Write the configuration with the first place of `old` (a gain: every place) replaced."""
    text = re.sub(r"(?m) +#.*$", "", place.config.read_text(encoding="utf-8"))
    assert old in text
    path = place.folder / "broken.toml"
    path.write_text(text.replace(old, new, -1 if "gain" in new else 1), encoding="utf-8")
    return path


@pytest.mark.parametrize(("old", "new", "path", "words"), [f[1:] for f in CONFIG_FAULTS], ids=FAULT_NAMES)
@pytest.mark.parametrize("command", ["replay", "run", "check"])
def test_faulty_configuration_is_exit_2_with_key_path_and_no_row_changes(
    command: str, old: str, new: str, path: str, words: str, place: Place, deltak: Run
) -> None:
    config = str(broken(place, old, new))
    extra = {
        "replay": [str(place.recording), "--db", str(place.db)],
        "run": ["--db", str(place.db)],
        "check": [],
    }
    code, out, err = deltak(command, config, *extra[command])
    assert code == 2, err
    lines = [line for line in err.splitlines() if line.startswith(f"deltak: error: {path}")]
    assert lines, err
    assert any(words in line for line in lines), lines
    assert "Traceback" not in err
    assert place.unchanged()
    if command != "check":
        assert out == ""


def test_unobservable_states_name_what_to_measure(place: Place, deltak: Run) -> None:
    """Velocities alone do not show where a mass on a damper only is."""
    text = place.config.read_text(encoding="utf-8").replace(
        'quantity = "displacement"', 'quantity = "velocity"'
    )
    text = text.replace('unit = "m"', 'unit = "m/s"')
    text = text[: text.index("spring = ")] + "spring = []\n" + text[text.index("damper = ") :]
    alarms = text.index("[[alarm]]")
    text = text[:alarms] + text[text.index("[[source]]") :]
    config = place.folder / "free.toml"
    config.write_text(text, encoding="utf-8")
    code, _, err = deltak("replay", str(config), str(place.recording), "--db", str(place.db))
    assert code == 2
    assert (
        "no channel shows the displacement of m1 and displacement of m2; "
        "measure the displacement of m1 and m2" in err
    )
    assert place.unchanged()


SERVO = """
[rig]
name = "servo"
sample_rate_hz = 1000.0
clock = "uniform"
[model]
kind = "mass-spring-damper"
mass = [{ name = "M", value = 95.0 }]
damper = [{ name = "Fv", between = ["ground", "M"], nominal = 200.0 }]
friction = [{ name = "Fc", between = ["ground", "M"], nominal = 20.0 }]
[[channel]]
name = "force"
quantity = "force"
at = "M"
unit = "N"
[[channel]]
name = "x1"
quantity = "velocity"
at = "M"
unit = "m/s"
[estimator]
window_s = 0.25
hop_s = 0.05
estimate = ["M", "Fv", "Fc"]
[store]
path = "servo.db"
"""


def test_free_mass_with_dry_friction_of_which_only_the_speed_is_measured_names_what_to_measure(
    place: Place, deltak: Run
) -> None:
    config = place.folder / "servo.toml"
    config.write_text(SERVO, encoding="utf-8")
    for arguments in (["replay", str(config)], ["check", str(config), "--recording"]):
        code, _, err = deltak(*arguments, str(place.recording))
        assert code == 2, err
        assert "no channel shows the displacement of M; measure the displacement of M" in err


RUBBISH = bytes(np.random.default_rng(1).integers(0, 256, 5000, dtype=np.uint8))
RECORDINGS: list[tuple[str, Callable[[Path], Path], str]] = [
    ("missing", lambda folder: folder / "nowhere.csv", "nowhere.csv"),
    ("empty", lambda folder: csv(folder / "empty.csv", [], header=""), "empty"),
    (
        "without header",
        lambda folder: csv(folder / "plain.csv", samples(), header=""),
        "the first line must name the columns",
    ),
    (
        "without a channel",
        lambda folder: csv(folder / "short.csv", samples(), header="t,force,x1,other"),
        "x2",
    ),
    ("binary rubbish", lambda folder: _bytes(folder / "rubbish.csv", RUBBISH), "rubbish.csv"),
    ("rubbish as npz", lambda folder: _bytes(folder / "rubbish.npz", RUBBISH), "rubbish.npz"),
    ("folder", lambda folder: folder, ""),
]


def _bytes(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


@pytest.mark.parametrize(("make", "words"), [r[1:] for r in RECORDINGS], ids=[r[0] for r in RECORDINGS])
@pytest.mark.parametrize("command", ["replay", "check"])
def test_unusable_recording_is_exit_2_and_no_row_changes(
    command: str, make: Callable[[Path], Path], words: str, place: Place, deltak: Run
) -> None:
    recording = str(make(place.folder))
    extra = [recording, "--db", str(place.db)] if command == "replay" else ["--recording", recording]
    code, out, err = deltak(command, str(place.config), *extra)
    assert code == 2, err
    assert words in err
    assert err.startswith("deltak: error: ")
    assert "Traceback" not in err
    assert out == ""
    assert place.unchanged()


def replayed(place: Place, lines: list[list[float]] | list[str], deltak: Run) -> dict[str, Any]:
    """Replay lines; return the document's ledger once the database has the same, and one run more."""
    code, out, err = deltak(
        "replay",
        str(place.config),
        str(csv(place.folder / "odd.csv", lines)),
        "--db",
        str(place.db),
        "--json",
    )
    assert code == 0, err
    found: dict[str, Any] = json.loads(out)["samples"]
    stored = rows(place.db, "SELECT received, used, rejected, gaps FROM v_health")
    assert rows(place.db, "SELECT count(*) FROM v_runs") == [(2,)]
    assert (found["received"], found["used"], sum(found["rejected"].values()), found["gaps"]) in stored
    return found


def test_recording_with_nan_and_text_in_cells_counts_them_and_goes_on(place: Place, deltak: Run) -> None:
    lines = [",".join(map(str, row)) for row in samples()]
    lines[100] = "0.1,nan,0.001,0.001"
    lines[150] = "0.15,0.5,broken,0.001"
    lines[200] = "0.2,0.5,,0.001"
    found = replayed(place, lines, deltak)
    assert found == {"received": 400, "used": 397, "rejected": {"missing value": 3}, "dropped": {}, "gaps": 3}


def test_recording_with_time_running_backwards_refuses_those_samples(place: Place, deltak: Run) -> None:
    lines = samples()
    lines[300][0] = 0.1
    lines[301][0] = 0.1
    found = replayed(place, lines, deltak)
    assert (found["received"], found["used"], found["gaps"]) == (400, 398, 1)
    assert found["rejected"] == {"backwards": 2}


def test_recording_of_time_that_only_runs_backwards_is_refused_and_its_ledger_kept(
    place: Place, deltak: Run
) -> None:
    path = csv(place.folder / "odd.csv", samples(50)[::-1])
    code, _, err = deltak("replay", str(place.config), str(path), "--db", str(place.db), "--json")
    assert code == 2
    assert "its times run backwards from row to row; sort the rows by time" in err
    assert (50, 1, 49, 0) in rows(place.db, "SELECT received, used, rejected, gaps FROM v_health")


def _foreign(path: Path) -> None:
    with closing(sqlite3.connect(path)) as database:
        database.execute("CREATE TABLE theirs (a)")
        database.execute("INSERT INTO theirs VALUES (1)")
        database.commit()


def _newer(path: Path) -> None:
    with closing(sqlite3.connect(path)) as database:
        database.execute(f"PRAGMA user_version = {version_mark(SCHEMA_VERSION + 1)}")
        database.commit()


def _text(path: Path) -> None:
    path.write_text("this is no database\n" * 200, encoding="utf-8")


DATABASES = [("foreign", _foreign, True), ("newer", _newer, False), ("text", _text, True)]


@pytest.mark.parametrize(("spoil", "fresh"), [d[1:] for d in DATABASES], ids=[d[0] for d in DATABASES])
@pytest.mark.parametrize("command", ["replay", "run", "estimates"])
def test_database_that_is_not_ours_or_newer_is_exit_3_and_untouched(
    command: str, spoil: Callable[[Path], None], fresh: bool, place: Place, deltak: Run
) -> None:
    db = place.folder / "theirs.db" if fresh else place.db
    spoil(db)
    content = db.read_bytes()
    arguments = {
        "replay": ["replay", str(place.config), str(place.recording), "--db", str(db)],
        "run": ["run", str(place.config), "--db", str(db), "--duration", "1"],
        "estimates": ["estimates", str(db)],
    }
    code, out, err = deltak(*arguments[command])
    assert code == 3, err
    assert err.startswith(f"deltak: error: {db}: ")
    assert out == ""
    assert db.read_bytes() == content


def test_missing_database_is_exit_3_and_is_not_made(place: Place, deltak: Run) -> None:
    code, _, err = deltak("estimates", str(place.folder / "nowhere.db"))
    assert code == 3
    assert "there is no such database" in err
    assert not (place.folder / "nowhere.db").exists()


def test_second_agent_or_replay_on_the_same_file_is_exit_3(place: Place, deltak: Run) -> None:
    text, db = place.config.read_text(encoding="utf-8"), place.folder / "shared.db"
    with (
        simulator(place.folder, text, "--scenario", "steady") as device,
        agent(device.config, options=["--db", str(db)]) as running,
    ):
        wait_until(lambda: hops(db) >= 2, "two rows")
        runs = rows(db, "SELECT * FROM v_runs")
        for arguments in (["run", str(place.config)], ["replay", str(place.config), str(place.recording)]):
            code, _, err = deltak(*arguments, "--db", str(db))
            assert code == 3, err
            assert str(db) in err
        assert rows(db, "SELECT * FROM v_runs") == runs
        assert running.document()["samples"]["used"] > 0


@pytest.fixture
def deaf() -> Iterator[int]:
    """A port that accepts and never answers."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server.getsockname()[1]


def test_port_that_refuses_or_never_answers_keeps_the_agent_trying(place: Place, deaf: int) -> None:
    text = place.config.read_text(encoding="utf-8")
    port = next(line for line in text.splitlines() if line.startswith("port = "))
    alarms = "SELECT kind, parameter, state FROM v_alarms"
    for number in (free_port(), deaf):
        config, db = place.folder / f"{number}.toml", place.folder / f"{number}.db"
        config.write_text(text.replace(port, f"port = {number}"), encoding="utf-8")
        with agent(config, options=["--db", str(db)]) as running:
            wait_until(
                lambda db=db: rows(db, alarms) == [("source", "modbus", "UNACK")], "a source alarm", LIMIT_S
            )
            document = running.document()
        assert document["samples"] == {"received": 0, "used": 0, "rejected": {}, "dropped": {}, "gaps": 0}
        assert rows(db, "SELECT count(*) FROM v_estimates") == [(0,)]


def test_check_probe_of_a_device_that_is_not_there_names_the_source(place: Place, deltak: Run) -> None:
    code, _, err = deltak("check", str(place.config), "--probe")
    assert code == 4
    assert "modbus: 127.0.0.1:" in err
    assert "Connection refused" in err
