"""Which configurations and databases an upgrade concerns: those named, else those of the services."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

CONFIGURATIONS = Path("/etc/deltak")
DATABASES = Path("/var/lib/deltak")


@dataclass(frozen=True, slots=True)
class Places:
    """Configurations by agent (each a file, or a folder of files that one agent runs on), and databases."""

    configs: tuple[Path, ...]
    databases: tuple[Path, ...]


def places_of(named: Sequence[Path]) -> Places:
    """Return what paths name (*.toml and folders are configurations); without any what the services have."""
    if not named:
        return _of_services()
    configs = tuple(path for path in named if path.suffix == ".toml" or path.is_dir())
    return Places(configs, tuple(path for path in named if path not in configs))


def _of_services() -> Places:
    folder = CONFIGURATIONS / "conf.d"
    shared = (folder,) if any(folder.glob("*.toml")) else ()
    return Places((*shared, *sorted(CONFIGURATIONS.glob("*.toml"))), tuple(sorted(DATABASES.glob("*.db"))))
