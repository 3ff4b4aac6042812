"""The image of deploy/Containerfile: built and run here, not as root, on a read-only root, without
capabilities."""

import json
import os
import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

import agent
from tests import peers
from tests.packages import chroot

pytestmark = [pytest.mark.soak, pytest.mark.timeout(1800)]
BASE, IMAGE = "localhost/deltak-test-base", "localhost/deltak-test"
DATA = "/var/lib/deltak"


def buildah(*words: str | Path) -> str:
    tool = peers.program("buildah", "buildah")
    environment = os.environ | {"BUILDAH_ISOLATION": "chroot"}
    done = subprocess.run(
        [tool, *map(str, words)], env=environment, capture_output=True, text=True, check=False, timeout=900
    )
    assert done.returncode == 0, f"buildah {words}\n{done.stdout}{done.stderr}"
    return done.stdout.strip()


def base() -> None:
    """Make an image of Debian 12 as small ones are: without what of systemd makes users and folders."""
    container = buildah("from", "scratch")
    buildah("add", "-q", container, chroot.archive(), "/")
    buildah("run", container, "rm", "/usr/bin/systemd-sysusers", "/usr/bin/systemd-tmpfiles")
    buildah("commit", "-q", container, BASE)
    buildah("rm", container)


@pytest.fixture(scope="module")
def root(dists: Mapping[str, Path]) -> Iterator[Path]:
    """The file system of a container of the image."""
    base()
    context = dists[agent.__version__]
    file = peers.ROOT / "deploy/Containerfile"
    buildah("bud", "-q", "--build-arg", f"BASE={BASE}", "-t", IMAGE, "-f", file, context)
    container = buildah("from", IMAGE)
    yield Path(buildah("mount", container))
    buildah("rm", container)
    buildah("rmi", IMAGE, BASE)


def run(root: Path, folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run a program in a container as the head of the Containerfile says: its user, its data, /tmp; nothing
    else."""
    tool = peers.program("runc", "runc")
    data = folder / "data"
    data.mkdir(parents=True)
    subprocess.run([tool, "spec"], cwd=folder, check=True)
    lines = (root / "etc/passwd").read_text().splitlines()
    uid, gid = next(map(int, line.split(":")[2:4]) for line in lines if line.startswith("deltak:"))
    os.chown(data, uid, gid)
    spec = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps(_spec(spec, root, (uid, gid), words)))
    command = [tool, "run", f"deltak-test-{os.getpid()}-{folder.name}"]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=300)


def _spec(spec: Any, root: Path, user: tuple[int, int], words: tuple[str, ...]) -> Any:
    spec["root"] = {"path": str(root), "readonly": True}
    spec["process"] |= {
        "terminal": False, "user": {"uid": user[0], "gid": user[1]}, "args": words, "cwd": DATA,
        "capabilities": {},
        "noNewPrivileges": True, "rlimits": [],
    }  # fmt: skip
    spec["mounts"] = [mount for mount in spec["mounts"] if mount["destination"] != "/sys/fs/cgroup"]
    spec["mounts"] += [
        {"destination": DATA, "type": "bind", "source": "data", "options": ["rbind", "rw"]},
        {"destination": "/tmp", "type": "tmpfs", "source": "tmpfs", "options": ["mode=1777"]},
    ]
    del spec["linux"]["resources"]  # control groups are not this machine's to give
    return spec


def test_image_names_its_user_its_volume_and_its_command(root: Path) -> None:
    found = json.loads(buildah("inspect", "--type", "image", IMAGE))["OCIv1"]["config"]
    assert found["User"] == "deltak"
    assert found["Volumes"] == {DATA: {}}
    assert found["Entrypoint"] == ["/opt/deltak/bin/deltak"]
    assert found["Cmd"] == ["run", "/etc/deltak/conf.d", "--db", f"{DATA}/deltak.db"]


def test_agent_runs_without_root_and_capabilities_on_a_read_only_root(root: Path, tmp_path: Path) -> None:
    words = ["/opt/deltak/bin/deltak", "demo", "--fast", "--json", "--db", f"{DATA}/rig.db"]
    done = run(root, tmp_path / "demo", *words)
    assert done.returncode == 0, done.stderr
    samples = json.loads(done.stdout)["samples"]
    assert samples["received"] == samples["used"] > 0
    assert (tmp_path / "demo/data/rig.db").stat().st_uid != 0


def test_container_can_write_nothing_but_its_data(root: Path, tmp_path: Path) -> None:
    script = (
        "id -u; grep CapEff /proc/self/status; "
        f"for f in /opt/deltak/x /etc/x {DATA}/x; do touch $f && echo $f; done"
    )
    done = run(root, tmp_path / "probe", "/bin/sh", "-c", script)
    uid, *shown = done.stdout.split()
    assert int(uid) > 0
    assert shown == ["CapEff:", "0" * 16, f"{DATA}/x"]
    assert done.stderr.count("Read-only file system") == 2


def test_version_of_the_image_is_that_of_the_package(root: Path, tmp_path: Path) -> None:
    done = run(root, tmp_path / "version", "/opt/deltak/bin/deltak", "--version")
    assert done.stdout == f"deltak {agent.__version__}\n"
