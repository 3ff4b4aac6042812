"""What a CAN source keeps in memory: nothing of what only other formats need."""

import subprocess
import sys

PROGRAM = """
import sys
from pathlib import Path
from agent.config import load
from agent.runtime.sources import wire_steps
wire_steps(load(Path("deploy/examples/can.toml")))
import can
print(sorted({name.split(".")[0] for name in sys.modules} & {"can", "cantools", "asammdf", "pandas", "pyarrow"}))
"""


def test_can_source_imports_no_reader_of_measurement_files() -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "['can', 'cantools']"
