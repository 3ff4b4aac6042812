"""One connection to the units behind it, shared by all sources naming it: a serial line, a gateway, a device.

Requests go out one at a time, the most urgent first. A unit that does not answer costs the others little:
once it has failed it is given no longer than its answers used to take, but for now and then, and is asked
ever more seldom, in the others' pauses; `drivers.modbus.units` says what that comes to. A late answer is
never taken for another's: over TCP its transaction is known to be given up; over RTU, where answers do not
say what they answer, the unit is left alone for a while and then asked for a number of registers that it owes
no answer of. Units answer in order, so that with that answer all late ones have come.
"""

import threading
from collections import Counter
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from weakref import WeakValueDictionary

from drivers import clock
from drivers.fields import ByteArray
from drivers.modbus import tuning
from drivers.modbus.frames import ADDRESS, FIFO, MAX_REGISTERS, VALUE, Frames, ReplyError, Request
from drivers.modbus.line_lock import LineLock
from drivers.modbus.units import LaterError, Unit
from drivers.pipe import Pipe
from drivers.port import DriverConfigError, DriverIOError


@dataclass(frozen=True, slots=True)
class _Asked:
    """A request that was given up: whose it was, when it went out, and who counts what becomes of it."""

    unit: Unit
    at: float
    faults: Counter[str]


