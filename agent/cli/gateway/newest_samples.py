"""The last minute of each source's raw recording, as files that `deltak replay` reads."""

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from agent.errors import RecordingError
from agent.recording import blocks
from agent.recording.setup import FOLDER

SPAN_S = 60.0
MOST_BYTES = 20_000_000
"""Of one file of text at most, from its end."""


def newest_samples(db: Path) -> Iterator[tuple[str, bytes]]:
    """Yield name and content of the newest minute of every source that is recorded; nothing where none is."""
    folder = db.with_name(db.name + FOLDER)
    newest: dict[str, Path] = {}
    for file in sorted(folder.glob("*")) if folder.is_dir() else ():
        if file.suffix in {blocks.SUFFIX, ".log"}:
            newest[file.name.rpartition("-")[0]] = file
    for file in newest.values():
        with suppress(OSError, RecordingError, ValueError):
            yield file.name, _blocks(file) if file.suffix == blocks.SUFFIX else _lines(file)


def _blocks(file: Path) -> bytes:
    kept = list(blocks.read_blocks(file))
    newest = kept[-1].arrival_ns if kept else 0
    with file.open("rb") as stream:
        header = blocks.read_header(stream, file)
    fresh = [block for block in kept if newest - block.arrival_ns <= SPAN_S * 1e9]
    return blocks.encode_header(header) + b"".join(map(blocks.encode_block, fresh))


def _lines(file: Path) -> bytes:
    """Return the last minute of a candump log: lines that begin with (seconds)."""
    with file.open("rb") as stream:
        stream.seek(max(0, file.stat().st_size - MOST_BYTES))
        lines = [line for line in stream.read().splitlines(keepends=True) if line.startswith(b"(")]
    until = _seconds(lines[-1]) if lines else 0.0
    return b"".join(line for line in lines if until - _seconds(line) <= SPAN_S)


def _seconds(line: bytes) -> float:
    return float(line[1 : line.index(b")")])
