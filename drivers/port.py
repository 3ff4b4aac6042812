"""The interface between a bus and the agent: one block of samples, one driver, one error tree.

    DriverError
    ├── DriverConfigError    the settings cannot work: do not retry
    └── DriverIOError        the bus or device failed: may be retried after a while

A driver only listens. The bytes that drivers write are listed in `LISTENER_WRITES`; everything else is a
fault.
"""

from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, Union, get_args, get_origin

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationInfo, field_validator
from pydantic_core import PydanticKnownError

from drivers.tuning import RETRY_S

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

LISTENER_WRITES: Mapping[str, str] = {
    "modbus": "read requests: function codes 1, 2, 3, 4 and 24",
    "socketcand": "its handshake, which puts no frame on the bus: < open BUS > and < rawmode >",
    "slcan": (
        "nothing, or with open_adapter what opens the adapter listen-only: C, S0 to S8, Z0, Z1, L; never O"
    ),
    "netlink": "the question how an interface is set up (RTM_GETLINK); it goes to the kernel, not to a bus",
}
"""What each protocol may write, in words; the suite traces every write to a bus descriptor against it."""


class DriverError(Exception):
    """Base of what a driver raises."""


class DriverConfigError(DriverError):
    """The settings cannot work (no such field, no such file): retrying does not help."""


class DriverIOError(DriverError, OSError):
    """The bus or the device failed: retrying may help. kind: a short word for what it was, where known."""

    kind: str = ""


@dataclass(frozen=True, slots=True)
class SampleBlock:
    """Consecutive samples of one source, in the order in which they arrived.

    Attributes:
        values: (n, m) one column a requested field, in the field's unit (the field's own scale and offset
            applied); NaN where the sample lacks that field.
        arrival_ns: monotonic time at which the block was received, ns.
        counter: (n,) the device's sample counter as on the wire, still wrapped; None where there is none.
        t_ns: (n,) the device's or the recording's time stamps, ns; None where there is none.
        epoch: counts up by one when the device is known to have begun counting anew (a restart): counters and
            time stamps of different epochs cannot be compared.
        received_ns: (n,) monotonic time at which each sample was received, ns; None where only the block's is
            known.
        wall_offset_ns: wall minus monotonic clock at the receipt, noted by whoever labels samples; drivers
            leave None.
    """

    values: FloatArray
    arrival_ns: int
    counter: IntArray | None = None
    t_ns: IntArray | None = None
    epoch: int = 0
    wall_offset_ns: int | None = None
    received_ns: IntArray | None = None

    def __len__(self) -> int:
        return len(self.values)


@dataclass(frozen=True, slots=True)
class Unit:
    """A frame, a line or an answer as it came, and what it decodes to.

    Attributes:
        raw: as text; it may hold anything, orders to a terminal too.
        values: (m,) one a requested field, NaN where this unit carries none; None where it was rejected.
        reason: why it was.
    """

    raw: str
    values: FloatArray | None = None
    reason: str = ""


class Trace:
    """A source's newest units, for who looks on; older give way. Of a batch the last `NEWEST` are kept."""

    NEWEST: ClassVar[int] = 16

    def __init__(self, most: int = 256) -> None:
        self._units: deque[Unit] = deque(maxlen=most)

    def good(self, raws: Sequence[str], values: FloatArray) -> None:
        """Keep units and what each decodes to, (n, m)."""
        self._units.extend(Unit(raw, row) for raw, row in zip(raws, values, strict=True))

    def bad(self, reason: str, raws: Iterable[str]) -> None:
        """Keep units that were rejected."""
        self._units.extend(Unit(raw, None, reason) for raw in raws)

    def take(self) -> list[Unit]:
        """Return what came since the last call, oldest first; another thread may add meanwhile."""
        return [self._units.popleft() for _ in range(len(self._units))]


@dataclass(slots=True)
class Counts:
    """Sample instants that a driver met since it was made; kept over re-opens.

    received counts every instant that reached this process, good or bad; rejected those of them that were
    thrown away, by reason ("crc", "overrun", "dlc" ...), so that received = delivered + sum(rejected);
    dropped those lost before this process could read them where the bus tells (kernel queue, overwritten
    ring), by reason. faults counts, by reason, what went wrong on the line without being a sample: late
    replies, stray bytes, text in a cell. first shows, by reason, the first line or frame that was refused for
    it. trace, where somebody looks on, is shown what comes; copies have none.
    """

    received: int = 0
    rejected: Counter[str] = field(default_factory=Counter)
    dropped: Counter[str] = field(default_factory=Counter)
    faults: Counter[str] = field(default_factory=Counter)
    reopened: int = 0
    first: dict[str, str] = field(default_factory=dict, compare=False)
    trace: Trace | None = field(default=None, compare=False)

    def show_bad(self, reason: str, *raws: str) -> None:
        """Keep the first unit that is rejected for a reason, and show the newest to who looks on."""
        self.first.setdefault(reason, raws[0])
        if self.trace is not None:
            self.trace.bad(reason, raws[-Trace.NEWEST :])

    def copy(self) -> "Counts":
        """Return the counts as they are now."""
        rejected, dropped, faults = self.rejected.copy(), self.dropped.copy(), self.faults.copy()
        return Counts(self.received, rejected, dropped, faults, self.reopened, self.first.copy())


@dataclass(frozen=True, slots=True)
class Capture:
    """What a bus carried since it was last asked for, as other tools read it; for recording.

    Attributes:
        text: makes the text, whole lines; may be called later, in another thread.
        lines: how many they are.
        beside: what the text cannot carry, as JSON can; for `Driver.decode_capture`.
    """

    text: Callable[[], bytes]
    lines: int
    beside: Mapping[str, Any]


