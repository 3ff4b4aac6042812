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
print(sorted({name.split(".")[0] for name in sys.modules} & {
    "can", "cantools", "asammdf", "pandas", "pyarrow", "asyncio", "ssl"}))
import asyncio

async def read():
    reader = can.AsyncBufferedReader()
    reader(can.Message(arbitration_id=7))
    return await reader.get_message()

print(asyncio.run(read()).arbitration_id)
"""


def test_can_source_imports_no_reader_of_measurement_files() -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["['can', 'cantools']", "7"]
