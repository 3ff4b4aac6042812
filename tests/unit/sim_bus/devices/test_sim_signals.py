"""Signals that end the simulator, whatever it is doing when they come."""

import signal

import pytest

from sim_bus.commands import _stopped_by_signals


@pytest.mark.timeout(20)
def test_signal_that_comes_while_the_lock_of_the_wait_is_held_ends_the_wait() -> None:
    noted: list[int] = []
    with _stopped_by_signals(noted) as stop:
        with stop._cond:  # type: ignore[attr-defined]
            signal.raise_signal(signal.SIGTERM)
        assert stop.wait(10)
    assert noted == [signal.SIGTERM]
