"""python-can without what it imports beside itself: its MF4 reader takes asammdf, and that pandas, 80 MB in all."""

import importlib
import sys

MEASUREMENTS = "asammdf"


def import_lean() -> None:
    """Import python-can, which cantools imports as well, as where asammdf is not installed."""
    if "can" in sys.modules or MEASUREMENTS in sys.modules:
        return
    sys.modules[MEASUREMENTS] = None  # type: ignore[assignment]  # which makes importing it an ImportError
    try:
        importlib.import_module("can")
    finally:
        del sys.modules[MEASUREMENTS]


def import_measurements() -> None:
    """Let python-can's MF4 reader have asammdf, where that is installed."""
    known = MEASUREMENTS in sys.modules
    reader = importlib.import_module("can.io.mf4")
    if not known and reader.asammdf is None:
        # the classes that python-can hands out find it in the same module
        importlib.reload(reader)
