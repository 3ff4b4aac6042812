"""Each key of a scenario, each fault and each scenario that comes along is in docs/scenarios.md, as it is."""

import re

import pytest
from pydantic import BaseModel

from agent.evaluation.score.score import Expect
from sim_bus.rig.covariates.course import Covariate
from sim_bus.rig.excitation import Force
from sim_bus.rig.fault_names import KNOWN
from sim_bus.rig.scenario import FaultAt, Initial, Scenario, built_in_names, load_scenario
from sim_bus.rig.schedule import Change, Draw
from sim_bus.rig.sensors import Oscillator, Sensor
from sim_bus.rig.wear import Wear
from tests.docs.test_nothing_undocumented import documented
from tests.peers import ROOT

TEXT = (ROOT / "docs/scenarios.md").read_text(encoding="utf-8")
PARTS = (Scenario, Initial, Force, Change, Draw, Wear, Covariate, Sensor, Oscillator, FaultAt, Expect)


@pytest.mark.parametrize("part", PARTS, ids=lambda part: part.__name__)
def test_every_key_of_a_scenario_is_documented(part: type[BaseModel]) -> None:
    headed = {name for name in Scenario.model_fields if f"[{name}]" in TEXT}
    assert set(part.model_fields) - documented(TEXT) - headed - {"folder"} == set()


@pytest.mark.parametrize("driver", KNOWN)
def test_every_fault_is_documented_as_it_is(driver: str) -> None:
    for name, kind in KNOWN[driver].items():
        lasts = f"{kind.lasts_s:g} s" if kind.lasts_s else "a sample"
        reported = kind.cause or "(nothing to tell)"
        assert f"| `{driver}.{name}` | {kind.words} | {lasts} | {reported} |" in TEXT


def test_every_fault_stands_beside_what_happens_in_the_field() -> None:
    table = TEXT.partition("| in the field | here |")[2].partition("\n\n")[0]
    shown = set(re.findall(r"`([a-z0-9-]+)`", table))
    assert {name for faults in KNOWN.values() for name in faults} - shown == set()


def test_every_scenario_that_comes_along_is_documented() -> None:
    for name in built_in_names():
        assert f"| `{name}` | {load_scenario(name, {}).title} |" in TEXT
