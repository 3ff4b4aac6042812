"""Density of the product's functions: `python -m tests.lint.density`, a part of `make lint`.

A function has a cognitive complexity (Campbell, SonarSource 2018) of at most `HARDEST`, and at most `MOST`
boolean operators and ternaries: what is more wants conditions with names. A tuple assignment holds values of
one kind, or exchanges them; unrelated values stand on lines of their own.
"""

import ast
import sys
from collections.abc import Iterator

from cognitive_complexity.api import get_cognitive_complexity

from tests.peers import ROOT

MOST = 4
HARDEST = 10
PACKAGES = ("agent", "drivers", "sim_bus")
READ = (ast.Name, ast.Attribute, ast.Subscript, ast.Constant, ast.UnaryOp)
COLLECTION = (
    ast.List,
    ast.Dict,
    ast.Set,
    ast.Tuple,
    ast.ListComp,
    ast.DictComp,
    ast.SetComp,
    ast.GeneratorExp,
)
FUNCTION = (ast.FunctionDef, ast.AsyncFunctionDef)
CONDITION = (ast.Compare, ast.BoolOp)


def findings(source: str) -> Iterator[tuple[int, str]]:
    """Yield the lines of a module that are too dense, and in words why."""
    for function in (node for node in ast.walk(ast.parse(source)) if isinstance(node, FUNCTION)):
        operators = sum(_operators(node) for node in _body(function))
        hardness = get_cognitive_complexity(function)
        if operators > MOST:
            words = f"{operators} and/or/ternaries, more than {MOST}: name conditions"
            yield function.lineno, f"{function.name} has {words}"
        if hardness > HARDEST:
            words = f"cognitive complexity {hardness}, more than {HARDEST}: part it"
            yield function.lineno, f"{function.name} has {words}"
        for node in _body(function):
            if isinstance(node, ast.Assign) and not _is_of_a_kind(node):
                yield node.lineno, f"unrelated values in one assignment: {ast.unparse(node)}"


def _body(node: ast.AST) -> Iterator[ast.AST]:
    """Yield what is in a function and in none inside it."""
    for child in ast.iter_child_nodes(node):
        if not isinstance(child, (*FUNCTION, ast.ClassDef)):
            yield child
            yield from _body(child)


def _operators(node: ast.AST) -> int:
    if isinstance(node, ast.BoolOp):
        return len(node.values) - 1
    return int(isinstance(node, ast.IfExp))


def _is_of_a_kind(node: ast.Assign) -> bool:
    target, value = node.targets[0], node.value
    if not isinstance(target, ast.Tuple) or not isinstance(value, ast.Tuple):
        return True
    assigned = {ast.unparse(one) for one in target.elts}
    read = {ast.unparse(one) for one in ast.walk(value) if isinstance(one, READ)}
    return bool(assigned & read) or len({_kind(one) for one in value.elts}) == 1


def _kind(value: ast.expr) -> str:
    """Name what an expression is: a read, a call of some function, a collection, a condition, arithmetic."""
    if isinstance(value, ast.Call):
        return f"call of {ast.unparse(value.func).rpartition('.')[2]}"
    if isinstance(value, READ):
        return "read"
    if isinstance(value, COLLECTION):
        return "collection"
    return "condition" if isinstance(value, CONDITION) else "arithmetic"


def main() -> int:
    """Print what is too dense in the product; return whether anything is."""
    found = 0
    for file in sorted(file for package in PACKAGES for file in (ROOT / package).rglob("*.py")):
        for line, words in findings(file.read_text(encoding="utf-8")):
            found += 1
            print(f"{file.relative_to(ROOT).as_posix()}:{line}: {words}")
    print(f"density: {found} functions or lines too dense")
    return int(found > 0)


if __name__ == "__main__":
    sys.exit(main())
