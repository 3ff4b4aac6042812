"""The jump-and-drift scene for all methods in one table: python -m tests.bench.comparison (part of make
bench).

Columns: root mean square error after a jump (rows whose 250 samples lie behind the last jump) and in the
drift, in per cent of nominal, mean over the four parameters, once over the rows that the method itself calls
valid and once over all rows, the newest valid value standing in; `bad rows` are those not given or marked not
valid; delay from a jump until every parameter stays within its alarm limit of the truth; coverage of the 95 %
intervals after jumps; microseconds a sample in the scene and, without changes, over a long record; and by how
much another past (other parameters, other force) moves an estimate from the same window, in per cent of
nominal. "none": no valid row.
"""

import os

# small products are ten times slower on two threads; must stand before numpy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from numpy.typing import NDArray

from agent.evaluation.compare import joint, rivals
from tests.bench.contenders import Contender, Estimates, contenders
from tests.bench.scene import (
    DRIFT_FROM,
    END,
    JUMPS,
    NOMINAL,
    PERIOD,
    WINDOW,
    Record,
    play,
    rig,
    schedule,
    two_pasts,
)

FloatArray = NDArray[np.float64]
LIMITS = np.array([15.0, 20.0, 2.0, 2.0])
SIGMAS = (1e-6, 1e-5)
SEEDS = (11, 12, 13)
TUNING_SEED = 1
STEADY = {
    "seed as printed": 20_000,
    "joint UKF": 3_000,
    "joint EKF": 20_000,
    "RLS": 20_000,
    "seed re-centred": 2_000,
}
"""Samples of the record without changes; 1,310,720 for those not named."""
ROUNDS = 5


@dataclass(frozen=True, slots=True)
class Score:
    """What a method showed on one record; the fields are the columns of the table."""

    jump: float
    jump_shown: float
    drift: float
    drift_shown: float
    bad: float
    delay_s: float
    coverage: float
    microseconds: float


def score(found: Estimates, record: Record) -> Score:
    """Judge one run against the truth."""
    error = found.theta - record.theta[found.index]
    behind = np.min([np.where(found.index >= s, found.index - s, END) for s, _ in JUMPS], axis=0)
    after_jump = (found.index < DRIFT_FROM) & (behind >= WINDOW - 1)
    in_drift = found.index >= DRIFT_FROM + WINDOW
    assessed = found.valid & np.isfinite(error)
    inside = np.abs(error) <= found.half
    counted = assessed & after_jump[:, None]
    shown, everything = found.shown - record.theta[found.index], np.ones_like(assessed)
    return Score(
        jump=_rms(error, assessed, after_jump),
        jump_shown=_rms(shown, everything, after_jump),
        drift=_rms(error, assessed, in_drift),
        drift_shown=_rms(shown, everything, in_drift),
        bad=1.0 - float(np.mean(assessed[after_jump | in_drift])),
        delay_s=float(np.mean([_delay(found, error, assessed, start) for start, _ in JUMPS[1:]])),
        coverage=float(np.mean(inside[counted])) if counted.any() else float("nan"),
        microseconds=found.microseconds,
    )


def _rms(error: FloatArray, assessed: NDArray[np.bool_], rows: NDArray[np.bool_]) -> float:
    """Per cent of nominal, mean over parameters; nan where a parameter has no row that counts."""
    columns = [error[assessed[:, i] & rows, i] / NOMINAL[i] for i in range(error.shape[1])]
    return float(np.mean([100.0 * np.sqrt(np.mean(c**2)) if len(c) else np.nan for c in columns]))


def _delay(found: Estimates, error: FloatArray, assessed: NDArray[np.bool_], start: int) -> float:
    """Seconds from a jump to the row from which nothing leaves its limit; 1 where that does not come."""
    rows = (found.index >= start) & (found.index < start + 1000)
    wrong = np.any(assessed[rows] & ~(np.abs(error[rows]) <= LIMITS), axis=1) | ~np.any(
        assessed[rows], axis=1
    )
    last = np.flatnonzero(wrong)
    first = 0 if not len(last) else int(last[-1]) + 1
    times = found.index[rows]
    return float(times[first] + 1 - start) * PERIOD if first < len(times) else 1.0


def tuning_score(record: Record) -> Callable[[Estimates], float]:
    """What tuning minimises: the mean of both errors, rows that are not given or not finite count as 100 per
    cent."""

    def total(found: Estimates) -> float:
        assessed = score(found, record)
        return float(
            np.nan_to_num(assessed.jump, nan=1e9)
            + np.nan_to_num(assessed.drift, nan=1e9)
            + 100.0 * assessed.bad
        )

    return total


Result = tuple[Contender, Score, float, float]


