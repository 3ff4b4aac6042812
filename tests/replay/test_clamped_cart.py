"""ECP-210 with its second cart held: rests of seconds on dry friction, between two step responses."""

from pathlib import Path

import pytest

from agent.runtime.replay import replay
from tests.figures import figure
from tests.peers import data
from tests.replay.records import rows_of

STIFFNESS = (3.25e-4, 3.61e-4)
"""What k1 + k2 came to in five runs, V/count."""
NOMINAL = 3.4e-4
"""V/count"""
TEXT = """
[rig]
name = "clamped"
sample_rate_hz = 887.1
clock = "uniform"
[model]
kind = "mass-spring-damper"
mass = [{{ name = "m1", value = 7.474e-7 }}]
spring = [{{ name = "k", between = ["ground", "m1"], nominal = {nominal} }}]
damper = [{{ name = "B", between = ["ground", "m1"], nominal = 2.3e-6 }}]
[[channel]]
name = "effort"
quantity = "force"
at = "m1"
unit = "V"
scale = 1.220703125e-3
[[channel]]
name = "x1"
quantity = "displacement"
at = "m1"
unit = "counts"
bias = true
[estimator]
window_s = {window_s}
hop_s = {hop_s}
hold = "zero"
[[alarm]]
parameter = "k"
limit_percent = 15.0
[columns]
effort = "Control Effort"
x1 = "Encoder 1 Pos"
"""


@pytest.mark.parametrize(
    ("window_s", "known"),
    [(3.0, 0.07), *(pytest.param(w, 0.05, marks=pytest.mark.soak) for w in (1.0, 1.5, 2.0))],
)
def test_windows_that_mostly_rest_are_not_sure_of_a_wrong_stiffness(
    tmp_path: Path, window_s: float, known: float
) -> None:
    """known: sd, a share of nominal, of rows that are held to; beyond 0.05 they are `unexcited`.

    Rows of 3 s hold one of the two steps: with a mass known no better than its data sheet they come to 0.06.
    """
    config, database = tmp_path / "clamped.toml", tmp_path / "clamped.db"
    config.write_text(TEXT.format(nominal=NOMINAL, window_s=window_s, hop_s=window_s / 20), encoding="utf-8")
    document = replay(config=config, recordings=[data("ecp210/m2_clamped_a.txt")], db=database)
    rows = [r for r in rows_of(database) if r["parameter"] == "k" and r["status"] in ("valid", "unexcited")]
    rows = [r for r in rows if r["sd"] is not None and r["sd"] < known * NOMINAL]
    held = [r["lower"] <= STIFFNESS[1] and r["upper"] >= STIFFNESS[0] for r in rows]
    figure(f"ECP-210 clamped, windows of {window_s:g} s: {sum(held)} of {len(held)} intervals hold")
    assert len(held) >= 5
    assert sum(held) >= 0.85 * len(held)
    assert document["alarms"] == []


@pytest.mark.parametrize("nominal", [3.25e-4, 3.52e-4, 3.61e-4])
def test_windows_in_which_friction_holds_the_cart_do_not_lose_its_spring(
    tmp_path: Path, nominal: float
) -> None:
    """For half of such a window it rests where its spring would move it: as if there were none."""
    config, database = tmp_path / "clamped.toml", tmp_path / "clamped.db"
    config.write_text(TEXT.format(nominal=nominal, window_s=2.0, hop_s=0.02), encoding="utf-8")
    document = replay(config=config, recordings=[data("ecp210/m2_clamped_a.txt")], db=database)
    rows = [r for r in rows_of(database) if r["parameter"] == "k" and r["status"] == "valid"]
    assert all(r["upper"] > 0.85 * STIFFNESS[0] for r in rows)
    assert document["alarms"] == []
