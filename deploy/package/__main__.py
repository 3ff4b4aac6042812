"""python -m deploy.package DIST: everything that is handed out of the last commit, into a folder."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from deploy.package import bill, deb, manual, release, source


def make(work: Path, to: Path, epoch: int) -> Iterator[Path]:
    """Make all of it of the files in work/tree; yield each file as it is there."""
    tree, environment = work / "tree", work / "environment"
    built = source.build(tree, to, epoch)
    yield built.wheel
    yield built.sdist
    version = release.version_of(built.wheel)
    release.lay(environment, built.wheel, tree / "deploy/requirements.lock", epoch)
    bill.write(environment, tree / "pyproject.toml", version, to / "sbom.cdx.json", epoch)
    yield to / "sbom.cdx.json"
    # by the environment itself, so that the page is of what is packed
    words = ["-m", "deploy.package.manual", str(work / "manual"), str(epoch)]
    subprocess.run([str(environment / "bin/python"), "-B", *words], cwd=tree, check=True)
    yield Path(work / "manual" / manual.PAGE).rename(to / "deltak.1")
    yield deb.pack(work, to, version, epoch)


def main(to: Path) -> None:
    """Make everything of the last commit."""
    os.umask(0o022)  # what is packed is for everybody to read
    to.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="deltak-package") as name:
        work = Path(name)
        source.clean_tree(work / "tree")
        for file in make(work, to, source.epoch_of()):
            sys.stdout.write(f"{file}\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
