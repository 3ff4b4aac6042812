"""A fresh Debian 12 below a folder, in which commands run without a network; made once and kept in the temp
folder."""

import shlex
import subprocess
import tarfile
import tempfile
from pathlib import Path

from tests import peers

SUITE = "bookworm"
PACKAGES = "python3.11,libstdc++6,systemd,passwd"
KEPT = Path(tempfile.gettempdir(), f"deltak-{SUITE}-{PACKAGES.replace(',', '-')}.tar")
_ENTER = """
mount --bind "$1" "$1"
mount -t proc proc "$1/proc"
mount -t tmpfs tmpfs "$1/dev"
for device in null zero urandom; do touch "$1/dev/$device"; mount --bind /dev/$device "$1/dev/$device"; done
mkdir "$1/dev/shm"
ip link set lo up
exec chroot "$1" /bin/sh -c "$2"
"""


def archive() -> Path:
    """Return the archive of the root, made where it is not there yet."""
    tool = peers.program("mmdebstrap", "mmdebstrap")
    if not KEPT.exists():
        part = KEPT.with_name(f"part-{KEPT.name}")
        command = [tool, "--quiet", "--variant=minbase", f"--include={PACKAGES}", SUITE, str(part)]
        subprocess.run(command, check=True, capture_output=True)
        part.rename(KEPT)
    return KEPT


def fresh(folder: Path) -> Path:
    """Unpack a root; return its folder."""
    folder.mkdir()
    with tarfile.open(archive()) as packed:
        members = [member for member in packed if not member.isdev()]
        packed.extractall(folder, members, filter="fully_trusted")
    return folder


def run(root: Path, script: str, *, check: bool = True) -> subprocess.CompletedProcess[str]:
    """Run a script of sh in the root: own processes, own mounts, loopback for a network."""
    command = [
        "unshare",
        "--mount",
        "--net",
        "--pid",
        "--fork",
        "sh",
        "-euc",
        _ENTER,
        "sh",
        str(root),
        script,
    ]
    environment = {
        "PATH": "/usr/sbin:/usr/bin:/sbin:/bin",
        "DEBIAN_FRONTEND": "noninteractive",
        "LC_ALL": "C.UTF-8",
    }
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=300)
    assert not check or done.returncode == 0, f"{script}\n{done.stdout}{done.stderr}"
    return done


def as_user(user: str, *words: str) -> str:
    """Return the command that runs another as somebody else."""
    return f"setpriv --reuid={user} --regid={user} --init-groups {shlex.join(words)}"


def write(root: Path, name: str, text: str) -> None:
    """Write a file of the root."""
    path = root / name.lstrip("/")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
