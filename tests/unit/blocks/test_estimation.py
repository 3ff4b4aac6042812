"""What a row is worth: status, reason, held values and their ages, counts, intervals."""

import pickle
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.blocks.estimation import Estimation, Labels
from agent.numerics.estimator.outcome import Outcome
from agent.types import EstimateBatch, FloatArray, IntArray, Reason, Samples, Status

BoolArray = NDArray[np.bool_]
START = 1_760_000_000_123_456_789
HOP = 10


@dataclass
class Told:
    """A method that says what it was told: a row every tenth sample."""

    sd: dict[int, float] = field(default_factory=dict)
    changing: set[int] = field(default_factory=set)
    mismatch: set[int] = field(default_factory=set)
    segments: int = 0
    spikes: int = 0

    def knowledge(self) -> str | None:
        return None

    def adopt(self, content: str) -> None: ...

    def start_segment(self) -> None:
        self.segments += 1

    def step(
        self, index: int, y: FloatArray, u: FloatArray, _missing: BoolArray | None = None,
        _suspect: BoolArray | None = None,
    ) -> Outcome:  # fmt: skip
        due = np.array([i for i in range(index, index + len(y)) if i % HOP == HOP - 1], dtype=np.int64)
        rows = Outcome.warming(due, 2)
        for row, i in enumerate(due.tolist()):
            if i >= 29:
                rows.dof[row], rows.window[row] = 40.0, 30
                rows.theta[row], rows.sd[row] = [i, 2.0 * i], [self.sd.get(i, 0.1), 0.1]
                rows.lower[row], rows.upper[row] = (
                    rows.theta[row] - rows.sd[row],
                    rows.theta[row] + 3 * rows.sd[row],
                )
                rows.status[row] = np.where(rows.sd[row] < 1.0, Status.VALID, Status.UNEXCITED)
            if i in self.changing or i in self.mismatch:
                rows.invalidate(row, Reason.CHANGING if i in self.changing else Reason.MISMATCH)
        return rows


def estimation(method: Told) -> Estimation:
    labels = Labels(
        "rig",
        "told",
        ("k", "B"),
        ("N/m", "N s/m"),
        np.zeros(2),
        None,
        30,
        30,
        HOP,
        1000.0,
        0,
        np.array([1.0, 1.0]),
    )
    return Estimation(method, labels)


def feed(block: Estimation, cuts: list[int], total: int = 100) -> list[EstimateBatch]:
    batches = []
    for start, stop in zip([0, *cuts], [*cuts, total], strict=True):
        index: IntArray = np.arange(start, stop, dtype=np.int64)
        samples = Samples(
            index, START + index * 1_000_000, np.zeros((len(index), 1)), np.zeros((len(index), 1)), 0
        )
        batch = block.step(samples).batch
        batches += [] if batch is None else [batch]
    return batches


def column(batches: list[EstimateBatch], name: str) -> FloatArray:
    return np.concatenate([getattr(b, name) for b in batches])


def test_estimation_rows_get_their_status_and_reason() -> None:
    method = Told(sd={49: 5.0, 59: np.inf, 69: np.nan}, changing={79}, mismatch={89})
    batches = feed(estimation(method), [])
    status, reason = column(batches, "status"), column(batches, "reason")
    W, V, U, I = Status.WARMING, Status.VALID, Status.UNEXCITED, Status.INVALID
    assert status[:, 0].tolist() == [W, W, V, V, U, U, U, I, I, V]
    assert status[:, 1].tolist() == [W, W, V, V, V, V, V, I, I, V]
    assert reason[:, 0].tolist() == [0, 0, 0, 0, 0, 0, 0, Reason.CHANGING, Reason.MISMATCH, 0]
    valid = status == V
    for name in ("value", "sd", "lower", "upper"):
        assert np.isfinite(column(batches, name)[valid]).all()
    assert np.isnan(column(batches, "value")[:2]).all()


def test_estimation_interval_is_the_methods_own_however_skewed() -> None:
    (batch,) = feed(estimation(Told()), [])
    np.testing.assert_allclose(batch.upper[4] - batch.value[4], 0.3)
    np.testing.assert_allclose(batch.value[4] - batch.lower[4], 0.1)


