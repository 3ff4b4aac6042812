"""A sensor that reads 5 % high, live: found by the paper's descent over W, and by window-ml."""

from pathlib import Path

import pytest

from agent.records import ConditionsRecord
from agent.types import EstimateBatch, Status
from tests.scenario.test_linear_rigs import play

RIG = """
[rig]
name = "press-7"
sample_rate_hz = 500.0
[model]
mass = [{ name = "m1", value = 5.0 }, { name = "m2", value = 3.0 }]
spring = [
  { name = "k1", between = ["ground", "m1"], nominal = 2500.0 },
  { name = "k2", between = ["m1", "m2"], nominal = 1000.0 },
]
damper = [
  { name = "B1", between = ["ground", "m1"], nominal = 50.0 },
  { name = "B2", between = ["m1", "m2"], nominal = 50.0 },
]
[[channel]]
name = "force"
quantity = "force"
at = "m2"
unit = "N"
[[channel]]
name = "x1"
quantity = "displacement"
at = "m1"
unit = "m"
noise_sd = 1e-7
[[channel]]
name = "x2"
quantity = "displacement"
at = "m2"
unit = "m"
noise_sd = 1e-7
gain_sd_percent = 0.0
[estimator]
window_s = 1.0
hop_s = 0.5
estimate = ["x1.gain"]
METHOD
[[source]]
driver = "serial"
port = "press.tty"
format = "binary"
sync = "AA55"
fields = [{ name = "force", type = "float64" }, { name = "x1", type = "float64" }, \
{ name = "x2", type = "float64" }]
map = { force = "force", x1 = "x1", x2 = "x2" }
"""
SEED = """method = "seed"
passes = 2
observer = { gain = "poles", poles = [-60.0, -50.0, -40.0, -30.0] }"""
SCENARIO = {
    "seed": 3,
    "force": [{"kind": "random", "rms": 50.0}],
    "noise": {"displacement": 1e-7},
    "sensor": [{"channel": "x1", "gain": 0.05}],
}


@pytest.mark.parametrize(("method", "within"), [(SEED, 1e-3), ("", 1e-3)])
def test_sensor_that_reads_five_per_cent_high_is_found_live(
    tmp_path: Path, method: str, within: float
) -> None:
    file = tmp_path / "press.toml"
    file.write_text(RIG.replace("METHOD", method))
    records, _ = play(file, SCENARIO, 2.6)
    last = [record for record in records if isinstance(record, EstimateBatch)][-1]
    assert last.parameters == ("x1.gain",)
    assert Status(int(last.status[-1, 0])) is Status.VALID
    assert last.value[-1, 0] == pytest.approx(1.05, abs=within)
    assert last.sd[-1, 0] < within
    kept = [record for record in records if isinstance(record, ConditionsRecord)]
    assert bool(kept) == bool(method)
    assert all(record.found.passes == 2 and record.window_s == 1.0 for record in kept)
