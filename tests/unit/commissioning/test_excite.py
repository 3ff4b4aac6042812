"""The designed motion, read back from its file: optimal by the theorem, within bounds, as sharp as said."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import cont2discrete

from agent.cli.app import app
from agent.cli.terminal.errors import guarded
from tests.figures import figure
from tests.peers import ROOT
from tests.rigs import step_matrices, two_mass_recording

TRUTH = np.array([25.0, 100.0, 5.0, 5.0])
SIGMA, STEP = 1e-6, 2e-6
"""Noise of the sensors, and the steps of the wire that the example describes, m."""
SECONDS, RATE = 20.0, 100.0
NAMES = ("k1", "k2", "B1", "B2")


@pytest.fixture
def config(tmp_path: Path) -> Path:
    text = (ROOT / "deploy/examples/modbus.toml").read_text(encoding="utf-8")
    path = tmp_path / "rig.toml"
    path.write_text(text.replace("sample_rate_hz = 1000.0", f"sample_rate_hz = {RATE}"), encoding="utf-8")
    return path


def deltak(capsys: pytest.CaptureFixture[str], *argv: object) -> tuple[int, str, str]:
    capsys.readouterr()
    code = guarded(app, [str(word) for word in argv])
    return (code, *capsys.readouterr())


def excited(
    capsys: pytest.CaptureFixture[str], config: Path, *argv: object
) -> tuple[dict[str, Any], np.ndarray[Any, Any]]:
    to = config.with_name("shaker.csv")
    code, out, err = deltak(capsys, "excite", config, "--seconds", SECONDS, "--to", to, *argv, "--json")
    assert code == 0, err
    return json.loads(out), np.loadtxt(to, delimiter=",", skiprows=1)


def response(theta: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """(F, 2): displacements by force of the two masses, sampled with a force of straight lines."""
    k1, k2, B1, B2 = theta
    A = np.zeros((4, 4))
    A[0, 2] = A[1, 3] = 1.0
    A[2] = np.array([-(k1 + k2), k2, -(B1 + B2), B2]) / 5.0
    A[3] = np.array([k2, -k2, B2, -B2]) / 3.0
    B = np.array([[0.0], [0.0], [0.0], [1 / 3.0]])
    F, G, C, D, _ = cont2discrete((A, B, np.eye(2, 4), np.zeros((2, 1))), 1 / RATE, method="foh")
    return np.array(
        [(C @ np.linalg.solve(np.exp(1j * w / RATE) * np.eye(4) - F, G) + D)[:, 0] for w in omega]
    )


def test_no_frequency_of_the_band_could_teach_more_by_the_equivalence_theorem(
    config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    document, table = excited(capsys, config, "--band", 0.1, 4.0)
    count = len(table)
    assert count == SECONDS * RATE
    power = 2.0 * np.abs(np.fft.rfft(table[:, 1])) ** 2 / count**2
    hertz = np.fft.rfftfreq(count, 1 / RATE)
    band = (hertz >= 0.1) & (hertz <= 4.0)
    assert power[~band].sum() < 1e-12 * power.sum()
    omega = 2 * np.pi * hertz[band]
    steps = 1e-4 * TRUTH * np.eye(4)
    S = np.array([(response(TRUTH + d, omega) - response(TRUTH - d, omega)) / (2 * d.sum()) for d in steps])
    lines = np.einsum("kfp,lfp->fkl", S.conj(), S).real / SIGMA**2
    share = power[band] / power[band].sum()
    M = np.einsum("f,fkl->kl", share, lines)
    traces = np.einsum("kl,flk->f", np.linalg.inv(M), lines)
    assert traces.max() <= 4 * (1 + 1e-3)
    assert document["design_gap"] == pytest.approx(traces.max() / 4 - 1, abs=2e-4)
    # and the theorem is no formality: an even spread is far from it
    even = np.einsum("kl,flk->f", np.linalg.inv(lines.mean(axis=0)), lines)
    assert even.max() > 8


def play(force: np.ndarray, theta: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(N, R, 2): displacements of R machines theta (R, 4) from states x (R, 4)."""
    F, G0, G1 = (
        np.array(part) for part in zip(*(step_matrices(*row, 1 / RATE) for row in theta), strict=True)
    )
    ahead = np.append(force[1:], force[-1])
    found = np.empty((len(force), len(theta), 2))
    for i, now in enumerate(force):
        found[i] = x[:, :2]
        x = np.einsum("rij,rj->ri", F, x) + G0 * now + G1 * ahead[i]
    return found