def test_estimation_not_valid_holds_the_last_valid_with_its_age() -> None:
    (batch,) = feed(estimation(Told(sd={49: 5.0, 59: 5.0}, changing={69})), [])
    np.testing.assert_array_equal(batch.held[4:7], [[39, np.nan], [39, np.nan], [39, 118]])
    np.testing.assert_array_equal(batch.held_age_s[4:7], [[0.01, np.nan], [0.02, np.nan], [0.03, 0.01]])
    assert np.isnan(batch.held[:4]).all()


@pytest.mark.parametrize("cuts", [[5, 50], [29, 30, 31], list(range(10, 100, 10)), list(range(1, 100))])
def test_estimation_any_cutting_gives_the_same_rows_to_the_last_bit(cuts: list[int]) -> None:
    def method() -> Told:
        return Told(sd={39: 5.0, 49: 5.0}, changing={69, 79}, mismatch={89})

    whole, cut = feed(estimation(method()), []), feed(estimation(method()), cuts)
    for name in (
        "index",
        "t_ns",
        "value",
        "sd",
        "status",
        "reason",
        "held",
        "held_age_s",
        "n_used",
        "window_s",
    ):
        np.testing.assert_array_equal(column(cut, name), column(whole, name), err_msg=name)


def test_estimation_gap_starts_the_method_anew_and_counts_every_sample() -> None:
    method = Told()
    block = estimation(method)
    feed(block, [])
    index: IntArray = np.arange(200, 250, dtype=np.int64)
    block.step(Samples(index, START + index, np.zeros((50, 1)), np.zeros((50, 1)), 1))
    assert method.segments == 1
    assert block.used == 150


def test_estimation_warming_row_says_how_many_samples_there_are() -> None:
    batches = feed(estimation(Told()), [7, 13])
    assert column(batches, "n_used").tolist() == [10, 20, 30, 30, 30, 30, 30, 30, 30, 30]


def test_estimation_counts_what_windows_lack_and_forgets_what_no_window_reaches() -> None:
    block, sizes, counts = estimation(Told()), [], []
    for start in range(0, 20_000, 100):
        index: IntArray = np.arange(start, start + 100, dtype=np.int64)
        missing = np.zeros((100, 2), dtype=bool)
        missing[::10, 0] = True
        samples = Samples(index, START + index, np.zeros((100, 1)), np.zeros((100, 1)), 0, missing)
        batch = block.step(samples).batch
        assert batch is not None
        counts.append(batch.n_missing)
        sizes.append(len(pickle.dumps(block)))
    assert np.unique(np.concatenate(counts[1:])).tolist() == [3]
    assert max(sizes) <= sizes[2] + 100


def test_estimation_failure_of_a_call_that_ends_no_row_is_said_at_its_newest_sample() -> None:
    @dataclass
    class Failing(Told):
        def step(self, index: int, y: FloatArray, u: FloatArray, *masks: BoolArray | None) -> Outcome:
            return replace(Told.step(self, index, y, u, *masks), failures=((index + len(y) - 1, "planted"),))

    index: IntArray = np.arange(4, dtype=np.int64)
    samples = Samples(index, START + index, np.zeros((4, 1)), np.zeros((4, 1)), 0)
    found = estimation(Failing()).step(samples)
    assert found.batch is None
    assert (found.failures, found.newest_ns) == (((3, "planted"),), START + 3)
    assert found.times([1]) == {1: START + 3}


@dataclass
class Sharp(Told):
    """Its rows differ from one another by a tenth of what they may be off."""

    def step(self, index: int, *others: Any) -> Outcome:
        rows = super().step(index, *others)
        return replace(rows, sd_repeat=0.1 * rows.sd)


def test_rows_too_vague_against_nominal_are_valid_against_a_reference_learnt_of_the_same_rig() -> None:
    vague = dict.fromkeys(range(30, 80), 4.0) | dict.fromkeys(range(80, 90), 40.0)
    nominal = estimation(Sharp(sd=vague))
    learnt = estimation(Sharp(sd=vague, changing={69}))
    learnt.labels = replace(
        learnt.labels, baseline_id=(7, None), reference_sd=(0.5, float("nan")), enough=np.array([1.0, 1.0])
    )
    before, after = (np.concatenate([b.status[:, 0] for b in feed(block, [])]) for block in (nominal, learnt))
    assert before.tolist() == [Status.WARMING] * 2 + [Status.VALID] + [Status.UNEXCITED] * 6 + [Status.VALID]
    told = [Status.VALID] * 4 + [Status.INVALID] + [Status.VALID] + [Status.UNEXCITED] + [Status.VALID]
    assert after.tolist() == [Status.WARMING] * 2 + told
