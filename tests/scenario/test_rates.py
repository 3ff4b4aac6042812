"""Devices of different rates, live: force on Modbus at 1 kHz, displacement on CAN at 500 Hz, and one of them
late."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.cli.gateway.status import status
from agent.errors import StoreError
from agent.runtime.replay import replay
from agent.types import FloatArray
from tests.figures import figure
from tests.ports import free_port
from tests.scenario.live import agent, hops, rows, wait_until
from tests.scenario.two_sources import EXAMPLES
from tests.sim.rigs import simulator

DELAY_S = 0.0037
SECONDS = 5
TRUTH = {"k1": 25.0, "k2": 100.0, "B1": 5.0, "B2": 5.0}


def configure(folder: Path, rate_hz: float) -> str:
    """Return the configuration: sensors of 1 µm, displacements of so many samples a second."""
    modbus, can = ((EXAMPLES / f"{name}.toml").read_text(encoding="utf-8") for name in ("modbus", "can"))
    ring = re.sub(r"map = \{.*\}", 'map = { force = "force" }', modbus[modbus.index("[[source]]") :])
    frames = can[can.index("[[source]]") : can.index("[store]")]
    frames = re.sub(r"map = \{.*\}", 'map = { x1 = "RIG_SAMPLE.X1", x2 = "RIG_SAMPLE.X2" }', frames)
    text = modbus[: modbus.index("[[source]]")] + frames + f"rate_hz = {rate_hz}\n" + ring
    text = text.replace("every_s = 1.0", "every_s = 0").replace("[[source]]", "[[source]]\nrecord = true")
    for port in ("1502", "29536"):
        text = text.replace(f"port = {port}", f"port = {free_port()}")
    (folder / "two-mass-rig.dbc").write_bytes((EXAMPLES / "two-mass-rig.dbc").read_bytes())
    return text


def play(folder: Path, rate_hz: float, seconds: float) -> tuple[Path, dict[str, Any], dict[str, Any]]:
    """Play both devices and let the agent listen; return the configuration, its document and the simulator's
    ledger."""
    scenario = folder / "late.toml"
    late = "".join(f'[[sensor]]\nchannel = "{name}"\ndelay_s = {DELAY_S}\n' for name in ("x1", "x2"))
    force = '[[force]]\nkind = "random"\nrms = 5.0\n[noise]\ndisplacement = 1e-6\n'
    scenario.write_text(f"duration_s = {seconds}\n{force}{late}", encoding="utf-8")
    db = folder / "live.db"
    with simulator(folder, configure(folder, rate_hz), "--scenario", str(scenario)) as device:
        with agent(device.config, options=["--db", str(db)]) as running:
            every = (1000.0 + rate_hz) * seconds
            wait_until(lambda: received(db) >= every, "every sample", limit_s=60.0 + seconds)
            wait_until(lambda: hops(db) >= 20 * seconds - 10, "their rows")
            document = running.document()
        assert device.stop() == 0
        return device.config, document, device.ledger()


def received(db: Path) -> int:
    """Samples that the agent says it has received of both sources, 0 before it answers."""
    try:
        (rig,) = status(db)["rigs"]
    except StoreError:
        return 0
    return sum(source.get("received", 0) for source in rig["sources"])


def found(db: Path) -> tuple[FloatArray, FloatArray]:
    """Return how many rows of each parameter are valid, and their mean error in their standard deviations."""
    query = "SELECT value, sd FROM v_estimates WHERE parameter = ? AND status = 'valid' ORDER BY t_ns"
    valid = [np.array(rows(db, query, name), float).reshape(-1, 2) for name in TRUTH]
    errors = [(row[:, 0] - true) / row[:, 1] for row, true in zip(valid, TRUTH.values(), strict=True)]
    return np.array([len(row) for row in valid]), np.array(
        [np.mean(error) if len(error) else 0.0 for error in errors]
    )


def replayed(config: Path, folder: Path, skew_s: str) -> Path:
    """Replay what the live run recorded, its skew given instead of measured; return the database."""
    text = config.read_text(encoding="utf-8").replace(
        "rate_hz = 500.0", f"rate_hz = 500.0\nskew_s = {skew_s}"
    )
    config.write_text(text, encoding="utf-8")
    recordings = [path for path in sorted((folder / "live.db.raw").iterdir()) if path.suffix != ".idx"]
    replay(config=config, recordings=recordings, db=folder / "again.db")
    return folder / "again.db"


@pytest.mark.realtime
def test_sources_of_different_rates_are_estimated_live_without_bias_and_a_delay_that_is_left_is_the_inputs(
    tmp_path: Path,
) -> None:
    config, document, ledger = play(tmp_path, 500.0, SECONDS)
    samples = {name: document["samples"][name] for name in ("received", "gaps", "dropped")}
    assert samples == {"received": (1000 + 500) * SECONDS, "gaps": 0, "dropped": {}}
    assert ledger["sources"]["can"]["sent"] == 500 * SECONDS
    ((skew_s,),) = rows(tmp_path / "live.db", "SELECT skew_s FROM v_health WHERE source = 'can' AND "
                        "skew_s NOT NULL ORDER BY t_ns DESC LIMIT 1")  # fmt: skip
    count, bias = found(tmp_path / "live.db")
    again = replayed(config, tmp_path, "0.0")
    left, left_bias = found(again)
    delay = rows(again, "SELECT probability FROM v_verdicts WHERE hypothesis = 'delay' ORDER BY t_ns DESC")
    figure(
        f"force at 1 kHz, displacement at 500 Hz and 3.7 ms late, live: {1e3 * skew_s:.2f} ms measured; "
        f"{_words(count)} valid rows of k1, k2, B1, B2; bias {_words(bias)} sd; "
        f"delay left alone: {_words(left)} rows, bias {_words(left_bias)} sd"
    )
    assert np.abs(bias).max() < 1.0
    assert count.min() > 10 * (SECONDS - 1)
    assert delay[0][0] > 0.95
    assert np.abs(left_bias).max() < 2.5


def _words(errors: FloatArray) -> str:
    return ", ".join(f"{error:.3g}" for error in errors)
