"""Differences of few numbers, and matrix products whose rows do not depend on how many there are."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.numerics.preprocessing.rows import steps_from
from agent.numerics.window.filtering.products import row_products
from agent.numerics.window.tuning import ROWS

NUMBERS = st.integers(-(2**62), 2**62)


@given(NUMBERS, st.lists(NUMBERS, max_size=5))
def test_steps_are_differences_to_the_number_before(before: int, numbers: list[int]) -> None:
    index = np.array(numbers, dtype=np.int64)
    kept = index.copy()
    np.testing.assert_array_equal(steps_from(before, index), np.diff(index, prepend=np.int64(before)))
    np.testing.assert_array_equal(index, kept)


@pytest.mark.parametrize("count", [1, 2, ROWS - 1, ROWS, ROWS + 1, 3 * ROWS, 3 * ROWS + 5])
def test_row_of_a_product_is_the_same_to_the_last_bit_however_many_there_are(
    count: int, rng: np.random.Generator
) -> None:
    left, right = rng.standard_normal((count, 75)), rng.standard_normal((75, 10))
    alone = [row_products(left[row : row + 1], right)[0] for row in range(count)]
    np.testing.assert_array_equal(row_products(left, right), alone)
    shaped = row_products(left.reshape(count, 3, 25), right[:25])
    assert shaped.shape == (count, 3, 10)
    np.testing.assert_allclose(shaped, left.reshape(count, 3, 25) @ right[:25], rtol=0, atol=1e-12)
