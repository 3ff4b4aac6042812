from decimal import ROUND_HALF_EVEN, Decimal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.timestamps import column_to_ns, text_to_ns

DIGITS = st.text("0123456789", max_size=14)


@st.composite
def decimals(draw: st.DrawFn) -> str:
    whole, part = draw(st.text("0123456789", max_size=10)), draw(DIGITS)
    sign = draw(st.sampled_from(["", "-", "+"]))
    text = whole + draw(st.sampled_from([".", ""])) * bool(whole) + part if part == "" else f"{whole}.{part}"
    return sign + (text if any(map(str.isdigit, text)) else "0")


def exact(text: str) -> int | None:
    nanoseconds = int((Decimal(text) * 10**9).to_integral_value(ROUND_HALF_EVEN))
    return nanoseconds if abs(nanoseconds) < 2**63 else None


def column(cells: list[str]) -> np.ndarray | None:
    text = np.frombuffer(("\n".join(cells) + "\n").encode(), np.uint8)
    ends = np.flatnonzero(text == 10)
    return column_to_ns(text, np.concatenate(([0], ends[:-1] + 1)), ends)


@given(st.lists(decimals(), min_size=1, max_size=20))
def test_column_of_decimals_equals_exact_arithmetic(cells: list[str]) -> None:
    fast = column(cells)
    expected = [exact(cell) for cell in cells]
    assert [text_to_ns(cell) for cell in cells] == expected
    if fast is not None:
        assert fast.tolist() == expected
    else:
        assert any(value is None or abs(value) > 8e18 for value in expected)


def test_ties_round_to_even() -> None:
    fast = column(
        ["0.0000000005", "0.0000000015", "0.00000000050000001", "-0.0000000025", "1700000000.1234567895"]
    )
    assert fast is not None
    assert fast.tolist() == [0, 2, 1, -2, 1700000000123456790]


@pytest.mark.parametrize(
    "cells", [["1e-3"], ["1", "x"], ["1", ""], ["1.2.3"], ["."], ["1-2"], ["9999999999"]]
)
def test_column_with_other_cells_is_left_to_the_slow_way(cells: list[str]) -> None:
    assert column(cells) is None


@pytest.mark.parametrize(
    ("text", "nanoseconds"),
    [
        ("1e-3", 1_000_000),
        (" 2.5E+01 ", 25 * 10**9),
        ("1970-01-01T00:00:01Z", 10**9),
        ("1970-01-01 00:00:01.5", 1_500_000_000),
        ("1970-01-01T01:00:00.000000001+01:00", 1),
        ("1969-12-31T23:59:59.25Z", -750_000_000),
        ("2024-02-29T12:00Z", 1709208000 * 10**9),
        ("abc", None),
        ("nan", None),
        ("1e999", None),
        ("2023-02-29T12:00Z", None),
        ("", None),
    ],
)
def test_text_of_a_time_is_read_or_refused(text: str, nanoseconds: int | None) -> None:
    assert text_to_ns(text) == nanoseconds
