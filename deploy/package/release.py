"""The environment of a gateway: Debian's interpreter, the locked dependencies, deltak, byte code.

It works at the one path that its version names, /opt/deltak/releases/VERSION, so that several versions can
lie side by side.
"""

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

PYTHON = "python3.11"
INTERPRETER = Path("/usr/bin", PYTHON)
HOME = Path("/opt/deltak")
SITE = Path("lib", PYTHON, "site-packages")
PLUGINS = HOME / "plugins"
"""Where others' drivers and commands are installed to outlive upgrades; found after deltak's own."""
# -I: neither PYTHONPATH nor the current folder brings another package of the name `agent`
_COMMAND = """#!{place}/bin/python -I
import sys
from deltak import main
sys.exit(main())
"""
_MARK = "home = /usr/bin\ninclude-system-site-packages = false\nversion = 3.11\n"


def place_of(version: str) -> Path:
    """Return where a version's environment works."""
    return HOME / "releases" / version


def lay(to: Path, wheel: Path, lock: Path, epoch: int) -> None:
    """Make the environment of a wheel; what the lock names is fetched, and refused where its hash differs."""
    site = to / SITE
    site.mkdir(parents=True)
    _pip(site, "--require-hashes", "--requirement", str(lock))
    # by its name: of a wheel that is named by its path pip notes that path
    _pip(site, "--no-index", "--find-links", str(wheel.parent), f"deltak=={version_of(wheel)}")
    shutil.rmtree(
        site / "bin", ignore_errors=True
    )  # commands of the dependencies, which work at no other place
    (site / "deltak-plugins.pth").write_text(f"{PLUGINS}\n", encoding="ascii")
    place = place_of(version_of(wheel))
    _interpreter(to, place)
    _compile(to, place)
    for path in (*to.rglob("*"), to):
        os.utime(path, (epoch, epoch), follow_symlinks=False)


def version_of(wheel: Path) -> str:
    """Return the version that a wheel's name states."""
    return wheel.name.split("-")[1]


def _pip(site: Path, *words: str) -> None:
    fixed = (
        "--no-compile",
        "--no-deps",
        "--only-binary=:all:",
        "--python-version=3.11",
        "--implementation=cp",
    )
    _run([sys.executable, "-m", "pip", "install", "--quiet", "--target", str(site), *fixed, *words])


def _interpreter(to: Path, place: Path) -> None:
    (to / "bin").mkdir()
    (to / "bin" / "python3").symlink_to(INTERPRETER)
    (to / "bin" / "python").symlink_to("python3")
    (to / "pyvenv.cfg").write_text(_MARK, encoding="ascii")
    command = to / "bin" / "deltak"
    command.write_text(_COMMAND.format(place=place), encoding="ascii")
    command.chmod(0o755)


def _compile(to: Path, place: Path) -> None:
    """Compile everything: the service may write nothing beside it, and would compile at each start."""
    words = ["-m", "compileall", "-q", "-j", "2", "--invalidation-mode", "unchecked-hash"]
    _run([str(INTERPRETER), *words, "-s", str(to), "-p", str(place), str(to / SITE)])


def _run(command: Sequence[str]) -> None:
    environment = os.environ | {"PYTHONHASHSEED": "0", "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    done = subprocess.run(command, env=environment, umask=0o022, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}\n{done.stdout}{done.stderr}")
