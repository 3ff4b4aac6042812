"""The demo's configurations: the same rig on each bus, with the wire that its scenario needs."""

import socket
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

Marks = dict[str, str]
"""What stands in a template's places."""


@dataclass(frozen=True, slots=True)
class Number:
    """One number on the wire: its channel, its name in a CAN frame, its unit; an input or a measurement."""

    channel: str
    signal: str
    unit: str
    is_input: bool = False


@dataclass(frozen=True, slots=True)
class DemoRig:
    """A rig of the demo: its template, what its wire carries, and the scenario played by default."""

    template: str
    numbers: tuple[Number, ...]
    scenario: str


@dataclass(frozen=True, slots=True)
class Wire:
    """What the wire carries: bits of an integer and its steps, those of inputs and of lengths."""

    bits: int
    force_step: str
    length_step: str

    @property
    def type(self) -> str:
        """The integer's name."""
        return f"int{self.bits}"

    def step(self, number: Number) -> str:
        """Return the step of a number."""
        return self.force_step if number.is_input else self.length_step

    def marks(self, numbers: tuple[Number, ...]) -> Marks:
        """Return what fills the templates' places; on CAN a counter and the numbers make one frame."""
        size = self.bits * (1 + len(numbers)) // 8
        fields = (
            f'    {{ name = "{n.channel}", type = "{self.type}", scale = {self.step(n)} }},' for n in numbers
        )
        return {
            "BITS": str(self.bits), "FRAME_BYTES": str(size),
            "FD": "true" if size > CLASSIC_BYTES else "false", "FIELDS": "\n".join(fields),
            "FIELD_MAP": ", ".join(f'{n.channel} = "{n.channel}"' for n in numbers),
            "SIGNALS": "\n".join(self._signal(1 + i, n) for i, n in enumerate(numbers)),
            "SIGNAL_MAP": ", ".join(f'{n.channel} = "RIG_SAMPLE.{n.signal}"' for n in numbers),
        }  # fmt: skip

    def _signal(self, place: int, number: Number) -> str:
        layout = f"{place * self.bits}|{self.bits}@1- ({self.step(number)},0) [0|0]"
        return f' SG_ {number.signal} : {layout} "{number.unit}" GATEWAY'


CLASSIC_BYTES = 8
"""Fixed by ISO 11898-1: what a frame of classic CAN holds: what a frame of classic CAN holds."""
TWO_MASSES = DemoRig(
    "rig.toml",
    (Number("force", "Force", "N", is_input=True), Number("x1", "X1", "m"), Number("x2", "X2", "m")),
    "default",
)  # fmt: skip
VOICE_COIL = DemoRig(
    "voice-coil.toml",
    (Number("voltage", "Voltage", "V", is_input=True), Number("position", "Position", "m")),
    "voice-coil",
)  # fmt: skip
RIGS: Mapping[str, DemoRig] = {"two-mass": TWO_MASSES, "voice-coil": VOICE_COIL}
COARSE = Wire(16, "1e-3", "2e-6")
VCAN = "vcan0"
FINE = Wire(32, "1e-6", "1e-11")


@dataclass(frozen=True, slots=True)
class DemoBus:
    """A configuration file for one bus, and the bus in words."""

    config: Path
    words: str


def write_config(
    bus: str, wire: Wire, folder: Path, *, fast: bool = False, rig: DemoRig = TWO_MASSES
) -> DemoBus:
    """Write the configuration of a rig of the demo on a bus into a folder.

    Played fast, a bus is wanted whose reader can hold the device back.
    """
    made, words = _MAKERS[bus](folder, fast=fast)
    marks = wire.marks(rig.numbers) | made
    config = folder / "demo.toml"
    config.write_text(_template(rig.template) + _filled(_template(f"{bus}.toml"), marks))
    (folder / "demo.dbc").write_text(_filled(_template("can.dbc"), marks))
    return DemoBus(config, words)


def _template(name: str) -> str:
    return (files("agent.evaluation.demo") / "files" / name).read_text()


def _filled(text: str, marks: Mapping[str, str]) -> str:
    for mark, value in marks.items():
        text = text.replace(f"@{mark}@", value)
    return text


def free_port() -> int:
    """Return a TCP port on loopback that nobody listens to now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _modbus(_folder: Path, **_: bool) -> tuple[Marks, str]:
    port = free_port()
    return {"PORT": str(port)}, f"Modbus TCP on 127.0.0.1:{port}"


def _can(_folder: Path, *, fast: bool) -> tuple[Marks, str]:
    missing = why_no_vcan() or ("vcan0 holds no sender back" if fast else "")
    if not missing:
        return {"WHERE": 'interface = "socketcan"'}, f"CAN on the kernel's {VCAN}"
    port = free_port()
    where = f'interface = "socketcand"\nhost = "127.0.0.1"\nport = {port}'
    return {"WHERE": where}, f"{missing}: socketcand on 127.0.0.1:{port}"


def why_no_vcan() -> str:
    """Return in words why the kernel's virtual CAN bus cannot be used, "" where it can."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except (AttributeError, OSError):
        return "kernel has no CAN"
    state = Path("/sys/class/net") / VCAN / "flags"
    up = state.exists() and int(state.read_text(), 16) & 1
    return "" if up else f"kernel has no {VCAN} that is up"


def _serial(folder: Path, **_: bool) -> tuple[Marks, str]:
    line = folder / "demo.tty"
    return {"PORT": line.name}, f"serial line on a pseudo-terminal, {line}"


_MAKERS: Mapping[str, Callable[..., tuple[Marks, str]]] = {"modbus": _modbus, "can": _can, "serial": _serial}
"""How each bus is made; a maker returns what fills its template, and the bus in words."""
