"""The joint EKF on runs of the detection test: same readings, same alarm rules, its random walk tuned for the
task."""

import numpy as np
import pytest

from agent.blocks.level_alarms import LevelAlarms
from agent.evaluation.compare import joint, rivals
from agent.numerics.model.mechanics import Element, Mass, MassSpringDamper, Output, Structure
from agent.types import EstimateBatch, FloatArray, Status
from tests.statistical.detection import WITHIN, Verdict, assessed, played, raised, verdict
from tests.statistical.machine import MASSES, NAMES, NOMINAL, PERIOD, configuration, each, say
from tests.statistical.operation import NOISE_M

HOP, RUNS, TUNING_RUNS = 50, 50, 12
WALKS = (1e-5, 3e-5, 1e-4, 3e-4, 1e-3, 3e-3)


def model() -> MassSpringDamper:
    masses = tuple(Mass(name, value) for name, value in MASSES.items())
    ends = (("ground", "m1"), ("m1", "m2"))
    springs = tuple(
        Element(name, end, value) for name, end, value in zip(("k1", "k2"), ends, NOMINAL[:2], strict=True)
    )
    dampers = tuple(
        Element(name, end, value) for name, end, value in zip(("B1", "B2"), ends, NOMINAL[2:], strict=True)
    )
    outputs = (Output("displacement", "m1"), Output("displacement", "m2"))
    return MassSpringDamper(Structure(masses, springs, dampers), NAMES, ("m2",), outputs)


def batch(theta: FloatArray, sd: FloatArray) -> EstimateBatch:
    """Rows of the filter at every hop, as the alarm block takes them."""
    index = np.arange(HOP - 1, len(theta), HOP, dtype=np.int64)
    value, sd = theta[index], sd[index]
    none, zero = np.full(value.shape, np.nan), np.zeros(len(index), dtype=np.int64)
    status = np.where(np.isfinite(value), int(Status.VALID), int(Status.INVALID)).astype(np.uint8)
    return EstimateBatch(
        rig="rig", method="ekf", parameters=NAMES, units=("N/m", "N/m", "N s/m", "N s/m"), reference=NOMINAL,
        baseline_id=None, index=index, t_ns=index * 1_000_000, value=value, sd=sd, lower=value - 1.96 * sd,
        upper=value + 1.96 * sd, sd_repeat=sd, status=status, reason=np.zeros(value.shape, dtype=np.uint8),
        held=none,
        held_age_s=none, window_s=np.zeros(value.shape), n_used=zero, n_missing=zero,
        dof=np.full(len(index), np.inf),
    )  # fmt: skip


def ekf_verdict(work: tuple[int, float]) -> Verdict:
    seed, walk = work
    play = played(seed)
    u, y = play.readings[:, :1], play.readings[:, 1:]
    track = joint.run_ekf(rivals.Polynomial(model(), PERIOD), NOISE_M, rivals.Tuning(walk, spread=0.1), y, u)
    alarms = LevelAlarms("rig", configuration(NOISE_M).alarm, 1.0 / PERIOD)
    return assessed(seed, play, raised(alarms.step(batch(*track))))


def faults(found: list[Verdict]) -> int:
    return sum(run.delay is None for run in found) + sum(bool(run.blamed) for run in found)


def line(name: str, found: list[Verdict]) -> str:
    delays = [run.delay for run in found if run.delay is not None]
    median = f"{np.median(delays) / 1000:.2f} s" if delays else "none"
    blamed = sum(bool(run.blamed) for run in found)
    return (
        f"{name}: {len(delays)} of {len(found)} alarmed within {WITHIN / 1000:g} s (median {median}), "
        f"another parameter blamed in {blamed}"
    )


@pytest.mark.bench
def test_detection_misses_and_blames_less_than_the_joint_ekf(request: pytest.FixtureRequest) -> None:
    tuning = {
        walk: faults(each(ekf_verdict, [(90_000 + i, walk) for i in range(TUNING_RUNS)])) for walk in WALKS
    }
    walk = min(tuning, key=lambda candidate: tuning[candidate])
    ekf, ours = each(ekf_verdict, [(seed, walk) for seed in range(RUNS)]), each(verdict, range(RUNS))
    say(request, line("window-ml", ours))
    say(request, line(f"joint EKF, walk {walk:g} of nominal a sample", ekf))
    assert faults(ours) <= faults(ekf)
