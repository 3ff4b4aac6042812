"""A scenario that goes beyond what a rig's wire can carry is refused before a device is opened."""

from pathlib import Path

import pytest

from sim_bus.reach import carried_by, fitting
from sim_bus.rig.rigfile import read_rig
from tests.ports import free_port
from tests.sim.rigs import MODEL, ROOT, refused, ring_config


def test_sim_scenario_beyond_the_fields_is_refused_with_the_figures(tmp_path: Path) -> None:
    sim = refused(tmp_path, (ROOT / "deploy" / "examples" / "modbus.toml").read_text(encoding="utf-8"),
                  "--scenario", "step")  # fmt: skip
    assert (sim.code, sim.out) == (2, "")
    assert "x2 would reach 0.252 m, its field carries -0.0655 to 0.0655" in sim.err
    assert "(default, paper, random, steady)" in sim.err


def test_sim_unknown_scenario_names_those_that_fit_the_rig(tmp_path: Path) -> None:
    text = (ROOT / "deploy" / "examples" / "serial.toml").read_text(encoding="utf-8")
    sim = refused(tmp_path, text, "--scenario", "no-such")
    assert sim.code == 2
    assert sim.err.endswith("is neither a file nor one of default, paper, random, steady\n")


@pytest.mark.parametrize("rig", ["can", "modbus", "serial"])
def test_scenarios_fit_the_rigs_that_they_name(rig: str) -> None:
    names = fitting(read_rig(ROOT / "sim_bus" / "scenarios" / "rigs" / f"bench-{rig}.toml"))
    assert {"healthy", "step", "sweep", "hammer", "standstill"} <= set(names)


def test_carried_is_what_the_fields_hold_in_the_channels_unit(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(ring_config(free_port()), encoding="utf-8")
    carried = carried_by(read_rig(tmp_path / "rig.toml"))
    assert carried["force"] == pytest.approx((-32.768, 32.767))
    assert carried["x1"] == pytest.approx((-0.065536, 0.065534))


def test_sim_configuration_without_a_source_says_so(tmp_path: Path) -> None:
    sim = refused(tmp_path, MODEL.format(rate=1000.0))
    assert sim.code == 2
    assert "has no [[source]]; add one for each device" in sim.err
