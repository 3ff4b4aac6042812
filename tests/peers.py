"""What the tests need from outside: programs, measured data. The run's last lines say what is missing."""

import os
import shutil
from pathlib import Path
from typing import NoReturn

import pytest

ROOT = Path(__file__).resolve().parent.parent
NOT_TESTED: list[str] = []


def missing(text: str) -> NoReturn:
    """Say what was not tested and why; skip here, fail where CI=true, since nothing may be missing there."""
    NOT_TESTED.append(text)
    if os.environ.get("CI") == "true":
        pytest.fail(f"CI=true and not tested: {text}", pytrace=False)
    pytest.skip(text)


def program(name: str, package: str) -> str:
    """Return the path of an independent program, or say that it is missing."""
    found = shutil.which(name, path=f"{os.environ.get('PATH', os.defpath)}:/usr/sbin:/sbin")
    return found or missing(f"{name} is not installed (Debian package {package})")


def data_folder() -> Path:
    """Return where the measured data lies: DELTAK_DATA, else ../shared/data beside the repository."""
    return Path(os.environ.get("DELTAK_DATA") or ROOT.parent / "shared" / "data")


def data(name: str) -> Path:
    """Return a measured record's path. Records cannot be shipped (no licence): without them the run says so.

    Their absence fails the run only where somebody set DELTAK_DATA and so promised that they are there.
    """
    path = data_folder() / name
    if path.exists():
        return path
    text = f"no measured data {name} in {data_folder()} (set DELTAK_DATA)"
    if os.environ.get("DELTAK_DATA"):
        missing(text)
    NOT_TESTED.append(text)
    pytest.skip(text)
