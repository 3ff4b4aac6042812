import math

import pytest

from agent.text import behind, counted, interval, iso_time, number, short_time, with_sd

NAN = float("nan")


@pytest.mark.parametrize(
    ("value", "sd", "text"),
    [
        (25.0612, 0.9123, "25.1 ± 0.9"),
        (25.0612, 0.123, "25.06 ± 0.12"),
        (25.0612, 0.29, "25.06 ± 0.29"),
        (25.0612, 0.296, "25.1 ± 0.3"),
        (-0.012, 0.9, "0.0 ± 0.9"),
        (123456.0, 1234.0, "123500 ± 1200"),
        (7.488e-7, 1.2e-8, "(7.49 ± 0.12)e-07"),
        (3.2e9, 4e7, "(3.20 ± 0.04)e+09"),
        (5.0, NAN, "5"),
        (NAN, 1.0, "-"),
        (5.0, 0.0, "5"),
        (0.0, 2.0, "0.0 ± 2.0"),
    ],
)
def test_with_sd_pair_is_written_to_the_digits_of_its_sd(value: float, sd: float, text: str) -> None:
    assert with_sd(value, sd) == text


@pytest.mark.parametrize(
    ("lower", "upper", "text"),
    [
        (24.8123, 25.3123, "24.81 … 25.31"),
        (-1200.0, 34.0, "-1200 … 0"),
        (7.1e-7, 7.3e-7, "7.1e-07 … 7.3e-07"),
        (None, None, "- … -"),
        (1.0, 1.0, "1 … 1"),
    ],
)
def test_interval_is_written_to_the_digits_of_its_width(
    lower: float | None, upper: float | None, text: str
) -> None:
    assert interval(lower, upper) == text


def test_number_without_a_value_is_a_dash() -> None:
    assert [number(x) for x in (None, NAN, math.inf, 1234567.0, 0.1)] == ["-", "-", "-", "1.23457e+06", "0.1"]


@pytest.mark.parametrize(
    ("t_ns", "text"),
    [
        (0, "1970-01-01T00:00:00.000000000Z"),
        (1_770_000_000_123_456_789, "2026-02-02T02:40:00.123456789Z"),
        (-1, "1969-12-31T23:59:59.999999999Z"),
    ],
)
def test_iso_time_has_nine_decimals(t_ns: int, text: str) -> None:
    assert iso_time(t_ns) == text


def test_short_time_has_milliseconds() -> None:
    assert short_time("2026-02-02T02:40:00.123456789Z") == "2026-02-02 02:40:00.123Z"
    assert short_time(None) == ""


def test_unit_behind_a_number_is_left_out_where_there_is_none() -> None:
    assert [f"3{behind(unit)}" for unit in ("N/m", "", "1", "1/s")] == ["3 N/m", "3", "3", "3 1/s"]


def test_counted_names_one_without_an_s() -> None:
    found = [counted(n, "window") for n in (0, 1, 2, 1234)]
    assert found == ["0 windows", "1 window", "2 windows", "1,234 windows"]
    assert [counted(n, "box", "boxes") for n in (1, 2)] == ["1 box", "2 boxes"]
