"""Processes of this machine that compute parts, and may die at any moment."""

import os
import signal
import threading
import time
from concurrent.futures import wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from pathlib import Path

import pytest

from agent.errors import StoreError
from agent.runtime.reestimation.pools import LocalPool

LONG = 300_000_000
"""Bytes of an answer that takes a while to give."""


def doubled(value: bytes) -> bytes:
    """Compute something, in a process of the pool."""
    return 2 * value


def refused(_value: bytes) -> bytes:
    """Raise something, in a process of the pool."""
    raise ValueError("no")


def dies_while_it_answers() -> bytes:
    """Return a long answer from a process that is killed while it gives it."""

    def kill() -> None:
        time.sleep(0.3)  # while it gives the answer, here; before or after it elsewhere
        os.kill(os.getpid(), signal.SIGKILL)

    threading.Thread(target=kill).start()
    return bytes(LONG)


def test_local_pool_gives_answers_and_errors_and_leaves_no_file() -> None:
    with closing(LocalPool(2)) as pool:
        folder = Path(pool._folder.name)
        assert pool.submit(doubled, b"ab").result(timeout=60) == b"abab"
        with pytest.raises(ValueError, match="no"):
            pool.submit(refused, b"").result(timeout=60)
        assert list(folder.iterdir()) == []
    assert not folder.exists()


def test_local_pool_says_where_no_answer_can_be_left() -> None:
    with closing(LocalPool(1)) as pool:
        Path(pool._folder.name).rmdir()
        with pytest.raises(StoreError, match="TMPDIR"):
            pool.submit(doubled, b"ab").result(timeout=60)


def test_local_pool_tells_of_a_process_that_dies_while_it_answers() -> None:
    with closing(LocalPool(2)) as pool:
        pool.submit(doubled, b"").result(timeout=60)
        future = pool.submit(dies_while_it_answers)
        assert not wait([future], timeout=60).not_done
        assert future.exception() is None or isinstance(future.exception(), BrokenProcessPool)
        pool.renew()
        assert pool.submit(doubled, b"ab").result(timeout=60) == b"abab"
