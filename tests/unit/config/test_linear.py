"""kind = "linear": discrete time, D, dC, dD, uncertain entries, files; every fault with its key path and
advice."""

import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.io import savemat
from scipy.signal import StateSpace, TransferFunction

from agent.cli.app import app
from agent.cli.terminal.errors import guarded
from agent.config import LinearModel, RigConfig, load
from agent.config.plants import linear_table
from agent.errors import ConfigError, Fault, UsageError

CHANNELS = """
[[channel]]
name = "u"
quantity = "input"
unit = "V"

[[channel]]
name = "y"
quantity = "output"
unit = "m"
noise_sd = 1e-3

[estimator]
window_s = 2.0
hop_s = 0.5
"""
RIG = '[rig]\nname = "d"\nsample_rate_hz = 100.0\nclock = "uniform"\n'
MODEL = """
[model]
kind = "linear"
time = "discrete"
rate_hz = 100.0
A = [[0.9, 0.1], [-0.1, 0.9]]
B = [[0.0], [0.1]]
C = [[1.0, 0.0]]
D = [[0.0]]
state = [{ name = "p", unit = "m" }, { name = "v", unit = "m/s" }]
uncertain = ["A[1,0]", "D", "C[0, 0]"]
"""
ROW = 'parameter = [{ name = "%s", nominal = 1.0, %s }]\nuncertain'


def read(folder: Path, model: str) -> RigConfig:
    file = folder / "rig.toml"
    file.write_text(RIG + model + CHANNELS)
    return load(file)


def faults(folder: Path, model: str) -> tuple[Fault, ...]:
    with pytest.raises(ConfigError) as caught:
        read(folder, model)
    return tuple(caught.value.faults)


def test_linear_model_in_discrete_time_offers_its_uncertain_entries(tmp_path: Path) -> None:
    config = read(tmp_path, MODEL)
    assert config.estimator.estimate == ("A[1,0]", "D[0,0]", "C[0,0]")
    assert [(p.nominal, p.unit) for p in config.parameters.values()][:3] == [
        (-0.1, "(m/s)/m"),
        (0.0, "m/V"),
        (1.0, "1"),
    ]
    assert config.estimator.hold == "zero"


def test_linear_model_in_continuous_time_has_units_a_second(tmp_path: Path) -> None:
    text = MODEL.replace('time = "discrete"\nrate_hz = 100.0\n', "").replace('"D"', '"A[0,0]", "B[1,0]"')
    units = {name: parameter.unit for name, parameter in read(tmp_path, text).parameters.items()}
    assert (units["A[1,0]"], units["A[0,0]"], units["B[1,0]"]) == ("(m/s)/(m s)", "1/s", "(m/s)/(V s)")


@pytest.mark.parametrize("kind", ["npz", "mat", "csv"])
def test_matrix_in_a_file_reads_as_one_in_the_configuration(tmp_path: Path, kind: str) -> None:
    A = np.array([[0.9, 0.1], [-0.1, 0.9]])
    write = {
        "npz": lambda: np.savez(tmp_path / "plant.npz", A=A, other=A),
        "mat": lambda: savemat(tmp_path / "plant.mat", {"A": A}),
        "csv": lambda: np.savetxt(tmp_path / "plant.csv", A, delimiter=","),
    }
    write[kind]()
    inline = read(tmp_path, MODEL)
    filed = read(tmp_path, MODEL.replace("A = [[0.9, 0.1], [-0.1, 0.9]]", f'A = {{ file = "plant.{kind}" }}'))
    assert isinstance(filed.model, LinearModel)
    assert filed.model == inline.model


