"""`deltak examples` and `deltak init`: files `check` accepts, questions on a terminal, what is refused."""

import json
import os
import pty
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from agent.blocks.rig_model import rig_model
from agent.cli.app import app
from agent.cli.terminal.errors import guarded
from agent.commissioning.setup.init import init
from agent.commissioning.setup.plan import Plan, channel_of
from agent.config import load
from agent.runtime.assembly.model_check import model_faults
from tests.peers import ROOT

FILES = {file.name for file in (ROOT / "deploy/examples").iterdir() if file.suffix in (".toml", ".dbc")}
MASSES = ["--rate", "1000", "--mass", "m1=5", "--mass", "m2=3"]
CHANNELS = ["--channel", "force=force@m2", "--channel", "x1=displacement@m1:mm", "--channel", "x2=disp@m2:mm"]
REGISTERS = "force:int16:1e-3,x1:int16:2e-3,x2:int16:2e-3"
BUSES = {
    "can": [
        "--dbc",
        "two-mass-rig.dbc",
        "--counter",
        "Counter",
        "--bus-channel",
        "vcan0",
        "--host",
        "127.0.0.1",
    ],
    "serial": ["--port", "line.tty", "--columns", "n,force,x1,x2", "--counter", "n"],
    "modbus": ["--port", "1502", "--index", "0", "--ring", "16:1024", "--fields", REGISTERS],
    None: [],
}
Capture = pytest.CaptureFixture[str]


def run(capsys: Capture, *arguments: str) -> tuple[int, str, str]:
    code = guarded(app, list(arguments))
    return code, *capsys.readouterr()


def test_wheel_holds_the_examples_of_deploy(tmp_path: Path) -> None:
    """One set of files serves both: what lies in deploy/ is packed, and git keeps no second copy."""
    source, wheels = tmp_path / "source", tmp_path / "wheels"
    for package in ("agent", "drivers", "sim_bus", "deploy/examples"):
        left_out = shutil.ignore_patterns("__pycache__", "*.db")
        shutil.copytree(ROOT / package, source / package, symlinks=True, ignore=left_out)
    for file in ("pyproject.toml", "README.md", "LICENSE", "deltak.py"):
        shutil.copy(ROOT / file, source)
    wheels.mkdir()
    build = "import sys; from setuptools import build_meta; build_meta.build_wheel(sys.argv[1])"
    subprocess.run(
        [sys.executable, "-c", build, str(wheels)], cwd=source, check=True, capture_output=True, timeout=100
    )
    (wheel,) = wheels.glob("*.whl")
    with zipfile.ZipFile(wheel) as packed:
        prefix = "agent/examples/"
        found = {name.removeprefix(prefix) for name in packed.namelist() if name.startswith(prefix)}
        assert found == FILES
        assert packed.read(f"{prefix}can.toml") == (ROOT / "deploy/examples/can.toml").read_bytes()


def test_examples_copy_brings_what_the_example_needs_and_overwrites_nothing(
    tmp_path: Path, capsys: Capture
) -> None:
    code, out, _ = run(capsys, "examples", "list", "--json")
    assert code == 0
    assert {name for row in json.loads(out)["examples"] for name in row["files"]} == FILES
    assert run(capsys, "examples", "copy", "can", str(tmp_path / "rig"))[0] == 0
    assert {file.name for file in (tmp_path / "rig").iterdir()} == {"can.toml", "two-mass-rig.dbc"}
    assert load(tmp_path / "rig/can.toml").rig.name == "two-mass-rig"
    code, _, err = run(capsys, "examples", "copy", "can", str(tmp_path / "rig"))
    assert code == 2
    assert err.count("is there already; name another folder") == 2
    code, _, err = run(capsys, "examples", "copy", "cam")
    assert (code, 'no example is called "cam"; examples are can, ' in err) == (2, True)


