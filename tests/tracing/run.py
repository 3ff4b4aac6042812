"""A test run's part of the watch on writes: where the processes report, and what becomes of the run."""

import os
import re
import tempfile
from pathlib import Path

from tests.tracing import watch

FOLDER = str(Path(__file__).parent)


def begin() -> Path:
    """Watch this process and all that it starts; return the file of their reports."""
    number, name = tempfile.mkstemp(prefix="deltak-writes-")
    os.close(number)
    os.environ[watch.REPORT] = name
    paths = [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path and path != FOLDER]
    os.environ["PYTHONPATH"] = os.pathsep.join([FOLDER, *paths])
    watch.install()
    return Path(name)


def end(report: Path) -> tuple[int, list[str]]:
    """Return how many permitted writes of drivers were seen, and the forbidden ones in words."""
    lines = report.read_text(encoding="utf-8").splitlines()
    report.unlink()
    counts = [re.fullmatch(r"permitted (\d+)", line) for line in lines]
    seen = watch.permitted.total() + sum(int(match[1]) for match in counts if match)
    return seen, [line for line, match in zip(lines, counts, strict=True) if not match]
