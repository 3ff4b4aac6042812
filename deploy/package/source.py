"""Wheel and sdist from a clean tree: a commit's files alone, the same bytes whoever builds them and when."""

import gzip
import io
import os
import subprocess
import sys
import tarfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True, slots=True)
class Built:
    """The two files of a distribution."""

    wheel: Path
    sdist: Path


def epoch_of(root: Path = ROOT, commit: str = "HEAD") -> int:
    """Return the time that every packed file bears, s: SOURCE_DATE_EPOCH, else that of the commit."""
    named = os.environ.get("SOURCE_DATE_EPOCH")
    if named:
        return int(named)
    command = ["git", "-C", str(root), "log", "-1", "--format=%ct", commit]
    return int(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def clean_tree(to: Path, root: Path = ROOT, commit: str = "HEAD") -> Path:
    """Write the files of a commit, and none that merely lie in the work tree; return their folder."""
    to.mkdir(parents=True)
    command = ["git", "-C", str(root), "-c", "tar.umask=0022", "archive", commit]
    packed = subprocess.run(command, check=True, capture_output=True).stdout
    with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
        archive.extractall(to, filter="tar")
    return to


def build(tree: Path, to: Path, epoch: int) -> Built:
    """Build the sdist of a tree and the wheel of that sdist."""
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(to), str(tree)]
    _run(command, epoch)
    built = Built(next(to.glob("deltak-*.whl")), next(to.glob("deltak-*.tar.gz")))
    _repack(built.sdist, epoch)
    return built


def wheel_of(sdist: Path, to: Path, epoch: int) -> Path:
    """Build the wheel of an sdist, as somebody would who has nothing else."""
    with tarfile.open(sdist) as archive:
        archive.extractall(to / "unpacked", filter="data")
    (tree,) = (to / "unpacked").iterdir()
    _run([sys.executable, "-m", "build", "--no-isolation", "--wheel", "--outdir", str(to), str(tree)], epoch)
    return next(to.glob("deltak-*.whl"))


def _run(command: list[str], epoch: int) -> None:
    environment = os.environ | {"SOURCE_DATE_EPOCH": str(epoch)}
    done = subprocess.run(command, env=environment, umask=0o022, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}\n{done.stdout}{done.stderr}")


def _repack(sdist: Path, epoch: int) -> None:
    """Rewrite an sdist without traces of when and by whom it was built: setuptools keeps times and owners."""
    packed = io.BytesIO()
    with tarfile.open(sdist) as old, tarfile.open(fileobj=packed, mode="w", format=tarfile.PAX_FORMAT) as new:
        for member in sorted(old.getmembers(), key=lambda member: member.name):
            content = old.extractfile(member) if member.isfile() else None
            new.addfile(_anonymous(member, epoch), content)
    with sdist.open("wb") as file, gzip.GzipFile("", "wb", 9, file, mtime=epoch) as zipped:
        zipped.write(packed.getvalue())


def _anonymous(member: tarfile.TarInfo, epoch: int) -> tarfile.TarInfo:
    plain = tarfile.TarInfo(member.name)
    plain.size = member.size
    plain.type = member.type
    plain.linkname = member.linkname
    plain.mtime = epoch
    plain.mode = 0o755 if member.isdir() or member.mode & 0o100 else 0o644
    return plain
