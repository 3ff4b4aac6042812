"""Plays three devices at 20 Hz by the standard library: frames on CAN, lines on a pty, registers over Modbus
TCP."""

import os
import random
import socket
import struct
import sys
import threading
import time
import tty
from pathlib import Path

PERIOD_S = 0.05
VALUES = [0, 0, 0, 0]


def play_can(channel: str) -> None:
    bus = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    bus.bind((channel,))
    while True:
        time.sleep(PERIOD_S)
        counter, force, x1, x2 = VALUES
        bus.send(struct.pack("<IB3x8s", 0x100, 8, struct.pack("<Hhhh", counter, force, x1, x2)))


def play_line(link: str) -> None:
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    Path(link).symlink_to(os.ttyname(theirs))
    Path(link).chmod(0o660)
    os.chown(link, 0, int(sys.argv[3]))  # as udev gives serial ports to dialout
    os.close(theirs)  # whoever reads it is its only holder, as of a real port
    os.set_blocking(ours, False)
    while True:
        time.sleep(PERIOD_S)
        try:
            os.write(ours, (",".join(map(str, VALUES)) + "\n").encode())
        except BlockingIOError:
            continue  # nobody reads at present


def answer(peer: socket.socket) -> None:
    while head := peer.recv(7, socket.MSG_WAITALL):
        number, _, length, unit = struct.unpack(">HHHB", head)
        _, address, count = struct.unpack(">BHH", peer.recv(length - 1, socket.MSG_WAITALL))
        data = struct.pack(">Hhhh", *VALUES)[2 * address : 2 * (address + count)]
        peer.sendall(struct.pack(">HHHBBB", number, 0, 3 + len(data), unit, 4, len(data)) + data)


def play_registers(port: int) -> None:
    with socket.create_server(("127.0.0.1", port)) as server:
        while True:
            threading.Thread(target=answer, args=(server.accept()[0],), daemon=True).start()


def main(channel: str, link: str) -> None:
    for target, argument in ((play_can, channel), (play_line, link), (play_registers, 1502)):
        threading.Thread(target=target, args=(argument,), daemon=True).start()
    while True:
        time.sleep(PERIOD_S)
        VALUES[0] = (VALUES[0] + 1) % 65536
        VALUES[1:] = [random.randrange(-999, 1000) for _ in range(3)]


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
