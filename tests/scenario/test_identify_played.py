"""What `deltak sim` played, as a CSV, gives back its springs and dampers to a configuration that has none."""

import json
import re
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.peers import ROOT

pytestmark = pytest.mark.realtime
DELTAK = str(Path(sys.executable).parent / "deltak")


def played(folder: Path, seconds: int) -> tuple[Path, Path]:
    """Play the Modbus example to the agent; return its configuration without nominals and what was read, as
    CSV."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    text = (
        (ROOT / "deploy/examples/modbus.toml")
        .read_text(encoding="utf-8")
        .replace("port = 1502", f"port = {port}")
    )
    rig, blank, truth = folder / "rig.toml", folder / "blank.toml", folder / "truth.npz"
    rig.write_text(text, encoding="utf-8")
    blank.write_text(re.sub(r", nominal = [\d.]+", "", text), encoding="utf-8")
    sim = [DELTAK, "sim", str(rig), "--scenario", "steady", "--duration", str(seconds), "--truth", str(truth)]
    with subprocess.Popen(sim, stdout=subprocess.PIPE, text=True) as device:
        assert device.stdout is not None
        assert device.stdout.readline().strip() == "ready"
        agent = [DELTAK, "run", str(rig), "--db", str(folder / "rig.db"), "--duration", str(seconds)]
        subprocess.run(agent, check=True, capture_output=True, timeout=60)
        assert device.wait(timeout=60) == 0
    found, csv = np.load(truth), folder / "run.csv"
    rows = [
        f"{i / 1000:.3f}," + ",".join(f"{v:.9g}" for v in row)
        for i, row in enumerate(found["readings"].tolist())
    ]
    csv.write_text("\n".join([f"t,{','.join(found['channel_names'].tolist())}", *rows, ""]), encoding="utf-8")
    return blank, csv


def test_what_sim_played_is_identified_and_written(tmp_path: Path) -> None:
    blank, csv = played(tmp_path, 6)
    done = subprocess.run(
        [DELTAK, "identify", str(blank), str(csv), "--write", "--json"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    truth = {"k1": 25.0, "k2": 100.0, "B1": 5.0, "B2": 5.0}
    for name, true in truth.items():
        row = document["parameters"][name]
        assert abs(row["value"] - true) < 3 * row["sd"], name
        assert abs(row["value"] / true - 1.0) < 0.1, name
    assert document["unexplained_percent"] < 2.0
    assert subprocess.run([DELTAK, "check", str(blank)], capture_output=True, check=False).returncode == 0
