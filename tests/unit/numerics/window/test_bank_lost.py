"""Windows that lost readings: the bank against dense generalised least squares, a column a lost reading."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.numerics.window.filtering.hops import HopPlan
from agent.numerics.window.filtering.noise import NoiseModel
from agent.numerics.window.lost import Lost, Taps
from agent.numerics.window.rows import BankRows, Windowed
from agent.numerics.window.stream import Stream
from tests.unit.numerics.window.bank_rigs import BankRig, due, joined
from tests.unit.numerics.window.dense import covariance, free, mean_and_columns
from tests.unit.numerics.window.test_bank_dense import CASES, prior_of

FloatArray = NDArray[np.float64]
Record = tuple[FloatArray, FloatArray]
SAMPLES = 420
POLYNOMIAL: tuple[tuple[int, int, float], ...] = (
    (0, 2, 0.7),
    (-2, 2, -0.1),
    (-1, 2, 0.4),
    (1, 3, 0.3),
    (2, 2, -0.2),
)
"""A reading that several samples hold, before it and after it."""
PLAIN: Taps = [[(0, column, 1.0)] for column in range(4)]
WIDE: Taps = [*PLAIN[:2], POLYNOMIAL, PLAIN[3]]
# (sample, channel): of a window that ends with sample 392 its first samples, both sides of hops, heads, and
# its last
PLACES = (
    (230, 1), (260, 0), (261, 2), (279, 2), (280, 0), (280, 1), (281, 2), (300, 0), (301, 0), (302, 0),
    (312, 2),
    (313, 2), (313, 0), (339, 2), (340, 2), (379, 1), (381, 2), (391, 0), (391, 2), (392, 2),
)  # fmt: skip


def lost_at(places: Sequence[tuple[int, int]], u: FloatArray) -> Lost:
    sample, channel = (np.array(one, dtype=np.int64) for one in zip(*places, strict=True))
    sd = np.where(channel < 2, np.inf, 2.0 + 0.1 * np.arange(len(places)))
    return Lost(sample, channel, sd, channel == 2)


def rows_with(
    rig: BankRig, noise: NoiseModel, plan: HopPlan, record: Record, lost: Lost, taps: Taps,
    longer: tuple[int, ...] = (), portion: int = SAMPLES,
) -> BankRows:  # fmt: skip
    stream = Stream(rig.model, rig.push, noise, plan, longer, rig.interest, taps)
    pieces = []
    for start in range(0, len(record[0]), portion):
        stop = min(start + portion, len(record[0]))
        stream.append(start, np.hstack(record)[start:stop], lost.between(start, stop))
        pieces += due(stream)
    return joined(pieces)


@dataclass(frozen=True)
class Truth:
    """Normal equations with the lost readings out, their answers, and what is needed for a jump."""

    H: FloatArray
    g: FloatArray
    rss: float
    values: FloatArray
    sds: FloatArray
    x0: FloatArray
    rest: FloatArray
    root: FloatArray
    whitened: FloatArray
    residual: FloatArray
    psi: FloatArray

    def glr(self, jump: FloatArray, prior: FloatArray) -> float:
        """Drop of the penalised residual by further columns, everything estimated at once."""
        padded = np.vstack(
            [self.whitened @ jump, np.zeros((len(self.root) - len(self.whitened), jump.shape[1]))]
        )
        held = np.hstack([self.rest, self.psi])
        penalty = np.hstack([np.zeros((len(prior), self.rest.shape[1])), np.diag(np.sqrt(prior))])
        few = np.vstack([held, penalty])
        more = np.hstack([few, np.vstack([padded, np.zeros((len(prior), jump.shape[1]))])])
        y = np.concatenate([self.residual, np.zeros(len(prior))])
        return left_over(few, y) - left_over(more, y)


def left_over(X: FloatArray, y: FloatArray) -> float:
    keep = np.linalg.norm(X, axis=0)
    Q = np.linalg.qr(X / np.where(keep > 0, keep, 1.0))[0]
    return float(np.sum((y - Q @ (Q.T @ y)) ** 2))


def truth(
    rig: BankRig, noise: NoiseModel, record: Record, start: int, length: int, lost: Lost, taps: Taps
) -> Truth:
    model = rig.model
    y, u = (one[start : start + length] for one in record)
    inside = lost.between(start, start + length)
    columns = []
    silent = y.reshape(-1) - mean_and_columns(model, u, np.zeros(model.n))[0]
    for sample, channel in zip(inside.sample.tolist(), inside.channel.tolist(), strict=True):
        change = np.zeros((length, model.p + model.m))
        for offset, column, weight in taps[channel]:
            if 0 <= sample + offset - start < length:
                change[sample + offset - start, column] += weight
        driven = mean_and_columns(model, change[:, model.p :], np.zeros(model.n))[0]
        columns.append(driven - change[:, : model.p].reshape(-1))
    k = np.arange(length)
    lines = np.zeros((length, model.p, 2 * len(noise.lines)))
    for i, line in enumerate(noise.lines):
        lines[:, line.channel, 2 * i] = np.cos(line.radians_per_sample * k)
        lines[:, line.channel, 2 * i + 1] = np.sin(line.radians_per_sample * k)
    flat = np.hstack([free(model, length), lines.reshape(length * model.p, -1), np.stack(columns, 1)])
    whiten = np.linalg.inv(np.linalg.cholesky(covariance(model, rig.push, noise, length)))
    known = np.flatnonzero(np.isfinite(inside.sd))
    penalty = np.zeros((len(known), flat.shape[1]))
    at = flat.shape[1] - len(inside)
    penalty[np.arange(len(known)), at + known] = 1 / inside.sd[known]
    rest = np.vstack([whiten @ flat, penalty])
    residual = np.concatenate([whiten @ silent, np.zeros(len(known))])
    scale = np.linalg.norm(rest, axis=0)
    found = np.linalg.lstsq(rest / scale, residual, rcond=None)[0] / scale
    psi = np.vstack(
        [whiten @ mean_and_columns(model, u, found[: model.n])[1], np.zeros((len(known), model.q))]
    )
    Q = np.linalg.qr(rest / scale)[0]
    X, r = psi - Q @ (Q.T @ psi), residual - Q @ (Q.T @ residual)
    X, r = X - Q @ (Q.T @ X), r - Q @ (Q.T @ r)
    both = np.hstack([rest / scale, psi])
    prior = np.diag(np.concatenate([np.zeros(rest.shape[1]), prior_of(rig)]))
    unit = 1 / np.sqrt(np.diag(both.T @ both + prior))
    cov = np.linalg.inv((both.T @ both + prior) * np.outer(unit, unit)) * np.outer(unit, unit)
    mean = cov @ both.T @ residual
    gaps = slice(at, flat.shape[1])
    return Truth(
        X.T @ X, X.T @ r, float(r @ r), (mean / np.append(scale, np.ones(model.q)))[gaps],
        np.sqrt(np.diag(cov)[gaps]) / scale[gaps], found[: model.n], rest, rest, whiten, residual, psi,
    )  # fmt: skip


def compared(rig: BankRig, noise: NoiseModel, record: Record, windowed: Windowed, i: int, length: int,
             lost: Lost, taps: Taps) -> Truth:  # fmt: skip
    start = int(windowed.index[i]) + 1 - length
    dense = truth(rig, noise, record, start, length, lost, taps)
    normal, prior = windowed.normal, np.diag(prior_of(rig))
    cov, exact = (np.linalg.inv(H + prior) for H in (normal.H[i], dense.H))
    sd = np.sqrt(np.diag(exact))
    assert np.max(np.abs(cov @ normal.g[i] - exact @ dense.g) / sd) < 1e-6
    assert np.max(np.abs(cov - exact) / np.outer(sd, sd)) < 1e-6
    assert normal.rss[i] == pytest.approx(dense.rss, rel=1e-6)
    held = lost.between(start, start + length)
    assert windowed.lost[i] == np.isinf(held.sd).sum()
    assert not windowed.unsolved[i]
    if windowed.jumps is None:
        return dense
    asked = next(one for one in windowed.asked if one.index == windowed.index[i])
    value = asked.value + asked.slope @ (cov @ normal.g[i])
    spread = np.sqrt(np.diag(asked.covariance + asked.slope @ cov @ asked.slope.T))
    assert asked.sample.tolist() == held.sample[held.asked].tolist()
    assert np.max(np.abs(value - dense.values[held.asked]) / dense.sds[held.asked]) < 1e-6
    assert spread == pytest.approx(dense.sds[held.asked], rel=1e-6)
    return dense


NAMES = (
    "sensor noise only",
    "white forces",
    "coloured force",
    "both coloured",
    "line and colour",
    "no constants",
)


@pytest.mark.parametrize("taps", [PLAIN, WIDE], ids=["one tap", "several taps"])
@pytest.mark.parametrize("name", NAMES)
def test_windows_that_lost_readings_equal_dense_least_squares_with_a_column_each(
    name: str, taps: Taps
) -> None:
    rig, noise = CASES[name]
    rng = np.random.default_rng(7)
    record = rig.record(rng, noise, SAMPLES, 0.02 * rng.standard_normal(rig.model.n))
    lost = lost_at(PLACES, record[1])
    for sample, channel in PLACES:  # filled in wrongly
        record[channel >= 2][sample, channel % 2] += 1e-3 if channel < 2 else 1.5
    rows = rows_with(rig, noise, HopPlan(133, 20), record, lost, taps, (3, 8))
    for windowed, length in zip(rows.windows, (133, 73, 173), strict=True):
        assert windowed is not None
        for i in (-2, -1):
            dense = compared(rig, noise, record, windowed, i, length, lost, taps)
        jumps = windowed.jumps
        if jumps is None:
            continue
        at = int(np.searchsorted(windowed.index, jumps.index[-1]))
        dense = compared(rig, noise, record, windowed, at, length, lost, taps)
        u = record[1][windowed.index[at] + 1 - length : windowed.index[at] + 1]
        cov = np.linalg.inv(windowed.normal.H[at] + np.diag(prior_of(rig)))
        found = jumps.part(slice(-1, None)).glr((cov @ windowed.normal.g[at])[None], cov[None])[0]
        for value, samples in zip(found, jumps.samples, strict=True):
            columns = mean_and_columns(rig.model, u, dense.x0, length - samples)[1][:, : rig.interest]
            assert value == pytest.approx(dense.glr(columns, prior_of(rig)), rel=1e-5, abs=1e-5)


@pytest.mark.parametrize("window", [133, 140])
def test_rows_with_lost_readings_are_the_same_to_the_last_bit_however_samples_arrive(window: int) -> None:
    rig, noise = CASES["coloured force"]
    record = rig.record(np.random.default_rng(3), noise, SAMPLES, np.zeros(4))
    lost, plan = lost_at(PLACES, record[1]), HopPlan(window, 20)
    whole = rows_with(rig, noise, plan, record, lost, WIDE, (8,))
    for portion in (13, 137):
        portions = rows_with(rig, noise, plan, record, lost, WIDE, (8,), portion)
        for one, other in zip(whole.windows, portions.windows, strict=True):
            assert one is not None
            assert other is not None
            assert np.array_equal(one.normal.H, other.normal.H)
            assert np.array_equal(one.normal.g, other.normal.g)
            assert np.array_equal(one.normal.rss, other.normal.rss)
            assert np.array_equal(one.lost, other.lost)
            if one.jumps is not None and other.jumps is not None:
                assert np.array_equal(one.jumps.cross, other.jumps.cross)


def test_windows_before_and_after_lost_readings_are_those_of_a_bank_that_lost_nothing() -> None:
    rig, noise = CASES["white forces"]
    record = rig.record(np.random.default_rng(3), noise, SAMPLES, np.zeros(4))
    lost, plan = lost_at(((231, 2), (239, 0)), record[1]), HopPlan(133, 20)
    some, none = (rows_with(rig, noise, plan, record, one, WIDE).windows[0] for one in (lost, Lost.none()))
    assert some is not None
    assert none is not None
    differ = ~np.all(some.normal.g == none.normal.g, axis=1)
    holds = (some.index >= 231) & (some.index - 132 <= 239)
    assert np.array_equal(differ, holds)


def test_a_window_that_lost_more_than_can_be_eliminated_is_not_solved(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("agent.numerics.window.lost.MOST_EVENTS", 5)
    rig, noise = CASES["white forces"]
    record = rig.record(np.random.default_rng(3), noise, SAMPLES, np.zeros(4))
    lost = lost_at([(200 + i, 0) for i in range(8)], record[1])
    windowed = rows_with(rig, noise, HopPlan(133, 20), record, lost, PLAIN).windows[0]
    assert windowed is not None
    assert windowed.unsolved.any()
    assert np.array_equal(windowed.unsolved, (windowed.index >= 220) & (windowed.index - 132 <= 202))
