"""Patterns that can be held against any line are taken, all others are refused before the first line."""

import re
import time

import pytest

from drivers.serial.patterns import check, effort
from drivers.serial.tuning import EFFORT, LONGEST

TAKEN = [
    r"#(?P<n>\d+) a=(?P<a>\S+) b=(?P<b>\S+)",
    r".*F=(?P<f>\S+).*",
    r"(?P<f>[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?)\s*N",
    r"(?P<a>[^;]*);(?P<b>[^;]*);",
    r"(?i)f=(?P<f>\d+)g",
    r"(?P<f>-?\d+|NaN)(?:\s+\S+)*",
    r"(?P<f>.+?),.*",
    r"^(?P<f>\d{1,6})\D(?P<g>\d{1,6})$",
    r"(?P<f>(?>\d+)) kg",
]
REFUSED = [
    r"(?P<f>a+)+b",
    r"(?P<f>(?:a|aa)*)b",
    r"(?P<f>(?:\d+,?)*)x",
    r"(?P<f>(?:\w+\s?)*)!",
    r"(?P<f>(?:a*)*)b",
    r"(?P<f>(?:a?){30}a{30})",
    r".*a=(?P<a>\S+).*b=(?P<b>\S+).*",
    r"(?P<f>" + "a?" * 25 + "a" * 25 + ")",
    r"(?i)(?P<f>(?:A|aa)*)b",
    r"(?P<f>.*).*.*x",
]


@pytest.mark.parametrize("text", TAKEN)
def test_pattern_without_overlapping_repeats_is_taken_and_quick_on_the_worst_lines(text: str) -> None:
    assert effort(text) <= EFFORT
    pattern = check(text)
    begun = time.process_time()
    for unit in ("a", "1", "F=", ",", " x", "1 ", "a=b=", "-1.5e3", ";", "\xff"):
        pattern.fullmatch((unit * LONGEST)[: LONGEST - 1] + "\0")
    assert time.process_time() - begun < 4.0


@pytest.mark.parametrize("text", REFUSED)
def test_pattern_that_can_take_for_ever_is_refused_with_advice(text: str) -> None:
    re.compile(text)
    with pytest.raises(
        ValueError, match=r"very long on a line that does not match: repeats overlap; say what lies"
    ):
        check(text)


@pytest.mark.parametrize(
    "text", [r"(?P<f>\d+)(?P=f)", r"(?=a)(?P<f>\w)", r"(?P<f>\w)(?<!a)", r"(?P<f>a)?(?(f)b|c)"]
)
def test_pattern_that_looks_around_or_back_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="looks ahead, behind or back"):
        check(text)


def test_pattern_that_doubles_its_time_is_one_of_those_refused() -> None:
    def seconds(length: int) -> float:
        begun = time.process_time()
        re.compile(r"(?P<f>a+)+b").fullmatch("a" * length)
        return time.process_time() - begun

    assert seconds(22) > 4 * seconds(14)  # the danger is real in this Python