@pytest.mark.parametrize("bus", BUSES)
def test_init_writes_what_check_accepts(bus: str | None, tmp_path: Path, capsys: Capture) -> None:
    shutil.copy(ROOT / "deploy/examples/two-mass-rig.dbc", tmp_path)
    file, flags = str(tmp_path / "press.toml"), ["--bus", bus] if bus else []
    assert run(capsys, "init", file, *flags, *BUSES[bus], *MASSES, *CHANNELS)[0] == 0
    code, out, _ = run(capsys, "check", file, "--json")
    assert (code, json.loads(out)["ok"]) == (0, True)
    known = ["--spring", "a=ground,m1:25", "--spring", "b=m1,m2:100", "--damper", "c=ground,m2:5"]
    whole = str(tmp_path / "whole.toml")
    assert run(capsys, "init", whole, *flags, *BUSES[bus], *MASSES, *CHANNELS, *known)[0] == 0
    config = load(whole)
    assert [e.nominal for e in (*config.model.spring, *config.model.damper)] == [25.0, 100.0, 5.0]
    assert config.channel[1].si_factor == 1e-3
    assert config.rig.clock == ("counter" if bus else "device")
    field = "RIG_SAMPLE.X1" if bus == "can" else "x1"
    assert [source.map["x1"] for source in config.source] == [field] * bool(bus)
    before = Path(file).read_bytes()
    code, _, err = run(capsys, "init", file, *MASSES, *CHANNELS)
    assert (code, "is there already" in err, Path(file).read_bytes() == before) == (2, True, True)


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        ([], ["--rate: is missing", "--mass: is missing", "--channel: nothing", "no terminal to ask on"]),
        (["--bus", "can", *MASSES, *CHANNELS], ["--dbc: is missing"]),
        (
            ["--bus", "serial", *MASSES, *CHANNELS],
            ["--port: is missing", "--columns or --fields: is missing"],
        ),
        (
            ["--bus", "modbus", *MASSES, *CHANNELS, "--ring", "16:8"],
            ["--fields: is missing", "--index: is missing"],
        ),
        (
            [*MASSES, "--channel", "x9=displacement@m9"],
            ['no mass is called "m9"', "press.toml: was not written"],
        ),
        ([*MASSES, "--channel", "x1=length@m1"], ['--channel: "x1=length@m1" is none']),
        ([*MASSES, *CHANNELS, "--spring", "k1=ground"], ['--spring: "k1=ground" is none']),
        ([*MASSES, "--mass", "m3=heavy", *CHANNELS], ['--mass: "m3=heavy" holds no number']),
    ],
)
def test_init_says_what_is_missing_or_wrong_and_writes_nothing(
    flags: list[str], words: list[str], tmp_path: Path, capsys: Capture
) -> None:
    code, _, err = run(capsys, "init", str(tmp_path / "press.toml"), *flags)
    assert code == 2
    assert [text for text in words if text not in err] == []
    assert not list(tmp_path.iterdir())


COIL = [
    "--rate", "2000", "--kind", "voice-coil", "--element", "R=4", "--element", "L=4e-3", "--element", "K=5",
    "--element", "m=0.02", "--element", "b=1.5", "--element", "k=400",
    "--channel", "u=voltage", "--channel", "x=displacement:um",
]  # fmt: skip
TEMPLATES: dict[str, tuple[list[str], list[str]]] = {
    "coil": (COIL, ["R", "K", "b", "k"]),
    "tanks": (
        ["--rate", "1", "--kind", "hydraulic", "--element", "tank:T1=0.05", "--element", "vessel:V=1e-6",
         "--element", "restriction:c=T1,ground:5e6",
         "--element", 'line={ name = "p", between = ["V", "T1"], nominal = 1e6, resistance = 2e6 }',
         "--channel", "flow@V:l/s", "--channel", "h=level@T1"],
        ["c", "p.R"],
    ),
    "ladder": (
        ["--rate", "1e4", "--kind", "rlc-ladder", "--element", "stage={ R = 5.0, L = 1e-2, C = 1e-4 }",
         "--element", "load=60.0", "--channel", "u=voltage@source", "--channel", "v=voltage@C1"],
        ["R1", "C1", "load"],
    ),
    "linear": (
        ["--rate", "100", "--kind", "linear", "--element", "A=[[0.9, 0.1], [-0.1, 0.9]]",
         "--element", 'time="discrete"', "--element", "rate_hz=100", "--element", "B=[[0.0], [0.1]]",
         "--element", "C=[[1.0, 0.0]]", "--element", 'uncertain=["A[1,0]"]',
         "--channel", "u=input:V", "--channel", "y=output:m"],
        ["A[1,0]"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", TEMPLATES)
def test_init_of_another_domain_writes_what_check_accepts(name: str, tmp_path: Path, capsys: Capture) -> None:
    flags, names = TEMPLATES[name]
    file = str(tmp_path / "plant.toml")
    code, out, err = run(capsys, "init", file, *flags)
    assert code == 0, err
    assert "nobody stated" not in out
    config = load(file)
    assert list(config.estimator.estimate) == names
    assert not list(model_faults(config, rig_model(config)))
    text = Path(file).read_text(encoding="utf-8")
    assert f'# parameter = "{names[0]}"' in text


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["--kind", "motor"], ['--kind: "motor" is none; choose one of rlc-ladder, dc-motor']),
        (["--kind", "dc-motor", "--rate", "9"], ["--element: is missing", "keys are R, L, K", "--channel"]),
        (["--kind", "dc-motor", "--mass", "m1=5"], ["--mass: does not go with --kind dc-motor"]),
        (["--element", "R=5"], ["--element: goes with the kind of a model; give --kind too"]),
        ([*COIL, "--element", "tank:T1"], ['--element: "tank:T1" is none']),
        ([*COIL[:-2], "--channel", "x=level"], ['"level" is nowhere in this model', "was not written"]),
        ([*COIL[:4], *COIL[6:]], ["model.R: is missing", "was not written"]),
    ],
)
def test_init_says_what_is_wrong_of_another_domain(
    flags: list[str], words: list[str], tmp_path: Path, capsys: Capture
) -> None:
    code, _, err = run(capsys, "init", str(tmp_path / "plant.toml"), *flags)
    assert code == 2
    assert [text for text in words if text not in err] == []
    assert not list(tmp_path.iterdir())


