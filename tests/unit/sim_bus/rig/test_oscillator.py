"""Devices with clocks of their own, held against a plant that is stepped at their own moments."""

import numpy as np
import pytest

from sim_bus.clock import PlayClock
from sim_bus.devices.device import Bench
from sim_bus.devices.oscillator import OwnClock, OwnTrajectory, Pace, _cubic
from sim_bus.errors import SimUsageError
from sim_bus.rig.plant import equations, step
from sim_bus.rig.scenario import Scenario
from sim_bus.rig.trajectory import Rig, Trajectory
from sim_bus.tuning import CHUNK
from tests.sim.rigs import rig, ring_config

RIG = rig(ring_config(1502))
SCENARIO = Scenario.model_validate(
    {"seed": 3, "force": [{"kind": "sweep", "amplitude": 10.0, "from_hz": 1, "to_hz": 9, "over_s": 1.0}]}
)


def trajectory(
    rate_hz: float = 1000.0, slowness: float = 1.0, jitter_s: float = 0.0
) -> tuple[Trajectory, OwnTrajectory]:
    whole = Trajectory(Rig(RIG, SCENARIO))
    return whole, OwnTrajectory(whole, Pace(1000.0, rate_hz, slowness, jitter_s), 1)


def test_own_tape_without_drift_or_jitter_reads_what_the_rig_reads() -> None:
    whole, own = trajectory()
    np.testing.assert_allclose(own.chunk(1).readings, whole.chunk(1).readings, rtol=0, atol=1e-15)


@pytest.mark.parametrize("rate_hz", [1000.0, 750.0, 2000.0])
@pytest.mark.parametrize("ppm", [5000.0, -5000.0])
def test_own_tape_of_another_rate_and_a_drifting_clock_reads_the_motion_at_its_own_moments(
    ppm: float, rate_hz: float
) -> None:
    whole, own = trajectory(rate_hz, 1.0 + 1e-6 * ppm)
    here = whole.chunk(0)
    motion = equations(RIG.model.graph, RIG.model.nominal)
    for k in (10, 250, 700):
        moment = k * (1.0 + 1e-6 * ppm) * 1000.0 / rate_hz
        i, part = int(moment), moment - int(moment)
        within = step(motion, 1e-3, "first", part)
        x = within.A @ here.states[i] + within.B0 @ here.forces[i] + within.B1 @ here.forces[i + 1]
        read = own.chunk(0).readings[k] * [c.si_factor for c in RIG.channel]
        np.testing.assert_allclose(read[1:], x[:2], rtol=0, atol=2e-12)
        assert read[0] == pytest.approx(
            (1 - part) * here.forces[i, 1] + part * here.forces[i + 1, 1], abs=1e-9
        )


def test_own_tape_of_half_the_rate_reads_every_second_sample_of_the_rig_for_as_long_as_it_plays() -> None:
    whole, own = trajectory(500.0)
    for number in (0, 1, 200):
        read = own.chunk(number).readings
        np.testing.assert_array_equal(read[:512], whole.chunk(2 * number).readings[::2])
        np.testing.assert_array_equal(read[512:], whole.chunk(2 * number + 1).readings[::2])
        assert own.chunk(number).first == number * CHUNK


def test_own_tape_goes_on_over_chunks_without_a_step() -> None:
    _, own = trajectory(slowness=1.0003)
    x1 = np.concatenate([own.chunk(n).readings[:, 1] for n in range(3)])
    curl = np.abs(np.diff(x1, 3))
    assert curl[CHUNK - 5 : CHUNK + 5].max() <= 2.0 * np.median(curl) + 1e-9


def test_own_tape_jitter_has_the_spread_that_was_asked_for() -> None:
    whole, own = trajectory(jitter_s=1e-4)
    late = own.chunk(0).readings[:, 0] - whole.chunk(0).readings[:, 0]
    slope = np.gradient(whole.chunk(0).readings[:, 0], 1e-3)
    steep = np.abs(slope) > np.percentile(np.abs(slope), 50)
    assert np.std(late[steep] / slope[steep]) == pytest.approx(1e-4, rel=0.15)


def test_cubic_is_exact_for_cubics_at_the_very_beginning_too() -> None:
    t = np.arange(12.0)
    y = 2.0 * t**3 - t**2 + 4.0
    at = np.array([0.3, 1.7, 7.25])
    found = _cubic(y, np.floor(at).astype(np.int64), at - np.floor(at))
    np.testing.assert_allclose(found, 2.0 * at**3 - at**2 + 4.0, rtol=1e-12)


def test_own_clock_counts_fewer_samples_when_it_is_slow() -> None:
    now = [0]
    whole = PlayClock(1000.0, None, ("plc",), "ready", now_ns=lambda: now[0])
    slow = OwnClock(whole, Pace(1000.0, 1000.0, 1.001))
    whole.ready()
    now[0] = 100_000_000_000
    assert whole.head() == 100_001
    assert slow.head() == 99_901
    assert slow.due_ns(1000) == 1_001_000_000


def bench(fast: bool = False, **keys: object) -> Bench:
    """A rig of 1 kHz whose device has a rate of its own, and a fault a second after the start."""
    source = RIG.source[0].model_copy(update={"name": "plc", **keys})
    clock = PlayClock(1000.0, 3000, ("plc",), "ready", fast=fast, now_ns=lambda: 0)
    file = RIG.model_copy(update={"source": (source,)})
    scenario = Scenario.model_validate({"fault": [{"name": "modbus.nan", "at_s": 1.0, "for_s": 0.5}]})
    return Bench(file, Trajectory(Rig(RIG, SCENARIO)), clock, scenario)


def test_device_of_another_rate_counts_plays_and_errs_by_its_own_clock() -> None:
    slow = bench(rate_hz=500.0)
    assert slow.clock_of(0).sample_rate_hz == 500.0
    assert slow.clock_of(0).total == 1500
    assert [(strike.first, strike.end) for strike in slow.faults(0).strikes] == [(500, 750)]
    assert isinstance(slow.trajectory_of(0), OwnTrajectory)


def test_device_of_the_rigs_rate_plays_by_the_rigs_clock() -> None:
    same = bench(rate_hz=1000.0)
    assert same.clock_of(0) is same.clock
    assert same.trajectory_of(0) is same.trajectory


def test_devices_of_different_rates_cannot_be_hurried() -> None:
    with pytest.raises(SimUsageError, match="in real time only"):
        bench(fast=True, rate_hz=500.0).clock_of(0)
