"""A force with nine samples a period: straight lines lose 4 % of it, which data tell; polynomials do not."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from agent.blocks.estimation import FAILURE
from agent.config import load
from agent.records import HealthEvent
from agent.runtime.replay import SOURCE, make_pipeline
from agent.types import EstimateBatch, FloatArray, Status
from drivers.port import SampleBlock

RATE_HZ, SAMPLES, WINDOW = 100.0, 1600, 400
MASS, SPRING, DAMPER = 2.0, 9000.0, 14.0
NOISE_M = 3e-5
TEXT = """
[rig]
name = "rig"
sample_rate_hz = 100.0
clock = "counter"
[model]
kind = "mass-spring-damper"
mass = [{{ name = "m", value = 2.0, sd_percent = 0.0 }}]
spring = [{{ name = "k", between = ["ground", "m"], nominal = 9500.0 }}]
damper = [{{ name = "B", between = ["ground", "m"], nominal = 13.0 }}]
[[channel]]
name = "force"
quantity = "force"
at = "m"
unit = "N"
gain_sd_percent = {gain}
[[channel]]
name = "x"
quantity = "displacement"
at = "m"
unit = "m"
gain_sd_percent = 0.0
noise_sd = 3e-5
[estimator]
window_s = 4.0
hop_s = {hop}
hold = "{hold}"
[store]
path = "rig.db"
every_s = 0
"""


def recording(lost: slice = slice(0)) -> FloatArray:
    """Readings (N, 2) of the steady motion under four tones of 8.6 to 9.4 samples a period, some of the force
    lost."""
    rng, t = np.random.default_rng(9), np.arange(SAMPLES) / RATE_HZ
    omega = 2 * np.pi * RATE_HZ / np.array([8.6, 8.87, 9.13, 9.4])
    tones = 5.0 * np.exp(1j * (np.outer(t, omega) + rng.uniform(0, 2 * np.pi, 4)))
    motion = (tones / (SPRING - MASS * omega**2 + 1j * omega * DAMPER)).real.sum(axis=1)
    v = np.column_stack([tones.real.sum(axis=1), motion + NOISE_M * rng.standard_normal(SAMPLES)])
    v[lost, 0] = np.nan
    return v


def run(
    folder: Path,
    hold: str,
    gain: float = 0.0,
    hop_s: float = 0.5,
    cuts: Sequence[int] = (),
    lost: slice = slice(0),
) -> list[EstimateBatch]:
    file = folder / "rig.toml"
    file.write_text(TEXT.format(hold=hold, gain=gain, hop=hop_s), encoding="utf-8")
    pipe, v, index = make_pipeline(load(file)), recording(lost), np.arange(SAMPLES, dtype=np.int64)
    found = []
    for part in np.split(index, cuts):
        found += pipe.step(SOURCE, SampleBlock(v[part], 0, None, part * 10_000_000), None, None)
    found += pipe.finish()
    assert not any(isinstance(record, HealthEvent) and record.cause == FAILURE for record in found)
    return [record for record in found if isinstance(record, EstimateBatch)]


def joined(batches: list[EstimateBatch], part: str) -> FloatArray:
    return np.concatenate([getattr(batch, part) for batch in batches])


def errors(batches: list[EstimateBatch]) -> tuple[FloatArray, FloatArray]:
    """Relative errors and errors in sds, (rows, 2), of the rows after the first window."""
    late = joined(batches, "index") >= 2 * WINDOW
    assert (joined(batches, "status")[late] == Status.VALID).all()
    off = joined(batches, "value")[late] - [SPRING, DAMPER]
    return np.abs(off / [SPRING, DAMPER]), np.abs(off / joined(batches, "sd")[late])


@pytest.mark.parametrize("gain", [0.0, 1.0])
def test_what_straight_lines_lose_between_nine_samples_a_period_is_a_constant_that_data_tell(
    gain: float, tmp_path: Path
) -> None:
    relative, sds = errors(run(tmp_path, "first", gain))
    assert relative.max() < 0.005
    assert sds.max() < 3.5


@pytest.mark.parametrize(("hold", "most"), [("cubic", 0.005), ("quintic", 0.001)])
def test_polynomials_lose_half_a_percent_at_the_most(hold: str, most: float, tmp_path: Path) -> None:
    relative, _ = errors(run(tmp_path, hold))
    assert relative.max() < most


@pytest.mark.parametrize("hold", ["cubic", "quintic"])
def test_polynomials_are_within_3_sd_beside_a_gain_known_to_a_percent(hold: str, tmp_path: Path) -> None:
    relative, sds = errors(run(tmp_path, hold, 1.0))
    assert relative.max() < 0.005
    assert sds.max() < 3


def test_readings_of_the_force_that_are_lost_are_unknown_at_every_tap(tmp_path: Path) -> None:
    relative, sds = errors(run(tmp_path, "cubic", 1.0, lost=slice(1000, 1003)))
    assert relative.max() < 0.005
    assert sds.max() < 3.5


def test_late_rows_are_the_same_however_the_stream_is_cut_and_carry_their_own_stamps(tmp_path: Path) -> None:
    cuts = [1, 2, 3, 400, 401, 402, 403, 800, 801, 1203, 1204]
    whole, parts = run(tmp_path, "quintic", 1.0, 0.01), run(tmp_path, "quintic", 1.0, 0.01, cuts)
    index = joined(whole, "index")
    # three readings are yet to come when the recording ends
    np.testing.assert_array_equal(index, np.arange(SAMPLES - 3))
    np.testing.assert_array_equal(joined(whole, "t_ns"), index * 10_000_000)
    for part in ("index", "t_ns", "value", "sd", "status", "reason"):
        np.testing.assert_array_equal(joined(parts, part), joined(whole, part))
