"""What is played: deterministic, exact at changes, true to its sensors."""

import numpy as np
import pytest

from sim_bus.errors import SimUsageError
from sim_bus.rig.rigfile import RigFile
from sim_bus.rig.scenario import Scenario, built_in_names, load_scenario
from sim_bus.rig.trajectory import Chunk, Rig, Trajectory
from sim_bus.tuning import CHUNK, KEPT
from tests.sim.rigs import rig, ring_config

OF_THEIR_OWN_RIGS = {"voice-coil", "dc-drive", "filter", "oven", "transfer", "gearbox", "gantry"}


def played(scenario: Scenario, seconds: float = 3.0, rig_file: RigFile | None = None) -> Chunk:
    source = Rig(rig_file or rig(ring_config(1)), scenario)
    return source.advance(round(seconds * 1000))


def scenario(**keys: object) -> Scenario:
    return Scenario.model_validate(keys)


def test_rig_paper_scenario_begins_in_every_state_at_a_hundredth() -> None:
    chunk = played(load_scenario("paper", {}))
    np.testing.assert_array_equal(chunk.states[0], [0.01, 0.01, 0.01, 0.01])
    assert not chunk.forces.any()
    np.testing.assert_array_equal(chunk.readings[:, 1], chunk.states[:, 0])
    np.testing.assert_allclose(chunk.readings[:, 2], 1e3 * chunk.states[:, 1], rtol=1e-15)


def test_rig_default_scenario_plays_the_three_segments_of_the_table() -> None:
    chunk = played(load_scenario("default", {}))
    k1, k2, b1, b2 = chunk.parameters[:, 2:].T
    for first, row in ((0, (50, 150, 5, 5)), (1000, (25, 100, 2, 2)), (2000, (75, 75, 5, 5))):
        assert {tuple(p) for p in zip(k1, k2, b1, b2, strict=True)} >= {row}
        np.testing.assert_array_equal(chunk.parameters[first : first + 1000, 2:], np.tile(row, (1000, 1)))
    assert np.std(chunk.forces[:, 1]) == pytest.approx(5.0, rel=0.05)
    assert not chunk.forces[:, 0].any()
    assert np.std(chunk.readings[:, 1] - chunk.true[:, 1]) == pytest.approx(1e-6, rel=0.1)
    assert np.std(chunk.readings[:, 2] - 1e3 * chunk.true[:, 2]) == pytest.approx(1e-3, rel=0.1)


def test_rig_change_carries_the_physical_state() -> None:
    free = {"initial": {"all": 0.01}}
    stepped = played(scenario(**free, change=[{"at_s": 0.5, "delta": {"k1": 25.0}}]), 1.0)
    same = played(scenario(**free), 0.501)
    np.testing.assert_array_equal(stepped.states[:501], same.states)
    later = played(
        scenario(
            initial={
                "displacement": dict(zip(("m1", "m2"), same.states[500, :2], strict=True)),
                "velocity": dict(zip(("m1", "m2"), same.states[500, 2:], strict=True)),
            },
            change=[{"at_s": 0, "delta": {"k1": 25.0}}],
        ),
        0.5,
    )
    np.testing.assert_allclose(stepped.states[500:], later.states, atol=1e-16)


@pytest.mark.parametrize("name", sorted(set(built_in_names()) - OF_THEIR_OWN_RIGS))
def test_rig_same_seed_is_played_alike_whatever_the_chunks(name: str) -> None:
    one, other = (Rig(rig(ring_config(1)), load_scenario(name, {})) for _ in range(2))
    whole = one.advance(2000)
    pieces = [other.advance(n) for n in (1, 999, 7, 993)]
    readings = np.vstack([piece.readings for piece in pieces])
    if name == "paper":
        np.testing.assert_allclose(readings, whole.readings, atol=1e-12)
    np.testing.assert_allclose(np.vstack([p.states for p in pieces]), whole.states, atol=1e-14)
    np.testing.assert_array_equal(np.vstack([p.parameters for p in pieces]), whole.parameters)


def test_load_scenario_seed_in_the_environment_goes_before_the_file() -> None:
    first, second = (load_scenario("random", {"DELTAK_SEED": seed}) for seed in ("5", "6"))
    assert (first.seed, load_scenario("random", {}).seed) == (5, 1)
    assert first.changes != second.changes
    assert first.changes == load_scenario("random", {"DELTAK_SEED": "5"}).changes


@pytest.mark.parametrize("delay_s", [0.003, 0.0123, 0.0001])
def test_rig_late_sensor_reads_the_true_past(delay_s: float) -> None:
    text = ring_config(1).replace('unit = "m"\n', f'unit = "m"\ndelay_s = {delay_s}\n', 1)
    force = {"kind": "random", "rms": 5.0}
    late = played(scenario(force=[force]), 0.5, rig(text))
    # the same motion on a grid a hundred times finer: a force that runs linearly between the coarse samples
    grid = np.arange(500) - delay_s * 1000.0
    before = np.clip(np.floor(grid).astype(int), 0, 498)
    part = (grid - before)[:, None]
    fine = hermite(late, before, part)
    np.testing.assert_allclose(late.readings[50:499, 1], fine[50:499], atol=1e-11)


