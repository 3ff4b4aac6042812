"""Values under way inside the agent; what else is stored is in `agent.records`. Frozen, in SI units.

Times are integer nanoseconds since the epoch (or since a recording's own start). Arrays are numpy; NaN in
`value`, `sd`, `lower`, `upper`, `held` means "none" and never goes with status VALID.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any, Generic, Literal, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
CodeArray = NDArray[np.uint8]
ComplexArray = NDArray[np.complex128]

_Value = TypeVar("_Value")
_Event = TypeVar("_Event")


@dataclass(frozen=True)  # no slots: a generic class notes its parameters on what it makes
class Output(Generic[_Value, _Event]):
    """Result of one step of a stage: what goes on to the next stage, and what was found, in order of time."""

    values: Sequence[_Value] = ()
    events: Sequence[_Event] = ()

    @classmethod
    def joined(cls, parts: "Iterable[Output[_Value, _Event]]") -> "Output[_Value, _Event]":
        """Return results one after the other."""
        values: list[_Value] = []
        events: list[_Event] = []
        for part in parts:
            values += part.values
            events += part.events
        return cls(values, events)


class Status(IntEnum):
    """What an estimate is worth (CONTRACT section 6); the name in lower case is what the database shows."""

    WARMING = 0
    VALID = 1
    UNEXCITED = 2
    INVALID = 3


class Reason(IntEnum):
    """Why an estimate is not valid; NONE shows as NULL."""

    NONE = 0
    CHANGING = 1
    MISMATCH = 2
    SENSOR = 3
    DIVERGED = 4
    GAP = 5
    NO_DATA = 6
    DRY_FRICTION = 7
    BIAS = 8
    NONLINEAR = 9
    STUCK = 10
    SATURATED = 11
    STANDSTILL = 12
    INSEPARABLE = 13
    MASS = 14
    REALIGNING = 15


@dataclass(frozen=True, slots=True)
class SensorFault:
    """A channel that cannot be believed, and why (NO_DATA, STUCK, SATURATED, SENSOR)."""

    channel: str
    reason: Reason


@dataclass(frozen=True, slots=True)
class SensorEvent:
    """At a sample (its time) a fault of a channel began to stand, or (standing False) ended."""

    fault: SensorFault
    standing: bool
    index: int
    t_ns: int


@dataclass(frozen=True, slots=True)
class Aligned:
    """Uninterrupted samples of a rig in SI units.

    Attributes:
        index: (n,) consecutive sample numbers.
        u, y: (n, m) inputs, (n, p) outputs.
        stamps: (n,) time stamps, ns; None where the source has none.
        segment: counts up at each gap.
        anew: some device began to count anew since the samples before: they go with none of these.
        realigning: it is not known which samples of the sources go together.
    """

    index: IntArray
    u: FloatArray
    y: FloatArray
    stamps: IntArray | None
    segment: int
    anew: bool = False
    realigning: bool = False


@dataclass(frozen=True, slots=True)
class Samples:
    """Aligned samples of one rig: consecutive indices, SI units.

    Attributes:
        index: (n,) sample index since the run's first sample, strictly increasing by one; a jump starts a new
            Samples.
        t_ns: (n,) time stamps, ns.
        u: (n, m) model inputs (forces), N.
        y: (n, p) model outputs, SI.
        segment: number of the uninterrupted segment these belong to; counts up at each gap.
        missing: (n, p+m) readings (outputs, then inputs) that were lost or refused and are filled in; None
            when none.
        suspect: (n, p+m) inputs that may be spikes, as only the motion can tell; None when none.
        fault: a channel that spoils estimates made now; None when all are sound.
        usable: false while a channel is at fault: nothing is to be estimated from these samples.
    """

    index: IntArray
    t_ns: IntArray
    u: FloatArray
    y: FloatArray
    segment: int
    missing: BoolArray | None = None
    suspect: BoolArray | None = None
    fault: SensorFault | None = None
    usable: bool = True

    @property
    def complete(self) -> BoolArray:
        """(n,) true for the instants of which nothing was lost or refused."""
        if self.missing is None:
            return np.ones(len(self.index), dtype=np.bool_)
        return np.asarray(~self.missing.any(axis=1))


PER_HOP = (
    "index", "t_ns", "value", "sd", "lower", "upper", "sd_repeat", "status", "reason", "held", "held_age_s",
    "window_s", "n_used", "n_missing", "dof",
)  # fmt: skip
"""What an EstimateBatch has a row of an instant of."""


@dataclass(frozen=True, slots=True)
class EstimateBatch:
    """The estimates of every parameter at consecutive hops; one row a hop, one column a parameter.

    Attributes:
        rig: name of the rig.
        method: "window-ml", "seed" ...
        parameters, units: (q,) names and units.
        reference: (q,) what delta is counted from.
        baseline_id: (q,) the baseline that each reference comes from, None for the nominal; None where all
            are nominal.
        index, t_ns: (N,) the newest sample of each window.
        value, sd, lower, upper: (N, q) estimate, standard deviation, 95 % interval: against the nominal.
        sd_repeat: (N, q) standard deviation against another estimate of the same rig: the constants taken as
            they are.
        status: (N, q) codes of Status.
        reason: (N, q) codes of Reason.
        held, held_age_s: (N, q) the last valid value and its age while status is UNEXCITED or INVALID.
        window_s: (N, q) length of the window used.
        n_used, n_missing: (N,) samples in the window and samples known missing from it.
        dof: (N,) degrees of freedom of the residual variance (for Student's t).
        others: where there are several windows, what each of them says at the same hops; NaN where it is not
            whole, or where it is the one that was chosen.
        reference_sd: (q,) standard deviation of references that were learnt, NaN of others; None where none
            was.
        remarks: (q,) why a reference is less well known than it was learnt, in words, empty where it is; None
            for none.
    """

    rig: str
    method: str
    parameters: tuple[str, ...]
    units: tuple[str, ...]
    reference: FloatArray
    baseline_id: tuple[int | None, ...] | None
    index: IntArray
    t_ns: IntArray
    value: FloatArray
    sd: FloatArray
    lower: FloatArray
    upper: FloatArray
    sd_repeat: FloatArray
    status: CodeArray
    reason: CodeArray
    held: FloatArray
    held_age_s: FloatArray
    window_s: FloatArray
    n_used: IntArray
    n_missing: IntArray
    dof: FloatArray
    others: tuple["EstimateBatch", ...] = ()
    reference_sd: tuple[float, ...] | None = None
    remarks: tuple[str, ...] | None = None

    def __len__(self) -> int:
        return len(self.t_ns)

    def part(self, rows: "NDArray[Any] | slice") -> "EstimateBatch":
        """Return the rows that a mask, an array of numbers or a slice names."""
        parts: dict[str, Any] = {name: getattr(self, name)[rows] for name in PER_HOP}
        return replace(self, **parts, others=tuple(other.part(rows) for other in self.others))


AlarmKind = Literal["level", "rate", "forecast", "sensor", "source", "blind", "mismatch"]
AlarmState = Literal["NORM", "UNACK", "ACKED", "RTNUN", "SHLVD", "DSUPR", "OOSRV"]
COMPUTING, WORKER = "computing", "worker"
"""What alarms of kind `source` are called that are of the agent: computing is behind, a worker is gone."""


@dataclass(frozen=True, slots=True)
class AlarmTransition:
    """One step of one alarm's life (ISA-18.2). A new activation has from_state NORM and to_state UNACK.

    parameter is the parameter's name for kinds "level" and "blind", "model" for "mismatch", the source's or
    channel's name for the others; delta, sd, limit_value, probability and percent (delta as a share of the
    reference) are None for kinds without a number. advice is what the configuration says to do.
    """

    rig: str
    kind: AlarmKind
    parameter: str
    priority: str
    t_ns: int
    from_state: AlarmState
    to_state: AlarmState
    cause: str
    message: str
    delta: float | None = None
    sd: float | None = None
    limit_value: float | None = None
    probability: float | None = None
    by: str | None = None
    comment: str | None = None
    advice: str | None = None
    percent: float | None = None

    @property
    def is_of_agent(self) -> bool:
        """Whether it tells of the agent itself and not of the rig or of what is read of it."""
        return self.kind == "source" and self.parameter in {COMPUTING, WORKER}

    @classmethod
    def plain(
        cls, rig: str, kind: AlarmKind, parameter: str, t_ns: int, message: str, *, stands: bool,
        priority: str = "high", advice: str | None = None,
    ) -> Self:  # fmt: skip
        """Return the step of an alarm without a number: raised where its condition stands, else cleared."""
        before: AlarmState = "NORM" if stands else "UNACK"
        after: AlarmState = "UNACK" if stands else "RTNUN"
        cause = "raise" if stands else "clear"
        return cls(rig, kind, parameter, priority, t_ns, before, after, cause, message, advice=advice)


@dataclass(frozen=True, slots=True)
class Learnt:
    """What a rig's windows have taught, for the next start: noise, constants, point of linearisation.

    Attributes:
        key: what it was learnt for: a hash of the model, the channels and the rate; an edit elsewhere keeps
            it.
        content: JSON text.
    """

    key: str
    content: str


@dataclass(frozen=True, slots=True)
class Verdict:
    """What is believed of a constant of the rig: a mass, a sensor's gain, the inputs' delay.

    Attributes:
        hypothesis: what is off: "m1", "all masses", "x1", "x1 drifts", "delay" of the inputs, "x1 late".
        size, sd: how far, and how well that is known, in `unit`: per cent more than configured, or seconds.
        probability: posterior.
    """

    rig: str
    t_ns: int
    hypothesis: str
    size: float
    sd: float
    unit: str
    probability: float


@dataclass(frozen=True, slots=True)
class WindowConditions:
    """What the paper's conditions and descents say of one window (method = "seed").

    Attributes:
        window: samples.
        defect: share of (10) that no one matrix explains: zero where (11) holds; defect_outputs: of the
            readings.
        rank, rank_joined: of the regressors, and with their targets: equal where (12) holds.
        defect_special: (15), of the middle one of the window's states: zero where (14) may be used for any
            one.
        z_zero: the states fill all directions of the window: Z = 0 does, nothing is left for descent.
        iterations: steps of descent in the last pass, over Z and W; converged: one of the paper's rules ended
            them.
        cost, step: (16) at the end of descent over Z, and its last step's size.
        passes: that were made; ratio: of the last two of their steps, None of fewer.
        trail: (passes, q) parameters after each pass.
    """

    window: int
    defect: float
    defect_outputs: float
    rank: int
    rank_joined: int
    defect_special: float
    z_zero: bool
    iterations: int
    converged: bool
    cost: float
    step: float
    passes: int
    ratio: float | None
    trail: tuple[tuple[float, ...], ...]
