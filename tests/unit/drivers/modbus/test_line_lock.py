import threading
from collections.abc import Callable

import numpy as np

from drivers.modbus.line_lock import LineLock


def until(condition: Callable[[], bool]) -> None:
    tick = threading.Event()
    for _ in range(4000):
        if condition():
            return
        tick.wait(0.005)
    raise AssertionError("the condition did not come true")


def test_turns_of_many_who_wait_come_by_their_deadlines(rng: np.random.Generator) -> None:
    line_lock, order = LineLock(), []
    deadlines = rng.permutation(40).tolist()

    def work(deadline: float) -> None:
        with line_lock.taken(deadline):
            order.append(deadline)

    threads = [threading.Thread(target=work, args=(deadline,)) for deadline in deadlines]
    with line_lock.taken(-1.0):
        for number, thread in enumerate(threads, 1):
            thread.start()
            until(lambda number=number: line_lock.waiting == number)  # type: ignore[misc]
    for thread in threads:
        thread.join()
    assert order == sorted(deadlines)


def test_turns_with_equal_deadlines_come_in_the_order_of_asking() -> None:
    line_lock, order = LineLock(), []

    def work(number: int) -> None:
        with line_lock.taken(5.0):
            order.append(number)

    threads = [threading.Thread(target=work, args=(number,)) for number in range(10)]
    with line_lock.taken(0.0):
        for number, thread in enumerate(threads, 1):
            thread.start()
            until(lambda number=number: line_lock.waiting == number)  # type: ignore[misc]
    for thread in threads:
        thread.join()
    assert order == list(range(10))


def test_turn_that_ends_in_an_error_is_given_on() -> None:
    line_lock = LineLock()
    for _ in range(2):
        try:
            with line_lock.taken(0.0):
                raise KeyError
        except KeyError:
            pass
    with line_lock.taken(0.0):
        assert line_lock.waiting == 0