def hermite(chunk: Chunk, k: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Displacement of m1 between samples from displacement, velocity and acceleration at both ends (fifth
    order)."""
    t, h = part[:, 0], 1e-3
    x1, x2, v1, v2 = chunk.states.T
    a1 = (-10.0 * v1 + 5.0 * v2 - 125.0 * x1 + 100.0 * x2) / 5.0
    p0, p1, v0, w1, a0, b1 = x1[k], x1[k + 1], v1[k] * h, v1[k + 1] * h, a1[k] * h * h, a1[k + 1] * h * h
    d = p1 - p0 - v0 - a0 / 2
    e, f = w1 - v0 - a0, b1 - a0
    c3, c4, c5 = 10 * d - 4 * e + f / 2, -15 * d + 7 * e - f, 6 * d - 3 * e + f / 2
    return np.asarray(p0 + v0 * t + a0 / 2 * t**2 + c3 * t**3 + c4 * t**4 + c5 * t**5)


def test_rig_sensor_faults_change_the_reading_only_where_they_say() -> None:
    base = {"initial": {"all": 0.01}, "seed": 3}
    healthy = played(scenario(**base), 1.0).readings[:, 1]

    def read(**keys: object) -> np.ndarray:
        return played(scenario(**base, sensor=[{"channel": "x1", **keys}]), 1.0).readings[:, 1]

    np.testing.assert_allclose(read(bias=0.5), healthy + 0.5)
    np.testing.assert_allclose(read(gain=-0.2), 0.8 * healthy)
    np.testing.assert_allclose(read(drift_per_s=2.0, from_s=0.5)[500:], healthy[500:] + np.arange(500) * 2e-3)
    np.testing.assert_allclose(read(rail=0.005), np.clip(healthy, -0.005, 0.005))
    stuck = read(stuck=True, from_s=0.2, until_s=0.4)
    np.testing.assert_array_equal(stuck[200:400], np.full(200, healthy[200]))
    np.testing.assert_array_equal(stuck[400:], healthy[400:])
    spiked = read(spike=1.0, spikes_hz=50.0) - healthy
    assert 20 < np.sum(np.abs(np.abs(spiked) - 1.0) < 1e-9) < 90


def test_rig_sensor_fault_is_in_the_ledger_with_its_samples() -> None:
    keys = {"channel": "x1", "stuck": True, "from_s": 0.2, "until_s": 0.4}
    source = Rig(rig(ring_config(1)), scenario(initial={"all": 0.01}, sensor=[keys]))
    for _ in range(3):
        source.advance(150)
    assert source.sensors[1].affected_before(1000) == {"stuck": [(200, 399)]}
    assert source.sensors[1].affected_before(300) == {"stuck": [(200, 299)]}


def test_tape_chunk_is_made_once_and_old_ones_are_refused() -> None:
    seen: list[int] = []
    trajectory = Trajectory(
        Rig(rig(ring_config(1)), load_scenario("steady", {})), lambda chunk: seen.append(chunk.first)
    )
    assert trajectory.chunk(2).first == 2 * CHUNK
    assert trajectory.chunk(0) is trajectory.chunk(0)
    assert seen == [0, CHUNK, 2 * CHUNK]
    trajectory.chunk(KEPT)
    with pytest.raises(LookupError, match="are gone"):
        trajectory.chunk(0)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"change": [{"at_s": 0, "delta": {"k9": 1.0}}]}, "k9"),
        ({"force": [{"kind": "random", "rms": 1.0, "at": "m9"}]}, "m9"),
        ({"sensor": [{"channel": "x9"}]}, "x9"),
        ({"initial": {"displacement": {"m9": 0.0}}}, "m9"),
    ],
)
def test_rig_scenario_that_names_what_is_not_there_is_refused(keys: dict[str, object], words: str) -> None:
    with pytest.raises(SimUsageError, match=words):
        played(scenario(**keys))


@pytest.mark.parametrize(
    ("kind", "keys", "expected"),
    [
        ("steps", {"amplitude": 2.0, "period_s": 0.01}, [2, 2, 2, 2, 2, -2, -2, -2, -2, -2, 2, 2]),
        (
            "impacts",
            {"amplitude": 1.0, "period_s": 0.006, "width_s": 0.002},
            [0, 1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0],
        ),
        ("sweep", {"amplitude": 1.0, "from_hz": 250.0, "to_hz": 250.0, "over_s": 1.0}, [0, 1, 0, -1] * 3),
        ("none", {}, [0] * 12),
    ],
)
def test_force_each_kind_has_its_shape(kind: str, keys: dict[str, float], expected: list[float]) -> None:
    chunk = played(scenario(force=[{"kind": kind, **keys}]), 0.012)
    np.testing.assert_allclose(chunk.forces[:, 1], expected, atol=1e-9)


@pytest.mark.parametrize("suffix", ["npz", "csv"])
def test_force_recorded_is_played_again_and_again(suffix: str, tmp_path: object) -> None:
    from pathlib import Path

    folder = Path(str(tmp_path))
    if suffix == "npz":
        np.savez(folder / "f.npz", hammer=np.array([1.0, 2.0, 3.0]))
    else:
        (folder / "f.csv").write_text("t,hammer\n0,1\n1,2\n2,3\n", encoding="utf-8")
    force = {"kind": "recorded", "file": f"f.{suffix}", "column": "hammer", "gain": 2.0}
    chunk = played(scenario(force=[force], folder=folder), 0.005)
    np.testing.assert_array_equal(chunk.forces[:, 1], [2, 4, 6, 2, 4])
