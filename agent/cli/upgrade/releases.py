"""Program versions side by side: HOME/releases/VERSION, and HOME/current, a link to the one that runs."""

import os
from pathlib import Path

from agent.errors import UsageError
from agent.storage.database.files import sync_folder

HOME = Path("/opt/deltak")


class Releases:
    """The versions under one folder.

    Args:
        home: the folder that holds `releases` and the link `current`.
    """

    def __init__(self, home: Path = HOME) -> None:
        self._home = home

    @property
    def current(self) -> str:
        """The version that the link leads to. Raises UsageError where there is none."""
        try:
            return (self._home / "current").readlink().name
        except OSError as error:
            advice = (
                "versions are switched where the package or `ln -s releases/VERSION current` laid them out"
            )
            raise UsageError.at(str(self._home / "current"), "is no link to a version", advice) from error

    def versions(self) -> list[str]:
        """Return the versions that are there."""
        return sorted(
            path.name for path in (self._home / "releases").glob("*") if self._command(path.name).exists()
        )

    def command(self, version: str) -> Path:
        """Return the program of a version. Raises UsageError where it is not there."""
        found = self._command(version)
        if "/" in version or not found.exists():
            there = ", ".join(self.versions()) or "none"
            raise UsageError.at(
                "--to", f"there is no version {version} in {self._home}", f"versions are {there}"
            )
        return found

    def switch(self, version: str) -> None:
        """Lead the link to a version, in one step that a power cut cannot tear."""
        fresh = self._home / "current.new"
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(Path("releases", version))
        os.replace(fresh, self._home / "current")  # noqa: PTH105 - Path.replace says the same of files only
        sync_folder(self._home)

    def _command(self, version: str) -> Path:
        return self._home / "releases" / version / "bin" / "deltak"
