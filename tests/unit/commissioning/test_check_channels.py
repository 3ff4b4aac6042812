"""`deltak check --recording` and `--probe`: what each channel shows, and which channels are suspected of
what."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.commissioning.check import check
from agent.commissioning.misassignment import findings
from agent.commissioning.progress import silent
from agent.config import load
from agent.errors import BusError, UsageError
from agent.types import FloatArray
from sim_bus.rig.excitation import Force
from sim_bus.rig.rigfile import read_rig
from sim_bus.rig.scenario import Scenario
from sim_bus.rig.schedule import Change
from sim_bus.rig.trajectory import Rig
from tests.figures import figure
from tests.scenario.live import EXAMPLES, example
from tests.scenario.two_sources import configure
from tests.sim.rigs import ROOT, simulator

CHANNELS = ("force", "x1", "x2")
STEPS = np.array([1e-3, 2e-6, 2e-6])
WORN = {"k1": 10.0, "k2": -30.0, "B2": -2.0}
FACTORS = (2.0, 0.5, 10.0, 0.1, 1000.0, 0.001)


def readings(
    seed: int, *, worn: bool = False, noise_m: float = 1e-5, force: Force | None = None
) -> FloatArray:
    """Four seconds of the example rig (n, 3), as its wire carries them."""
    config = read_rig(EXAMPLES / "modbus.toml")
    changes = (Change(at_s=0.0, delta=WORN),) if worn else ()
    forces = (force or Force(kind="random", rms=5.0),)
    scenario = Scenario(seed=seed, force=forces, noise={"displacement": noise_m}, change=changes)
    return np.asarray(np.round(Rig(config, scenario).advance(4000).readings / STEPS) * STEPS)


def suspected(values: FloatArray) -> list[dict[str, Any]]:
    config = load(EXAMPLES / "modbus.toml")
    return findings(config, values, [(0, len(values))], silent)


SWEEP = Force(kind="sweep", amplitude=5.0, from_hz=0.2, to_hz=5.0, over_s=4.0)
STEPPED = Force(kind="steps", amplitude=5.0, period_s=1.0)


def healthy(seeds: range) -> int:
    """Of healthy and worn rigs under several forces and noises, how many are suspected of something."""
    forces, noises = (None, SWEEP, STEPPED), (1e-6, 1e-5, 1e-4, 1e-3)
    false = 0
    for seed in seeds:
        worn, force, noise = bool(seed % 2), forces[seed % 3], noises[seed % 4]
        false += bool(suspected(readings(seed, worn=worn, noise_m=noise, force=force)))
    return false


def test_suspicion_healthy_and_worn_rigs_are_not_suspected() -> None:
    false = healthy(range(6))
    figure(f"channels of healthy recordings suspected: {false} of 12 recordings")
    assert false == 0


@pytest.mark.soak
@pytest.mark.timeout(900)
def test_suspicion_hardly_any_healthy_recording_is_suspected() -> None:
    false = healthy(range(240))
    figure(f"channels of healthy recordings suspected: {false} of 240 recordings")
    assert false <= 2


def scaled(channel: int, factor: float) -> FloatArray:
    values = readings(channel + 1, worn=factor > 1)
    values[:, channel] *= factor
    return values


def assert_named(values: FloatArray, kind: str, *channels: str, factor: float | None = None) -> None:
    found = suspected(values)
    assert [(f["kind"], tuple(f["channels"])) for f in found] == [(kind, channels)], found
    assert found[0]["factor"] == (None if factor is None else pytest.approx(factor))
    assert all(name in found[0]["words"] for name in channels)


# every plant runs in soak, a few of each kind every time
PLANTS = [(c, f) for c in range(3) for f in FACTORS]
OFTEN = {(0, 2.0), (2, 10.0), (1, 0.001)}


@pytest.mark.parametrize(
    ("channel", "factor"),
    [plant if plant in OFTEN else pytest.param(*plant, marks=pytest.mark.soak) for plant in PLANTS],
)
def test_suspicion_names_a_channel_that_is_mis_scaled(channel: int, factor: float) -> None:
    assert_named(scaled(channel, factor), "scale", CHANNELS[channel], factor=factor)


@pytest.mark.parametrize("channel", [0, *(pytest.param(c, marks=pytest.mark.soak) for c in (1, 2))])
def test_suspicion_names_a_channel_that_is_turned_round(channel: int) -> None:
    values = readings(7)
    values[:, channel] *= -1
    assert_named(values, "sign", CHANNELS[channel])


@pytest.mark.parametrize(
    ("first", "second"), [(1, 2), *(pytest.param(0, c, marks=pytest.mark.soak) for c in (1, 2))]
)
def test_suspicion_names_channels_that_are_swapped(first: int, second: int) -> None:
    values = readings(9)
    values[:, [first, second]] = values[:, [second, first]]
    assert_named(values, "swap", CHANNELS[first], CHANNELS[second])


@pytest.mark.soak
def test_suspicion_says_that_all_displacements_in_mm_look_like_a_force_too_small() -> None:
    values = readings(3)
    values[:, 1:] *= 1000
    (found,) = suspected(values)
    assert "all of x1, x2 1000 times too large: a prefix: mm against m" in found["words"]


def test_suspicion_of_a_rig_that_stands_still_is_none() -> None:
    rng = np.random.default_rng(0)
    assert suspected(np.column_stack([np.zeros(3000), 1e-6 * rng.standard_normal((3000, 2))])) == []


def written(folder: Path, values: FloatArray) -> Path:
    path = folder / "recording.csv"
    lines = [f"{i / 1000:.3f},{','.join(map(repr, row))}" for i, row in enumerate(values.tolist())]
    path.write_text("\n".join(["t,force,x1,x2", *lines, ""]), encoding="utf-8")
    return path


def test_check_recording_warns_of_a_suspected_channel_at_its_key_path(tmp_path: Path) -> None:
    values = readings(2)
    values[:, 2] *= -1
    values[100:103, 1] = np.nan
    path = written(tmp_path, values)
    path.write_text(path.read_text(encoding="utf-8").replace("nan", ""), encoding="utf-8")
    document = check(config=example("modbus", tmp_path), recording=path, probe=False)
    assert document["ok"]
    (warning,) = [
        w for w in document["warnings"] if w["path"] == "channel[2]" and "turned round" in w["message"]
    ]
    assert "wiring" in warning["advice"]
    facts = document["recording"]
    assert [s["kind"] for s in facts["suspicions"]] == ["sign"]
    assert {c["name"]: c["missing"] for c in facts["channels"]} == {"force": 0, "x1": 3, "x2": 0}
    assert document["probe"] is None


def test_check_probe_without_sources_is_a_usage_error(tmp_path: Path) -> None:
    text = example("modbus", tmp_path).read_text(encoding="utf-8")
    path = tmp_path / "plain.toml"
    path.write_text(text[: text.index("[[source]]")], encoding="utf-8")
    with pytest.raises(UsageError):
        check(config=path, recording=None, probe=True)


def test_check_probe_of_a_bus_that_cannot_be_opened_names_every_source(tmp_path: Path) -> None:
    with pytest.raises(BusError) as caught:
        check(config=example("modbus", tmp_path), recording=None, probe=True)
    assert caught.value.exit_code == 4
    assert [fault.path for fault in caught.value.faults] == ["modbus"]


@pytest.mark.realtime
def test_check_probe_hears_both_sources_and_names_what_is_wrong(tmp_path: Path) -> None:
    """x2 is wired the wrong way round, and the motion is read 3.7 ms later than the force."""
    path = configure(tmp_path)
    scenario = tmp_path / "late.toml"
    late = "".join(f'[[sensor]]\nchannel = "{name}"\ndelay_s = 0.0037\n' for name in ("x1", "x2"))
    scenario.write_text(
        f'[[force]]\nkind = "random"\nrms = 5.0\n[noise]\ndisplacement = 1e-6\n{late}', encoding="utf-8"
    )
    text = path.read_text(encoding="utf-8")
    with simulator(tmp_path, text, "--scenario", str(scenario)) as device:
        wrong = device.config.with_name("wrong.toml")
        wrong.write_text(
            text.replace('at = "m2"\nunit = "m"', 'at = "m2"\nunit = "m"\nscale = -1.0'), encoding="utf-8"
        )
        assert "scale = -1.0" in wrong.read_text(encoding="utf-8")
        command = [sys.executable, "-m", "agent", "check", str(wrong), "--probe", "--json"]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
        assert device.stop() == 0
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    probe = document["probe"]
    assert [s["kind"] for s in probe["suspicions"]] == ["sign"]
    assert probe["suspicions"][0]["channels"] == ["x2"]
    for channel in probe["channels"]:
        assert channel["rate_hz"] == pytest.approx(1000.0, rel=0.02)
        assert abs(channel["drift_ppm"]) < 4 * channel["drift_sd_ppm"] + 20
    assert {c["name"]: c["source"] for c in probe["channels"]} == {
        "force": "can",
        "x1": "modbus",
        "x2": "modbus",
    }
    noise = {c["name"]: c["noise_sd"] for c in probe["channels"]}
    assert noise["x1"] == pytest.approx(1e-6, rel=0.3)


def test_displacement_that_was_never_zeroed_is_named_with_its_offset() -> None:
    values = readings(3)
    values[:, 1] += 0.05
    (row,) = suspected(values)
    assert (row["kind"], row["channels"]) == ("offset", ["x1"])
    assert row["words"].startswith("x1 reads 0.0")
    assert " m too high, as if never zeroed" in row["words"]


def test_displacement_that_never_moves_is_named_for_that() -> None:
    values = readings(3)
    values[:, 1] = 0.0
    (row,) = suspected(values)
    assert (row["kind"], row["channels"]) == ("still", ["x1"])
    assert row["words"].startswith("x1 never moves: it reads 0 m from the first sample to the last")


def test_coarse_channel_beside_the_noise_of_a_rig_at_rest_is_not_named() -> None:
    rng = np.random.default_rng(0)
    assert suspected(np.column_stack([np.zeros((3000, 2)), 1e-6 * rng.standard_normal(3000)])) == []


def test_force_that_rests_all_the_time_is_not_named() -> None:
    values = readings(3)
    values[:, 0] = 0.0
    assert [row for row in suspected(values) if row["kind"] == "still"] == []


def test_channels_that_read_the_same_to_the_last_digit_are_named_together() -> None:
    values = readings(3)
    values[:, 2] = values[:, 1]
    (row,) = suspected(values)
    assert (row["kind"], row["channels"]) == ("same", ["x1", "x2"])
    assert row["words"] == "x1 and x2 read the same to the last digit: two names for one sensor?"


def test_channels_of_a_few_coarse_levels_may_read_the_same() -> None:
    values = readings(3)
    values[:, 1] = values[:, 2] = np.round(values[:, 2] / 0.02) * 0.02
    assert [row for row in suspected(values) if row["kind"] == "same"] == []


def test_force_that_reads_a_fifth_too_large_is_named_with_its_factor() -> None:
    values = readings(3, noise_m=1e-6)
    values[:, 0] *= 1.2
    (row,) = suspected(values)
    assert (row["kind"], row["channels"]) == ("scale", ["force"])
    assert row["factor"] == pytest.approx(1.2, rel=0.01)
    assert row["words"].startswith("force reads 1.2 times what the motion asks for")


def test_displacement_that_comes_late_is_named_with_its_delay() -> None:
    values = readings(3, noise_m=1e-6)
    values[5:, 1] = values[:-5, 1].copy()
    (row,) = suspected(values[5:])
    assert (row["kind"], row["channels"], row["factor"]) == ("delay", ["x1"], None)
    assert row["words"].startswith(("x1 comes 5 ms late", "x1 comes 4.9", "x1 comes 5.0"))
