"""Summaries of stretches: merging is associative, sliding windows equal sums taken one after the other."""

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.numerics.window.filtering.summary import Sliding, Summary

FloatArray = NDArray[np.float64]
STEP = 0.3 * np.random.default_rng(0).standard_normal((5, 5))


def hops(count: int, seed: int = 1) -> Summary:
    rng = np.random.default_rng(seed)
    return Summary(rng.standard_normal((count, 3, 3)), rng.standard_normal((count, 3, 5)))


def test_merging_is_associative() -> None:
    a, b, c = (hops(4, seed) for seed in range(3))
    left = a.merged(b, STEP).merged(c, STEP @ STEP)
    right = a.merged(b.merged(c, STEP), STEP)
    np.testing.assert_allclose(left.moment, right.moment, rtol=1e-13, atol=1e-14)
    np.testing.assert_allclose(left.gram, right.gram, rtol=1e-13, atol=1e-14)


def summed(all_hops: Summary, count: int, last: int) -> Summary:
    total = all_hops.part(slice(last - count, last - count + 1))
    for k in range(1, count):
        at = last - count + k
        total = total.merged(all_hops.part(slice(at, at + 1)), POWERS[k])
    return total


POWERS = [np.linalg.matrix_power(STEP, k) for k in range(131)]


@pytest.mark.parametrize("every", [1, 2, 8])
@pytest.mark.parametrize("size", [1, 7, 200])
def test_sliding_windows_equal_sums_of_their_hops(size: int, every: int) -> None:
    counts = (1, 2, 3, 5, 7, 8, 9, 15, 16, 17, 31, 64, 72, 73, 130)
    record, sliding = hops(200), Sliding([(count, every) for count in counts], STEP)
    found: dict[int, list[Summary]] = {count: [] for count in counts}
    for start in range(0, 200, size):
        for (count, _), windows in sliding.append(record.part(slice(start, start + size))).items():
            found[count].append(windows)
    for count, pieces in found.items():
        windows = pieces[0]
        for piece in pieces[1:]:
            windows = windows.followed(piece)
        ends = [end for end in range(every - 1, 200, every) if end >= count - 1]
        assert len(windows) == len(ends)
        for at in {0, len(ends) // 2, len(ends) - 1}:
            wanted = summed(record, count, ends[at] + 1)
            np.testing.assert_allclose(windows.moment[at], wanted.moment[0], rtol=1e-9, atol=1e-12)
            np.testing.assert_allclose(windows.gram[at], wanted.gram[0], rtol=1e-9, atol=1e-12)
