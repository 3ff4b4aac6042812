"""What a process wrote to buses, as strace saw it: every write to no file, pipe or output of its own."""

import re
from dataclasses import dataclass
from pathlib import Path

from drivers.write_gate import permitted

_CALL = re.compile(
    r"\d+ +\w+\(\d+<"
    r"(?P<what>[A-Z][A-Z0-9-]*:\[[^\]]*\]|(?:\\x[0-9a-f]{2})+(?:<char [0-9:]+>)?)"
    r">, (?P<rest>.*)"
)
_QUOTED = re.compile(r'"((?:\\x[0-9a-f]{2})*)"')
_FITTING = {
    "<char 136:": ("modbus-rtu", "slcan"),
    "TCP": ("modbus-tcp", "socketcand"),
    "NETLINK": ("netlink",),
}
"""The protocols that may be spoken to a terminal, over TCP and to the kernel."""


@dataclass(frozen=True)
class Write:
    """One call: where to, the bytes, and the protocol whose rule permits them there ("" for none)."""

    where: str
    data: bytes
    protocol: str


def bus_writes(trace: Path) -> list[Write]:
    """Return the writes in a trace to anything but pipes and files."""
    found = []
    for line in trace.read_text(encoding="ascii").splitlines():
        if "resumed>" in line or re.match(r"\d+ +[+-]{3}", line):
            continue
        match = _CALL.fullmatch(line)
        assert match, f"a line of the trace is not understood: {line}"
        where = _plain(match["what"])
        file = where.startswith("/") and "<char" not in where
        if not file and not where.startswith(("pipe:", "anon_inode:", "/dev/null<")):
            data = b"".join(bytes.fromhex(text.replace("\\x", "")) for text in _QUOTED.findall(match["rest"]))
            found.append(Write(where, data, _protocol(where, data)))
    return found


def _plain(what: str) -> str:
    return re.sub(r"\\x([0-9a-f]{2})", lambda code: chr(int(code[1], 16)), what)


def _protocol(where: str, data: bytes) -> str:
    fitting = next((names for mark, names in _FITTING.items() if mark in where), ())
    return next((name for name in fitting if permitted(name, data)), "")


def forbidden(writes: list[Write]) -> list[Write]:
    """Return the writes that no rule permits."""
    return [write for write in writes if not write.protocol]
