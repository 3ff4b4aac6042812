"""The life of the Debian package on a fresh Debian 12 without a network: install, upgrade, downgrade, remove,
purge."""

import gzip
import json
import re
import shutil
import sqlite3
import subprocess
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from tests import figures, peers
from tests.packages import chroot
from tests.packages.conftest import NEW, OLD

pytestmark = [pytest.mark.soak, pytest.mark.timeout(1800)]
DB = "/var/lib/deltak/rig.db"
INSTALLED = """
import json, sys, agent
from importlib.metadata import distributions
print(json.dumps({"packages": {d.name: d.version for d in distributions()}, "agent": agent.__file__,
    "path": sys.path}))
"""
PLUG_IN = {
    "greeting.py": 'def greet() -> None:\n    """Greet."""\n    print(\'hello\')\n',
    "greeting-1.0.dist-info/METADATA": "Metadata-Version: 2.1\nName: greeting\nVersion: 1.0\n",
    "greeting-1.0.dist-info/entry_points.txt": "[deltak.commands]\ngreet = greeting:greet\n",
    "agent/__init__.py": "raise ImportError('of another')\n",
}
"""A command of another distribution, which also brings a package called like one of deltak's."""


def rows(root: Path) -> int:
    with closing(sqlite3.connect(root / DB[1:])) as connection:
        return int(connection.execute("SELECT count(*) FROM v_estimates").fetchone()[0])


def about(root: Path, name: str) -> dict[str, Any]:
    """Return what is there after a step of the package's life."""
    home = root / "opt/deltak"
    return {
        "current": (home / "current").readlink().name if (home / "current").is_symlink() else None,
        "releases": sorted(path.name for path in (home / "releases").glob("*")),
        "version": chroot.run(root, "deltak --version", check=False).stdout.strip(),
        "plugged in": chroot.run(root, "deltak greet", check=False).stdout.strip(),
        "rows": rows(root) if (root / DB[1:]).exists() else None,
        "configuration": (root / "etc/deltak/conf.d/rig.toml").exists(), "step": name,
    }  # fmt: skip


