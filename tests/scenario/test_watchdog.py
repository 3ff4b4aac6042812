"""Each thread of a running agent is watched by itself: where one hangs its progress stops, and no other's."""

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from agent.cli.app import app
from agent.cli.terminal.errors import guarded
from agent.config import load
from agent.runtime.process.heartbeats import Heartbeats
from agent.runtime.rig_set import RigSet
from agent.runtime.service import Service
from agent.storage.write.writer import StoreWriter
from tests.scenario.live import example, wait_until

pytestmark = pytest.mark.realtime


@pytest.fixture
def service(tmp_path: Path) -> Iterator[Service]:
    """An agent whose device is away; it tries again and again, which is progress."""
    running = Service([load(example("modbus", tmp_path))], tmp_path / "rig.db", "live")
    thread = threading.Thread(target=running.run, args=(None,))
    thread.start()
    wait_until(lambda: sum(found.alive for found in running.threads()) == 4, "four threads")
    yield running
    running.stop()
    thread.join(30.0)
    assert not thread.is_alive()


def stalled(service: Service) -> set[str]:
    """Return the threads that make no progress within four seconds, a minute to whoever watches."""
    heartbeats = Heartbeats(service.threads, 60.0, 15.0)
    pause, found = threading.Event(), [""]
    for tick in range(17):
        found = heartbeats.look(tick * 15_000_000_000)
        pause.wait(0.25)
    return {name.split()[0] for name in found}


def test_threads_that_hang_are_those_that_make_no_progress(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    release = threading.Event()

    def hanging(act: Callable[..., Any]) -> Callable[..., Any]:
        def hang(*args: Any, **options: Any) -> Any:
            release.wait(20.0)
            return act(*args, **options)

        return hang

    monkeypatch.setattr(RigSet, "take", hanging(RigSet.take))
    monkeypatch.setattr(StoreWriter, "_collect", hanging(StoreWriter._collect))
    try:
        assert stalled(service) == {"processing", "write"}  # and not those that read, or write event records
    finally:
        release.set()


def test_agent_that_does_not_run_is_said_with_exit_3(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert guarded(app, ["status", str(tmp_path / "press.db"), "--json"]) == 3
    out, err = capsys.readouterr()
    assert "press.db: no agent runs on it; start it" in err
    assert '"errors"' in out
    assert guarded(app, ["reload", str(tmp_path / "press.db")]) == 3
