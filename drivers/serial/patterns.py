"""Whether a regular expression can be trusted with whatever bytes come: found from its text, before any line.

Python's engine tries one way after another through a pattern. Where two ways begin with the same character, a
line that fits neither is tried both ways; repeats multiply that. `effort` bounds it: the number of ways, as a
power of two, in which a line of LONGEST characters can be tried. What cannot be bounded by EFFORT is refused
by `check`.
"""

import importlib
import re
from collections.abc import Sequence
from math import log2
from typing import Any, NamedTuple

from drivers.serial.tuning import EFFORT, LONGEST

_EVERY = (1 << 256) - 1  # fixed by bytes: one bit for each character there is
_ADVICE = r"say what lies between the values more narrowly, e.g. [^,]* or \s+ in place of .*"


class _Part(NamedTuple):
    """A piece of a pattern: the characters it can begin with (a bit each), if it can be empty, its effort."""

    first: int
    empty: bool
    effort: float


def check(text: str) -> re.Pattern[str]:
    """Return the compiled pattern; ValueError when it is none, looks around or back, or can take too long."""
    try:
        pattern = re.compile(text)
    except re.error as error:
        raise ValueError(f"is no pattern: {error}") from error
    if effort(text) > EFFORT:
        raise ValueError(f"can take very long on a line that does not match: repeats overlap; {_ADVICE}")
    return pattern


def effort(text: str) -> float:
    """Return the bound on the ways in which a line can be tried, as a power of two."""
    fold = bool(re.compile(text).flags & re.IGNORECASE) or "(?i" in text
    return _Reader(fold).sequence(importlib.import_module("re._parser").parse(text), 0).effort


class _Reader:
    """Walks the parsed pattern from its end to its beginning."""

    def __init__(self, fold: bool) -> None:
        self._fold = fold

    def sequence(self, nodes: Sequence[tuple[Any, Any]], follow: int) -> _Part:
        """Judge pieces one after another; `follow` are the characters that may come behind them."""
        part = _Part(0, True, 0.0)
        for kind, value in reversed(nodes):
            node = self._node(kind.name, value, part.first | (follow if part.empty else 0))
            first = node.first | (part.first if node.empty else 0)
            part = _Part(first, node.empty and part.empty, node.effort + part.effort)
        return part

    def _node(self, kind: str, value: Any, follow: int) -> _Part:
        if kind in {"MAX_REPEAT", "MIN_REPEAT", "POSSESSIVE_REPEAT"}:
            least, most, nodes = value
            return self._repeat(int(least), int(most), nodes, follow)
        if kind == "BRANCH":
            return self._branch([self.sequence(nodes, follow) for nodes in value[1]], follow)
        if kind == "SUBPATTERN":
            return self.sequence(value[3], follow)
        if kind == "ATOMIC_GROUP":
            return self.sequence(value, follow)
        if kind == "AT":
            return _Part(0, True, 0.0)
        return _Part(self._folded(_characters(kind, value)), False, 0.0)

    def _repeat(self, least: int, most: int, nodes: Sequence[tuple[Any, Any]], follow: int) -> _Part:
        times = min(most, LONGEST)
        once = self.sequence(nodes, follow)
        if times > 1:
            once = self.sequence(nodes, follow | once.first)
        effort = once.effort * times
        if once.first & follow and times > least:
            effort += log2(times - least + 1)
        return _Part(once.first, once.empty or least == 0, effort)

    def _branch(self, ways: Sequence[_Part], follow: int) -> _Part:
        seen, shared = 0, 1
        for way in ways:
            begins = way.first | (follow if way.empty else 0)
            shared += bool(seen & begins)
            seen |= begins
        first = 0
        for way in ways:
            first |= way.first
        return _Part(first, any(way.empty for way in ways), max(way.effort for way in ways) + log2(shared))

    def _folded(self, characters: int) -> int:
        if not self._fold:
            return characters
        both = characters
        for code in range(256):
            swapped = ord(chr(code).swapcase()[0])
            if characters >> code & 1 and swapped < 256:
                both |= 1 << swapped
        return both


def _characters(kind: str, value: Any) -> int:
    """Return the characters that a node of one character can be, a bit each."""
    if kind in {"LITERAL", "NOT_LITERAL"}:
        one = 1 << value if value < 256 else 0
        return one if kind == "LITERAL" else _EVERY & ~one
    if kind == "ANY":
        return _EVERY
    if kind == "RANGE":
        return sum(1 << code for code in range(value[0], min(value[1], 255) + 1))
    if kind == "CATEGORY":
        return _category(value.name)
    if kind == "IN":
        return _set(value)
    raise ValueError("looks ahead, behind or back at a group, which can take very long; write it without")


def _set(items: Sequence[tuple[Any, Any]]) -> int:
    bits = 0
    for kind, value in items:
        bits |= 0 if kind.name == "NEGATE" else _characters(kind.name, value)
    return _EVERY & ~bits if items[0][0].name == "NEGATE" else bits


def _category(name: str) -> int:
    """Return what the escapes for digits, spaces, words and their opposites stand for."""
    letter = name.removeprefix("CATEGORY_").removeprefix("NOT_")[0].lower()
    escape = letter.upper() if "_NOT_" in name else letter
    return sum(1 << code for code in range(256) if re.fullmatch(f"\\{escape}", chr(code)))
