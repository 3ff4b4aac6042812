"""Frames made for all samples at once against cantools, which makes them one by one."""

import cantools
import numpy as np
import pytest
from cantools.database.can import Database, Message, Signal
from cantools.database.conversion import BaseConversion

from sim_bus.devices.can.packing import Packing
from sim_bus.errors import SimUsageError
from sim_bus.rig.rigfile import Source

DBC = """VERSION ""
NS_ :
BS_:
BU_: RIG
BO_ 256 RIG_SAMPLE: 8 RIG
 SG_ Counter : 0|16@1+ (1,0) [0|65535] "" RIG
 SG_ Force : 16|16@1- (0.001,0) [-32|32] "N" RIG
 SG_ X1 : 39|16@0- (2E-06,0) [-0.065|0.065] "m" RIG
 SG_ X2 : 55|16@0- (0.002,0) [-65|65] "mm" RIG
BO_ 2566844672 RIG_LONG: 16 RIG
 SG_ N : 7|32@0+ (1,0) [0|0] "" RIG
 SG_ F : 32|32@1- (1E-06,0) [0|0] "N" RIG
"""


def random_message(rng: np.random.Generator) -> Message:
    """Return a message whose signals fill it in random lengths, orders, signs and scales, without overlap."""
    size = int(rng.choice([1, 2, 5, 8]))
    free = list(range(8 * size))
    signals: list[Signal] = []
    while free and len(signals) < 8:
        length = min(int(rng.integers(1, 33)), len(free))
        big = bool(rng.random() < 0.5)
        run = free[:length]
        if run != list(range(run[0], run[0] + length)):
            break
        # little-endian bits count up from the lowest; big-endian signals here fill whole bytes
        if big and (run[0] % 8 or length % 8):
            big = False
        start = run[0] + 7 if big else run[0]
        free = free[length:]
        scale = float(rng.choice([1.0, 0.5, 1e-3, 3.0]))
        signals.append(
            Signal(
                f"s{len(signals)}", start, length, "big_endian" if big else "little_endian",
                bool(rng.random() < 0.5),
                conversion=BaseConversion.factory(scale, float(rng.integers(-5, 5))),
            )
        )  # fmt: skip
    return Message(int(rng.integers(1, 2000)), "M", size, signals)


@pytest.mark.parametrize("number", range(40))
def test_pack_random_messages_decode_by_cantools_to_what_was_packed(number: int) -> None:
    rng = np.random.default_rng(number)
    database = Database([random_message(rng)])
    message = database.messages[0]
    packing = Packing(
        database, Source(name="s", driver="can", map={"x": f"M.{message.signals[0].name}"}), fd=False
    )
    raw = {n.name: rng.integers(n.low or 0, (n.high or 0) + 1, 20) for n in packing.numbers}
    for k, data in enumerate(packing.pack(raw)):
        decoded = message.decode(data, scaling=False)
        assert decoded == {name: raw[f"M.{name}"][k] for name in decoded}
        assert data == message.encode({name: int(raw[f"M.{name}"][k]) for name in decoded}, scaling=False)


def database() -> Database:
    loaded = cantools.database.load_string(DBC, "dbc")
    assert isinstance(loaded, Database)
    return loaded


def test_packing_fd_frames_and_extended_identifiers() -> None:
    source = Source(
        name="s", driver="can", map={"f": "RIG_LONG.F", "x": "RIG_SAMPLE.X1"}, counter="RIG_LONG.N"
    )
    packing = Packing(database(), source, fd=True)
    long, short = packing.kinds
    assert (long.identifier, long.extended, long.fd, long.size) == (2566844672 & 0x1FFFFFFF, True, True, 16)
    assert (short.identifier, short.extended, short.size) == (256, False, 8)


@pytest.mark.parametrize(
    ("field", "fd", "words"),
    [
        ("RIG_LONG.F", False, "classic frames carry 8"),
        ("NONE.F", True, "NONE"),
        ("RIG_LONG.Z", True, "RIG_LONG.Z"),
    ],
)
def test_packing_what_cannot_be_sent_is_refused(field: str, fd: bool, words: str) -> None:
    with pytest.raises(SimUsageError, match=words):
        Packing(database(), Source(name="s", driver="can", map={"f": field}), fd=fd)