@cache
def compare(sigma: float) -> list[Result]:
    """Return each contender with its mean score, steady cost and shift by another past (% of nominal)."""
    tuning_record = play(schedule(), sigma, np.random.default_rng(TUNING_SEED))
    field = contenders(sigma, tuning_record, tuning_score(tuning_record))
    records = [play(schedule(), sigma, np.random.default_rng(seed)) for seed in SEEDS]
    results = []
    for contender in field:
        scores = [score(contender.run(record), record) for record in records]
        mean = Score(
            *(float(np.mean([getattr(s, name) for s in scores])) for name in Score.__dataclass_fields__)
        )
        results.append((contender, mean, steady_cost(contender, sigma), shift_by_past(contender, sigma)))
    return results


def steady_cost(contender: Contender, sigma: float) -> float:
    """Microseconds a sample over a long record without changes, the fastest of several: the machine has other
    work."""
    record = _steady(STEADY.get(contender.name, 1_310_720), sigma)
    return min(contender.run(record).settled for _ in range(ROUNDS))


@lru_cache(maxsize=1)
def _steady(samples: int, sigma: float) -> Record:
    return play(np.tile(NOMINAL, (samples, 1)), sigma, np.random.default_rng(2))


def shift_by_past(contender: Contender, sigma: float) -> float:
    """Largest change of the newest estimate, per cent of nominal, when only samples before its window differ.

    Parameters that the method itself calls not valid do not count; nan where none is left.
    """
    theta, other = (NOMINAL + np.array(JUMPS[i][1]) for i in (0, 2))
    records = two_pasts(theta, other, contender.window + 1750, contender.window, sigma)
    one, two = (contender.run(record) for record in records)
    shift = 100.0 * np.abs(one.theta[-1] - two.theta[-1]) / NOMINAL
    assessed = one.valid[-1] & two.valid[-1]
    return float(np.max(shift[assessed])) if assessed.any() else float("nan")


def joint_ekf_and_filterpys_own() -> tuple[float, float]:
    """Microseconds a sample of the comparison's joint EKF and of filterpy's own predict + update at that
    size.

    In turns, the fastest of each.
    """
    pairs = [(_joint_ekf_step(), _filterpys_own_step()) for _ in range(ROUNDS)]
    ours, own = (min(column) for column in zip(*pairs, strict=True))
    return ours, own


def _filterpys_own_step(steps: int = 4_000) -> float:
    ekf = ExtendedKalmanFilter(dim_x=8, dim_z=2)
    ekf.x, H = np.zeros(8), np.eye(2, 8)
    reading = np.zeros(2)
    start = time.process_time()
    for _ in range(steps):
        ekf.predict()
        ekf.update(reading, lambda _x: H, lambda x: H @ x)
    return 1e6 * (time.process_time() - start) / steps


def _joint_ekf_step(steps: int = 4_000) -> float:
    record = play(np.tile(NOMINAL, (steps, 1)), 1e-6, np.random.default_rng(5))
    polynomial = rivals.Polynomial(rig(), PERIOD)
    start = time.process_time()
    joint.run_ekf(polynomial, 1e-6, rivals.Tuning(1e-3), record.y, record.u)
    return 1e6 * (time.process_time() - start) / steps


def table(sigma: float, results: list[Result]) -> list[str]:
    """Return the lines of one noise level's table, in Markdown."""
    heads = (
        *("method", "jumps %", "all rows", "drift %", "all rows", "bad rows", "delay s", "coverage"),
        *("us/sample", "steady", "other past %", "tuned to"),
    )
    lines = [f"noise {sigma * 1e6:g} um, {len(SEEDS)} records", "", _row(*heads), "|---" * len(heads) + "|"]
    for contender, s, steady, shift in results:
        errors = [_or_none(error) for error in (s.jump, s.jump_shown, s.drift, s.drift_shown)]
        delay = ">= 1" if s.delay_s >= 1.0 else f"{s.delay_s:.2f}"
        shares = (f"{100 * s.bad:.0f} %", delay, f"{100 * s.coverage:.0f} %")
        costs = (f"{s.microseconds:.3g}", f"{steady:.3g}")
        lines.append(_row(contender.name, *errors, *shares, *costs, _or_none(shift), contender.tuning))
    return lines


def _row(*cells: str) -> str:
    return "| " + " | ".join(cells) + " |"


def _or_none(figure: float) -> str:
    return "none" if np.isnan(figure) else f"{figure:.3g}"


def main() -> None:
    """Print one table a noise level."""
    ours, own = joint_ekf_and_filterpys_own()
    print(f"joint EKF {ours:.1f} us a step, filterpy's own predict + update {own:.1f} us: {ours / own:.2f} x")
    for sigma in SIGMAS:
        print("\n" + "\n".join(table(sigma, compare(sigma))))


if __name__ == "__main__":
    main()
