"""Computing that goes on when there is no time any more is broken off, and nothing else is."""

import threading
import time

from agent.runtime.process.deadline import Deadline


def spin() -> None:
    until = time.monotonic() + 20.0
    while time.monotonic() < until:
        pass


def test_what_is_computed_at_the_deadline_is_broken_off_and_no_more_is_begun() -> None:
    deadline, begun = Deadline(), time.monotonic()
    deadline.in_s(0.2)
    assert not deadline.within(spin)
    assert time.monotonic() - begun < 5.0
    assert not deadline.within(lambda: 1 / 0)


def test_containment_of_failures_does_not_keep_what_is_overdue() -> None:
    def contained() -> None:
        try:
            spin()
        except Exception:  # noqa: BLE001 - as the pipeline contains what one window leads to
            spin()

    deadline = Deadline()
    deadline.in_s(0.1)
    assert not deadline.within(contained)


def test_deadline_between_two_computations_breaks_off_neither() -> None:
    deadline, done = Deadline(), []
    assert deadline.within(lambda: done.append(1))
    deadline.in_s(0.0)
    until = time.monotonic() + 5.0
    while not deadline.over and time.monotonic() < until:
        threading.Event().wait(0.001)
    assert done == [1]
    assert deadline.over


def test_deadline_at_any_instant_of_short_computations_stays_inside_them() -> None:
    for _ in range(100):
        deadline = Deadline()
        timer = threading.Thread(target=deadline._end)
        timer.start()
        while deadline.within(lambda: sum(range(200))):
            pass
        timer.join()  # an exception outside of a computation would have ended the test
        assert deadline.over
        assert not deadline.within(lambda: 1 / 0)
