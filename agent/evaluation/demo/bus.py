"""The demo's configurations: the same rig on each bus, with the wire that its scenario needs."""

import socket
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

Marks = dict[str, str]
"""What stands in a template's places."""


@dataclass(frozen=True, slots=True)
class Wire:
    """What the wire carries: bits of an integer and its steps, N and m."""

    bits: int
    force_step: str
    length_step: str

    @property
    def type(self) -> str:
        """The integer's name."""
        return f"int{self.bits}"

    @property
    def marks(self) -> Marks:
        """What fills the templates' places for numbers; on CAN a counter and three numbers make one frame."""
        return {
            "TYPE": self.type, "FORCE_STEP": self.force_step, "LENGTH_STEP": self.length_step,
            "BITS": str(self.bits), "AT_X1": str(2 * self.bits), "AT_X2": str(3 * self.bits),
            "FRAME_BYTES": str(self.bits // 2), "FD": "true" if self.bits > 16 else "false",
        }  # fmt: skip


COARSE = Wire(16, "1e-3", "2e-6")
VCAN = "vcan0"
FINE = Wire(32, "1e-6", "1e-11")


@dataclass(frozen=True, slots=True)
class DemoBus:
    """A configuration file for one bus, and the bus in words."""

    config: Path
    words: str


def write_config(bus: str, wire: Wire, folder: Path, *, fast: bool = False) -> DemoBus:
    """Write the configuration of the demo's rig on a bus into a folder.

    Played fast, a bus is wanted whose reader can hold the device back.
    """
    made, words = _MAKERS[bus](folder, fast=fast)
    marks = wire.marks | made
    config = folder / "demo.toml"
    config.write_text(_template("rig.toml") + _filled(_template(f"{bus}.toml"), marks))
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
