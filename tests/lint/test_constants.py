"""A name of a number means one thing in its package, so that a reader who has met it knows it."""

import ast
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from tests.lint.density import PACKAGES
from tests.peers import ROOT

ROOMS_OF_THEIR_OWN = "agent/numerics"
"""Its rooms are packages to a reader: each has its table (`tuning.py`, `constants.py`)."""


def package_of(file: Path) -> str:
    parts = file.relative_to(ROOT).parent.parts
    own = "/".join(parts[:2]) == ROOMS_OF_THEIR_OWN
    return "/".join(parts[: 3 if own else 2])


def numbers(source: str) -> Iterator[tuple[str, str]]:
    """Yield the names in capitals that a module gives to numbers, and what stands there."""
    for node in ast.parse(source).body:
        value = node.value if isinstance(node, ast.Assign | ast.AnnAssign) else None
        target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
        if value is None or target is None:
            continue
        names = target.elts if isinstance(target, ast.Tuple) else [target]
        values = value.elts if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple) else [value]
        for name, one in zip(names, values, strict=False):
            is_constant = isinstance(name, ast.Name) and name.id.isupper()
            if is_constant and is_number(one):
                yield ast.unparse(name), ast.unparse(one)


def is_number(value: ast.expr) -> bool:
    try:
        found = eval(compile(ast.Expression(value), "", "eval"), {"__builtins__": {}})
    except NameError:
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


def test_constants_of_tables_are_seen() -> None:
    found = meanings()
    assert ("agent/blocks", "PARTNER_S") in found
    assert ("drivers/modbus", "PATIENCE") in found
    source = "A, B = 1.0, -2\nC = (1, 2)\nD = 'x'\nE = {1: 2}\nf = 3\nG = 1 << 4\nH = A * 2\nI: Final = 9"
    assert dict(numbers(source)) == {
        "A": "1.0", "B": "-2", "C": "(1, 2)", "G": "1 << 4", "I": "9",
    }  # fmt: skip
