"""A small rig on each kind of line, a fault, and what the agent made of it on simulated time."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agent.evaluation.score.measures import Assessment
from agent.evaluation.score.play import play
from sim_bus.rig.scenario import load_scenario
from sim_bus.virtual_time.bench import PlayedBench

RATE = 200.0
AT_S = 1.5
RIG = """
[rig]
name = "faulty"
sample_rate_hz = 200.0
[model]
kind = "mass-spring-damper"
mass = [{ name = "m1", value = 5.0 }]
spring = [{ name = "k1", between = ["ground", "m1"], nominal = 2000.0 }]
damper = [{ name = "B1", between = ["ground", "m1"], nominal = 20.0 }]
[[channel]]
name = "force"
quantity = "force"
at = "m1"
unit = "N"
[[channel]]
name = "x1"
quantity = "displacement"
at = "m1"
unit = "m"
[estimator]
window_s = 0.25
hop_s = 0.05
"""
MAP = 'map = { force = "F", x1 = "X" }'
RING = """
mode = "ring"
index = {{ address = 0, type = "uint32" }}
ring = {{ address = 16, slots = 512 }}
fields = [{{ name = "F", type = "{type}", scale = {force} }}, \
{{ name = "X", type = "{type}", scale = {length} }}]
timeout_s = 0.2
period_s = 0.02
"""
INT, FLOAT = (
    {"type": "int32", "force": "1e-4", "length": "1e-8"},
    {"type": "float32", "force": 1, "length": 1},
)
TCP = 'transport = "tcp"\nhost = "127.0.0.1"\nport = 1502'
RTU = 'transport = "rtu"\nport = "rtu.tty"\nbaudrate = 921600'
SOURCES = {
    "serial": """
driver = "serial"
port = "line.tty"
format = "binary"
sync = "AA55"
fields = [
  { name = "N", type = "uint16" },
  { name = "F", type = "int32", scale = 1e-4 },
  { name = "X", type = "int32", scale = 1e-8 },
]
crc = "CRC-16/IBM-3740"
counter = "N"
""",
    "serial float": """
driver = "serial"
port = "float.tty"
format = "binary"
sync = "AA55"
fields = [{ name = "N", type = "uint16" }, { name = "F", type = "float32" }, { name = "X", type = "float32" }]
crc = "CRC-16/IBM-3740"
counter = "N"
""",
    "bare": """
driver = "serial"
port = "bare.tty"
format = "binary"
sync = "AA55"
fields = [
  { name = "N", type = "uint16" },
  { name = "F", type = "int32", scale = 1e-4 },
  { name = "X", type = "int32", scale = 1e-8 },
]
counter = "N"
""",
    "text": """
driver = "serial"
port = "text.tty"
format = "text"
columns = ["N", "F", "X"]
checksum = "nmea"
counter = "N"
counter_modulus = 65536
""",
    "can": """
driver = "can"
interface = "socketcand"
channel = "vcan0"
dbc = "faulty.dbc"
counter = "S.N"
map = { force = "S.F", x1 = "S.X" }
""",
    "can float": """
driver = "can"
interface = "socketcand"
channel = "vcan0"
dbc = "faulty.dbc"
counter = "T.N"
map = { force = "T.F", x1 = "T.X" }
""",
    "can sum": """
driver = "can"
interface = "socketcand"
channel = "vcan0"
dbc = "faulty.dbc"
counter = "C.N"
map = { force = "C.F", x1 = "C.X" }
checksum = { signal = "K", method = "xor" }
""",
    "can adapter": """
driver = "can"
interface = "slcan"
channel = "adapter.tty"
dbc = "faulty.dbc"
counter = "S.N"
map = { force = "S.F", x1 = "S.X" }
""",
    "tcp": f'driver = "modbus"\n{TCP}{RING.format(**INT)}',
    "float": f'driver = "modbus"\n{TCP}{RING.format(**FLOAT)}',
    "rtu": f'driver = "modbus"\n{RTU}{RING.format(**INT)}',
}
DBC = """VERSION ""
NS_ :
BS_:
BU_: RIG
BO_ 256 S: 8 RIG
 SG_ N : 0|16@1+ (1,0) [0|0] "" Vector__XXX
 SG_ F : 16|16@1- (1e-2,0) [0|0] "N" Vector__XXX
 SG_ X : 32|32@1- (1e-8,0) [0|0] "m" Vector__XXX
BO_ 257 T: 8 RIG
 SG_ N : 0|16@1+ (1,0) [0|0] "" Vector__XXX
 SG_ F : 16|16@1- (1e-2,0) [0|0] "N" Vector__XXX
 SG_ X : 32|32@1- (1,0) [0|0] "m" Vector__XXX
BO_ 258 C: 8 RIG
 SG_ N : 0|8@1+ (1,0) [0|0] "" Vector__XXX
 SG_ K : 8|8@1+ (1,0) [0|0] "" Vector__XXX
 SG_ F : 16|16@1- (1e-2,0) [0|0] "N" Vector__XXX
 SG_ X : 32|32@1- (1e-8,0) [0|0] "m" Vector__XXX
SIG_VALTYPE_ 257 X : 1;
"""
SCENARIO = """
seed = 7
duration_s = {duration}
[[force]]
kind = "random"
rms = 20.0
[noise]
displacement = 1e-6
"""


@dataclass(frozen=True)
class Run:
    """What came of a fault."""

    assess: Assessment
    found: dict[str, Any]

    @property
    def lost(self) -> set[int]:
        """The samples of which nothing was used."""
        matched = self.assess.matched
        return set(range(self.found["samples"]["played"])) - set(matched.number[matched.whole].tolist())

    @property
    def absent(self) -> set[int]:
        """The samples that by the simulator's ledger no reader got whole."""
        (runs,) = self.found["samples"]["absent"].values()
        return {number for first, last in runs for number in range(first, last + 1)}

    @property
    def causes(self) -> list[str]:
        """What the agent told of its source."""
        return [cause for _, cause in self.found["events"]]


def write_rig(line: str, folder: Path) -> Path:
    """Write the rig with one source."""
    fields = "" if line.startswith("can") else MAP
    (folder / "faulty.dbc").write_text(DBC, encoding="utf-8")
    config = folder / "faulty.toml"
    config.write_text(f'{RIG}\n[[source]]\nname = "line"\n{SOURCES[line]}\n{fields}\n', encoding="utf-8")
    return config


def run(line: str, faults: list[str], folder: Path, duration_s: float = 4.0) -> Run:
    """Play the rig with faults."""
    scenario = folder / "scenario.toml"
    scenario.write_text(SCENARIO.format(duration=duration_s), encoding="utf-8")
    bench = PlayedBench(write_rig(line, folder), load_scenario(str(scenario), {}).with_faults(faults))
    assess = Assessment(play(bench, lambda _share: None), bench.strikes())
    return Run(assess, assess.document())
