"""Imports without the search for garbage: they make none, and it takes a seventh of their time."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager

from agent.cli.terminal.class_methods import fast_methods


@contextmanager
def fast_import() -> Iterator[None]:
    """Look for no garbage inside, nor ever among what was made there; define dataclasses quickly."""
    gc.disable()
    try:
        with fast_methods():
            yield
    finally:
        gc.freeze()
        gc.enable()
