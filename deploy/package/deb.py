"""The Debian package: the environment, the units and what belongs to them, documents; installed offline."""

import gzip
import os
import shutil
import subprocess
from pathlib import Path

from deploy.package.release import HOME

_FILES = {
    "systemd/deltak.sysusers": "usr/lib/sysusers.d/deltak.conf",
    "systemd/deltak.tmpfiles": "usr/lib/tmpfiles.d/deltak.conf",
    "deb/copyright": "usr/share/doc/deltak/copyright",
    "RUNBOOK.md": "usr/share/doc/deltak/RUNBOOK.md",
    "ALARMS.md": "usr/share/doc/deltak/ALARMS.md",
    "requirements.lock": "usr/share/doc/deltak/requirements.lock",
    # these name a device or an interface: whoever installs edits a copy
    "udev": "usr/share/doc/deltak/examples/udev",
    "can": "usr/share/doc/deltak/examples/can",
    "grafana": "usr/share/doc/deltak/examples/grafana",
    "prometheus": "usr/share/doc/deltak/examples/prometheus",
}
"""What of deploy/ goes where, beside the units."""
_UNITS = "lib/systemd/system"
_SCRIPTS = ("postinst", "prerm", "postrm")
_LINKS = {"opt/deltak/bin": "current/bin", "usr/bin/deltak": "/opt/deltak/bin/deltak"}


def pack(work: Path, to: Path, version: str, epoch: int) -> Path:
    """Build the package; work: the folder of tree, environment and manual; to: bill, page and the package."""
    root, tree = work / "deb", work / "tree"
    shutil.copytree(work / "manual", root)
    shutil.copytree(work / "environment", root / str(HOME)[1:] / "package", symlinks=True)
    for source, target in _FILES.items():
        _copy(tree / "deploy" / source, root / target)
    for unit in (tree / "deploy/systemd").glob("*.service"):
        _copy(unit, root / _UNITS / unit.name)
    for link, target in _LINKS.items():
        (root / link).parent.mkdir(parents=True, exist_ok=True)
        (root / link).symlink_to(target)
    documents = root / "usr/share/doc/deltak"
    for document in (tree / "docs").glob("*.md"):
        _copy(document, documents / document.name)
    _copy(tree / "SECURITY.md", documents / "SECURITY.md")
    _copy(to / "sbom.cdx.json", documents / "sbom.cdx.json")
    _zip((tree / "CHANGELOG.md").read_text(encoding="utf-8"), documents / "changelog.gz")
    _zip((to / "deltak.1").read_text(encoding="utf-8"), root / "usr/share/man/man1/deltak.1.gz")
    return _built(root, tree / "deploy/deb", version, to, epoch)


def _copy(source: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    if source.is_dir():
        shutil.copytree(source, target)
    else:
        shutil.copy(source, target)


def _zip(text: str, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(gzip.compress(text.encode(), mtime=0))


def _built(root: Path, templates: Path, version: str, to: Path, epoch: int) -> Path:
    asked = subprocess.run(
        ["/usr/bin/dpkg", "--print-architecture"], check=True, capture_output=True, text=True
    )
    architecture = asked.stdout.strip()
    kilobytes = sum(path.lstat().st_size for path in root.rglob("*") if path.is_file()) // 1024
    words = {"@VERSION@": version, "@ARCHITECTURE@": architecture, "@KILOBYTES@": str(kilobytes)}
    (root / "DEBIAN").mkdir()
    for name in ("control", *_SCRIPTS):
        text = (templates / name).read_text(encoding="utf-8")
        for mark, word in words.items():
            text = text.replace(mark, word)
        (root / "DEBIAN" / name).write_text(text, encoding="utf-8")
        (root / "DEBIAN" / name).chmod(0o644 if name == "control" else 0o755)
    package = to / f"deltak_{version}_{architecture}.deb"
    command = ["/usr/bin/dpkg-deb", "--root-owner-group", "-Zzstd", "-z9", "--build", str(root), str(package)]
    environment = os.environ | {"SOURCE_DATE_EPOCH": str(epoch)}
    subprocess.run(command, env=environment, check=True, capture_output=True)
    return package
