"""One connection to the units behind it, shared by all sources that name it: a serial line, a gateway, a device.

Requests go out one at a time, the most urgent first. A unit that does not answer costs the others little: once it has
failed it is given no longer than its answers used to take, but for now and then. A late answer is never taken for
another's: over TCP its transaction is known to be given up; over RTU, where answers do not say what they answer, the
unit is left alone for a while and then asked for a number of registers that it owes no answer of. Units answer in
order, so that with that answer all late ones have come.
"""

import threading
from collections import Counter
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from weakref import WeakValueDictionary

from drivers import clock
from drivers.fields import ByteArray
from drivers.modbus_frames import ADDRESS, FIFO, MAX_REGISTERS, VALUE, Frames, ReplyError, Request
from drivers.pipe import Pipe
from drivers.port import DriverConfigError, DriverIOError
from drivers.turns import Turns

_LONGEST = 2048
"""Bytes looked through for a reply; noise before them is forgotten."""
_SHORTEST_S = 0.05
_USUAL = 4.0
_FULL_EVERY, _FULL_EVERY_UNKNOWN = 16, 4
_DEAF = 3
_REMEMBERED_S, _EACH_S = 5.0, 0.7
"""How long a lost request's answer may still come: at most, and for each other length there is to ask for."""
_FADE = 0.98
ROUNDING_S = 1e-6
"""Times this near are the same: a wait may end so much early."""


class LaterError(Exception):
    """The unit cannot be asked now; `until` says when (clock.monotonic)."""

    def __init__(self, until: float) -> None:
        super().__init__(f"not before {until:g}")
        self.until = until


@dataclass(slots=True)
class _Unit:
    """What is known of a unit: its slowest answer of late, failures in a row, and what answers it owes.

    These are kept by their number of registers, with the time at which they were given up.
    """

    slowest_s: float = 0.0
    unanswered: int = 0
    late_until: float = 0.0
    lost: dict[int, float] = field(default_factory=dict)


