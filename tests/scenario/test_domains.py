"""Templates of other domains: each example is checked, played, its physical parameters found again."""

from typing import Any

import pytest

from agent.types import AlarmTransition, EstimateBatch, Status
from sim_bus.rig.rigfile import read_rig
from sim_bus.rig.scenario import load_scenario
from sim_bus.rig.trajectory import Rig
from tests.scenario.test_linear_rigs import play
from tests.sim.rigs import ROOT

EXAMPLES = ROOT / "deploy/examples"


def random_force(rms: float, at: str | None = None) -> dict[str, Any]:
    return {"kind": "random", "rms": rms} | ({"at": at} if at else {})


PLAYED: dict[str, tuple[list[dict[str, Any]], dict[str, float], dict[str, float], float]] = {
    "dc_drive": ([random_force(5.0)], {"speed": 0.05}, {"R": 15.0, "K": -8.0, "b": 40.0}, 1.1),
    "loudspeaker": (
        [random_force(4.0)], {"displacement": 1e-6}, {"R": 20.0, "K": -8.0, "b": 40.0, "k": -15.0}, 1.1,
    ),
    "rlc_filter": (
        [random_force(10.0)], {"current": 2e-4, "voltage": 1e-3},
        {"R1": 30.0, "C1": -15.0, "R2": 10.0, "C2": -12.0, "load": 5.0}, 0.6,
    ),
    "oven": (
        [random_force(800.0, "heater"), random_force(1.0, "room")], {"temperature": 0.02},
        {"R1": 25.0, "R2": -20.0},
        6000.0,
    ),
    "transfer_line": ([random_force(1e-4)], {"level": 1e-4}, {"pipe.R": 20.0, "valve": -15.0}, 1500.0),
    "geared_drive": ([random_force(1.0)], {"speed": 1e-3}, {"k": -15.0, "b1": 40.0, "b2": 35.0}, 1.7),
    "gantry": ([random_force(20.0)], {"displacement": 1e-6}, {"post": -8.0, "arm": 4.0, "tau": 10.0}, 1.1),
}  # fmt: skip


OWN = {
    "dc-drive": "dc_drive", "filter": "rlc_filter", "oven": "oven", "transfer": "transfer_line",
    "gearbox": "geared_drive", "gantry": "gantry",
}  # fmt: skip


@pytest.mark.parametrize("name", PLAYED)
def test_parameters_of_an_example_are_found_where_they_moved(name: str) -> None:
    forces, noise, percent, seconds = PLAYED[name]
    scenario = {"seed": 4, "force": forces, "noise": noise, "change": [{"at_s": 0.0, "percent": percent}]}
    records, truth = play(EXAMPLES / f"{name}.toml", scenario, seconds)
    last = [r for r in records if isinstance(r, EstimateBatch)][-1]
    assert set(last.parameters) == set(percent)
    for parameter, value, sd, status in zip(
        last.parameters, last.value[-1], last.sd[-1], last.status[-1], strict=True
    ):
        true = truth[parameter][-1]
        assert Status(int(status)) is Status.VALID, parameter
        assert abs(value - true) < 3 * sd < 0.05 * true, (parameter, value, true, sd)


@pytest.mark.parametrize(("scenario", "file"), OWN.items())
def test_scenario_of_an_example_names_what_its_rig_has(scenario: str, file: str) -> None:
    rig = read_rig(EXAMPLES / f"{file}.toml")
    played = load_scenario(scenario, {})
    played.fits(rig)
    assert len(Rig(rig, played).advance(3).readings) == 3


def test_alarms_of_a_motor_watched_by_its_speed_are_those_due() -> None:
    forces, noise, percent, _ = PLAYED["dc_drive"]
    change = {"at_s": 0.0, "percent": {**percent, "b": 20.0}}
    records, _ = play(
        EXAMPLES / "dc_drive.toml", {"seed": 5, "force": forces, "noise": noise, "change": [change]}, 2.2
    )
    raised = {r.parameter for r in records if isinstance(r, AlarmTransition) and r.to_state == "UNACK"}
    assert raised == {"R", "K"}
