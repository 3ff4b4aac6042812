"""deploy/requirements.lock: what packages hold of others satisfies pyproject.toml, and each file of it has a
hash."""

import re
import tomllib
from itertools import chain

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

from tests.peers import ROOT

LOCK = (ROOT / "deploy/requirements.lock").read_text(encoding="utf-8")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = ("metrics", "web", "plot", "mqtt", "postgres", "opcua")
WANTED = [
    *PROJECT["dependencies"],
    *chain.from_iterable(PROJECT["optional-dependencies"][extra] for extra in EXTRAS),
]
PINNED = {
    name: Version(version) for name, version in re.findall(r"^([\w.-]+)==(\S+) \\$", LOCK, re.MULTILINE)
}


@pytest.mark.parametrize("wanted", WANTED)
def test_lock_satisfies_the_project(wanted: str) -> None:
    requirement = Requirement(wanted)
    found = PINNED.get(canonicalize_name(requirement.name))
    assert found is not None, "run `make lock`"
    assert found in requirement.specifier, "run `make lock`"


def test_every_package_of_the_lock_has_hashes_and_nothing_else_is_in_it() -> None:
    entries = re.split(r"^(?=\S)", LOCK, flags=re.MULTILINE)[1:]
    assert len(entries) == len(PINNED) > 20
    assert [
        entry.split()[0] for entry in entries if not re.search(r"--hash=sha256:[0-9a-f]{64}", entry)
    ] == []


def test_lock_names_no_place_that_files_come_from() -> None:
    assert re.findall(r"https?:|file:|--index|--find-links|@ ", LOCK) == []


def test_release_is_made_with_the_extras_of_the_lock() -> None:
    (line,) = [
        line for line in (ROOT / "Makefile").read_text(encoding="utf-8").splitlines() if "pip compile" in line
    ]
    assert re.findall(r"--extra (\w+)", line) == list(EXTRAS)
