"""Many CAN frames by one system call: the kernel writes them where numpy reads them.

recvmmsg fills a table of frames in place, with the time stamp and the count of lost frames beside each. A
frame costs a few numbers moved, and no Python object.
"""

import ctypes
import errno
import os
import socket
from functools import cache

import numpy as np

from drivers.can.codec.frames import FRAME, Frames, no_frames
from drivers.can.tuning import BATCH_FRAMES
from drivers.port import IntArray

_SO_TIMESTAMPNS = 35
_SO_RXQ_OVFL = 40  # fixed by asm-generic/socket.h
_CONTROL = np.dtype([
    ("length", "u8"), ("level", "i4"), ("kind", "i4"), ("seconds", "i8"), ("nanoseconds", "i8"),
    ("length2", "u8"), ("level2", "i4"), ("kind2", "i4"), ("lost", "u4"), ("rest", "u1", 12),
])  # fmt: skip
"""The kernel's control messages of one frame on 64-bit machines: the time stamp, then the count of lost
frames where there are any."""
_WITH_LOST = 52  # fixed by the kernel: bytes of both messages, of which the second is not padded


class _Vector(ctypes.Structure):
    _fields_ = (("base", ctypes.c_size_t), ("length", ctypes.c_size_t))


class _Header(ctypes.Structure):
    _fields_ = (
        ("name", ctypes.c_size_t),
        ("name_length", ctypes.c_uint32),
        ("vectors", ctypes.c_size_t),
        ("vector_count", ctypes.c_size_t),
        ("control", ctypes.c_size_t),
        ("control_length", ctypes.c_size_t),
        ("flags", ctypes.c_int),
    )


class _Message(ctypes.Structure):
    _fields_ = (("header", _Header), ("length", ctypes.c_uint32))


@cache
def batches_work() -> bool:
    """Tell whether this machine has recvmmsg and lays its answer out as it is read here."""
    return ctypes.sizeof(ctypes.c_void_p) == 8 and hasattr(ctypes.CDLL(None), "recvmmsg")


@cache
def _library() -> ctypes.CDLL:
    """Return the C library, opened once: each opening of it would leave types of its own behind."""
    return ctypes.CDLL(None, use_errno=True)


class BatchReceiver:
    """Receives from a CAN socket told to give time stamps (SO_TIMESTAMPNS) and lost frames (SO_RXQ_OVFL).

    Args:
        descriptor: of the socket.
        most: frames by one call.

    Attributes:
        lost: the kernel's count, so far, of frames that it had no room for; 32 bits, wrapping.
    """

    def __init__(self, descriptor: int, most: int = BATCH_FRAMES) -> None:
        self.lost = 0
        self._call = _library().recvmmsg
        self._descriptor = descriptor
        self._table = np.zeros(most, FRAME)
        self._bytes = self._table.view(np.uint8).reshape(most, FRAME.itemsize)
        self._control = np.zeros(most, _CONTROL)
        self._vectors = np.zeros(most, np.dtype(_Vector))
        self._messages = np.zeros(most, np.dtype(_Message))
        self._point(most)

    def _point(self, most: int) -> None:
        """Tell the kernel where each frame and its control messages go."""
        place = np.arange(most)
        self._vectors["base"] = self._table.ctypes.data + FRAME.itemsize * place
        self._vectors["length"] = 72
        header = self._messages["header"]
        header["vectors"] = self._vectors.ctypes.data + self._vectors.itemsize * place
        header["vector_count"] = 1
        header["control"] = self._control.ctypes.data + _CONTROL.itemsize * place

    def receive(self) -> Frames:
        """Return the frames that wait, without waiting; OSError when the socket fails."""
        self._messages["header"]["control_length"] = _CONTROL.itemsize
        most = len(self._messages)
        messages = self._messages.ctypes.data
        count = self._call(
            ctypes.c_int(self._descriptor), ctypes.c_void_p(messages), ctypes.c_uint(most),
            ctypes.c_int(socket.MSG_DONTWAIT), None,
        )  # fmt: skip
        if count < 0:
            return self._nothing(ctypes.get_errno())
        table = self._table[:count].copy()
        self._bytes[:count] = 0
        return Frames(table, self._stamps(count))

    def _nothing(self, number: int) -> Frames:
        if number in (errno.EAGAIN, errno.EINTR):
            return no_frames()
        raise OSError(number, os.strerror(number))

    def _stamps(self, count: int) -> IntArray:
        """Return the times of the newest frames (count,), and note the count of lost ones."""
        control = self._control[:count]
        lengths = self._messages["header"]["control_length"][:count]
        counted = (lengths >= _WITH_LOST) & (control["kind2"] == _SO_RXQ_OVFL)
        if counted.any():
            self.lost = int(control["lost"][np.flatnonzero(counted)[-1]])
        times = control["seconds"] * 10**9 + control["nanoseconds"]
        stamps: IntArray = np.where(control["kind"] == _SO_TIMESTAMPNS, times, 0)
        return stamps
