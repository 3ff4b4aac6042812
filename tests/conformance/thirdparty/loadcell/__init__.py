"""A driver made by somebody else: samples as JSON lines over a local socket."""

import json
import select
import socket
import time
from typing import ClassVar

import numpy as np

from drivers.port import Driver, DriverConfigError, DriverIOError, DriverSettings, SampleBlock, SourceRequest


class LoadcellSettings(DriverSettings):
    """Where the load cell's gateway listens."""

    path: str
    names: tuple[str, ...] = ("force", "x1")
    step: float = 0.25


class LoadcellDriver(Driver):
    """Reads a gateway that sends each sample as a JSON list, counter first, over a local stream socket."""

    settings_model: ClassVar[type[DriverSettings]] = LoadcellSettings
    counter_modulus = 1 << 16

    def __init__(self, request: SourceRequest) -> None:
        super().__init__(request)
        self._socket: socket.socket | None = None
        self._rest = b""
        self._opened = False
        for name in request.fields:
            if name not in request.settings.names:
                raise DriverConfigError(f'the load cell has no "{name}"')

    def open(self) -> None:
        self.close()
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._socket.connect(self.request.settings.path)
        except OSError as error:
            self.close()
            raise DriverIOError(str(error)) from error
        self.counts.reopened += self._opened
        self._opened = True

    def read(self, timeout_s: float) -> SampleBlock:
        if self._socket is None:
            raise DriverIOError("read before open")
        ready, _, _ = select.select([self._socket], [], [], timeout_s)
        *lines, self._rest = (self._rest + self._data()).split(b"\n") if ready else [self._rest]
        rows = np.array([json.loads(line) for line in lines], float).reshape(
            len(lines), 1 + len(self.request.settings.names)
        )
        columns = [1 + self.request.settings.names.index(name) for name in self.request.fields]
        self.counts.received += len(rows)
        if not len(rows):
            return SampleBlock(np.empty((0, len(columns))), time.monotonic_ns(), np.empty(0, np.int64))
        return SampleBlock(rows[:, columns], time.monotonic_ns(), rows[:, 0].astype(np.int64))

    def _data(self) -> bytes:
        assert self._socket is not None
        data = self._socket.recv(65536)
        if not data:
            raise DriverIOError("the gateway closed the connection")
        return data

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket = None
        self._rest = b""

    def resolution(self) -> tuple[float, ...]:
        return (self.request.settings.step,) * len(self.request.fields)
