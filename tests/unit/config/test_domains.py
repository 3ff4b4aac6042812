"""Templates of other domains: equations against the simulator's own, derivatives, and what is wrong said in
words."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.blocks.rig_model import rig_model
from agent.config import RigConfig, load, parse
from agent.config.domains.kinds import DOMAINS
from agent.errors import ConfigError
from agent.numerics.model.statespace import StateSpace
from agent.runtime.assembly.model_check import model_faults
from sim_bus.rig.domains.built import Built
from sim_bus.rig.domains.system import KINDS, DomainTable
from tests.sim.rigs import ROOT

EXAMPLES = ROOT / "deploy/examples"
HEAD = '[rig]\nname = "r"\nsample_rate_hz = 1000.0\n[model]\n'
LADDER = 'kind = "rlc-ladder"\nload = 50.0\nstage = [{ R = 1.0, C = 1e-3 }, { R = 2.0, L = 0.1, C = 2e-3 }]\n'
MOTOR = 'kind = "dc-motor"\nR = 1.0\nL = 2e-3\nK = 0.05\nJ = 2e-4\nb = 1e-3\n'
COIL = 'kind = "voice-coil"\nR = 4.0\nL = 4e-3\nK = 5.0\nm = 0.02\nb = 1.5\nk = 400.0\n'
WARM = """kind = "thermal"
capacity = [{ name = "core", nominal = 5.0 }, { name = "shell", nominal = 15.0 }]
conductance = [{ name = "G", between = ["room", "core"], nominal = 0.2 }]
resistance = [{ name = "R1", between = ["core", "shell"], nominal = 0.5 }]
boundary = ["room"]
"""
WET = """kind = "hydraulic"
tank = [{ name = "T1", nominal = 0.05 }]
vessel = [{ name = "V", nominal = 1e-6 }]
restriction = [{ name = "r1", between = ["T1", "V"], nominal = 1e6 },
{ name = "r2", between = ["ground", "V"], nominal = 2e6 }]
line = [{ name = "p", between = ["supply", "T1"], nominal = 1e6, resistance = 2e6 }]
boundary = ["supply"]
"""
CHAIN = """kind = "torsional"
inertia = [{ name = "J1", nominal = 0.01 }, { name = "J2", nominal = 0.2 }]
shaft = [{ name = "k1", between = ["ground", "J1"], nominal = 50.0 },
{ name = "k2", between = ["J1", "J2"], ratio = 5.0, nominal = 100.0 }]
bearing = [{ name = "b", between = ["J1", "J2"], ratio = 5.0, nominal = 0.3 }]
"""
FRAME = """kind = "frame"
damping_s = 1e-3
node = [{ name = "a", at = [0.0, 0.0], support = "pinned" }, { name = "b", at = [0.3, 1.1] },
{ name = "c", at = [1.0, 1.4], mass = 1.0 },
{ name = "d", at = [1.5, 0.2], support = "clamped" }]
beam = [{ name = "e1", between = ["a", "b"], nominal = 40.0, mass_per_m = 1.5 },
{ name = "e2", between = ["b", "c"], nominal = 25.0, mass_per_m = 1.0 },
{ name = "e3", between = ["d", "c"], nominal = 60.0, mass_per_m = 2.0 }]
"""
VOLTAGE, SPEED, TWIST = ("voltage", "", "V"), ("speed", "", "rad/s"), ("torque", "k2", "N m")
RIGS: dict[str, tuple[str, tuple[tuple[str, str, str], ...]]] = {
    "ladder": (LADDER, (("voltage", "source", "V"), ("voltage", "C2", "V"), ("current", "L2", "A"))),
    "motor": (MOTOR, (VOLTAGE, ("torque", "shaft", "N m"), SPEED, ("angle", "", "rad"))),
    "coil": (COIL, (VOLTAGE, ("displacement", "", "m"), ("current", "winding", "A"))),
    "thermal": (WARM, (("power", "core", "W"), ("temperature", "room", "K"), ("temperature", "shell", "K"))),
    "hydraulic": (
        WET,
        (("pressure", "supply", "Pa"), ("flow", "V", "m3/s"), ("level", "T1", "m"), ("flow", "p", "m3/s")),
    ),
    "chain": (CHAIN, (("torque", "J1", "N m"), ("speed", "J2", "rad/s"), TWIST)),
    "angles": (CHAIN, (("torque", "J2", "N m"), ("angle", "J1", "rad"), TWIST, ("torque", "k1", "N m"))),
    "frame": (
        FRAME,
        (("force", "b.x", "N"), ("displacement", "c.y", "m"), ("angle", "b", "rad"),
         ("velocity", "c.x", "m/s")),
    ),
}  # fmt: skip


def text(model: str, channels: tuple[tuple[str, str, str], ...], more: str = "") -> str:
    rows = [
        f'[[channel]]\nname = "c{i}"\nquantity = "{quantity}"\nunit = "{unit}"\n'
        + (f'at = "{at}"\n' if at else "")
        for i, (quantity, at, unit) in enumerate(channels)
    ]
    return HEAD + model + "".join(rows) + more


def configured(model: str, channels: tuple[tuple[str, str, str], ...], more: str = "") -> RigConfig:
    return parse(text(model, channels, more).encode(), Path("rig.toml"))


def everything(config: RigConfig) -> RigConfig:
    names = tuple(p.name for p in config.parameters.values() if p.kind in ("element", "storage"))
    return config.model_copy(update={"estimator": config.estimator.model_copy(update={"estimate": names})})


def response(s: complex, A: Any, B: Any, C: Any) -> Any:
    return C @ np.linalg.solve(s * np.eye(len(A)) - A, B)


def simulated(config: RigConfig, values: dict[str, float]) -> tuple[Any, Any, Any]:
    built: Built = DomainTable.model_validate(config.model.model_dump(mode="json", exclude_unset=True)).built(
        values
    )
    B = np.array([built.drives[c.quantity, c.at] for c in config.inputs]).T
    return built.F, B, np.array([built.reads[c.quantity, c.at] for c in config.outputs])


def test_every_template_is_tried_here_and_played_by_the_simulator() -> None:
    assert {configured(*rig).model.kind for rig in RIGS.values()} == set(DOMAINS) == set(KINDS)


@pytest.mark.parametrize("name", RIGS)
def test_equations_are_the_simulators_own_at_any_values(name: str, rng: np.random.Generator) -> None:
    config = everything(configured(*RIGS[name]))
    rig = rig_model(config)
    theta = rig.model.nominal * rng.uniform(0.5, 2.0, len(rig.model.nominal))
    ours = rig.model.continuous(theta)
    theirs = simulated(config, dict(zip(rig.model.parameters, theta.tolist(), strict=True)))
    speed = np.abs(np.linalg.eigvals(ours.A)).max()
    for share in (0.01, 0.2, 1.0):
        s = speed * share * (0.3 + 1j)
        found, wanted = response(s, ours.A, ours.B, ours.C), response(s, *theirs)
        assert np.all(np.abs(found - wanted) < 1e-8 * np.abs(wanted).max(axis=1, keepdims=True)), (
            found,
            wanted,
        )


@pytest.mark.parametrize("name", RIGS)
def test_derivatives_by_physical_parameters_are_exact(name: str) -> None:
    model = rig_model(everything(configured(*RIGS[name]))).model
    at: StateSpace = model.continuous(model.nominal)
    for i, value in enumerate(model.nominal):
        step = 1e-5 * value * np.eye(len(model.nominal))[i]
        after, before = model.continuous(model.nominal + step), model.continuous(model.nominal - step)
        for letter in "ABCD":
            slope = (getattr(after, letter) - getattr(before, letter)) / (2e-5 * value)
            exact = getattr(at, f"d{letter}")[i]
            np.testing.assert_allclose(
                exact, slope, rtol=1e-7, atol=1e-8 * max(np.abs(slope).max(initial=0.0), 1e-12)
            )


@pytest.mark.parametrize(
    "file", ["dc_drive", "rlc_filter", "oven", "transfer_line", "geared_drive", "gantry"]
)
def test_examples_hide_a_domain_between_input_and_output(file: str) -> None:
    config = load(EXAMPLES / f"{file}.toml")
    model = rig_model(config).model
    assert len(config.outputs) < len(model.state_names)


def test_a_store_that_is_known_by_its_data_sheet_widens_what_depends_on_it() -> None:
    from agent.blocks.statistical_rig import statistical_rig

    config = configured(MOTOR + "sd_percent = { J = 2.0 }\n", RIGS["motor"][1])
    rig = statistical_rig(config)
    assert [(c.name, c.kind, c.sheet) for c in rig.constants if c.kind == "mass"] == [("J", "mass", 0.02)]
    assert rig.model.parameters == ("R", "K", "b", "J")


def test_what_cannot_be_told_apart_is_named_with_the_output_that_would_help() -> None:
    channels = (VOLTAGE, SPEED)
    config = configured(MOTOR, channels, '[estimator]\nestimate = ["R", "L", "K", "J", "b"]\n')
    faults = list(model_faults(config, rig_model(config)))
    assert len(faults) == 2
    assert all(
        "cannot be told apart" in fault.message and "measure current" in fault.advice for fault in faults
    )


MOVED = RIGS["motor"][1]
CASES: dict[str, tuple[str, tuple[tuple[str, str, str], ...], str, tuple[str, str, str]]] = {
    "unknown key": (MOTOR + "k = 1.0\n", MOVED, "", ("model.k", "unknown key", '"K"')),
    "missing": (MOTOR.replace("L = 2e-3\n", ""), MOVED, "", ("model.L", "is missing", "add it")),
    "negative": (MOTOR.replace("J = 2e-4", "J = -1.0"), MOVED, "", ("model.J", "must be greater than 0", "")),
    "not a number": (MOTOR.replace("R = 1.0", "R = nan"), MOVED, "",
                     ("model.R", "must be a finite number", "")),
    "node": (WARM.replace('"core", "shell"]', '"core", "shel"]'), RIGS["thermal"][1], "",
             ("model.resistance[0].between[1]", 'no node is called "shel"', "nodes are core, shell, room")),
    "loop": (WARM.replace('"core", "shell"]', '"core", "core"]'), RIGS["thermal"][1], "",
             ("model.resistance[0].between", 'both ends are "core"', "two different nodes")),
    "twice": (WARM.replace('"R1"', '"G"'), RIGS["thermal"][1], "",
              ("model.resistance[0].name", '"G" is the name of conductance[0]', "names must differ")),
    "still": (FRAME.split("beam", maxsplit=1)[0].replace('[0.3, 1.1] }',
                                                         '[0.3, 1.1], support = "clamped" }') +
              'beam = [{ name = "e1", between = ["a", "b"], nominal = 40.0, mass_per_m = 1.5 }]\n',
              RIGS["frame"][1], "", ("model.node[2]", 'no beam ends at "c"', "join it")),
    "quantity": (MOTOR, (VOLTAGE, ("displacement", "", "m")), "",
                 ("channel[1].quantity", "nowhere in this model", "can be measured is current, speed")),
    "place": (LADDER, (("voltage", "source", "V"), ("voltage", "C9", "V")), "",
              ("channel[1].at", 'no voltage is at "C9"', "source, C1, C2")),
    "which place": (LADDER, (("voltage", "source", "V"), VOLTAGE), "",
                    ("channel[1].at", "is missing", "source, C1, C2")),
    "unit of another kind": (MOTOR, (VOLTAGE, ("speed", "", "A")), "",
                             ("channel[1].unit", '"A" is a unit of current', "rad/s, rpm")),
    "unknown unit": (MOTOR, (("voltage", "", "counts"), ("speed", "", "rpm")), "",
                     ("channel[0].unit", '"counts" is no unit of voltage', "V, mV")),
    "nothing drives": (MOTOR, (VOLTAGE,), "", ("channel", "nothing is measured", "")),
    "parameter": (MOTOR, MOVED, '[estimator]\nestimate = ["R", "k"]\n',
                  ("estimator.estimate[1]", 'no parameter is called "k"', '"K"')),
    "sheet of what is estimated": (MOTOR + "sd_percent = { R = 2.0 }\n", MOVED, "",
                                   ("model.sd_percent.R", "keep energy", "L, J")),
    "kind": (MOTOR.replace("dc-motor", "motor"), MOVED, "", ("model.kind", "is none of", "choose one")),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_what_is_wrong_in_a_template_is_named_with_its_key_and_advice(case: str) -> None:
    model, channels, more, (path, what, advice) = CASES[case]
    with pytest.raises(ConfigError) as caught:
        configured(model, channels, more)
    found = {fault.path: fault for fault in caught.value.faults}
    assert path in found, list(found)
    assert what in found[path].message
    assert advice in found[path].advice


def test_quantities_of_templates_are_refused_in_other_models() -> None:
    text = (EXAMPLES / "voice_coil.toml").read_text().replace('quantity = "input"', 'quantity = "voltage"')
    with pytest.raises(ConfigError, match=r"channel\[0\]\.quantity.*templates"):
        parse(text.encode(), Path("rig.toml"))
    text = (EXAMPLES / "serial.toml").read_text().replace('quantity = "force"', 'quantity = "voltage"')
    with pytest.raises(ConfigError, match=r"channel\[0\]\.quantity.*templates"):
        parse(text.encode(), Path("rig.toml"))
