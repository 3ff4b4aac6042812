"""Signals by the hundred make no threads and are one more request."""

import logging
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from agent.runtime.process.requests import Request
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


@contextmanager
def handled(request: Request) -> Iterator[None]:
    previous = signal.signal(signal.SIGHUP, request)
    try:
        yield
    finally:
        signal.signal(signal.SIGHUP, previous)
        request.end()


def test_storm_of_signals_while_one_is_acted_upon_is_one_more_request_and_no_thread() -> None:
    act = Act()
    with handled(Request(act, "reload")):
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


def test_failure_is_logged_and_the_next_signal_is_acted_upon(caplog: pytest.LogCaptureFixture) -> None:
    act = Act()
    act.fails = True
    act.goes_on.set()
    with handled(Request(act, "reload")), caplog.at_level(logging.ERROR):
        for count in (1, 2):
            signal.raise_signal(signal.SIGHUP)
            wait_until(lambda n=count: act.done == n, "the signal to be acted upon")
    assert "reload: PermissionError" in caplog.text