def test_init_asks_for_elements_of_a_kind(tmp_path: Path) -> None:
    answers = iter(["none", "", "100", "capacity:core=500", "conductance:G=room,core:2", 'boundary=["room"]',
                    "", "p=power@core:W", "temperature@room", "core=temperature@core", ""])  # fmt: skip
    plan = Plan(kind="thermal")
    init(tmp_path / "oven.toml", plan, lambda _, default: next(answers) or default)
    config = load(tmp_path / "oven.toml")
    assert (config.model.kind, [c.name for c in config.channel]) == (
        "thermal",
        ["p", "temperature_room", "core"],
    )


def test_init_asks_for_what_flags_leave_open(tmp_path: Path) -> None:
    rig = ["modbus", "", "500", "5, 3", "", "c=m1,m2", "force=force@m2", "x1=disp@m1", ""]
    answers = iter([*rig, "10.0.0.7", "", REGISTERS, ""])
    asked: list[str] = []

    def ask(question: str, default: str) -> str:
        asked.append(question)
        return next(answers) or default

    plan = Plan(keys={"index": "0", "ring": "16:1024"})
    found = init(tmp_path / "press-7.toml", plan, ask)
    config = load(found["file"], identified=True)
    assert (config.rig.name, config.rig.sample_rate_hz) == ("press-7", 500.0)
    assert [e.name for e in (*config.model.spring, *config.model.damper)] == ["k1", "k2", "c"]
    assert found["to_identify"] == ["k1", "k2", "c"]
    assert config.source[0].settings.host == "10.0.0.7"
    assert asked[0].startswith("bus")


def test_init_asks_for_the_line_of_a_serial_bus(tmp_path: Path) -> None:
    answers = iter(["9600", "n,force,x1", "line.tty", "n"])
    channels = [channel_of("force=force@m1"), channel_of("x1=disp@m1")]
    plan = Plan(name="a", bus="serial", rate_hz=100.0, masses={"m1": 2.0}, channels=channels)
    init(
        tmp_path / "a.toml",
        plan,
        lambda question, default: default if question[0] in "nsd" else next(answers),
    )
    (source,) = load(tmp_path / "a.toml", identified=True).source
    assert (source.settings.baudrate, source.settings.columns, source.counter) == (
        9600,
        ("n", "force", "x1"),
        "n",
    )


def test_init_asks_on_a_terminal(tmp_path: Path) -> None:
    ours, theirs = pty.openpty()
    command = [sys.executable, "-m", "agent", "init", str(tmp_path / "a.toml"), *MASSES, *CHANNELS]
    os.write(ours, b"none\nbench\nnone\n\n")
    with subprocess.Popen(command, stdin=theirs, stdout=subprocess.PIPE, stderr=theirs) as process:
        os.close(theirs)
        out, _ = process.communicate(timeout=60)
        assert process.returncode == 0
    os.close(ours)
    assert b"bench" in out
    assert load(tmp_path / "a.toml", identified=True).model.spring == ()


def test_sim_of_a_file_without_nominals_says_what_to_do_instead(tmp_path: Path, capsys: Capture) -> None:
    file = str(tmp_path / "press.toml")
    assert run(capsys, "init", file, "--bus", "modbus", *BUSES["modbus"], *MASSES, *CHANNELS)[0] == 0
    code, _, err = run(capsys, "sim", file, "--duration", "0.1")
    assert code == 2
    assert "model.spring[0].nominal: is missing; the simulator plays what stands there: give the value" in err
    assert "deltak identify" in err


def test_init_names_the_signals_that_a_counter_of_two_messages_may_be(
    tmp_path: Path, capsys: Capture
) -> None:
    frames = (ROOT / "deploy/examples/two-mass-rig.dbc").read_text(encoding="utf-8")
    more = 'BO_ 257 ARM: 8 RIG\n SG_ Counter : 0|16@1+ (1,0) [0|65535] "" GATEWAY\n\nCM_ BO_'
    (tmp_path / "two-mass-rig.dbc").write_text(frames.replace("CM_ BO_", more, 1), encoding="utf-8")
    flags = ["--bus", "can", "--dbc", "two-mass-rig.dbc", "--rate", "1000", *MASSES, *CHANNELS]
    code, _, err = run(capsys, "init", str(tmp_path / "press.toml"), *flags, "--counter", "Counter")
    said = 'several signals are called "Counter"; name one of RIG_SAMPLE.Counter, ARM.Counter, as --counter'
    assert (code, said in err) == (2, True)


def test_init_writes_the_checksum_of_lines_of_text(tmp_path: Path, capsys: Capture) -> None:
    file = tmp_path / "press.toml"
    flags = ["--bus", "serial", "--rate", "100", *BUSES["serial"], *MASSES, *CHANNELS]
    assert run(capsys, "init", str(file), *flags, "--checksum", "nmea")[0] == 0
    assert 'checksum = "nmea"' in file.read_text(encoding="utf-8")
    other = tmp_path / "other.toml"
    code, _, err = run(capsys, "init", str(other), *flags, "--checksum", "xor")
    assert (code, "checksum" in err, other.exists()) == (2, True, False)
