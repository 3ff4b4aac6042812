"""Names of modules and public identifiers are English of the field's books, or stand in the glossary."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from tests.peers import ROOT

GLOSSARY = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
BOOKS = Path(__file__).with_name("words.txt")
_PART = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")


def words_of(name: str) -> set[str]:
    """Return the words of an identifier or a path, in lower case; letters of the books (two or fewer) are
    none."""
    return {part.lower() for part in _PART.findall(name) if len(part) > 2}


def listed(text: str) -> set[str]:
    return {word for word in re.findall(r"[a-z]+", text.lower()) if len(word) > 2}


def refused() -> set[str]:
    return listed(GLOSSARY.partition("## Words that are not used")[2].rpartition("\n\n")[2])


def glossary() -> set[str]:
    rows = re.findall(r"^\| ([^|]+) \|", GLOSSARY, re.MULTILINE)
    return {word for row in rows for word in listed(row)}


def defined(node: ast.stmt) -> Iterator[str]:
    """Yield the names that a statement of a module or class defines, with those of the class's own body."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        yield node.name
    if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
        for inner in node.body:
            yield from defined(inner)
    targets = (
        node.targets
        if isinstance(node, ast.Assign)
        else [node.target]
        if isinstance(node, ast.AnnAssign)
        else []
    )
    yield from (target.id for target in targets if isinstance(target, ast.Name))


def public_names(file: Path) -> set[str]:
    path = file.relative_to(ROOT).with_suffix("")
    names = {name for node in ast.parse(file.read_text(encoding="utf-8")).body for name in defined(node)}
    return {*path.parts, *(name for name in names if not name.startswith("_"))}


def names() -> Iterator[tuple[str, str]]:
    """Yield every module's path with each of its public names."""
    for package in ("agent", "drivers", "sim_bus"):
        for file in sorted((ROOT / package).rglob("*.py")):
            path = file.relative_to(ROOT).as_posix()
            yield from ((path, name) for name in public_names(file))


def found_in(wanted: set[str]) -> list[str]:
    return sorted(
        f"{path}: {name} ({', '.join(strange)})"
        for path, name in names()
        if (strange := words_of(name) & wanted)
    )


def test_words_of_public_names_are_known() -> None:
    used = {word for _, name in names() for word in words_of(name)}
    unknown = used - glossary() - set(BOOKS.read_text(encoding="utf-8").split())
    advice = (
        "take a word of the field's books, explain it in docs/glossary.md, "
        f"or add plain English to {BOOKS.name}"
    )
    assert found_in(unknown) == [], advice


def test_words_that_the_glossary_refuses_are_in_no_public_name() -> None:
    assert found_in(refused()) == []


def test_list_of_plain_words_is_sorted_and_holds_none_that_is_refused() -> None:
    plain = BOOKS.read_text(encoding="utf-8").split()
    assert plain == sorted(set(plain))
    assert not set(plain) & refused()


def test_glossary_refuses_private_metaphors() -> None:
    assert {"told", "heard", "judge", "errands", "tape"} <= refused()
    assert words_of("HeardDriver") & refused()
    assert words_of("_errands_of2") & refused()


def test_architecture_shows_every_room_and_the_files_it_names_are_there() -> None:
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    tree = text.partition("## The rooms")[2].partition("## ")[0]
    shown, at = set(), [""]
    for depth, name in re.findall(r"^    ( *)(\w+)/ ", tree, re.MULTILINE):
        at[len(depth) // 2 :] = [name]
        shown.add("/".join(at))
    packages = [
        init.parent for top in ("agent", "drivers", "sim_bus") for init in (ROOT / top).rglob("__init__.py")
    ]
    assert {path.relative_to(ROOT).as_posix() for path in packages} == shown - {"tests"}
    table = text.partition("## To add something")[2].partition("## ")[0]
    named = re.findall(r"`((?:agent|drivers|sim_bus|tests|docs|deploy)/[\w/.]+)`", table)
    assert [path for path in named if not (ROOT / path).exists()] == []