@pytest.fixture(scope="module")
def lived(dists: Mapping[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Any]:
    """Go through a package's life and note what is found after each step."""
    root = chroot.fresh(tmp_path_factory.mktemp("machine") / "root")
    for version, folder in dists.items():
        shutil.copy(next(folder.glob("*.deb")), root / f"tmp/{version}.deb")
    found: dict[str, Any] = {"root": root}
    found["said"] = chroot.run(root, f"dpkg --force-unsafe-io -i /tmp/{OLD}.deb").stdout
    found["whole"] = chroot.run(root, "dpkg --verify deltak").stdout
    python = f"/opt/deltak/releases/{OLD}/bin/python"
    found["installed"] = json.loads(chroot.run(root, f"{python} -I -c '{INSTALLED}'").stdout)
    for name, text in PLUG_IN.items():
        chroot.write(root, f"/opt/deltak/plugins/{name}", text)
    found["user"] = chroot.run(root, "id deltak; stat -c '%U %G %a' /var/lib/deltak").stdout
    found["documents"] = {
        path.name: path.read_bytes() for path in (root / "usr/share/doc/deltak").glob("*.*")
    }
    found["page"] = gzip.decompress((root / "usr/share/man/man1/deltak.1.gz").read_bytes()).decode()
    found["completed"] = chroot.run(
        root, "COMP_WORDS='deltak upg' COMP_CWORD=1 _DELTAK_COMPLETE=complete_bash deltak"
    ).stdout
    chroot.run(root, "cd /etc/deltak/conf.d && deltak examples copy modbus . && mv modbus.toml rig.toml")
    demo = chroot.run(root, chroot.as_user("deltak", "deltak", "demo", "--fast", "--json", "--db", DB))
    found["demo"] = json.loads(demo.stdout)
    found["check"] = json.loads(chroot.run(root, "deltak upgrade --check --json").stdout)
    found["first"] = about(root, "install")
    for step, words in (
        ("upgrade", f"-i /tmp/{NEW}.deb"), ("again", f"-i /tmp/{NEW}.deb"),
        ("downgrade", f"-i /tmp/{OLD}.deb"),
        ("remove", "-r deltak"), ("purge", "-P deltak"),
    ):  # fmt: skip
        chroot.run(root, f"dpkg --force-unsafe-io --force-downgrade {words}")
        found[step] = about(root, step)
    found["left"] = chroot.run(
        root, "find / -xdev -path /tmp -prune -o -name '*deltak*' -print; id -un deltak"
    ).stdout
    return found


def test_fresh_machine_has_the_program_its_user_and_its_folders(lived: Mapping[str, Any]) -> None:
    assert lived["first"]["version"] == f"deltak {OLD}"
    assert lived["first"]["releases"] == [OLD]
    assert re.search(r"groups=.*dialout.*deltak-command", lived["user"])
    assert "deltak deltak 750" in lived["user"]
    assert "systemctl enable --now deltak" in lived["said"]
    assert lived["whole"] == ""


def test_program_runs_in_an_environment_of_its_own(lived: Mapping[str, Any]) -> None:
    place = f"/opt/deltak/releases/{OLD}"
    assert lived["installed"]["agent"] == f"{place}/lib/python3.11/site-packages/agent/__init__.py"
    outside = [
        path for path in lived["installed"]["path"] if not path.startswith((place, "/usr/lib/python3"))
    ]
    assert outside == []
    assert "/usr/lib/python3/dist-packages" not in lived["installed"]["path"]


def test_demo_runs_as_the_service_s_user_without_a_network(lived: Mapping[str, Any]) -> None:
    assert lived["demo"]["samples"]["received"] == lived["demo"]["samples"]["used"] > 0
    assert lived["first"]["rows"] > 0


def test_check_finds_what_the_services_have(lived: Mapping[str, Any]) -> None:
    assert lived["check"]["ok"]
    assert [row["file"] for row in lived["check"]["configs"]] == ["/etc/deltak/conf.d"]
    assert [(row["db"], row["action"]) for row in lived["check"]["databases"]] == [(DB, "none")]


def normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def test_bill_of_materials_and_lock_are_what_is_installed(lived: Mapping[str, Any]) -> None:
    installed = {normal(name): version for name, version in lived["installed"]["packages"].items()}
    bill = json.loads(lived["documents"]["sbom.cdx.json"])
    listed = [bill["metadata"]["component"], *bill["components"]]
    assert {normal(part["name"]): part["version"] for part in listed} == installed
    locked = re.findall(r"^([\w.-]+)==(\S+) ", lived["documents"]["requirements.lock"].decode(), re.MULTILINE)
    assert {normal(name): version for name, version in locked} | {"deltak": OLD} == installed
    assert bill["bomFormat"] == "CycloneDX"


def test_man_page_and_completion_come_along(lived: Mapping[str, Any]) -> None:
    assert f'"deltak {OLD}"' in lived["page"]
    assert r".SS deltak upgrade" in lived["page"]
    assert lived["completed"].split() == ["upgrade"]


@pytest.mark.parametrize(
    ("step", "version", "others"), [("upgrade", NEW, OLD), ("again", NEW, OLD), ("downgrade", OLD, NEW)]
)
def test_other_version_takes_over_with_data_and_configuration_and_the_former_one_stays(
    lived: Mapping[str, Any], step: str, version: str, others: str
) -> None:
    found = lived[step]
    assert (found["version"], found["current"]) == (f"deltak {version}", version)
    assert set(found["releases"]) == {version, others}
    assert (found["rows"], found["configuration"]) == (lived["first"]["rows"], True)
    assert found["plugged in"] == lived["first"]["plugged in"] == "hello"


def test_removal_leaves_data_and_configuration_and_purge_does_not(lived: Mapping[str, Any]) -> None:
    assert lived["remove"] == {
        "current": None, "releases": [], "version": "", "plugged in": "", "rows": lived["first"]["rows"],
        "configuration": True, "step": "remove",
    }  # fmt: skip
    assert (lived["purge"]["rows"], lived["purge"]["configuration"]) == (None, False)
    # the user stays, so that nobody inherits its files
    assert lived["left"].split() == ["deltak"]


def test_sizes_are_as_the_documents_say(dists: Mapping[str, Path]) -> None:
    (package,) = dists[OLD].glob("*.deb")
    field = ["dpkg-deb", "--field", str(package), "Installed-Size"]  # in KiB
    unpacked = int(subprocess.run(field, check=True, capture_output=True, text=True).stdout) * 1024 / 1e6
    size = package.stat().st_size / 1e6
    figures.figure(f"{package.name}: {size:.0f} MB, {unpacked:.0f} MB unpacked")
    said = re.search(r"\((\d+) MB, (\d+) MB unpacked\)", (peers.ROOT / "docs/install.md").read_text())
    assert said is not None
    assert [size, unpacked] == pytest.approx([float(words) for words in said.groups()], rel=0.1)