@pytest.mark.parametrize(
    "bounds", [("--max-force", 3.0), ("--max-stroke", 0.02), ("--max-force", 9, "--max-stroke", 1)]
)
def test_bounds_on_force_and_stroke_are_kept_and_used(
    config: Path, capsys: pytest.CaptureFixture[str], bounds: tuple[Any, ...]
) -> None:
    document, table = excited(capsys, config, *bounds)
    stroke = np.abs(play(table[:, 1], TRUTH[None], np.zeros((1, 4)))).max()
    force = np.abs(table[:, 1]).max()
    assert document["peak_force"] == pytest.approx(force, rel=1e-6)
    assert document["peak_stroke"] == pytest.approx(stroke, rel=1e-3)
    allowed = dict(zip(bounds[::2], bounds[1::2], strict=True))
    used = [force / allowed.get("--max-force", np.inf), stroke / allowed.get("--max-stroke", np.inf)]
    assert max(used) <= 1 + 1e-6
    assert max(used) > 0.99
    assert document["crest_factor"] < 2.0


def test_sd_of_simulated_runs_is_the_predicted_one_where_constants_are_known(
    config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    document, table = excited(capsys, config, "--max-stroke", 0.02)
    force, runs = table[:, 1], 1000
    truth = np.concatenate([TRUTH, np.zeros(4)])
    scale = np.concatenate([TRUTH, np.full(4, 1e-3)])
    steps = 1e-5 * np.diag(scale)
    both = np.vstack([truth + steps, truth - steps])
    moved = play(force, both[:, :4], both[:, 4:])
    J = (moved[:, :8] - moved[:, 8:]).transpose(0, 2, 1).reshape(-1, 8) / (2e-5 * scale)
    rng = np.random.default_rng(1)
    y = play(force, TRUTH[None], np.zeros((1, 4))) + SIGMA * rng.standard_normal((len(force), runs, 2))
    y = STEP * np.round(y / STEP)
    found = np.tile(truth * 1.01, (runs, 1))
    to_theta = np.linalg.pinv(J / np.linalg.norm(J, axis=0)) / np.linalg.norm(J, axis=0)[:, None]
    for _ in range(6):
        residual = y - play(force, found[:, :4], found[:, 4:])
        found += np.einsum("kn,rn->rk", to_theta, residual.transpose(1, 0, 2).reshape(runs, -1))
    measured = found[:, :4].std(axis=0)
    predicted = np.array([document["sd_repeat"][name] for name in NAMES])
    assert measured == pytest.approx(predicted, rel=0.1)
    assert np.abs(found[:, :4].mean(axis=0) - TRUTH) == pytest.approx(0.0, abs=4 * predicted.max())


def replayed(
    config: Path, capsys: pytest.CaptureFixture[str], runs: int
) -> tuple[dict[str, Any], np.ndarray[Any, Any]]:
    """Return what the design predicts, and estimates (runs, 4) of its replays, each a run by itself."""
    text = re.sub(r"(window_s|hop_s) = [\d.]+", rf"\1 = {SECONDS}", config.read_text(encoding="utf-8"))
    config.write_text(text, encoding="utf-8")
    document, table = excited(capsys, config, "--max-stroke", 0.02)
    force = table[:, 1]
    clean = play(force, TRUTH[None], np.zeros((1, 4)))[:, 0]
    rng, found = np.random.default_rng(11), []
    for _ in range(runs):
        y = STEP * np.round((clean + SIGMA * rng.standard_normal(clean.shape)) / STEP)
        recording = config.with_name("run.npz")
        np.savez(recording, t=np.arange(len(force)) / RATE, force=force, x1=y[:, 0], x2=y[:, 1])
        code, out, err = deltak(capsys, "replay", config, recording, "--json")
        assert code == 0, err
        estimates = json.loads(out)["estimates"]
        found.append([estimates[name]["value"] for name in NAMES])
    return document, np.array(found)


def test_scatter_of_replays_is_that_predicted_and_not_that_of_known_constants(
    config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    document, found = replayed(config, capsys, 6)
    predicted, known = (
        np.array([document[key][name] for name in NAMES]) for key in ("predicted_sd", "sd_repeat")
    )
    assert 0.6 < np.sqrt(np.mean((found.std(axis=0, ddof=1) / predicted) ** 2)) < 1.6
    # each run weighs masses and gains anew, which moves k1 by several times what noise alone does
    assert predicted[0] > 4 * known[0]
    assert found[:, 0].std(ddof=1) > 2 * known[0]


@pytest.mark.soak
@pytest.mark.timeout(1200)
def test_scatter_of_two_hundred_replays_is_the_predicted_one(
    config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    document, found = replayed(config, capsys, 200)
    predicted = np.array([document["predicted_sd"][name] for name in NAMES])
    ratio = found.std(axis=0, ddof=1) / predicted
    figure(
        f"sd of 200 replays over the predicted one: {dict(zip(NAMES, ratio.round(3).tolist(), strict=True))}"
    )
    assert ratio == pytest.approx(1.0, abs=0.1)


def test_recording_at_hand_stands_beside_the_design_and_the_advice_compares_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config, recording = tmp_path / "rig.toml", tmp_path / "recording.csv"
    config.write_bytes((ROOT / "deploy/examples/modbus.toml").read_bytes())
    two_mass_recording(recording, np.random.default_rng(5), 3)
    to = tmp_path / "shaker.csv"
    argv = ("excite", config, "--recording", recording, "--seconds", 5, "--to", to)
    code, out, err = deltak(capsys, *argv, "--json")
    assert code == 0, err
    document = json.loads(out)
    force = np.loadtxt(recording, delimiter=",", skiprows=1)[:, 1]
    written = np.loadtxt(to, delimiter=",", skiprows=1)[:, 1]
    # at the same power
    assert written.std() == pytest.approx(force.std(), rel=0.01)
    ratio = {name: document["recording_sd"][name] / sd for name, sd in document["predicted_sd"].items()}
    assert min(ratio.values()) > 2
    assert any(f"{max(ratio.values()) ** 2:.2g} × longer" in words for words in document["advice"])
    assert any(words.startswith("of the power") and " Hz with " in words for words in document["advice"])
    code, out, _ = deltak(capsys, *argv)
    assert code == 0
    assert "deltak never transmits" in out


def test_lines_of_two_forces_alternate(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = config.read_text(encoding="utf-8").replace(
        '[[channel]]                        # what is measured',
        '[[channel]]\nname = "push"\nquantity = "force"\n'
        'at = "m1"\nunit = "kN"\n\n[[channel]]                        # what is measured', 1,
    )  # fmt: skip
    text = text[: text.index("[[source]]")] + '[store]\npath = "a.db"\n'
    config.write_text(text, encoding="utf-8")
    document, table = excited(capsys, config, "--max-force", 3.0)
    assert document["design_gap"] <= 1e-3
    spectra = np.abs(np.fft.rfft(table[:, 1:] * [1.0, 1000.0], axis=0))
    carried = spectra > 1e-6 * spectra.max()
    assert not np.any(carried[:, 0] & carried[:, 1])
    assert np.abs(table[:, 1:] * [1.0, 1000.0]).max() == pytest.approx(3.0)


def still(path: Path) -> None:
    rows = [f"{i / RATE},{np.sin(i / 9):.3f},0.001,0.002" for i in range(3000)]
    path.write_text("\n".join(["t,force,x1,x2", *rows, ""]), encoding="utf-8")


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (("--recording", "still.csv"), "nothing moves beyond the noise of its sensor"),
        (("--recording", "none.csv"), "none.csv"),
        (("--band", "3.01", "3.02"), "holds 0 lines"),
        (("--band", "4", "1"), "give LO below HI"),
        (("--max-force", "0"), "--max-force: 0 is none"),
        (("--max-stroke", "-1"), "--max-stroke: -1 is none"),
        (("--seconds", "1e9"), "is too long"),
        (("--seconds", "nan"), "--seconds"),
    ],
)
def test_what_cannot_be_designed_is_said_and_nothing_is_written(
    config: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    argv: tuple[str, ...],
    words: str,
) -> None:
    monkeypatch.chdir(config.parent)
    still(config.with_name("still.csv"))
    seconds = () if "--seconds" in argv else ("--seconds", 20)
    code, out, err = deltak(capsys, "excite", config, *seconds, *argv, "--to", "shaker.csv")
    assert (code, out) == (2, "")
    assert words in err
    assert not config.with_name("shaker.csv").exists()


def test_rig_without_a_force_cannot_be_excited(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = config.read_text(encoding="utf-8")
    first, second = text.index("[[channel]]"), text.index("[[channel]]", text.index("[[channel]]") + 5)
    text = text[:first] + text[second : text.index("[[source]]")]
    config.write_text(text, encoding="utf-8")
    code, _, err = deltak(capsys, "excite", config, "--seconds", 5, "--to", config.with_name("a.csv"))
    assert code == 2
    assert "there is no force that could excite the rig" in err
