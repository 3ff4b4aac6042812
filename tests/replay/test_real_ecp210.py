"""ECP-210, the two carts on springs of the paper on a real bench, in volts and encoder counts.

The reference is the mean of five runs of the same plant with both carts free.
"""

import numpy as np
import pytest

from tests.figures import figure
from tests.peers import data
from tests.replay.records import Replayed, replayed
from tests.replay.two_carts import free_run_fit

REFERENCE = {
    "m1": 7.474e-7, "m2": 6.495e-7, "k1": 1.771e-4, "k2": 1.636e-4, "B1": 2.287e-6, "B2": 1.658e-6,
}  # fmt: skip
NEAR = {"m1": 0.05, "m2": 0.05, "k1": 0.05, "k2": 0.05, "B1": 0.15, "B2": 0.15}
SHARP = {"B1": 0.45}
"""Sd as a share of the value, 0.35 elsewhere. B1 comes to 0.44 and 0.37, and within 7 % of the reference: it
stands for what is partly dry friction, so stretches of one run differ by more than noise, and the sd says
so."""


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Replayed]:
    folder = tmp_path_factory.mktemp("ecp210")
    return {r: replayed("ecp210.toml", data(f"ecp210/both_free_{r}.txt"), folder) for r in ("a", "b")}


@pytest.mark.parametrize("name", list(REFERENCE))
def test_ecp210_runs_agree_with_each_other_and_with_the_reference(
    runs: dict[str, Replayed], name: str
) -> None:
    a, b = runs["a"].last(name), runs["b"].last(name)
    errors = [row["value"] / REFERENCE[name] - 1.0 for row in (a, b)]
    shares = [row["sd"] / row["value"] for row in (a, b)]
    percent = np.round(100.0 * np.array([*errors, *shares]), 1)
    figure(
        f"ECP-210 {name}: a {a['value']:.4g}, b {b['value']:.4g} {a['unit']}; "
        f"errors, then sd, of a and b {percent} %"
    )
    assert abs(a["value"] / b["value"] - 1.0) < NEAR[name]
    assert max(map(abs, errors)) < NEAR[name]
    assert a["lower"] < b["value"] < a["upper"]
    assert b["lower"] < a["value"] < b["upper"]
    assert max(shares) < SHARP.get(name, 0.35)


@pytest.mark.parametrize("run", ["a", "b"])
def test_ecp210_free_run_of_the_estimates_follows_the_record(runs: dict[str, Replayed], run: str) -> None:
    values = {name: runs[run].last(name)["value"] for name in (*REFERENCE, "x1.bias", "x2.bias")}
    fit = free_run_fit(data(f"ecp210/both_free_{run}.txt"), values)
    figure(f"ECP-210 run {run}: free-run fit {fit.round(1)} %")
    assert fit.min() >= 85.0


def test_ecp210_in_its_own_units_gives_parameters_in_them(runs: dict[str, Replayed]) -> None:
    units = {row["parameter"]: row["unit"] for row in runs["a"].rows}
    assert (units["m1"], units["k1"], units["B1"]) == ("V s2/counts", "V/counts", "V s/counts")
