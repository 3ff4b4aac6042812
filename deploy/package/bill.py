"""The bill of materials (CycloneDX 1.6, JSON) of an environment: names, versions, licences, where from."""

import json
import os
import subprocess
import sys
from pathlib import Path


def write(environment: Path, project: Path, version: str, to: Path, epoch: int) -> None:
    """Write an environment's bill; project: pyproject.toml, which names what it is of, in which version."""
    tool = str(Path(sys.executable).with_name("cyclonedx-py"))
    form = [
        "--output-reproducible",
        "--spec-version",
        "1.6",
        "--of",
        "JSON",
        "--pyproject",
        str(project),
        "-o",
        str(to),
    ]
    command = [tool, "environment", *form, str(environment / "bin/python")]
    subprocess.run(
        command, env=os.environ | {"SOURCE_DATE_EPOCH": str(epoch)}, check=True, capture_output=True
    )
    found = json.loads(to.read_text(encoding="utf-8"))
    found["metadata"]["component"]["version"] = version
    to.write_text(json.dumps(found, indent=1, sort_keys=True) + "\n", encoding="utf-8")
