"""Imports without the search for garbage: they make none, and it takes a seventh of their time."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def fast_import() -> Iterator[None]:
    """Look for no garbage inside, nor ever among what was made there."""
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()
