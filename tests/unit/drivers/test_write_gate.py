import ast
from pathlib import Path

import pytest

import drivers
from drivers.can.bus.netlink import question
from drivers.write_gate import ForbiddenWriteError, check, permitted

FOLDER = Path(drivers.__file__).parent
WRITES = {
    "send", "sendall", "sendto", "sendmsg", "sendmsg_afalg", "sendfile", "send_periodic", "write",
    "writelines",
    "writev", "pwrite", "write_register", "write_registers", "write_coil", "write_coils", "send_break",
    "ioctl",
}  # fmt: skip
ALLOWED = {
    "write_gate.py": {"sendall"},  # behind `check`
    "pipe.py": {"send", "write"},  # os.write behind `check`
    "serial_port.py": {"ioctl"},  # TIOCEXCL and TIOCNXCL, which concern who may open the line
    "modbus/line.py": {"send"},  # of a pipe
    "can/bus/bus.py": {"send"},  # of a pipe: socketcand's handshake
    "can/bus/slcan.py": {"send"},  # of a pipe: opening the adapter listen-only, where that is asked for
    "can/bus/netlink.py": {"send"},  # of the gate: how an interface is set up, asked of the kernel
}


def calls(path: Path) -> set[str]:
    """Return the names of all methods and functions that a module calls."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            found.add(node.func.attr)
    return found


@pytest.mark.parametrize(
    "path", sorted(FOLDER.rglob("*.py")), ids=lambda path: path.relative_to(FOLDER).as_posix()
)
def test_module_calls_nothing_that_writes_but_through_the_gate(path: Path) -> None:
    assert calls(path) & WRITES <= ALLOWED.get(path.relative_to(FOLDER).as_posix(), set())


def tcp(pdu: str, length: int | None = None) -> bytes:
    data = bytes.fromhex(pdu)
    return (
        b"\x00\x01\x00\x00"
        + (len(data) + 1 if length is None else length).to_bytes(2, "big")
        + b"\x01"
        + data
    )


@pytest.mark.parametrize(
    ("protocol", "data", "may"),
    [
        ("modbus-tcp", tcp("04 0000 0001"), True),
        ("modbus-tcp", tcp("18 0000"), True),
        ("modbus-tcp", tcp("04 0000 0001", 9), False),
        ("modbus-tcp", tcp("04 0000 0001") + tcp("06 0000 0001"), False),
        ("modbus-tcp", tcp("05 0000 FF00"), False),
        ("modbus-tcp", tcp("0F 0000 0001 01 00"), False),
        ("modbus-tcp", tcp("17 0000 0001 0000 0001 02 0000"), False),
        ("modbus-tcp", b"", False),
        ("modbus-rtu", bytes.fromhex("01 03 03 00 00 02 C4 4F"), True),
        ("modbus-rtu", bytes.fromhex("01 06 03 00 00 02 C4 4F"), False),
        ("socketcand", b"< open can0 >", True),
        ("socketcand", b"< rawmode >", True),
        ("socketcand", b"< send 123 1 FF >", False),
        ("socketcand", b"< rawmode >< send 123 1 FF >", False),
        ("socketcand", b"< open can0 >< send 1 0 >", False),
        ("slcan", b"C\r", True),
        ("slcan", b"S6\r", True),
        ("slcan", b"L\r", True),
        ("slcan", b"O\r", False),
        ("slcan", b"L\rO\r", False),
        ("slcan", b"t1001FF\r", False),
        ("slcan", b"S9\r", False),
        ("slcan", b"", False),
        ("netlink", question("can0"), True),
        (
            "netlink",
            question("can0")[:4] + b"\x10" + question("can0")[5:],
            False,
        ),  # RTM_NEWLINK: would set it up
        ("netlink", question("can0") + b"\0", False),
        ("netlink", b"", False),
        ("serial", b"\x00", False),
        ("can", b"\x00" * 16, False),
    ],
)
def test_gate_lets_through_what_only_reads(protocol: str, data: bytes, may: bool) -> None:
    assert permitted(protocol, data) == may
    if not may:
        with pytest.raises(ForbiddenWriteError, match="a listener only reads"):
            check(protocol, data)
