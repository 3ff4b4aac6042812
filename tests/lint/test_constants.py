"""A name of a number means one thing in its package, so that a reader who has met it knows it."""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Self

from tests.lint.density import PACKAGES
from tests.peers import ROOT

TABLE = "tuning.py"
"""File of a package's tuned numbers."""
PACKAGE_DEPTH = {"agent/numerics": 3, "agent": 2, "drivers": 2, "sim_bus": 1}
"""Folders of a package's path below each of these; the numerics' rooms are packages to a reader."""
IMPORTS = ast.Import | ast.ImportFrom
FIXED = re.compile(r"fixed by \w+", re.IGNORECASE)
"""Says who has fixed a number that is not tuned: a standard, a format, an operating system, a definition."""


def package_of(file: Path) -> str:
    parts = file.relative_to(ROOT).parent.parts
    depth = next(depth for top, depth in PACKAGE_DEPTH.items() if "/".join(parts).startswith(top))
    return "/".join(parts[:depth])


def numbers(source: str) -> Iterator[tuple[str, str]]:
    """Yield the names in capitals that a module gives to numbers, and what stands there."""
    for node in ast.parse(source).body:
        yield from numbers_of(node)


def numbers_of(node: ast.stmt, names: Mapping[str, int] = MappingProxyType({})) -> Iterator[tuple[str, str]]:
    """Yield what a statement gives to names in capitals; names: what may stand in it beside numbers."""
    value = node.value if isinstance(node, ast.Assign | ast.AnnAssign) else None
    target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
    if value is None or target is None:
        return
    targets = target.elts if isinstance(target, ast.Tuple) else [target]
    values = value.elts if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple) else [value]
    for name, one in zip(targets, values, strict=False):
        is_constant = isinstance(name, ast.Name) and name.id.isupper()
        if is_constant and is_number(one, names):
            yield ast.unparse(name), ast.unparse(one)


def is_number(value: ast.expr, names: Mapping[str, int]) -> bool:
    if not any(isinstance(node, ast.Constant) for node in ast.walk(value)):
        return False
    try:
        found = eval(compile(ast.Expression(value), "", "eval"), {"__builtins__": {}}, names)
    except (NameError, TypeError, AttributeError):
        return False
    return all(
        type(one) in (int, float) for one in (found if isinstance(found, tuple) and found else (found,))
    )


@cache
def meanings() -> dict[tuple[str, str], dict[str, list[str]]]:
    """Return for each package and name its values, with the files that give them."""
    found: dict[tuple[str, str], dict[str, list[str]]] = defaultdict(lambda: defaultdict(list))
    for file in sorted(file for package in PACKAGES for file in (ROOT / package).rglob("*.py")):
        for name, value in numbers(file.read_text(encoding="utf-8")):
            found[package_of(file), name][value].append(file.relative_to(ROOT).as_posix())
    return found


def test_constants_a_name_never_means_two_numbers_in_a_package() -> None:
    twice = {key: dict(values) for key, values in meanings().items() if len(values) > 1}
    assert twice == {}


class SomeNumber(int):
    """What a name, or the attribute of one, stands for where it is not known which number it is."""

    def __new__(cls) -> Self:
        return int.__new__(cls, 2)

    def __getattr__(self, _: str) -> Self:
        return self


def loose(source: str, words: re.Pattern[str] = FIXED) -> set[str]:
    """Return the numbers at a module's top beside which such words do not stand: "fixed by", and who.

    What is said behind a number or in the string below it holds also for those in the lines before it.
    """
    found: set[str] = set()
    waiting: set[str] = set()
    lines = source.splitlines()
    nodes = ast.parse(source).body
    for node, after in zip(nodes, [*nodes[1:], None], strict=True):
        waiting |= {name for name, _ in numbers_of(node, defaultdict(SomeNumber))}
        said = lines[(node.end_lineno or 0) - 1].partition("#")[2]
        if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
            said += str(after.value.value)
        is_over = bool(said) or after is None or after.lineno > (node.end_lineno or 0) + 1
        if is_over and not words.match(said.strip()):
            found |= waiting
        if is_over:
            waiting = set()
    return found


def test_constants_that_are_tuned_stand_in_the_table_of_their_package() -> None:
    files = (file for package in PACKAGES for file in (ROOT / package).rglob("*.py") if file.name != TABLE)
    found = {file: loose(file.read_text(encoding="utf-8")) for file in files}
    assert {file.relative_to(ROOT).as_posix(): names for file, names in found.items() if names} == {}


def test_constants_have_one_table_a_package() -> None:
    tables = [file for package in PACKAGES for file in (ROOT / package).rglob(TABLE)]
    below = [file for file in tables if package_of(file) != file.parent.relative_to(ROOT).as_posix()]
    assert below == []
    names = {file: [name for name, _ in numbers(file.read_text(encoding="utf-8"))] for file in tables}
    assert [file for file, found in names.items() if len(found) != len(set(found))] == []
    parts = {file: ast.parse(file.read_text(encoding="utf-8")).body for file in tables}
    assert [file for file, nodes in parts.items() if any(isinstance(node, IMPORTS) for node in nodes)] == []


def test_constants_of_a_table_have_a_word_each() -> None:
    tables = [file for package in PACKAGES for file in (ROOT / package).rglob(TABLE)]
    bare = {file: loose(file.read_text(encoding="utf-8"), re.compile(r"\S")) for file in tables}
    assert {file.relative_to(ROOT).as_posix(): names for file, names in bare.items() if names} == {}


def test_constants_fixed_by_others_may_stand_at_a_modules_top() -> None:
    source = 'A = 1  # fixed by linux/can.h\nB = 2\nC = 3\n"""Fixed by ISO 1."""\nD = 4\n\nE = A * 5  # s\n'
    assert loose(source) == {"D", "E"}


def test_constants_of_tables_are_seen() -> None:
    found = meanings()
    assert ("agent/blocks", "PARTNER_S") in found
    assert ("drivers/modbus", "PATIENCE") in found
    source = "A, B = 1.0, -2\nC = (1, 2)\nD = 'x'\nE = {1: 2}\nf = 3\nG = 1 << 4\nH = A * 2\nI: Final = 9"
    assert dict(numbers(source)) == {
        "A": "1.0", "B": "-2", "C": "(1, 2)", "G": "1 << 4", "I": "9",
    }  # fmt: skip
