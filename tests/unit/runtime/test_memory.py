"""What an agent of one rig keeps in memory, on each bus: nothing of what only others need, and at most 110
MB; one that forecasts on its bus, at most 100."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from tests.figures import figure
from tests.scenario.live import Agent, agent, example, rows, wait_until
from tests.scenario.test_reload import peak_mb
from tests.sim.rigs import ROOT

MOST_MB, MOST_FORECASTING_MB = 110, 100
FORECASTS = 8
"""The second of each parameter with a limit: by then the samples before an alarm are all there, too."""
LIBRARIES = {"can": ["can", "cantools"], "modbus": ["pymodbus"], "serial": ["serial"]}
"""What reads each bus; numpy and scipy compute, on all of them, and pydantic checks the configuration."""
ASKED = {
    "can", "cantools", "pymodbus", "serial", "asammdf", "pandas", "pyarrow", "matplotlib", "sim_bus", "rich",
    "smtplib",
    "unittest", "charset_normalizer",
}  # fmt: skip

PROGRAM = f"""
import sys
from pathlib import Path

import numpy as np

from agent.config import load
from agent.prognosis.forecast import forecast
from agent.prognosis.history import History
from agent.runtime.process.memory import keep_heap_small, release_free_pages
from agent.runtime.service import Service
from drivers.port import SampleBlock

keep_heap_small()
config = load(Path(sys.argv[1]))
service = Service([config], None, "live")
service._start()
rig, source = service.rigs[config.rig.name], config.source[0].name
rng, x = np.random.default_rng(1), np.zeros(4)
for start in range(0, 1000, 100):
    v = np.column_stack([rng.normal(0.0, 5.0, 100), rng.normal(0.0, 1e-3, (100, 2))])
    rig.pipeline.take(source, SampleBlock(v, (start + 100) * 1_000_000,
                                              np.arange(start, start + 100)), None, None)
    rig.pipeline.compute()
now = np.linspace(-10.0, 0.0, 3600)
forecast(History(now, 25.0 - 0.3 * (now + 10.0) + rng.normal(0.0, 0.1, 3600), np.full(3600, 0.1)), 20.0)
service._finish()
lines = Path("/proc/self/status").read_text().splitlines()
print(next(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM")))
print(*sorted({{name.split(".")[0] for name in sys.modules}} & {ASKED!r}))
"""


@pytest.mark.parametrize("bus", list(LIBRARIES))
def test_agent_of_one_rig_takes_at_most_110_mb_and_imports_only_its_bus(bus: str, tmp_path: Path) -> None:
    command = [sys.executable, "-c", PROGRAM, str(example(bus, tmp_path))]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stderr
    peak, imported = done.stdout.strip().splitlines()[-2:]
    figure(f"most memory of an agent of one rig on {bus}: {float(peak):.0f} MB (at most {MOST_MB})")
    assert imported.split() == LIBRARIES[bus]
    assert float(peak) <= MOST_MB


@contextmanager
def forecasting(bus: str, folder: Path) -> Iterator[Agent]:
    """Run an agent that forecasts each five seconds, and its devices."""
    folder.mkdir()
    config = example(bus, folder)
    config.write_text(config.read_text(encoding="utf-8") + '[forecast]\nevery = "5s"\n', encoding="utf-8")
    play = [sys.executable, "-m", "agent", "sim", str(config)]
    with subprocess.Popen(play, cwd=ROOT, stdout=subprocess.PIPE, text=True) as devices:
        assert devices.stdout is not None
        assert devices.stdout.readline() == "ready\n"
        with agent(config, options=["--db", str(folder / "rig.db")]) as running:
            yield running
        devices.terminate()


@pytest.mark.realtime
def test_agents_that_forecast_keep_to_100_mb_on_each_bus(tmp_path: Path) -> None:
    made = "SELECT count(*) FROM v_forecast WHERE status != 'too short'"
    with ExitStack() as stack:
        folders = {bus: tmp_path / bus for bus in LIBRARIES}
        agents = {bus: stack.enter_context(forecasting(bus, folders[bus])) for bus in folders}
        wait_until(
            lambda: all(rows(one / "rig.db", made) >= [(FORECASTS,)] for one in folders.values()), "forecasts"
        )
        peaks = {bus: peak_mb(one.process.pid) for bus, one in agents.items()}
    said = ", ".join(f"{peak:.0f} MB on {bus}" for bus, peak in peaks.items())
    figure(f"most memory of an agent that forecasts: {said} (at most {MOST_FORECASTING_MB})")
    assert max(peaks.values()) <= MOST_FORECASTING_MB
