"""The files of event records: what they hold, and how they come and go so that a power cut leaves whole ones.

A rig with one source keeps one NPZ file an event, "RIG-NNNNNNNN-KIND-PARAMETER.npz", that `deltak replay`
reads like any recording: `t` (datetime64, the time stamps of the live run) and an array of raw readings for
each channel; beside them `index` (the sample's number), `counter` where the device counts, `meta`, a JSON
text with the provenance, and `state` (see `states`), from which `deltak explain` computes the alarms in it
again. A rig with several sources keeps a raw recording (see `blocks`) for each,
"RIG-NNNNNNNN-KIND-PARAMETER.SOURCE.raw", which are replayed together, and
"RIG-NNNNNNNN-KIND-PARAMETER.state.npz" with the state.
"""

import io
import json
import os
import re
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from agent.recording.blocks import encode_block, encode_header
from agent.recording.folder import make_folder
from agent.recording.header import RawHeader
from agent.storage.database.files import created, sync_folder
from agent.types import FloatArray, IntArray
from drivers.port import SampleBlock

FORMAT = "DELTAKEVENT1"
META = (
    "rig", "t_ns", "kind", "parameter", "alarms", "from_ns", "to_ns", "samples", "state", "baseline_id",
    "message",
)  # fmt: skip
"""What `meta` holds of the record; beside it config_sha256 and code_version."""
_PART = ".part"


class Taken(NamedTuple):
    """A block as the pipeline took it: its rows' numbers, which were taken, and how far the rig had come.

    serial counts blocks; round is that in which it was computed.
    """

    source: str
    block: SampleBlock
    number: IntArray
    kept: np.ndarray[tuple[int], np.dtype[np.bool_]]
    moment: int
    serial: int = 0
    round: int = 0


class Labels(NamedTuple):
    """Time stamps (n,) of sample numbers (n,), ns."""

    number: IntArray
    t_ns: IntArray


class Table(NamedTuple):
    """Samples of a source in order: numbers (n,), time stamps (n,), readings (n, m), counter (n,) or None."""

    number: IntArray
    t_ns: IntArray
    values: FloatArray
    counter: IntArray | None


def table_of(items: Sequence[Taken], labels: Sequence[Labels], span: tuple[int, int]) -> Table:
    """Return the samples of one source that were taken, lie within the span, and have a time stamp."""
    number = _joined([item.number[item.kept] for item in items])
    known, stamps = _joined([label.number for label in labels]), _joined([label.t_ns for label in labels])
    order = np.argsort(known, kind="stable")
    known, stamps = known[order], stamps[order]
    place = np.searchsorted(known, number)
    found = np.isin(number, known) & (number >= span[0]) & (number <= span[1])
    values = np.concatenate([item.block.values[item.kept] for item in items] or [np.zeros((0, 0))])
    counters = [item.block.counter[item.kept] for item in items if item.block.counter is not None]
    counter = _joined(counters)[found] if counters and len(counters) == len(items) else None
    return Table(number[found], stamps[place[found]], values[found], counter)


def _joined(parts: Sequence[IntArray]) -> IntArray:
    return np.concatenate([np.zeros(0, np.int64), *parts])


def npz_bytes(table: Table, channels: Sequence[str], meta: Mapping[str, Any], state: bytes = b"") -> bytes:
    """Return an NPZ file that `deltak replay` reads; state: what was known before its samples."""
    arrays: dict[str, Any] = {"t": table.t_ns.astype("datetime64[ns]")}
    # a source that never came has no readings, nor a width of them
    values = table.values if len(table.t_ns) else np.zeros((0, len(channels)))
    arrays |= {name: values[:, place] for place, name in enumerate(channels)}
    own = {"index": table.number} | ({} if table.counter is None else {"counter": table.counter})
    if state:
        own["state"] = np.frombuffer(state, np.uint8)
    own["meta"] = np.array(json.dumps({"format": FORMAT, **meta}))
    # a channel may have any name; the file's own arrays give way
    arrays |= {name if name not in arrays else f"deltak.{name}": array for name, array in own.items()}
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


def state_name(name: str) -> str:
    """Return the name of the file with the state, given the name of a record of several sources."""
    return name.replace(".*.raw", ".state.npz")


def alone(state: bytes) -> bytes:
    """Return an NPZ file with the state of a record of several sources, and all that they delivered since."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, state=np.frombuffer(state, np.uint8))
    return buffer.getvalue()


def raw_bytes(header: RawHeader, items: Sequence[Taken]) -> bytes:
    """Return the blocks of one source as a raw recording."""
    return encode_header(header) + b"".join(encode_block(item.block) for item in items)


def read_meta(path: Path) -> dict[str, Any]:
    """Return the provenance that an NPZ file of an event holds; empty when it holds none."""
    try:
        # opened here: numpy leaves a file that it cannot read open
        with path.open("rb") as octets, np.load(octets, allow_pickle=False) as file:
            name = "deltak.meta" if "deltak.meta" in file.files else "meta"
            meta = json.loads(str(file[name]))
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error):
        return {}
    whole = isinstance(meta, dict) and meta.get("format") == FORMAT and set(META) <= meta.keys()
    return meta if whole else {}


class EventFolder:
    """The event records of one rig: groups of files with a number each, bounded in number, size and age.

    Args:
        folder: where they lie, beside the database; made when the first is written.
        rig: whose they are.
    """

    def __init__(self, folder: Path, rig: str) -> None:
        self.folder = folder
        self._pattern = re.compile(rf"{re.escape(rig)}-(\d{{8}})-.*\.(npz|raw)")

    def groups(self) -> dict[int, list[Path]]:
        """Return the files by number, oldest first."""
        found: dict[int, list[Path]] = {}
        for path in sorted(self.folder.iterdir()) if self.folder.is_dir() else []:
            number = self.number(path.name)
            if number is not None:
                found.setdefault(number, []).append(path)
        return dict(sorted(found.items()))

    def number(self, name: str) -> int | None:
        """Return the number in a file's name; None when it is no record of this rig."""
        match = self._pattern.fullmatch(name)
        return None if match is None else int(match[1])

    def clean(self) -> None:
        """Remove what a power cut left half written."""
        for path in self.folder.glob(f"*{_PART}") if self.folder.is_dir() else []:
            path.unlink(missing_ok=True)

    def write(self, name: str, content: bytes) -> None:
        """Write a file so that it is there whole, and on the disk, or not at all. Raises OSError."""
        make_folder(self.folder)
        part = self.folder / (name + _PART)
        part.unlink(missing_ok=True)
        try:
            with created(part) as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            part.rename(self.folder / name)
        except OSError:
            part.unlink(missing_ok=True)
            raise
        sync_folder(self.folder)