class _EndedError(DriverIOError):
    """The connection ended while it was used; amid: with a part of a reply."""

    def __init__(self, words: str, *, amid: bool = False) -> None:
        super().__init__(words)
        self.amid = amid


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
        self._line_lock = LineLock()
        self._units: dict[int, Unit] = {}
        self._usual_s = 0.0
        self._unanswered = 0
        self._received_at = 0.0
        self._newest: _Asked | None = None
        self._given_up: dict[int, _Asked] = {}

    def open(self) -> None:
        """Connect unless that is done; raises DriverIOError."""
        with self._line_lock.taken(clock.monotonic()):
            self._connected()

    def close(self) -> None:
        """Let go of the connection; the next request makes it anew."""
        with self._line_lock.taken(clock.monotonic()):
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

        Raises LaterError while an answer of the unit may still be under way and while one that keeps silent
        leaves the line to the others, ReplyError for a missing or wrong answer, DriverIOError when the line
        is gone.
        """
        unit = self._units.setdefault(request.unit, Unit())
        with self._line_lock.taken(clock.monotonic() + tuning.POLITE_S if unit.is_lost else urgent_at):
            self._wait_for(unit)
            if request.count in unit.lost:
                self._come_level(request, unit, timeout_s, faults, spare)
            unit.plan(urgent_at)
            return self._exchange(request, unit, timeout_s, faults)

    def _wait_for(self, unit: Unit) -> None:
        now = clock.monotonic()
        begin = unit.late_until
        if unit.is_lost:
            others = [
                other for other in list(self._units.values()) if other is not unit and other.is_active(now)
            ]
            begin = max(begin, unit.start(now, others))
        if begin > now + tuning.ROUNDING_S:
            raise LaterError(begin)

    def _come_level(
        self, request: Request, unit: Unit, timeout_s: float, faults: Counter[str], spare: int
    ) -> None:
        """Ask for a number of registers that the unit owes no answer of; with it, every late one has come."""
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
            self._given_up.clear()
            self._newest = None
            self._unanswered = 0
        return self.pipe

    def _drop(self) -> None:
        if self.pipe is not None:
            self.pipe.close()
        self.pipe = None

    def _exchange(self, request: Request, unit: Unit, timeout_s: float, faults: Counter[str]) -> ByteArray:
        """Ask; once more over a new connection where a server ended this one, as many do with idle ones.

        Nothing says so before the request is out. Reading twice does no harm.
        """
        try:
            return self._once(self._connected(), request, unit, timeout_s, faults)
        except _EndedError as ended:
            if self._pause_s is not None:
                raise
            if ended.amid:
                faults["cut reply"] += 1
            return self._once(self._connected(), request, unit, timeout_s, faults)

    def _once(
        self, pipe: Pipe, request: Request, unit: Unit, timeout_s: float, faults: Counter[str]
    ) -> ByteArray:
        try:
            self._settle(pipe, faults)
            pipe.send(self.frames.protocol, self.frames.request(request))
            asked = self._newest = _Asked(unit, clock.monotonic(), faults)
            answer = self._await(pipe, request, timeout_s, asked)
        except _EndedError:
            self._drop()
            raise
        except DriverIOError as error:
            self._drop()
            raise _EndedError(str(error)) from error
        self._answered(asked)
        return answer

    def _settle(self, pipe: Pipe, faults: Counter[str]) -> None:
        """Leave RTU's silence between frames, and forget what came unasked: whose turn it was sent it."""
        if self._pause_s is None:
            return
        clock.sleep(max(0.0, self._received_at + self._pause_s - clock.monotonic()))
        stray = pipe.drain(0.0)
        sender = self._newest
        if stray:
            (faults if sender is None else sender.faults)["stray bytes"] += stray
            if sender is not None and sender.unit.unanswered:
                sender.unit.late(clock.monotonic() - sender.at)

    def _await(self, pipe: Pipe, request: Request, timeout_s: float, asked: _Asked) -> ByteArray:
        """Return the answer; a failure is noted before it is raised."""
        try:
            return self._answer(
                pipe, request, asked.at + asked.unit.allowed_s(timeout_s, self._usual_s), asked
            )
        except ReplyError as error:
            self._failed(request, asked, error, timeout_s)
            raise

    def _answer(self, pipe: Pipe, request: Request, deadline: float, asked: _Asked) -> ByteArray:
        data = b""
        answer = None
        try:
            while answer is None and (more := pipe.recv(deadline)):
                data = (data + more)[-tuning.LONGEST_NOISE :]
                answer = self.frames.reply(data, request)
        except DriverIOError as error:
            raise _EndedError(str(error), amid=self.frames.partial(data)) from error
        except ReplyError as error:
            error.data = data
            raise
        finally:
            self._received_at = clock.monotonic()
            for number in self.frames.late if data else ():
                self._came_late(self._given_up.get(number, asked))
        if answer is None:
            raise self._silence(data, request)
        return answer

    def _came_late(self, asked: _Asked) -> None:
        asked.faults["late reply"] += 1
        asked.unit.late(self._received_at - min(asked.unit.lost.values(), default=asked.at))

    def _silence(self, data: bytes, request: Request) -> ReplyError:
        if self._pause_s is None and self.frames.partial(data):
            self._drop()
        got = f"{len(data)} byte{'s' * (len(data) > 1)} that are no reply to it" if data else "no reply"
        error = ReplyError("timeout", f"{got} in time to {request.words}")
        error.data = data
        return error

    def _answered(self, asked: _Asked) -> None:
        seconds = clock.monotonic() - asked.at
        asked.unit.answered(seconds)
        self._unanswered = 0
        self._usual_s = max(seconds, tuning.FADE * self._usual_s)

    def _failed(self, request: Request, asked: _Asked, error: ReplyError, timeout_s: float) -> None:
        """Note what a failure says of the unit and of the connection."""
        now = clock.monotonic()
        asked.unit.failed(now - asked.at, now, silent=error.silent)
        if error.kind == "timeout":
            self._missed(request, asked, now, timeout_s)
        elif not error.code:
            self._drop()  # a stream of frames that do not fit cannot be trusted to fit later

    def _missed(self, request: Request, asked: _Asked, now: float, timeout_s: float) -> None:
        unit = asked.unit
        if self._pause_s is None:
            self._given_up[self.frames.give_up()] = asked
            if len(self._given_up) > tuning.REMEMBERED_REQUESTS:
                del self._given_up[next(iter(self._given_up))]
        else:
            unit.lost[request.count] = now
            unit.late_until = now + min(timeout_s, max(tuning.SHORTEST_S, tuning.USUAL * unit.slowest_s))
        self._unanswered += 1
        if self._unanswered >= tuning.UNANSWERED:
            self._drop()
            self._unanswered = 0


def _unowed(request: Request, unit: Unit, timeout_s: float, spare: int) -> Request | None:
    """Return a request from the same address whose answer cannot be one that the unit owes.

    None when no other length may be asked for, and the owed answers are so old that they will not come.
    LaterError while one may come and every length is owed.
    """
    most = 0 if request.function == FIFO else min(request.count + spare, MAX_REGISTERS)
    lengths = [*range(request.count - 1, 0, -1), *range(request.count + 1, most + 1)]
    remembered_s = max(timeout_s, min(tuning.REMEMBERED_S, tuning.REMEMBERED_EACH_S * len(lengths)))
    free_at = {
        count: unit.lost.get(count, -remembered_s) + remembered_s for count in lengths or [request.count]
    }
    count = min(free_at, key=lambda count: free_at[count])
    if free_at[count] > clock.monotonic() + tuning.ROUNDING_S:
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
            raise DriverConfigError(
                f"{name}: {manner} here and {line.manner} for another source; a line has one"
            )
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
