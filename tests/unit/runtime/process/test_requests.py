"""Signals by the hundred make no threads and are one more request."""

import logging
import signal
import threading
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from agent.runtime.process.requests import asked_by
from agent.runtime.workers import running
from tests.scenario.live import wait_until


class Act:
    """Something that takes until it is let go on."""

    def __init__(self) -> None:
        self.begun, self.done = 0, 0
        self.goes_on = threading.Event()
        self.fails = False

    def __call__(self) -> None:
        self.begun += 1
        self.goes_on.wait()
        self.done += 1
        if self.fails:
            raise PermissionError("planted")


def test_storm_of_signals_while_one_is_acted_upon_is_one_more_request_and_no_thread() -> None:
    act = Act()
    with asked_by(signal.SIGHUP, "reload") as request:
        request.begin(act)
        signal.raise_signal(signal.SIGHUP)
        wait_until(lambda: act.begun == 1, "the first")
        threads = threading.active_count()
        for _ in range(500):
            signal.raise_signal(signal.SIGHUP)
        assert threading.active_count() == threads
        act.goes_on.set()
        wait_until(lambda: act.done == 2, "the second")
        signal.raise_signal(signal.SIGHUP)
        wait_until(lambda: act.done == 3, "a later one")
    assert act.begun == 3


def test_signal_that_was_held_until_somebody_asks_for_it_is_the_first_request() -> None:
    act = Act()
    act.goes_on.set()
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGHUP})
    signal.raise_signal(signal.SIGHUP)
    with asked_by(signal.SIGHUP, "reload") as request:
        request.begin(act)
        wait_until(lambda: act.done == 1, "what was held")


def test_failure_is_logged_and_the_next_signal_is_acted_upon(caplog: pytest.LogCaptureFixture) -> None:
    act = Act()
    act.fails = True
    act.goes_on.set()
    with asked_by(signal.SIGHUP, "reload") as request, caplog.at_level(logging.ERROR):
        request.begin(act)
        for count in (1, 2):
            signal.raise_signal(signal.SIGHUP)
            wait_until(lambda n=count: act.done == n, "the signal to be acted upon")
    assert "reload: PermissionError" in caplog.text


def test_signal_that_comes_while_the_agent_starts_is_a_reload_once_it_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reloaded = threading.Event()

    def made(*_: Any) -> Any:
        signal.raise_signal(signal.SIGHUP)
        return SimpleNamespace(
            stop=None, reload=reloaded.set, lines=SimpleNamespace(kept=nullcontext), documents=lambda _: [{}],
            run=lambda _: wait_until(reloaded.is_set, "the reload"),
        )  # fmt: skip

    monkeypatch.setattr(running, "_service", made)
    monkeypatch.setattr("os.isatty", lambda _: False)
    rig = Path(__file__).parents[4] / "deploy/examples/modbus.toml"
    assert running.run(configs=[rig], db=tmp_path / "rig.db", duration_s=None) == {}
    assert reloaded.is_set()
