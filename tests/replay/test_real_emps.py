"""EMPS, a real drive train in closed loop: a free mass with dry friction, against the published figures.

Published (Janot, Gautier, Brunot 2019): M 95.1089 kg, Fv 203.5034 N s/m, Fc 20.3935 N, force offset -3.1648
N.
"""

from pathlib import Path

import pytest

from tests.figures import figure
from tests.peers import data
from tests.replay.records import Replayed, replayed

PUBLISHED = {
    "M": (95.1089, 0.01),
    "Fv": (203.5034, 0.02),
    "Fc": (20.3935, 0.02),
    "force.bias": (-3.1648, 0.02),
}
"""Value, and how near to it the whole record must come."""
WITHIN = {"M": 0.05, "Fv": 0.07, "Fc": 0.05}
"""How near windows of 6 s must come. Fv comes within 6.0 %: friction's two terms are told apart by little in
one such window, whose own sd of Fv is 7 to 8 % where the speed is low (of Fc 6 to 7 %, of M 1.5 to 2.8 %)."""
WHOLE = ("window_s = 6.0 ", "window_s = 24.8 ")
SPRING = (
    ("mass     =", 'spring   = [{ name = "K", between = ["ground", "M"], nominal = 0.0 }]\nmass     ='),
    ('estimate = ["M",', 'estimate = ["K", "M",'),
    ('[[alarm]]\nparameter = "M"', '[[alarm]]\nparameter = "K"\nlimit = 20.0\n\n[[alarm]]\nparameter = "M"'),
)
NO_FRICTION = (
    ("friction =", "friction = []  #"),
    ('"Fv", "Fc"]', '"Fv"]'),
    ('[[alarm]]\nparameter = "Fc"\nlimit_percent = 10.0\n', ""),
)


def test_emps_whole_record_gives_the_published_figures(tmp_path: Path) -> None:
    found = replayed("emps.toml", data("emps/emps.csv"), tmp_path, [WHOLE])
    for name, (published, share) in PUBLISHED.items():
        row = found.last(name)
        error = row["value"] / published - 1.0
        figure(
            f"EMPS {name}: {row['value']:.4f} +- {row['sd']:.4f}, published {published}, {100 * error:+.2f} %"
        )
        assert abs(error) < share, name
        assert row["lower"] < published < row["upper"], name


def test_emps_with_a_spring_finds_none(tmp_path: Path) -> None:
    row = replayed("emps.toml", data("emps/emps.csv"), tmp_path, [WHOLE, *SPRING]).last("K")
    figure(f"EMPS spring: {row['value']:.2f} +- {row['sd']:.2f} N/m")
    assert abs(row["value"]) < 20.0
    assert row["lower"] < 0.0 < row["upper"]


def test_emps_windows_of_six_seconds_raise_no_false_alarm(tmp_path: Path) -> None:
    found = replayed("emps.toml", data("emps/emps.csv"), tmp_path)
    assert found.document["alarms"] == []
    for name in ("M", "Fv", "Fc"):
        valid = [row for row in found.of(name) if row["status"] == "valid"]
        full = [row for row in found.of(name) if row["status"] != "warming"]
        worst = max(abs(row["value"] / PUBLISHED[name][0] - 1.0) for row in valid)
        figure(f"EMPS {name} in windows of 6 s: {len(valid)} of {len(full)} valid, worst {100 * worst:.1f} %")
        assert len(valid) > 0.9 * len(full)
        assert worst < WITHIN[name]


def reasons(found: Replayed, parameter: str) -> set[str | None]:
    return {row["reason"] for row in found.of(parameter) if row["status"] != "warming"}


def without_friction(folder: Path, window: str) -> Replayed:
    return replayed(
        "emps.toml",
        data("emps/emps.csv"),
        folder,
        [("window_s = 6.0 ", f"window_s = {window} "), *NO_FRICTION],
    )


@pytest.mark.parametrize("window", ["6.0", "24.8"])
def test_emps_without_the_friction_element_has_no_valid_row_and_no_alarm(tmp_path: Path, window: str) -> None:
    found = without_friction(tmp_path, window)
    full = [row for row in found.of("Fv") if row["status"] != "warming"]
    assert full
    assert {row["status"] for row in full} <= {"invalid", "unexcited"}
    assert found.document["alarms"] == []


SHORT = pytest.mark.xfail(
    strict=True,
    reason="38 of 38 rows are unexcited, none named: within 6 s dry friction looks like a slow unknown "
    "force, which widens the sd of Fv beyond what counts as excited instead",
)


@pytest.mark.parametrize("window", [pytest.param("6.0", marks=SHORT), "24.8"])
def test_emps_without_the_friction_element_names_dry_friction(tmp_path: Path, window: str) -> None:
    found = without_friction(tmp_path, window)
    full = [row for row in found.of("Fv") if row["status"] != "warming"]
    assert all(row["status"] == "invalid" for row in full)
    named = sum(row["reason"] == "dry friction" for row in full)
    assert named >= 0.9 * len(full)
    assert reasons(found, "Fv") <= {"dry friction", "changing", "mismatch"}
