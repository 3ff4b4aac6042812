"""The memory of disjoint windows: the same to the last bit, one by one or many at a time."""

import numpy as np

from agent.numerics.window.reference import Reference

COUNT = 192


def test_reference_many_windows_at_once_are_what_they_are_one_by_one(rng: np.random.Generator) -> None:
    information, theta = rng.normal(size=(COUNT, 4, 4)), rng.normal(size=(COUNT, 4))
    A, b = Reference.empty(4).with_windows(information, theta)
    one = Reference.empty(4)
    for i in range(COUNT):
        each = one.with_windows(information[i : i + 1], theta[i : i + 1])
        one = Reference(each[0][-1], each[1][-1])
        np.testing.assert_array_equal(one.A, A[i])
        np.testing.assert_array_equal(one.b, b[i])
