"""The demo's configurations: the same rig on each bus, with the wire that its scenario needs."""

import socket
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Wire:
    """What the wire carries: an integer type and its steps, N and m."""

    type: str
    force_step: str
    length_step: str


COARSE = Wire("int16", "1e-3", "2e-6")
FINE = Wire("int32", "1e-6", "1e-11")


@dataclass(frozen=True, slots=True)
class DemoBus:
    """A configuration file for one bus, and the bus in words."""

    config: Path
    words: str


def write_config(bus: str, wire: Wire, folder: Path) -> DemoBus:
    """Write the configuration of the demo's rig on a bus into a folder."""
    put, words = _MAKERS[bus](wire, folder)
    text = _template("rig") + _filled(_template(bus), put | _wire_marks(wire))
    config = folder / "demo.toml"
    config.write_text(text)
    return DemoBus(config, words)


def _template(name: str) -> str:
    return (files("agent.runtime") / "demo_files" / f"{name}.toml").read_text()


def _filled(text: str, marks: Mapping[str, str]) -> str:
    for mark, value in marks.items():
        text = text.replace(f"@{mark}@", value)
    return text


def _wire_marks(wire: Wire) -> dict[str, str]:
    return {"TYPE": wire.type, "FORCE_STEP": wire.force_step, "LENGTH_STEP": wire.length_step}


def free_port() -> int:
    """Return a TCP port on loopback that nobody listens to now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _modbus(wire: Wire, folder: Path) -> tuple[dict[str, str], str]:
    port = free_port()
    return {"PORT": str(port)}, f"Modbus TCP on 127.0.0.1:{port}"


_MAKERS = {"modbus": _modbus}
"""How each bus is made; a maker returns what fills its template, and the bus in words."""
