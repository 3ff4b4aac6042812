"""Archives: which recordings lie there, and of which rig each is."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from agent.config import RigConfig, files_of, load
from agent.errors import Fault, RecordingError, UsageError
from agent.recording.folder import AGES
from agent.recording.source import header_of, is_own, source_of, without_indexes
from agent.runtime.replay import CAN_LOGS

TABLES: Final = (".csv", ".npz")
_BESIDE: Final = (AGES, ".part")


class Recorded(NamedTuple):
    """A rig as it is to be estimated, and its recordings in the order in which they are played."""

    rig: RigConfig
    paths: list[Path]


class Archive(NamedTuple):
    """What was found: rigs in the order of their names, and why other files are left out."""

    rigs: list[Recorded]
    faults: list[Fault]


def configured(paths: Sequence[Path]) -> list[RigConfig]:
    """Load configurations, or folders of them. Raises ConfigError; UsageError for two of one rig."""
    rigs = [load(path) for path in files_of(paths)]
    names = [rig.rig.name for rig in rigs]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise UsageError.at("--config", f'two are of the rig "{twice}"', "give one configuration a rig")
    return rigs


def gathered(places: Sequence[Path], rigs: Sequence[RigConfig]) -> Archive:
    """Find the recordings of files and folders, and the configuration of each.

    A configuration is for the rig of its name; the only one is for all rigs, under the names that they were
    recorded with. Files are played in the order of their names within a folder.
    """
    found: dict[str, Recorded] = {}
    faults: list[Fault] = []
    files = without_indexes([path for place in places for path in _files(place)])
    for path in dict.fromkeys(files):
        try:
            rig = _rig(path, rigs)
        except RecordingError as error:
            faults += error.faults
        else:
            found.setdefault(rig.rig.name, Recorded(rig, [])).paths.append(path)
    return Archive([found[name] for name in sorted(found)], faults)


def _files(place: Path) -> Iterator[Path]:
    """Yield a file, or those below a folder but for what lies beside recordings."""
    if not place.is_dir():
        yield place
        return
    for path in sorted(place.rglob("*")):
        is_meant = path.is_file() and not path.name.startswith(".")
        if is_meant and path.suffix not in _BESIDE:
            yield path


def _rig(path: Path, rigs: Sequence[RigConfig]) -> RigConfig:
    """Return the configuration for a recording, under its rig's name. Raises RecordingError."""
    if not path.exists():
        raise RecordingError.at(path, "no such file", "name a recording, or a folder of them")
    name = header_of(path).rig if is_own(path) else _unnamed(path)
    chosen = rigs if len(rigs) == 1 else [rig for rig in rigs if rig.rig.name == name]
    if not chosen:
        what = (
            f'is of the rig "{name}", which has no configuration'
            if name
            else "does not say of which rig it is"
        )
        raise RecordingError.at(path, what, "give its configuration by --config")
    rig = chosen[0]
    if name not in {"", rig.rig.name}:
        rig = rig.model_copy(update={"rig": rig.rig.model_copy(update={"name": name})})
    if is_own(path):
        source_of(rig, path)
    return rig


def _unnamed(path: Path) -> str:
    """Return no name: tables and logs of other tools have none. Raises RecordingError for what is neither."""
    if path.suffix.lower() in {*TABLES, *CAN_LOGS}:
        return ""
    advice = "an archive holds what `record = true` left, CSV or NPZ tables, or logs of CAN frames"
    raise RecordingError.at(path, "is no recording", advice)