class DriverSettings(BaseModel):
    """Base of a driver's own configuration keys; unknown keys are errors, and text is no number."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _of_the_kind_that_it_says(cls, value: object, info: ValidationInfo) -> object:
        """Refuse what pydantic would convert: text or true as a number, a number as true."""
        kinds = _plain_kinds(cls.model_fields[str(info.field_name)].annotation)
        if kinds == {bool}:
            return _truth(value)
        if kinds <= {int, float, NoneType} and isinstance(value, (str, bool)):
            raise PydanticKnownError("float_type" if float in kinds else "int_type")
        if isinstance(value, str) and "\0" in value:
            raise ValueError("must not hold a zero byte")
        return value


def _truth(value: object) -> bool:
    if not isinstance(value, bool):
        raise PydanticKnownError("bool_type")
    return value


def _plain_kinds(annotation: Any) -> set[Any]:
    """Return what an annotation is a choice of, without what qualifies it."""
    if get_origin(annotation) is Annotated:
        return _plain_kinds(get_args(annotation)[0])
    if get_origin(annotation) in {Union, UnionType}:
        return set().union(*map(_plain_kinds, get_args(annotation)))
    return {annotation}


@dataclass(frozen=True, slots=True)
class SourceRequest:
    """What the agent asks of a source.

    Attributes:
        name: the source's name, for messages.
        settings: an instance of the driver's `settings_model`.
        fields: the bus's field names in the order of the columns of `SampleBlock.values`.
        counter: the name of the counter field, or None.
        folder: folder of the configuration file; relative paths start there.
    """

    name: str
    settings: Any
    fields: tuple[str, ...]
    counter: str | None = None
    folder: Path = Path()


class Driver(ABC):
    """One source of samples. Implementations override `open`, `read`, `close` and `resolution`.

    Vendor libraries are imported in `open`, so that naming a driver costs nothing. One thread owns a driver.
    """

    settings_model: ClassVar[type[DriverSettings]]
    counter_modulus: int | None = None
    """The counter wraps to 0 after counter_modulus - 1; None if unknown or without one. Known once open."""
    stamped: ClassVar[bool | None] = None
    """Whether samples carry time stamps of the device or the kernel (`SampleBlock.t_ns`); None: not told."""
    finite: ClassVar[bool] = False
    """True for recordings: `read` raises EOFError at the end."""
    capture_suffix: ClassVar[str | None] = None
    """Suffix of files that hold what the bus carried, such as ".log"; None: recordings hold the samples."""

    def __init__(self, request: SourceRequest) -> None:
        self.request = request
        self.counts = Counts()
        self._notes: list[str] = []
        self._reports: list[tuple[str, str]] = []

    @property
    def retry_s(self) -> float:
        """Longest pause between two tries to open the source, s; shorter where a try reaches nobody else."""
        return RETRY_S

    def note(self, text: str) -> None:
        """Keep a remark for the driver's owner, once; at most 100 wait."""
        if text not in self._notes and len(self._notes) < 100:
            self._notes.append(text)

    def take_notes(self) -> list[str]:
        """Return the remarks made since the last call, in words ("the device restarted"), and forget them."""
        notes, self._notes = self._notes, []
        return notes

    def hints(self) -> tuple[str, ...]:
        """Return what to mind about settings that work, in words, for `check`; asked before `open`."""
        return ()

    def report(self, cause: str, message: str) -> None:
        """Tell the driver's owner of a state of the bus that samples do not show; at most 100 wait.

        The cause is a short word such as "error-passive" and becomes a health event; one of `reconnect.AWAY`
        ("bus-off") also raises the source's alarm until samples come again.
        """
        if len(self._reports) < 100:
            self._reports.append((cause, message))

    def take_reports(self) -> list[tuple[str, str]]:
        """Return what was reported since the last call, and forget it."""
        reports, self._reports = self._reports, []
        return reports

    def keep_capture(self) -> None:  # noqa: B027 - drivers without such a form have nothing to do
        """Begin to keep what the bus carries, for `take_capture`; only where there is a capture_suffix."""

    def take_capture(self) -> Capture | None:
        """Return what the bus carried since the last call; None when that was nothing or is not kept."""
        return None

    def decode_capture(self, text: bytes, beside: Mapping[str, Any]) -> SampleBlock:
        """Return what `read` made of this on the bus. The driver is not open; its counts go on as they did.

        Raises DriverConfigError.
        """
        raise DriverConfigError(f"{self.request.name}: its driver has no form of what its bus carries")

    @abstractmethod
    def open(self) -> None:
        """Open the bus; raise DriverConfigError or DriverIOError. Reopening continues the counts."""

    @abstractmethod
    def read(self, timeout_s: float) -> SampleBlock:
        """Return what has arrived, waiting at most timeout_s; an empty block when nothing came.

        Raises DriverIOError when the bus fails; the driver must then be closed and opened again.
        """

    @abstractmethod
    def close(self) -> None:
        """Release the bus; harmless when closed already."""

    def switched(self) -> tuple[bool, ...]:
        """Tell of each field if its readings are seen to be held at a few levels, as what is commanded is."""
        return (False,) * len(self.request.fields)

    @abstractmethod
    def resolution(self) -> tuple[float, ...]:
        """Smallest step that the wire can carry, one a requested field, in the field's unit; 0.0 for floats.

        Works before `open`.
        """
