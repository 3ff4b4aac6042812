"""A live run and the replay of the same samples with the live labels give the same rows."""

import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import can
import cantools
import numpy as np
import pytest

from agent.config import load
from agent.runtime import replay
from agent.runtime.reestimation.reestimate import Wanted, reestimate
from agent.runtime.service import Service
from agent.types import FloatArray
from tests.replay.archives import Here
from tests.scenario.live import example, hops, rows, wait_until
from tests.sim.rigs import Simulator, simulator

STEPS = (1e-3, 2e-6, 2e-6)
EXACT = "t_ns, parameter, status, reason, n_used, n_missing, window_s, method, reference"
NUMBERS = "value, sd, lower, upper, held, held_age_s"


@dataclass(frozen=True)
class Live:
    """What a live run stored, and the samples that its device played as the wire carried them."""

    config: Path
    db: Path
    samples: FloatArray


@contextmanager
def service(config: Path, db: Path) -> Iterator[Service]:
    """Run the agent's service in a thread of this process."""
    running = Service([load(config)], db, "live")
    thread = threading.Thread(target=running.run, args=(None,))
    thread.start()
    try:
        yield running
    finally:
        running.stop()
        thread.join(30.0)
        assert not thread.is_alive()


@pytest.fixture(scope="module", params=["modbus", "can", "serial"])
def live(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Live:
    folder = tmp_path_factory.mktemp("live")
    example(request.param, folder)
    text = (folder / f"{request.param}.toml").read_text(encoding="utf-8")
    text = text.replace(f'driver = "{request.param}"', f'driver = "{request.param}"\nrecord = true')
    with simulator(folder, text, "--scenario", "default", "--fast") as device:
        with service(device.config, folder / "live.db"):
            wait_until(lambda: hops(folder / "live.db") == 60, "60 rows")
        assert device.stop() == 0
    return Live(device.config, folder / "live.db", _on_the_wire(device))


def _on_the_wire(device: Simulator) -> FloatArray:
    readings = device.truth()["readings"]
    steps = np.array(STEPS)
    return np.asarray(np.round(readings / steps) * steps)


def _recording(live: Live, folder: Path) -> Path:
    """Write the samples with the labels of the live run, which its rows tell."""
    first = rows(live.db, "SELECT min(t_ns) FROM v_estimates")[0][0]
    path = folder / "same.csv"
    with path.open("w", encoding="utf-8") as file:
        file.write("t,force,x1,x2\n")
        for index, values in enumerate(live.samples.tolist()):
            t_ns = first + (index - 49) * 1_000_000
            file.write(f"{t_ns // 10**9}.{t_ns % 10**9:09d},{','.join(map(repr, values))}\n")
    return path


def _replayed(live: Live, folder: Path) -> tuple[Path, dict[str, Any]]:
    db = folder / "replay.db"
    return db, replay.replay(config=live.config, recordings=[_recording(live, folder)], db=db)


@pytest.fixture(scope="module")
def replayed(live: Live) -> tuple[Path, dict[str, Any]]:
    """The database and the document of one replay of the live samples."""
    return _replayed(live, live.db.parent)


def _estimates(db: Path, columns: str) -> list[tuple[Any, ...]]:
    return rows(db, f"SELECT {columns} FROM v_estimates ORDER BY t_ns, parameter")


def test_replay_of_live_samples_gives_the_same_times_statuses_and_reasons(
    live: Live, replayed: tuple[Path, dict[str, Any]]
) -> None:
    db, document = replayed
    assert document["samples"] == {"received": 3000, "used": 3000, "rejected": {}, "dropped": {}, "gaps": 0}
    assert len(_estimates(db, EXACT)) == 240
    assert _estimates(db, EXACT) == _estimates(live.db, EXACT)


def test_replay_of_live_samples_gives_values_within_a_billionth_of_their_sd(
    live: Live, replayed: tuple[Path, dict[str, Any]]
) -> None:
    db, _ = replayed
    ours, theirs = (np.array(_estimates(name, NUMBERS), dtype=float) for name in (db, live.db))
    np.testing.assert_array_equal(np.isnan(ours), np.isnan(theirs))
    sd = np.nan_to_num(theirs[:, 1:2], nan=np.inf)
    off = np.nan_to_num(np.abs(ours - theirs))
    assert (off <= 1e-9 * sd)[:, :5].all(), (off / sd).max()
    assert off[:, 5].max() <= 1e-9


def test_replay_of_live_samples_raises_and_clears_the_same_alarms(
    live: Live, replayed: tuple[Path, dict[str, Any]]
) -> None:
    columns = "kind, parameter, priority, state, raised_at, cleared_at, limit_value"
    db, _ = replayed
    query = f"SELECT {columns} FROM v_alarms WHERE kind = 'level' ORDER BY id"
    assert rows(db, query) == rows(live.db, query)
    assert len(rows(db, query)) == 6


def test_two_replays_agree_to_the_last_bit(
    live: Live, replayed: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    first, _ = replayed
    second, _ = _replayed(live, tmp_path)
    assert _estimates(first, f"{EXACT}, {NUMBERS}") == _estimates(second, f"{EXACT}, {NUMBERS}")


def _recordings(live: Live) -> list[Path]:
    return sorted(
        path for path in live.db.with_name("live.db.raw").iterdir() if path.suffix in {".raw", ".log"}
    )


def test_raw_recording_of_a_live_run_replays_to_the_same_rows_to_the_last_bit(
    live: Live, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("agent.runtime.reestimation.pools.LocalPool", Here)
    alarms = (
        "SELECT kind, parameter, state, raised_at, cleared_at, delta, sd FROM v_alarms WHERE kind = 'level'"
    )
    for name in ("one.db", "two.db"):
        if name == "one.db":
            document = replay.replay(config=live.config, recordings=_recordings(live), db=tmp_path / name)
        else:  # in parts of a second, each begun where the one before ended, indexes among the recordings
            folder = live.db.with_name("live.db.raw")
            wanted = Wanted([folder], [live.config], str(tmp_path / name), workers=1, hour_ns=1_000_000_000)
            found = reestimate(wanted, lambda _: None)
            assert found["parts"] >= 2
            (document,) = found["runs"]
        assert document["samples"] == {
            "received": 3000,
            "used": 3000,
            "rejected": {},
            "dropped": {},
            "gaps": 0,
        }
        assert _estimates(tmp_path / name, f"{EXACT}, {NUMBERS}") == _estimates(
            live.db, f"{EXACT}, {NUMBERS}"
        )
        assert rows(tmp_path / name, alarms) == rows(live.db, alarms)


def test_recording_has_the_form_that_other_tools_read_where_there_is_one(live: Live) -> None:
    on_can = 'driver = "can"' in live.config.read_text(encoding="utf-8")
    assert [path.suffix for path in _recordings(live)] == [".log" if on_can else ".raw"]


def test_recorded_log_is_converted_to_other_forms_by_python_can_and_replays_from_them(
    live: Live, tmp_path: Path
) -> None:
    (path,) = _recordings(live)
    if path.suffix != ".log":
        return
    convert = [sys.executable, "-m", "can.logconvert", str(path), str(tmp_path / "out.blf")]
    subprocess.run(convert, check=True, capture_output=True, timeout=60)
    document = replay.replay(config=live.config, recordings=[tmp_path / "out.blf"], db=None)
    assert document["samples"] == {"received": 3000, "used": 3000, "rejected": {}, "dropped": {}, "gaps": 0}


def test_recorded_log_alone_holds_every_reading_for_python_can_and_cantools(live: Live) -> None:
    (path,) = _recordings(live)
    if path.suffix != ".log":
        return
    message = cantools.database.load_file(live.config.with_name("two-mass-rig.dbc")).get_message_by_name(
        "RIG_SAMPLE"
    )
    with can.CanutilsLogReader(path) as frames:
        decoded = [
            message.decode(bytes(frame.data)) for frame in frames if frame.arbitration_id == message.frame_id
        ]
    got = np.array([[float(row[name]) for name in ("Force", "X1", "X2")] for row in decoded])  # type: ignore[arg-type]
    np.testing.assert_allclose(got, live.samples, rtol=0, atol=1e-12)
