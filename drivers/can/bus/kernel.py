"""SocketCAN: a raw socket of the kernel, with its filters, time stamps and count of lost frames."""

import select
import socket
import struct
from contextlib import suppress

import numpy as np

from drivers import clock
from drivers.can.bus.batch import BatchReceiver, batches_work
from drivers.can.bus.bus import BusKeys, CanBus, Filters
from drivers.can.codec.frames import ERROR, Frames, frames_of, joined, no_frames
from drivers.can.tuning import READ_FRAMES, RECEIVE_BYTES
from drivers.port import Counts, DriverIOError

_CAN_RAW_ERR_FILTER = 2
_SO_RCVBUFFORCE = 33
_SO_TIMESTAMPNS = 35
_SO_RXQ_OVFL = 40  # fixed by linux/can/raw.h and asm-generic/socket.h
_TIMESPEC = struct.Struct("@qq")


class KernelBus(CanBus):
    """A raw socket on one interface.

    Args:
        keys: which interface.
        filters: what the kernel lets through.
        counts: told of frames that the kernel lost.
        batched: read many frames by one system call, where this machine can; one by one otherwise.

    Raises DriverIOError where the kernel has no CAN, or no such interface that is up.
    """

    gather_s = 0.02  # at the kernel's own limit a buffer has room for some hundred frames

    def __init__(self, keys: BusKeys, filters: Filters, counts: Counts, *, batched: bool = True) -> None:
        self._name = keys.channel
        self._counts = counts
        self._lost = 0
        self._failure: DriverIOError | None = None
        try:
            self._socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        except (AttributeError, OSError) as error:
            raise DriverIOError(
                f"{self._name}: this kernel has no CAN; try a socketcand elsewhere"
            ) from error
        try:
            self._set_up(keys, filters)
        except OSError as error:
            self._socket.close()
            raise DriverIOError(f"{self._name}: {error.strerror or error}") from error
        self._receiver = BatchReceiver(self._socket.fileno()) if batched and batches_work() else None

    def _set_up(self, keys: BusKeys, filters: Filters) -> None:
        packed = b"".join(struct.pack("=II", number, mask) for number, mask in filters)
        self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, packed)
        self._socket.setsockopt(socket.SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, struct.pack("=I", ERROR - 1))
        self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, int(keys.fd))
        self._widen_buffer()
        self._socket.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        self._socket.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
        self._socket.setblocking(False)
        self._socket.bind((keys.channel,))

    def _widen_buffer(self) -> None:
        """Ask for room for seconds of frames; without the right, the kernel's limit (rmem_max) stands."""
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BYTES)
        with suppress(PermissionError):
            self._socket.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, RECEIVE_BYTES)

    def frames(self, deadline: float) -> Frames:
        if self._failure is not None:
            raise self._failure
        select.select([self._socket], [], [], max(0.0, deadline - clock.monotonic()))
        frames = self._one_by_one() if self._receiver is None else self._in_batches(self._receiver)
        if self._failure is not None and not len(frames):
            raise self._failure
        return frames

    def _in_batches(self, receiver: BatchReceiver) -> Frames:
        frames = no_frames()
        try:
            while len(frames) < READ_FRAMES and len(more := receiver.receive()):
                frames = joined(frames, more)
        except OSError as error:
            self._fail(error)
        self._count_lost(receiver.lost)
        return frames

    def _one_by_one(self) -> Frames:
        rows: list[bytes] = []
        times: list[int] = []
        try:
            while len(rows) < READ_FRAMES:
                data, extra, _, _ = self._socket.recvmsg(72, 128)
                rows.append(data.ljust(80, b"\0"))
                times.append(self._ancillary(extra))
        except BlockingIOError:
            pass  # that was all of them
        except OSError as error:
            self._fail(error)
        return frames_of(rows, np.array(times, np.int64)) if rows else no_frames()

    def _fail(self, error: OSError) -> None:
        """Keep a failure: the kernel reports a downed interface only once, and earlier frames go first."""
        self._failure = DriverIOError(f"{self._name}: {error.strerror or error}")

    def _ancillary(self, extra: list[tuple[int, int, bytes]]) -> int:
        t_ns = 0
        for _, kind, data in extra:
            if kind == _SO_TIMESTAMPNS:
                seconds, nanoseconds = _TIMESPEC.unpack_from(data)
                t_ns = seconds * 10**9 + nanoseconds
            elif kind == _SO_RXQ_OVFL:
                self._count_lost(int.from_bytes(data[:4], "little"))
        return t_ns

    def _count_lost(self, lost: int) -> None:
        """Take the kernel's count of the frames that it has lost on this socket so far."""
        if lost != self._lost:
            self._counts.dropped["kernel queue"] += (lost - self._lost) % (1 << 32)
            self._lost = lost

    def close(self) -> None:
        self._socket.close()
