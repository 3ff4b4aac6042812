"""Products and courses whose rows do not know how many they are."""

import numpy as np
import pytest

from agent.numerics.window.course import Course
from agent.numerics.window.products import column_products, row_products


@pytest.mark.parametrize(("inner", "width"), [(95, 250), (45, 250), (50, 20), (20, 20), (16, 25), (4, 4), (7, 3)])
def test_products_rows_and_columns_are_equal_alone_and_among_many(
    inner: int, width: int, rng: np.random.Generator
) -> None:
    many, right = rng.normal(size=(200, inner)), rng.normal(size=(inner, width))
    rows, columns = row_products(many, right), column_products(right.T, many.T)
    np.testing.assert_allclose(rows, many @ right, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(columns, rows.T, rtol=1e-12, atol=1e-12)
    for start, stop in [(0, 1), (5, 7), (3, 19), (60, 199), (199, 200)]:
        np.testing.assert_array_equal(row_products(many[start:stop], right), rows[start:stop])
        np.testing.assert_array_equal(column_products(right.T, many[start:stop].T), columns[:, start:stop])


@pytest.mark.parametrize("cuts", [[], [1], [8], [3, 4, 5, 21], list(range(1, 50))], ids=str)
def test_course_over_any_cuts_is_the_recursion_and_the_same_to_the_last_bit(
    cuts: list[int], rng: np.random.Generator
) -> None:
    transition, forced = 0.3 * rng.normal(size=(6, 6)), rng.normal(size=(50, 6))
    start = rng.normal(size=6)
    whole, end = Course.at(start).over(transition, forced)
    expected = [start]
    for one in forced:
        expected.append(transition @ expected[-1] + one)
    np.testing.assert_allclose(whole, expected[:-1], rtol=1e-9, atol=1e-9)
    course, pieces = Course.at(start), []
    for part in np.split(forced, cuts):
        states, course = course.over(transition, part)
        pieces.append(states)
    np.testing.assert_array_equal(np.concatenate(pieces), whole)
    np.testing.assert_array_equal(course.start, end.start)
    np.testing.assert_array_equal(course.gained, end.gained)
    assert course.phase == end.phase == 50 % 8
