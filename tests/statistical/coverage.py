"""Runs on a constant rig whose readings are disturbed in one way: do the stated intervals hold the truth?

Every disjoint window of a run counts; one of a status other than valid counts as not covering.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.signal import butter, lfilter

from agent.blocks.estimation import Estimation
from agent.runtime.assembly.methods import make_estimation
from agent.runtime.playing import Track
from agent.runtime.replay import SOURCE, make_pipeline, opened
from agent.types import EstimateBatch, FloatArray, Samples, Status
from tests.statistical.machine import NAMES, SECOND, Machine, configuration, each, fresh, on_second

TRUTH = np.array([27.0, 95.0, 5.4, 4.7])
FORCE_N = 5.0
WARM = 5 * SECOND
STEP_M, STEP_N = 0.05 / 2**15, 50.0 / 2**15
"""Steps of 16 bits over +- 50 mm and +- 50 N."""
JITTER_S = 200e-6


@dataclass(frozen=True, slots=True)
class Readings:
    """Force (N,) and displacements (N, 2) as sensors gave them."""

    force: FloatArray
    y: FloatArray


@dataclass(frozen=True, slots=True)
class Case:
    """How a rig is disturbed and looked at.

    Attributes:
        readings: (rng, samples) -> readings.
        noise_sd: what the configuration says of the displacements' noise, m; None for nothing.
        window_s: of the estimator.
        limits: of the alarms, in each parameter's unit; 10 % of nominal where empty.
        skip: windows at the start that do not count.
        windows: that count.
        steps: of the wire, (force, displacement).
        recorded: read from a recording without a source instead, which has to show its steps by itself.
    """

    readings: Callable[[np.random.Generator, int], Readings]
    noise_sd: float | None = None
    window_s: float = 1.0
    limits: tuple[float, ...] = ()
    skip: int = 0
    windows: int = 6
    steps: tuple[float, float] = (0.0, 0.0)
    recorded: bool = False


@dataclass(frozen=True, slots=True)
class Coverage:
    """Shares over runs and windows, one a parameter: valid windows; windows whose interval has the truth."""

    valid: FloatArray
    covered: FloatArray

    def __str__(self) -> str:
        cells = zip(NAMES, self.valid, self.covered, strict=True)
        return ", ".join(
            f"{name} {100 * covered:.1f} % ({100 * valid:.1f} % valid)" for name, valid, covered in cells
        )


def motion(
    rng: np.random.Generator,
    samples: int,
    force_n: float = FORCE_N,
    unknown: tuple[float, float] = (0.0, 0.0),
) -> Readings:
    """The rig in steady motion under a white force, and forces (on each mass) that nobody measures."""
    known = on_second(force_n * rng.standard_normal(WARM + samples + 1))
    forces = known + np.array(unknown) * rng.standard_normal(known.shape)
    states = Machine.at_rest(TRUTH).play(forces)[WARM:]
    return Readings(known[WARM:-1, 1], states[:, :2])


def coloured(rng: np.random.Generator, samples: int, sigma: float, pole: float) -> Readings:
    """Sensor noise of rms sigma that remembers itself by a factor `pole` a sample; 0 is white."""
    found = motion(rng, samples)
    noise = rng.standard_normal((samples + 2000, 2))
    noise = lfilter([sigma * np.sqrt(1.0 - pole**2)], [1.0, -pole], noise, axis=0)[2000:]
    return Readings(found.force, found.y + noise)


def pushed(rng: np.random.Generator, samples: int, unknown: tuple[float, float]) -> Readings:
    """Unmeasured force noise beside a measured force of 20 N rms."""
    found = motion(rng, samples, 20.0, unknown)
    return Readings(found.force, found.y + 5e-6 * rng.standard_normal(found.y.shape))


def quantised(rng: np.random.Generator, samples: int) -> Readings:
    """No noise but the rounding of the wire."""
    found = motion(rng, samples)
    return Readings(np.round(found.force / STEP_N) * STEP_N, np.round(found.y / STEP_M) * STEP_M)


def jittered(rng: np.random.Generator, samples: int, sigma: float) -> Readings:
    """Displacements read up to a few hundred microseconds off their instants, all channels together."""
    smooth, lag = butter(2, 20.0, fs=1000.0), 2000
    force = FORCE_N * lfilter(*smooth, rng.standard_normal(WARM + samples + 1 + lag))[lag:]
    machine = Machine.at_rest(TRUTH)
    forces = on_second(force)
    states = machine.play(forces)
    rates = machine.rates(states, forces[:-1])
    late = (JITTER_S * rng.standard_normal((len(states), 1))).clip(-9e-4, 9e-4)
    y = states[:, :2] + late * states[:, 2:] + 0.5 * late**2 * rates
    return Readings(force[WARM:-1], y[WARM:] + sigma * rng.standard_normal((samples, 2)))


PAPER_LIMITS = (15.0, 20.0, 2.0, 2.0)
CASES: Mapping[str, Case] = {
    "white": Case(partial(coloured, sigma=5e-6, pole=0.0), noise_sd=5e-6),
    "white, to be learnt": Case(partial(coloured, sigma=5e-6, pole=0.0)),
    "AR(1) 0.9": Case(partial(coloured, sigma=5e-6, pole=0.9)),
    "AR(1) 0.99": Case(partial(coloured, sigma=1e-6, pole=0.99), skip=5, windows=20),
    "force on m1": Case(partial(pushed, unknown=(0.5, 0.0)), window_s=4.0, limits=PAPER_LIMITS, windows=4),
    "force on m2": Case(partial(pushed, unknown=(0.0, 0.5)), window_s=4.0, limits=PAPER_LIMITS, windows=4),
    "16 bits": Case(quantised, steps=(STEP_N, STEP_M)),
    "16 bits, recorded": Case(quantised, recorded=True),
    "200 us of jitter": Case(partial(jittered, sigma=40e-6), limits=PAPER_LIMITS),
    "200 us of jitter above all": Case(partial(jittered, sigma=1e-6), limits=PAPER_LIMITS),
    "200 us of jitter beside a stated noise": Case(
        partial(jittered, sigma=5e-6), noise_sd=5e-6, limits=PAPER_LIMITS
    ),
}


def cover(name: str, runs: int, first: int = 0) -> Coverage:
    """Play runs of a case and count, on two processes."""
    found = each(partial(_run, name), range(first, first + runs))
    valid, covered = (np.array(part) for part in zip(*found, strict=True))
    return Coverage(valid.mean(axis=(0, 1)), covered.mean(axis=(0, 1)))


def _run(name: str, seed: int) -> tuple[FloatArray, FloatArray]:
    """(windows, q) whether each disjoint window is valid, and whether its interval holds the truth."""
    case = CASES[name]
    width = round(case.window_s * SECOND)
    samples = (case.skip + case.windows) * width
    read = case.readings(np.random.default_rng([seed, *name.encode()]), samples)
    batches = _replayed(case, read) if case.recorded else _estimated(name, case, read)
    rows, lower, upper, status = (
        np.concatenate([getattr(batch, part) for batch in batches])
        for part in ("index", "lower", "upper", "status")
    )
    ends = np.searchsorted(rows, (np.arange(case.skip, case.skip + case.windows) + 1) * width - 1)
    valid = status[ends] == Status.VALID
    return valid.astype(float), (valid & (lower[ends] <= TRUTH) & (upper[ends] >= TRUTH)).astype(float)


def _estimated(name: str, case: Case, read: Readings) -> list[EstimateBatch]:
    block = fresh(name, partial(_estimation, case))
    index = np.arange(len(read.force), dtype=np.int64)
    parts = np.split(index, range(10_000, len(index), 10_000))
    found = [block.step(Samples(i, i * 1_000_000, read.force[i, None], read.y[i], 0)).batch for i in parts]
    return [batch for batch in found if batch is not None]


def _replayed(case: Case, read: Readings) -> list[EstimateBatch]:
    config = configuration(case.noise_sd, case.window_s, case.limits)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.npz"
        x1, x2 = read.y.T
        np.savez(path, t=np.arange(len(read.force)) / SECOND, force=read.force, x1=x1, x2=x2)
        driver = opened(config, path)
        pipeline = make_pipeline(config, [Track(SOURCE, driver, (), {})])
        records = pipeline.step(SOURCE, driver.read(1.0), None, None) + pipeline.finish()
        driver.close()
    return [record for record in records if isinstance(record, EstimateBatch)]


def _estimation(case: Case) -> Estimation:
    config = configuration(case.noise_sd, case.window_s, case.limits)
    return make_estimation(config, np.full(2, case.steps[1]))
