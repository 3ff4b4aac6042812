"""What is dense is found, and what only looks so is not."""

import pytest

from tests.lint.density import findings


def body(*lines: str) -> str:
    return "\n    ".join(["def f(self, a, b, c):", *lines, "pass"])


def test_density_five_operators_are_too_many_and_those_of_an_inner_function_are_its_own() -> None:
    outer = body("x = a and b and c", "def g():", "    return a or b", "y = 1 if a else 2 if b else 3")
    assert list(findings(outer)) == []
    ((line, words),) = findings(body("x = a and b and c or a", "y = 1 if a else 2 if b else 3"))
    assert (line, words) == (1, "f has 5 and/or/ternaries, more than 4: name conditions")


def test_density_deep_nesting_is_too_complex() -> None:
    deep = [
        "for a in b:",
        "    while c:",
        "        if a:",
        "            for b in c:",
        "                if b:",
    ]
    ((_, words),) = findings(body(*deep, "                    break"))
    assert words == "f has cognitive complexity 15, more than 10: part it"


@pytest.mark.parametrize(
    ("line", "related"),
    [
        ("a, b = b, a", True),
        ("events, self.events = self.events, []", True),
        ("a, b = c.low, c.high", True),
        ("a, b = float(c.low), float(c.high)", True),
        ("a, b = c[:1], c[1:]", True),
        ("a, b = divmod(c, 2)", True),
        ("a, b = len(c), 0", False),
        ("a, b = c.name, sorted(c)", False),
        ("a, b = [], 0", False),
    ],
)
def test_density_unrelated_values_stand_on_lines_of_their_own(line: str, related: bool) -> None:
    assert [words for _, words in findings(body(line))] == (
        [] if related else [f"unrelated values in one assignment: {line.replace('= ', '= (', 1)})"]
    )
