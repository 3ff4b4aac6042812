"""Golden outputs commit by commit: `python -m tests.golden.walk main~5..main` says at which commit one
changed.

Each commit is unpacked beside the others and plays its cases with its own code and entry points, but is held
against the outputs of the first.
"""

import os
import subprocess
import sys
import tarfile
import tempfile
import tomllib
from io import BytesIO
from pathlib import Path

from tests.peers import ROOT, data_folder


def main() -> int:
    """Walk a range of commits; return how many differ from the first."""
    span, *names = sys.argv[1:]
    first = span.partition("..")[0]
    commits = [first, *_git("rev-list", "--reverse", span).decode().split()]
    outputs = _git("archive", first, "tests/golden")
    return sum(not _same(commit, outputs, names) for commit in commits)


def _git(*arguments: str) -> bytes:
    return subprocess.run(["git", *arguments], cwd=ROOT, check=True, capture_output=True).stdout


def _same(commit: str, outputs: bytes, names: list[str]) -> bool:
    with tempfile.TemporaryDirectory() as folder:
        _unpack(_git("archive", commit), folder)
        for file in Path(folder, "tests", "golden").glob("*/*.txt"):
            file.unlink()
        _unpack(outputs, folder, only=".txt")
        _declare(Path(folder))
        chosen = ["-k", f"golden_one and ({' or '.join(names)})" if names else "golden_one"]
        command = [
            sys.executable,
            "-m",
            "pytest",
            "tests/golden/test_golden.py",
            "-q",
            "-p",
            "no:cacheprovider",
            *chosen,
        ]
        environment = os.environ | {
            "PYTHONPATH": folder,
            "OPENBLAS_NUM_THREADS": "1",
            "DELTAK_DATA": str(data_folder()),
        }
        done = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True, check=False
        )
    subject = _git("log", "-1", "--format=%h %s", commit).decode().strip()
    print(f"{'the same' if done.returncode == 0 else 'DIFFERENT'}: {subject[:100]}", flush=True)
    if done.returncode:
        print(
            "\n".join(
                line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR", "E  "))
            )
        )
    return done.returncode == 0


def _unpack(archive: bytes, folder: str, only: str = "") -> None:
    with tarfile.open(fileobj=BytesIO(archive)) as tar:
        members = [member for member in tar.getmembers() if member.name.endswith(only)]
        tar.extractall(folder, members, filter="data")


def _declare(folder: Path) -> None:
    """Write the entry points of a tree where they hide those that are installed."""
    groups = tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]["entry-points"]
    lines = [
        f"[{group}]\n" + "".join(f"{name} = {value}\n" for name, value in g.items())
        for group, g in groups.items()
    ]
    info = folder / "deltak-0.dist-info"
    info.mkdir()
    (info / "entry_points.txt").write_text("\n".join(lines), encoding="utf-8")
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: deltak\nVersion: 0\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
