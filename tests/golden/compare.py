"""Comparison of a committed output with a new one: to the last bit, or across machines to 1e-6 of an sd."""

import re
from collections.abc import Sequence
from itertools import zip_longest

ACROSS = 1e-6
"""Vector units of another width add in another order: descents then end elsewhere within their tolerance, on
AVX2 and AVX-512 up to 2e-7 of an sd apart (a serial line that loses bytes)."""
OF_SD = frozenset({"value", "held", "delta"})
"""What is measured in its line's standard deviation; other numbers are in parts of themselves."""
_HASHED = re.compile(r"^(rows|learnt) .* sha256 \w+$")
_FIGURE = re.compile(r"^([\w.]+)=([-+]?(?:\d+\.\d*(?:e[-+]?\d+)?|\d+e[-+]?\d+|inf))$")


def differences(committed: Sequence[str], found: Sequence[str], *, same_machine: bool) -> list[str]:
    """Return what differs, line by line, in words."""
    shown = []
    for number, (old, new) in enumerate(zip_longest(committed, found, fillvalue="(nothing)"), start=1):
        if old != new and (same_machine or not _near(old, new)):
            shown += [f"{number} - {old}", f"{number} + {new}"]
    return shown


def _near(old: str, new: str) -> bool:
    """Whether two lines differ by less than the rounding of another machine's arithmetic."""
    if all(_HASHED.match(line) for line in (old, new)):
        return old.partition(" sha256 ")[0] == new.partition(" sha256 ")[0]
    olds, news = old.split(), new.split()
    scale = next((float(token[3:]) for token in olds if token.startswith("sd=") and token != "sd=-"), None)
    return len(olds) == len(news) and all(_near_figure(a, b, scale) for a, b in zip(olds, news, strict=True))


def _near_figure(old: str, new: str, sd: float | None) -> bool:
    before, after = _FIGURE.match(old), _FIGURE.match(new)
    if old == new or before is None or after is None or before[1] != after[1]:
        return old == new
    a, b = float(before[2]), float(after[2])
    unit = sd if sd is not None and before[1] in OF_SD else max(abs(a), abs(b))
    return abs(a - b) <= ACROSS * unit
