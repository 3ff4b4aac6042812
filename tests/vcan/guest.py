"""Runs a command in a User-Mode Linux guest, whose kernel has CAN, with the host's files and its own virtual
bus."""

import os
import shlex
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from tests import peers

INIT = Path(__file__).with_name("guest-init.sh")
REGISTERS = Path(__file__).with_name("registers.c")
DIED = 125
"""Status of a command whose guest died."""
MODULES = "/usr/lib/uml/modules"


def run(
    command: Sequence[str],
    folder: Path,
    limit_s: float,
    kept: Path | None = None,
    init: Path = INIT,
    disk: Path | None = None,
) -> tuple[int, str]:
    """Return exit status and output of a command run in `folder` of a fresh guest; status DIED when the guest
    died.

    What the command finds in the folder that $RESULTS names is what is in `kept`, and what it leaves there
    goes to it; init: the guest's first process; disk: a file that is the guest's first disk (98, 0).
    """
    linux = peers.program("linux.uml", "user-mode-linux")
    peers.program("insmod", "kmod")
    with tempfile.TemporaryDirectory(prefix="guest") as name:
        results = Path(name)
        first = results / "init"
        first.write_bytes(init.read_bytes())
        first.chmod(0o755)
        (results / "kept").mkdir()
        for file in kept.glob("*.json") if kept is not None else ():
            shutil.copy(file, results / "kept")
        (results / "lean").mkdir()
        # what python-can imports only for MF4 logs (pandas and more): a guest takes seconds over it
        (results / "lean/asammdf.py").write_text("raise ImportError\n")
        (results / "command").write_text(_script(command, folder, results))
        arguments = [
            linux, "mem=512M", f"uml_dir={results}", "umid=guest", "root=/dev/root", "rootfstype=hostfs",
            "rootflags=/",
            "ro", "quiet", "loglevel=3", "panic=1", "con=null", "con0=null,fd:1", "ssl=null", f"init={first}",
            f"results={results}", f"modules={MODULES}", *([] if disk is None else [f"ubd0={disk}"]),
        ]  # fmt: skip
        printed = _run(_ahead_of_others([*_registers(results), *arguments]), limit_s)
        if kept is not None:
            shutil.copytree(results / "kept", kept, dirs_exist_ok=True)
        status, output = results / "status", results / "output"
        if not status.exists():
            return DIED, f"the guest died:\n{printed}"
        return int(status.read_text()), output.read_text(errors="replace")


def _run(command: Sequence[str], limit_s: float) -> str:
    """Run a guest and return what its console printed; its processes, which are many, end with it."""
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        start_new_session=True,
    ) as machine:  # fmt: skip
        try:
            return machine.communicate(timeout=limit_s)[0].decode(errors="replace")
        finally:
            with suppress(ProcessLookupError):
                os.killpg(machine.pid, signal.SIGKILL)


def _registers(folder: Path) -> list[str]:
    """Return what has a guest start where the processor has more registers than User-Mode Linux knows."""
    if "amx_tile" not in Path("/proc/cpuinfo").read_text():
        return []
    library = folder / "registers.so"
    compiler = peers.program("gcc", "gcc")
    subprocess.run([compiler, "-O2", "-shared", "-fPIC", "-o", library, REGISTERS], check=True)
    return ["env", f"LD_PRELOAD={library}"]


def _script(command: Sequence[str], folder: Path, results: Path) -> str:
    environment = {
        "PATH": os.environ["PATH"], "PYTHONPATH": str(results / "lean"), "RESULTS": str(results / "kept"),
        "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1",
    }  # fmt: skip
    exports = [f"export {name}={shlex.quote(value)}" for name, value in environment.items()]
    return "\n".join([*exports, f"cd {shlex.quote(str(folder))}", shlex.join(command), ""])


def _ahead_of_others(arguments: list[str]) -> list[str]:
    """Keep the guest on the last processor, where its kernel and its processes talk twice as fast.

    And ahead of others there, where that is allowed: its clock is this machine's and goes on while it waits,
    so that what it is asked to do in time it would do late, and be late for its watchdog.
    """
    ahead = ["chrt", "--rr", "1"]
    is_allowed = subprocess.run([*ahead, "true"], capture_output=True, check=False).returncode == 0
    place = ["taskset", "-c", str(max(os.sched_getaffinity(0)))]
    return [*(ahead if is_allowed else ()), *place, *arguments]
