"""Everything that takes part in the comparison, brought to one form, and how each was tuned.

Tuning is by search on a record of its own, played with the same schedule and noise but another seed than the
records that are scored: the random walk of the joint filters, memory and observer poles of recursive least
squares, observer poles of the re-centred seed. The seed as printed keeps the paper's poles. window-ml is not
tuned: it takes the noise from its configuration, its window is the paper's.
"""

import tempfile
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from agent.config import load
from agent.evaluation.compare import joint, rivals
from agent.numerics.model.observer import poles_gain
from agent.numerics.model.statespace import discretise
from agent.numerics.paper.seed_window import SeedSettings, SeedWindow
from agent.numerics.window.filtering.hops import HopPlan
from agent.runtime.assembly.methods import make_estimation
from agent.types import Samples, Status
from tests.bench.scene import HOP, NOMINAL, PERIOD, WINDOW, Record, rig

FloatArray = NDArray[np.float64]
PRINTED_POLES = -np.array([45.0, 40.0, 35.0, 30.0])
POLE_SCALES = (1.0, 2.0, 3.0, 6.0)
WALKS = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2)
MEMORIES = (0.98, 0.99, 0.996, 0.998)
PASSES = 10
WINDOWS = (
    ("0.25 s", "0.25", 250),
    ("0.5 s", "0.5", 500),
    ("0.25-2 s", "[0.25, 0.5, 1.0, 2.0]", 2000),
)
"""Names of the product's windows, as the configuration says them, and the longest in samples."""
BLOCK = 65_536
"""Samples that window-ml is given at once, as a replay reads them."""


@dataclass(frozen=True, slots=True)
class Estimates:
    """Rows of one run.

    Attributes:
        index: (N,) newest sample of each row.
        theta, half: (N, q) estimates and half the width of their 95 % intervals.
        valid: (N, q) what the method itself says it is sure of; the rivals always are.
        microseconds: processor time a sample; on one thread that is the run time, whatever else the machine
            does.
        settled: the same without the first fifth of the record.
    """

    index: NDArray[np.int64]
    theta: FloatArray
    half: FloatArray
    valid: NDArray[np.bool_]
    microseconds: float
    settled: float

    @property
    def shown(self) -> FloatArray:
        """(N, q) what stands on the screen: the newest valid estimate, nominal before the first."""
        known = np.vstack([NOMINAL, np.where(self.valid, self.theta, np.nan)])
        usable = np.isfinite(known)
        newest = np.maximum.accumulate(np.where(usable, np.arange(len(known))[:, None], 0), axis=0)
        return np.asarray(np.take_along_axis(known, newest, axis=0)[1:])


Run = Callable[[Record], Estimates]


@dataclass(frozen=True, slots=True)
class Contender:
    """A method with the figures that it was tuned to; only the newest `window` samples are to count."""

    name: str
    run: Run
    tuning: str
    window: int = WINDOW


def contenders(sigma: float, tuning_record: Record, score: Callable[[Estimates], float]) -> list[Contender]:
    """Return every method, tuned for a sensor noise on a record of its own."""

    def best(name: str, choices: Iterable[tuple[str, Run]]) -> Contender:
        scored = [(score(run(tuning_record)), text, run) for text, run in choices]
        _, text, run = min(scored, key=lambda entry: entry[0])
        return Contender(name, run, text)

    return [
        Contender("seed as printed", seed_run(1.0, 1), "the paper's poles, one pass"),
        best(
            "seed re-centred", [(f"poles x {s:g}, {PASSES} passes", seed_run(s, PASSES)) for s in POLE_SCALES]
        ),
        best(
            "RLS", [(f"poles x {s:g}, forgets {m:g}", rls_run(s, m)) for s in POLE_SCALES for m in MEMORIES]
        ),
        best("joint EKF", [(f"walk {w:g}", joint_run(joint.run_ekf, sigma, w)) for w in WALKS]),
        best("joint UKF", [(f"walk {w:g}", joint_run(joint.run_ukf, sigma, w)) for w in WALKS]),
        *[
            Contender(f"window-ml {name}", product_run(sigma, s), "not tuned", samples)
            for name, s, samples in WINDOWS
        ],
    ]


def gain(scale: float) -> FloatArray:
    """An observer gain with the paper's poles times a scale."""
    model = discretise(rig().continuous(NOMINAL), PERIOD, "first").model
    return poles_gain(model, (scale * PRINTED_POLES).tolist(), PERIOD)


def seed_run(scale: float, passes: int) -> Run:
    every = np.full(4, np.inf)
    settings = SeedSettings(
        PERIOD, HopPlan(WINDOW, HOP), "first", gain(scale), passes, NOMINAL, every, settled=1e-3
    )

    def run(record: Record) -> Estimates:
        start = time.process_time()
        rows = SeedWindow(rig(), settings).step(0, record.y, record.u)
        spent = time.process_time() - start
        half = 0.5 * (rows.upper - rows.lower)
        return Estimates(
            rows.index, rows.theta, half, np.isfinite(rows.theta), *[1e6 * spent / len(record.y)] * 2
        )

    return run


def rls_run(scale: float, memory: float) -> Run:
    L = gain(scale)
    return _tracked(lambda record: rivals.run_rls(rig(), PERIOD, L, memory, record.y, record.u))


def joint_run(runner: Callable[..., rivals.Track], sigma: float, walk: float) -> Run:
    polynomial, tuning = rivals.Polynomial(rig(), PERIOD), rivals.Tuning(walk)
    return _tracked(lambda record: runner(polynomial, sigma, tuning, record.y, record.u))


def _tracked(track: Callable[[Record], rivals.Track]) -> Run:
    def run(record: Record) -> Estimates:
        start = time.process_time()
        theta, sd = track(record)
        spent = time.process_time() - start
        index = np.arange(HOP - 1, len(record.y), HOP)
        everything = np.ones((len(index), theta.shape[1]), dtype=bool)
        return Estimates(
            index, theta[index], 1.96 * sd[index], everything, *[1e6 * spent / len(record.y)] * 2
        )

    return run


def product_run(sigma: float, window_s: str) -> Run:
    text = (Path(__file__).parent / "scene.toml").read_text(encoding="utf-8")
    text = text.replace("@NOISE@", f"{sigma!r}").replace("@WINDOW@", window_s)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scene.toml"
        file.write_text(text, encoding="utf-8")
        config = load(file)

    def run(record: Record) -> Estimates:
        block = make_estimation(config, np.zeros(2))
        batches, marks = [], [time.process_time()]
        for start in range(0, len(record.y), BLOCK):
            index = np.arange(start, min(start + BLOCK, len(record.y)), dtype=np.int64)
            samples = Samples(index, index * 1_000_000, record.u[index], record.y[index], segment=0)
            batches.append(block.step(samples).batch)
            marks.append(time.process_time())
        first = len(batches) // 5
        per_sample = 1e6 * np.diff(marks)[first:].sum() / (len(record.y) - first * BLOCK)
        index, theta, upper, status = (
            np.concatenate([getattr(batch, name) for batch in batches if batch is not None])
            for name in ("index", "value", "upper", "status")
        )
        whole = 1e6 * (marks[-1] - marks[0]) / len(record.y)
        return Estimates(index, theta, upper - theta, status == Status.VALID, whole, float(per_sample))

    return run
