"""python-can without what it imports besides: its MF4 reader takes asammdf, and that pandas, 80 MB in all.

Its listeners for asyncio, of which we use none, take that and TLS: 2 MB of an agent.
"""

import importlib
import sys
from collections.abc import Callable
from contextlib import suppress
from types import ModuleType
from typing import Any

MEASUREMENTS = "asammdf"
_EVENT_LOOPS = "asyncio"


class _Later(ModuleType):
    """Stands for a module that is imported once something of it is used; annotations need only a name."""

    AbstractEventLoop = object

    def __getattr__(self, name: str) -> Any:
        return getattr(importlib.import_module(self.__name__), name)


def import_lean() -> None:
    """Import python-can, which cantools imports as well, as where asammdf is not installed."""
    if "can" in sys.modules or MEASUREMENTS in sys.modules:
        return
    sys.modules[MEASUREMENTS] = None  # type: ignore[assignment]  # which makes importing it an ImportError
    later = sys.modules.setdefault(_EVENT_LOOPS, _Later(_EVENT_LOOPS))
    try:
        importlib.import_module("can")
    finally:
        del sys.modules[MEASUREMENTS]
        if isinstance(later, _Later):
            del sys.modules[_EVENT_LOOPS]


def import_measurements() -> None:
    """Let python-can's MF4 reader have asammdf, where that is installed."""
    known = MEASUREMENTS in sys.modules
    reader = importlib.import_module("can.io.mf4")
    if not known and reader.asammdf is None:
        # the classes that python-can hands out find it in the same module
        importlib.reload(reader)
    if MEASUREMENTS in sys.modules:
        measurement = importlib.import_module("asammdf.blocks.mdf_v4").MDF4
        measurement.__del__ = _forgiving(measurement.close)


def _forgiving(close: Callable[[Any], None]) -> Callable[[Any], None]:
    """Return a destructor for files that could not be read too: what was not set up by then is not torn down.

    asammdf's own raises AttributeError there, which Python shows as a traceback.
    """

    def finish(measurement: Any) -> None:
        with suppress(AttributeError):
            close(measurement)

    return finish