class ModbusLine:
    """A connection and the units behind it.

    Args:
        connect: opens the pipe; raises DriverIOError.
        frames: how requests and replies look on it.
        pause_s: silence between two frames (of a serial line); None over TCP.

    Attributes:
        pipe: the connection; None while there is none.
        users: how many sources use it now; `shared_line` and `let_go` count.
        manner: how it is set up, in words.
    """

    def __init__(self, connect: Callable[[], Pipe], frames: Frames, pause_s: float | None) -> None:
        self.frames = frames
        self.pipe: Pipe | None = None
        self.users = 0
        self.manner = ""
        self._connect = connect
        self._pause_s = pause_s
        self._turns = Turns()
        self._units: dict[int, _Unit] = {}
        self._usual_s = 0.0
        self._unanswered = 0
        self._heard_at = 0.0

    def open(self) -> None:
        """Connect unless that is done; raises DriverIOError."""
        with self._turns.taken(clock.monotonic()):
            self._connected()

    def close(self) -> None:
        """Let go of the connection; the next request makes it anew."""
        with self._turns.taken(clock.monotonic()):
            self._drop()

    def ask(
        self, request: Request, timeout_s: float, urgent_at: float, faults: Counter[str], spare: int = 0
    ) -> ByteArray:
        """Return the register bytes that answer a request.

        Args:
            request: what to read.
            timeout_s: how long the answer may take once the request is sent.
            urgent_at: the sooner, the earlier the request's turn (clock.monotonic).
            faults: counts late replies and stray bytes.
            spare: registers behind those requested that may be read along.

        Raises LaterError while an answer of the unit may still be under way, ReplyError for a missing or wrong answer,
        DriverIOError when the line is gone.
        """
        with self._turns.taken(urgent_at):
            unit = self._units.setdefault(request.unit, _Unit())
            if unit.late_until > clock.monotonic() + ROUNDING_S:
                raise LaterError(unit.late_until)
            if request.count in unit.lost:
                self._come_level(request, unit, timeout_s, faults, spare)
            return self._exchange(request, unit, timeout_s, faults)

    def _come_level(self, request: Request, unit: _Unit, timeout_s: float, faults: Counter[str], spare: int) -> None:
        """Ask for a number of registers that the unit owes no answer of; with that, every late one has come."""
        probe = _unowed(request, unit, timeout_s, spare)
        if probe is not None:
            try:
                self._exchange(probe, unit, timeout_s, faults)
            except ReplyError as error:
                if error.code not in {ADDRESS, VALUE} or probe.count < request.count:
                    raise
        unit.lost.clear()

    def _connected(self) -> Pipe:
        if self.pipe is None:
            self.pipe = self._connect()
            self.frames.restart()
            self._unanswered = 0
        return self.pipe

    def _drop(self) -> None:
        if self.pipe is not None:
            self.pipe.close()
        self.pipe = None

    def _exchange(self, request: Request, unit: _Unit, timeout_s: float, faults: Counter[str]) -> ByteArray:
        pipe = self._connected()
        try:
            if self._settle(pipe, faults) and unit.unanswered:
                unit.slowest_s = timeout_s
            pipe.send(self.frames.protocol, self.frames.request(request))
            asked_at = clock.monotonic()
            answer = self._await(pipe, request, asked_at + self._allowed(unit, timeout_s), faults)
        except DriverIOError:
            self._drop()
            raise
        except ReplyError as error:
            self._failed(request, unit, error, timeout_s)
            raise
        self._answered(unit, clock.monotonic() - asked_at)
        return answer

    def _settle(self, pipe: Pipe, faults: Counter[str]) -> bool:
        """Leave the silence that RTU wants between frames, and forget what came unasked; tell whether something did."""
        if self._pause_s is None:
            return False
        clock.sleep(max(0.0, self._heard_at + self._pause_s - clock.monotonic()))
        stray = pipe.drain(0.0)
        if stray:
            faults["stray bytes"] += stray
        return stray > 0

    def _allowed(self, unit: _Unit, timeout_s: float) -> float:
        usual = unit.slowest_s or self._usual_s
        every = _FULL_EVERY if unit.slowest_s else _FULL_EVERY_UNKNOWN
        if not usual or unit.unanswered % every == 0:
            return timeout_s
        return min(timeout_s, max(_SHORTEST_S, _USUAL * usual))

    def _await(self, pipe: Pipe, request: Request, deadline: float, faults: Counter[str]) -> ByteArray:
        data = b""
        answer = None
        self.frames.late = 0
        try:
            while answer is None and (more := pipe.recv(deadline)):
                data = (data + more)[-_LONGEST:]
                answer = self.frames.reply(data, request)
        finally:
            self._heard_at = clock.monotonic()
            if self.frames.late:
                faults["late reply"] += self.frames.late
        if answer is None:
            raise self._silence(data, request)
        return answer

    def _silence(self, data: bytes, request: Request) -> ReplyError:
        if self._pause_s is None and self.frames.partial(data):
            self._drop()
        got = f"{len(data)} bytes that are no reply to it" if data else "no reply"
        return ReplyError("timeout", f"{got} in time to {request.words}")

    def _answered(self, unit: _Unit, seconds: float) -> None:
        unit.unanswered = self._unanswered = 0
        unit.lost.clear()
        unit.slowest_s = max(seconds, _FADE * unit.slowest_s)
        self._usual_s = max(seconds, _FADE * self._usual_s)

    def _failed(self, request: Request, unit: _Unit, error: ReplyError, timeout_s: float) -> None:
        """Note what a failure says of the unit and of the connection."""
        unit.unanswered = unit.unanswered + 1 if error.silent else 0
        if self.frames.late:
            unit.slowest_s = timeout_s
        if error.kind == "timeout":
            self._missed(request, unit, timeout_s)
        elif not error.code:
            self._drop()  # a stream of frames that do not fit cannot be trusted to fit later

    def _missed(self, request: Request, unit: _Unit, timeout_s: float) -> None:
        self.frames.give_up()
        if self._pause_s is not None:
            now = clock.monotonic()
            unit.lost[request.count] = now
            unit.late_until = now + min(timeout_s, max(_SHORTEST_S, _USUAL * unit.slowest_s))
        self._unanswered += 1
        if self._unanswered >= _DEAF:
            self._drop()
            self._unanswered = 0


def _unowed(request: Request, unit: _Unit, timeout_s: float, spare: int) -> Request | None:
    """Return a request from the same address whose answer cannot be one that the unit owes.

    None when no other length may be asked for, and the owed answers are so old that they will not come. LaterError
    while one may come and every length is owed.
    """
    most = 0 if request.function == FIFO else min(request.count + spare, MAX_REGISTERS)
    lengths = [*range(request.count - 1, 0, -1), *range(request.count + 1, most + 1)]
    remembered_s = max(timeout_s, min(_REMEMBERED_S, _EACH_S * len(lengths)))
    free_at = {count: unit.lost.get(count, -remembered_s) + remembered_s for count in lengths or [request.count]}
    count = min(free_at, key=lambda count: free_at[count])
    if free_at[count] > clock.monotonic() + ROUNDING_S:
        raise LaterError(free_at[count])
    return Request(request.unit, request.function, request.address, count) if lengths else None


_LINES: WeakValueDictionary[Hashable, ModbusLine] = WeakValueDictionary()
_LOCK = threading.Lock()


def shared_line(name: str, manner: str, make: Callable[[], ModbusLine]) -> ModbusLine:
    """Return the line of that name and manner, made when no source holds it, and count one user more.

    Who has let go of it may keep the object: what its units owe is remembered for the next time. Raises
    DriverConfigError while others use the line in another manner.
    """
    key = (clock.played(), name)
    with _LOCK:
        line = _LINES.get(key)
        if line is not None and line.users and line.manner != manner:
            raise DriverConfigError(f"{name}: {manner} here and {line.manner} for another source; a line has one")
        if line is None or line.manner != manner:
            line = _LINES[key] = make()
            line.manner = manner
        line.users += 1
        return line


def let_go(line: ModbusLine) -> None:
    """Count one user less; the last one's leaving closes the connection."""
    with _LOCK:
        line.users -= 1
        if line.users > 0:
            return
    line.close()