def test_matrix_file_that_is_a_pipe_or_unpacks_without_end_is_refused_unread(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.npz")
    np.savez_compressed(tmp_path / "bomb.npz", A=np.zeros((3000, 3000)))
    for name, words in (
        ("pipe", "is no file, its end may never come"),
        ("bomb", "unpacks to more than 50 MB"),
    ):
        text = MODEL.replace("A = [[0.9, 0.1], [-0.1, 0.9]]", f'A = {{ file = "{name}.npz" }}')
        assert words in faults(tmp_path, text)[0].message


def test_configuration_whose_matrix_file_changes_has_another_sum(tmp_path: Path) -> None:
    text = MODEL.replace("A = [[0.9, 0.1], [-0.1, 0.9]]", 'A = { file = "a.csv" }')
    sums = set()
    for scale in (1.0, 0.5):
        np.savetxt(tmp_path / "a.csv", scale * np.array([[0.9, 0.1], [-0.1, 0.9]]), delimiter=",")
        sums.add(read(tmp_path, text).sha256)
    assert len(sums) == 2


@pytest.mark.parametrize(
    ("before", "after", "path", "words"),
    [
        ("B = [[0.0], [0.1]]", "B = [[0.0, 0.1]]", "model.B", "2 rows of 1 columns fit"),
        ("D = [[0.0]]", "D = [[0.0, 0.0]]", "model.D", "output channels 1, input channels 1"),
        ("A = [[0.9, 0.1], [-0.1, 0.9]]", "A = [[0.9, nan], [-0.1, 0.9]]", "model.A[0][1]", "finite"),
        ("rate_hz = 100.0", "rate_hz = 200.0", "model.rate_hz", "200 Hz is not the rate of the rig, 100 Hz"),
        ("rate_hz = 100.0\n", "", "model.rate_hz", "is missing"),
        ('time = "discrete"\n', "", "model.rate_hz", 'goes with time = "discrete"'),
        ("[-0.1, 0.9]]", "[-0.1, 1.2]]", "model.A", "outside the unit circle"),
        ('"A[1,0]"', '"A[2,0]"', "model.uncertain[0]", "2 rows of 2 columns"),
        ('"A[1,0]"', '"E[0,0]"', "model.uncertain[0]", "names no entry"),
        ("D = [[0.0]]\n", "", "model.uncertain[1]", "D is not given"),
        ('uncertain = ["A[1,0]", "D", "C[0, 0]"]', "", "model.parameter", "is missing"),
        ("uncertain", ROW % ('R', 'dC = [[0.0, 0.0]]'), "model.parameter[0]", "changes nothing"),
        ("uncertain", ROW % ('R', 'dD = [[1.0], [0.0]]'), "model.parameter[0].dD", "1 rows of 1"),
        ("uncertain", ROW % ('A[0,0]', 'dD = [[1.0]]'), "model.parameter[0].name", "entry"),
        ('{ name = "v", unit = "m/s" }', '{ name = "p" }', "model.state[1].name", "names must differ"),
        (', { name = "v", unit = "m/s" }', "", "model.state", "1 name for 2 states"),
        ("A = [[0.9, 0.1], [-0.1, 0.9]]", 'A = { file = "none.mat" }', "model.A.file", "No such file"),
        ("A = [[0.9, 0.1], [-0.1, 0.9]]", 'A = { file = "plant.xls" }', "model.A.file", ".mat, .npz, .csv"),
        ("A = [[0.9, 0.1], [-0.1, 0.9]]", 'A = { fil = "a.mat" }', "model.A.fil", "unknown key"),
    ],
)  # fmt: skip
def test_linear_model_with_one_change_names_path_and_rule(
    tmp_path: Path, before: str, after: str, path: str, words: str
) -> None:
    assert before in MODEL
    found = faults(tmp_path, MODEL.replace(before, after, 1))
    assert [fault.path for fault in found] == [path]
    assert words in f"{found[0].message}; {found[0].advice}"
    assert found[0].advice


REFUSED = {
    "shape": ("B = [[0.0], [0.1]]", "B = [[0.0, 0.1]]", "model.B: has 1 row of 2 columns; "),
    "rows of different length": ("[-0.1, 0.9]]", "[-0.1]]", "model.A: "),
    "not a number": ("D = [[0.0]]", "D = [[nan]]", "model.D[0][0]: must be a finite number"),
    "infinite": ("C = [[1.0, 0.0]]", "C = [[1.0, inf]]", "model.C[0][1]: must be a finite number"),
    "nowhere": ("uncertain", ROW % ("R", "dA = [[0.0, 0.0], [0.0, 0.0]]"),
                "model.parameter[0]: appears nowhere in dA, dB, dC or dD: it changes nothing; give"),
    "rate": ("rate_hz = 100.0", "rate_hz = 50.0", "model.rate_hz: 50 Hz is not the rate of the rig, 100 Hz"),
    "poles": ("[[0.9, 0.1]", "[[1.3, 0.1]", "model.A: "),
    "poles of files": ("A = [[0.9, 0.1], [-0.1, 0.9]]", 'A = { file = "grows.csv" }', "model.A"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
@pytest.mark.parametrize("command", ["check", "run", "replay", "identify"])
def test_bad_matrices_end_any_command_with_path_advice_and_code_2(
    case: str, command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before, after, words = REFUSED[case]
    np.savetxt(tmp_path / "grows.csv", [[1.2, 0.0], [0.0, 0.9]], delimiter=",")
    file = tmp_path / "rig.toml"
    assert before in MODEL
    file.write_text(RIG + MODEL.replace(before, after, 1) + CHANNELS)
    more = ["none.csv"] if command in {"replay", "identify"} else []
    assert guarded(app, [command, str(file), *more]) == 2
    out, err = capsys.readouterr()
    assert words in err
    assert "; " in err
    assert "Traceback" not in out + err


def test_hold_of_a_model_in_discrete_time_is_its_own(tmp_path: Path) -> None:
    file = tmp_path / "rig.toml"
    file.write_text(RIG + MODEL + CHANNELS + 'hold = "cubic"\n')
    with pytest.raises(ConfigError) as caught:
        load(file)
    assert [fault.path for fault in caught.value.faults] == ["estimator.hold"]


@pytest.mark.parametrize("dt", [None, 0.01])
def test_state_space_of_scipy_becomes_a_configuration(tmp_path: Path, dt: float | None) -> None:
    A, B, C, D = np.array([[0.9, 0.1], [-0.1, 0.9]]), [[0.0], [0.1]], [[1.0, 0.0]], [[0.0]]
    plant = StateSpace(A, B, C, D) if dt is None else StateSpace(A, B, C, D, dt=dt)
    file = tmp_path / "rig.toml"
    file.write_text(RIG + linear_table(plant, uncertain=["A[1,0]"]) + "[estimator]\nwindow_s = 2.0\n")
    config = load(file)
    assert isinstance(config.model, LinearModel)
    assert config.model.A == ((0.9, 0.1), (-0.1, 0.9))
    assert config.model.time == ("continuous" if dt is None else "discrete")
    assert [c.name for c in config.channel] == ["u1", "y1"]


def test_labels_of_python_control_become_names(tmp_path: Path) -> None:
    plant = SimpleNamespace(A=[[-1.0]], B=[[1.0]], C=[[1.0]], D=[[0.0]], dt=0, state_labels=["x[0]"],
                            input_labels=["volts"], output_labels=["speed"])  # fmt: skip
    file = tmp_path / "rig.toml"
    file.write_text(RIG + linear_table(plant, uncertain=["A"]) + "[estimator]\nwindow_s = 2.0\n")
    config = load(file)
    assert isinstance(config.model, LinearModel)
    assert config.model.state_names == ("x_0_",)
    assert [c.name for c in config.channel] == ["volts", "speed"]


def test_plant_that_is_improper_or_has_no_sampling_time_is_refused() -> None:
    with pytest.raises(UsageError, match="improper"):
        linear_table(TransferFunction([1.0, 0.0, 0.0], [1.0, 1.0]), uncertain=["A"])
    with pytest.raises(UsageError, match="no sampling time"):
        linear_table(SimpleNamespace(A=[[0.5]], B=[[1.0]], C=[[1.0]], D=[[0.0]], dt=True), uncertain=["A"])
    with pytest.raises(UsageError, match="descriptor"):
        linear_table(
            SimpleNamespace(A=[[0.5]], B=[[1.0]], C=[[1.0]], D=[[0.0]], E=[[0.0]], dt=0), uncertain=["A"]
        )


def test_skew_that_is_to_be_measured_is_refused_in_discrete_time(tmp_path: Path) -> None:
    source = (
        '[[source]]\nname = "{0}"\ndriver = "serial"\nport = "{0}.tty"\nbaudrate = 9600\nformat = "binary"\n'
    )
    source += 'sync = "AA"\nfields = [{{ name = "{0}", type = "int16" }}]\nmap = {{ {0} = "{0}" }}\n'
    text = MODEL + CHANNELS + source.format("u")
    (tmp_path / "rig.toml").write_text(RIG + text + source.format("y") + "skew_s = 0.0\n")
    load(tmp_path / "rig.toml")
    (tmp_path / "rig.toml").write_text(RIG + text + source.format("y"))
    with pytest.raises(ConfigError) as caught:
        load(tmp_path / "rig.toml")
    assert [fault.path for fault in caught.value.faults] == ["source[1].skew_s"]
