"""`deltak compare`: every method on one recording, tuned and scored on motion that it has not seen."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.cli.app import app
from agent.cli.terminal.errors import guarded
from agent.evaluation.compare import joint, methods, rivals
from agent.numerics.model.mechanics import Output
from agent.numerics.model.statespace import discretise, simulate
from tests.bench.scene import NOMINAL, PERIOD, play, rig
from tests.peers import ROOT

TRUE = NOMINAL * np.array([1.1, 0.95, 1.2, 0.9])
Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    """The example's configuration, and 1.6 seconds of a rig that is none of its nominals."""
    folder = tmp_path_factory.mktemp("compare")
    record = play(np.tile(TRUE, (1600, 1)), 1e-5, np.random.default_rng(3))
    columns = {"force": record.u[:, 0], "x1": record.y[:, 0], "x2": record.y[:, 1]}
    np.savez(folder / "run.npz", t=np.arange(len(record.y)) * PERIOD, **columns)
    text = (ROOT / "deploy/examples/modbus.toml").read_text(encoding="utf-8")
    (folder / "rig.toml").write_text(text, encoding="utf-8")
    return str(folder / "rig.toml"), str(folder / "run.npz")


def run(capsys: Capture, *arguments: str) -> tuple[int, str, str]:
    code = guarded(app, ["compare", *arguments])
    return code, *capsys.readouterr()


def test_compare_scores_each_method_on_windows_it_has_not_seen(
    files: tuple[str, str], tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(methods, "WALKS", (1e-6, 1e-3))
    for name in ("PUSHES", "SPEEDS", "MEMORIES", "RATES"):
        monkeypatch.setattr(methods, name, getattr(methods, name)[:2])
    plot = tmp_path / "compared.png"
    code, out, err = run(capsys, *files, "--json", "--plot", str(plot))
    assert code == 0, err
    document: dict[str, Any] = json.loads(out)
    found = document["methods"]
    assert set(found) == set(methods.METHODS)
    assert document["skipped"] == {}
    ekf = found["ekf"]
    # a filter that remembers everything knows a rig that does not change best, and predicts to the noise
    assert ekf["prediction_rms"] == pytest.approx(1.0, abs=0.15)
    off = [abs(row["value"] / true - 1) for row, true in zip(ekf["estimates"].values(), TRUE, strict=True)]
    assert max(off) < 0.02
    assert all(row["prediction_rms"] > 0.85 for row in found.values())
    assert found["window-ml"]["prediction_rms"] < 3
    assert all(row["cost_us_per_sample"] > 0 and row["tuned"] for row in found.values())
    assert found["observer"]["estimates"]["k1"]["sd"] is None
    k2 = found["window-ml"]["estimates"]["k2"]
    assert k2["lower"] < TRUE[1] < k2["upper"]
    assert plot.stat().st_size > 10_000


def test_compare_table_names_what_was_chosen_and_refuses_what_is_none(
    files: tuple[str, str], capsys: Capture
) -> None:
    code, out, _ = run(capsys, *files, "--methods", "observer,rls")
    assert code == 0
    assert "rate 0." in out
    assert "forgets 0.9" in out
    assert "window-ml" not in out
    code, _, err = run(capsys, *files, "--methods", "ekf,magic")
    assert (code, 'no method is called "magic"; methods are window-ml, ekf' in err) == (2, True)


def test_compare_refuses_a_recording_of_too_few_windows(
    files: tuple[str, str], tmp_path: Path, capsys: Capture
) -> None:
    config = tmp_path / "long.toml"
    text = Path(files[0]).read_text(encoding="utf-8").replace("window_s = 0.25 ", "window_s = 0.8 ")
    config.write_text(text, encoding="utf-8")
    code, _, err = run(capsys, str(config), files[1])
    assert code == 2
    assert "its longest piece of 1600 samples holds fewer than 3 windows of 800" in err


def test_command_line_does_not_import_filterpy_before_it_compares() -> None:
    code = "import sys, agent.cli.app, agent.evaluation.compare.compare; print('filterpy' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout == "False\n"


def test_joint_filters_read_accelerometers_whose_direct_part_depends_on_parameters() -> None:
    """Accelerations are C(theta) x + D u: the filters take both from the polynomial."""
    model = rig()
    sensed = type(model)(
        model.structure,
        model.parameters,
        model.forces,
        (Output("acceleration", "m1"), Output("displacement", "m2")),
    )
    rng = np.random.default_rng(4)
    u = rng.normal(scale=5.0, size=(1500, 1))
    truth = discretise(sensed.continuous(TRUE), PERIOD, "first")
    _, y = simulate(truth, np.zeros(4), u)
    sigma = np.array([1e-3, 1e-6])
    y = y + sigma * rng.normal(size=y.shape)
    polynomial, tuning = rivals.Polynomial(sensed, PERIOD), rivals.Tuning(1e-6)
    assert not polynomial.direct
    ekf, sd = joint.run_ekf(polynomial, sigma, tuning, y, u)
    ukf, _ = joint.run_ukf(polynomial, sigma, tuning, y[:300], u[:300])
    assert np.all(np.abs(ekf[-1] - TRUE) < np.maximum(4 * sd[-1], 0.01 * TRUE))
    assert np.all(np.abs(ukf[-1] - ekf[299])[[1, 3]] < 0.05 * TRUE[[1, 3]])


def test_adaptive_observer_converges_on_a_rig_that_does_not_change() -> None:
    record = play(np.tile(TRUE, (6000, 1)), 1e-6, np.random.default_rng(7))
    polynomial = rivals.Polynomial(rig(), PERIOD)
    poles = [-30.0, -31.5, -33.0, -34.5]
    gain = methods.poles_gain(polynomial.base.model, poles, PERIOD)
    theta, sd = rivals.run_observer(polynomial, gain, 0.03, np.full(2, 1e-6), record.y, record.u)
    assert np.abs(theta[-1] - TRUE).max() < 0.5 * np.abs(NOMINAL - TRUE).max()
    assert np.all(np.isnan(sd))
