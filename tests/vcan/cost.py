"""What a frame costs the thread that reads it: python-can and both paths of ours, the socket filled
beforehand.

A plain script for a machine with vcan0; prints one line a path: its name, frames and microseconds a frame.
"""

import socket
import struct
import sys
import time
from collections.abc import Callable
from pathlib import Path

import can

from drivers.can.bus.bus import BusKeys
from drivers.can.bus.kernel import KernelBus
from drivers.can.codec.database import load, message_codecs
from drivers.can.codec.decoder import FrameDecoder
from drivers.port import Counts
from tests.conformance import test_can_conformance

FRAMES, TURNS = 2000, 5
RECEIVE_BUFFER, SO_RCVBUFFORCE = 8 << 20, 33
FOLDER = Path(test_can_conformance.__file__).parent
FILTERS = ((0x100, 0x9FFFFFFF),)


def fill(sender: socket.socket) -> None:
    for number in range(FRAMES):
        sender.send(struct.pack("=IB3x", 0x100, 8) + struct.pack("<HhhH", number, 0, number % 1000, 0))


def cost(sender: socket.socket, read: Callable[[], int]) -> float:
    """Return the least of some turns, µs a frame."""
    best = float("inf")
    for _ in range(TURNS):
        fill(sender)
        begun, got = time.perf_counter(), 0
        while more := read():
            got += more
        best = min(best, (time.perf_counter() - begun) / FRAMES)
        assert got == FRAMES, got
    return best * 1e6


def library(sender: socket.socket) -> float:
    with can.Bus("vcan0", "socketcan", can_filters=[{"can_id": 0x100, "can_mask": 0x7FF}]) as bus:
        bus.socket.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, RECEIVE_BUFFER)
        return cost(sender, lambda: int(bus.recv(0.0) is not None))


def ours(sender: socket.socket, *, batched: bool, decoded: bool) -> float:
    counts = Counts()
    bus = KernelBus(BusKeys(interface="socketcan", channel="vcan0"), FILTERS, counts, batched=batched)
    fields = ("RIG_SAMPLE.Force", "RIG_SAMPLE.X1", "RIG_SAMPLE.X2")
    codecs = message_codecs(load(FOLDER / "rig.dbc"), fields, "RIG_SAMPLE.Counter")
    decoder = FrameDecoder(codecs, 3, counts, list[str]().append)

    def read() -> int:
        frames = bus.frames(time.monotonic())
        return len(decoder.decode(frames).values) if decoded else len(frames)

    found = cost(sender, read)
    bus.close()
    return found


def say(name: str, us: float) -> None:
    sys.stdout.write(f"{name} {FRAMES} {us:.2f}\n")


def main() -> None:
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as sender:
        sender.bind(("vcan0",))
        say("python-can", library(sender))
        say("one by one", ours(sender, batched=False, decoded=False))
        say("in batches", ours(sender, batched=True, decoded=False))
        say("in batches, decoded to samples", ours(sender, batched=True, decoded=True))


if __name__ == "__main__":
    main()
