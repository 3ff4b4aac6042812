"""Straight lines in the stream: where parameters move, and only there."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.numerics.estimator import moving as room
from agent.numerics.estimator.moving import Moving
from agent.numerics.estimator.window_ml import WindowML
from agent.numerics.window.rows import Rows
from tests.bench.scene import Record, play
from tests.unit.numerics.paper_rig import NOMINAL, rig
from tests.unit.numerics.rigs import settings

FloatArray = NDArray[np.float64]
SIGMA, LINES = 1e-6, 1000
SLOPE = np.array([-5.0, 20.0, 1.0, -1.0]) / 3000
DRIFT_FROM = 1500


def drifting(samples: int) -> FloatArray:
    moved = np.maximum(np.arange(samples) - DRIFT_FROM, 0)[:, None]
    return NOMINAL + moved * SLOPE


def stepping(samples: int) -> FloatArray:
    return np.where(np.arange(samples)[:, None] < DRIFT_FROM, NOMINAL, NOMINAL * [1.0, 0.7, 1.0, 1.0])


def rows_of(record: Record, lines: int | None, cuts: tuple[int, ...] = ()) -> Rows:
    ml = WindowML(rig(), replace(settings(500, 50, SIGMA), drift=lines))
    edges = (0, *cuts, len(record.y))
    return Rows.joined([ml.step(a, record.y[a:b], record.u[a:b]) for a, b in pairwise(edges)], 4)


def believed(rows: Rows) -> NDArray[np.bool_]:
    return np.asarray(rows.full & ~rows.changing & ~rows.mismatch)


def test_moving_lines_follow_what_constants_cannot_tell(rng: np.random.Generator) -> None:
    truth = drifting(4500)
    record = play(truth, SIGMA, rng)
    behind = DRIFT_FROM + LINES
    shares, errors = {}, {}
    for lines in (None, LINES):
        rows = rows_of(record, lines)
        late = rows.index >= behind
        shares[lines] = float(np.mean(believed(rows)[late]))
        told = late & believed(rows)
        errors[lines] = (rows.theta[told] - truth[rows.index[told]]) / rows.sd[told]
    assert shares[None] < 0.7
    assert shares[LINES] == 1.0
    assert np.sqrt(np.mean(errors[LINES] ** 2)) == pytest.approx(1.0, abs=0.3)


def test_moving_rig_at_rest_pays_for_no_line(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    record = play(np.tile(NOMINAL, (6000, 1)), SIGMA, rng)
    plain = rows_of(record, None)
    asked: list[int] = []
    told = room.fit_line
    monkeypatch.setattr(room, "fit_line", lambda *given: (asked.append(1), told(*given))[1])
    lined = rows_of(record, LINES)
    # the first fit moves theta_r; lines are tried for one of their windows behind it, then no more
    assert len(asked) <= LINES // 50 + 1
    for one, other in ((plain.theta, lined.theta), (plain.sd, lined.sd)):
        np.testing.assert_array_equal(one, other)


def test_moving_step_is_no_line(rng: np.random.Generator) -> None:
    record = play(stepping(4000), SIGMA, rng)
    plain, lined = rows_of(record, None), rows_of(record, LINES)
    np.testing.assert_array_equal(plain.changing, lined.changing)
    straddles = lined.index < DRIFT_FROM + 0.9 * LINES
    np.testing.assert_array_equal(plain.theta[straddles], lined.theta[straddles])
    after = believed(lined) & (lined.index >= DRIFT_FROM + 0.9 * LINES)
    assert np.all(np.abs(lined.theta[after, 1] - 70.0) < 0.01 * 70.0)


def test_moving_any_cutting_of_the_stream_gives_the_same_rows(rng: np.random.Generator) -> None:
    record = play(drifting(3500), SIGMA, rng)
    whole = rows_of(record, LINES)
    for cuts in (tuple(range(50, 3500, 50)), tuple(range(97, 3500, 97)), (1700, 2601)):
        cut = rows_of(record, LINES, cuts)
        np.testing.assert_array_equal(whole.changing, cut.changing)
        np.testing.assert_array_equal(whole.window, cut.window)
        np.testing.assert_allclose(whole.theta, cut.theta, atol=1e-9 * NOMINAL.min(), equal_nan=True)


def test_moving_window_after_a_gap_begins_behind_it(rng: np.random.Generator) -> None:
    record = play(drifting(4500), SIGMA, rng)
    ml = WindowML(rig(), replace(settings(500, 50, SIGMA), drift=LINES))
    ml.step(0, record.y[:3000], record.u[:3000])
    ml.start_segment()
    rows = ml.step(3000, record.y[3000:], record.u[3000:])
    assert np.all(rows.window[rows.index < 3000 + LINES - 1] < LINES)
    assert np.any(rows.window[rows.index >= 3000 + LINES - 1] == LINES)


@pytest.mark.parametrize("batch", [1, 7, 100])
def test_moving_a_line_that_tells_keeps_the_search_up_in_any_batch(batch: int, monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[int] = []

    def told(*given: object) -> bool:
        rows, row = given[-2:]
        tried.append(int(rows.index[row]))  # type: ignore[attr-defined]
        return tried[-1] < 3000

    monkeypatch.setattr(Moving, "_is_told", told)
    follower = Moving(LINES)
    hops = 50 * np.arange(1, 101)
    for start in range(0, 100, batch):
        rows = Rows.warming(hops[start : start + batch], 4)
        rows.full[:] = True
        rows.changing[:] = rows.index == 500
        follower.follow(None, None, None, rows, moved=False)  # type: ignore[arg-type]
    assert tried == [index for index in hops.tolist() if 500 <= index < 2950 + LINES]
