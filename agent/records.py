"""Records that the store keeps and consumers get, beside the values of `agent.types`. Frozen, in SI.

Times are integer nanoseconds since the epoch; None means "not known".
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from agent.types import AlarmKind, AlarmTransition, EstimateBatch, Learnt, Verdict, WindowConditions


@dataclass(frozen=True, slots=True)
class SourceClock:
    """What is known of a source's time; None where it is not.

    Attributes:
        drift_ppm, drift_sd_ppm: how fast its device's clock runs against the gateway's.
        skew_s, skew_sd_s: how much later it is read than the rig's reference source; compensated.
    """

    drift_ppm: float | None = None
    drift_sd_ppm: float | None = None
    skew_s: float | None = None
    skew_sd_s: float | None = None


@dataclass(frozen=True, slots=True)
class Health:
    """Conservation ledger of one source since run start, in sample instants.

    received = used + rejected + dropped.

    faults counts, by name, what went wrong on the line without being a sample: error frames, late replies.
    """

    rig: str
    source: str
    t_ns: int
    received: int
    used: int
    rejected: Mapping[str, int]
    dropped: Mapping[str, int]
    gaps: int
    lag_s: float | None
    faults: Mapping[str, int] = field(default_factory=dict)
    clock: SourceClock | None = None


@dataclass(frozen=True, slots=True)
class HealthEvent:
    """Something that happened to a source or the agent, once: cause as a short word, message for people."""

    rig: str
    source: str
    t_ns: int
    cause: str
    message: str


@dataclass(frozen=True, slots=True)
class EventRecord:
    """The raw samples that were kept around an alarm, as the index of them says; one file, known by its name.

    Attributes:
        rig: whose.
        t_ns: when the first alarm in it was raised; kind and parameter say which alarm that was.
        alarms: alarms raised while it was kept.
        file: its path from the database's folder.
        state: "recording" (what came after the alarm is still awaited), "complete", "cut" (the agent ended,
            or the disk failed, before all of it had come), "failed" (nothing could be kept), "purged" (it
            made room for others).
        from_ns, to_ns: times of its first and last sample.
        samples, bytes: how much it holds.
        baseline_id: the baseline that alarms counted from then; None for the nominal.
        message: in words, what is remarkable.
    """

    rig: str
    t_ns: int
    kind: AlarmKind
    parameter: str
    alarms: int
    file: str
    state: Literal["recording", "complete", "cut", "failed", "purged"]
    from_ns: int
    to_ns: int
    samples: int
    bytes: int
    baseline_id: int | None = None
    message: str = ""


@dataclass(frozen=True, slots=True)
class RunInfo:
    """What a run is: provenance of every row written in it.

    learnt_key: what its rig's knowledge is kept under (see `Learnt`); None takes nothing up from earlier
    runs.
    """

    rig: str
    kind: Literal["live", "replay", "demo"]
    started_ns: int
    code_version: str
    config_sha256: str
    baseline_id: int | None = None
    boot_id: str | None = None
    learnt_key: str | None = None
    offset_ns: int | None = None
    """Wall clock minus monotonic clock as it started; None where the monotonic clock is not this boot's."""
    site: str | None = None
    labels: Mapping[str, str] = field(default_factory=dict)
    graph: str | None = None
    """The graph of its model in words; None where nobody knows."""


@dataclass(frozen=True, slots=True)
class Baseline:
    """What a parameter was like while its machine was healthy.

    Attributes:
        rig, parameter, unit: what it is of; graph: of the model, in words, empty where it is not known.
        reference, sd: robust centre of the hours' means, and how well it is known, their autocorrelation
            counted.
        spread_sd: standard deviation of the hours' means about it.
        within_sd: of rows about the mean of their hour.
        days_sd: of the days' means; None from fewer than three days.
        correlation_s: how long a departure from the reference lasts; n_effective: independent hours there
            were.
        covariates: JSON list of what the reference depends on.
        from_ns, until_ns, n: first and last row learnt from, and how many.
        baseline_id: its number in the store; None before it is stored.
    """

    rig: str
    parameter: str
    unit: str
    graph: str
    reference: float
    sd: float
    spread_sd: float
    within_sd: float
    days_sd: float | None
    correlation_s: float
    n_effective: float
    covariates: str
    from_ns: int
    until_ns: int
    n: int
    baseline_id: int | None = None


@dataclass(frozen=True, slots=True)
class CovariateMean:
    """The mean of a covariate over a period of span_s from t_ns: of n readings, in its own unit."""

    rig: str
    name: str
    unit: str
    t_ns: int
    value: float
    n: int
    span_s: int = 60


@dataclass(frozen=True, slots=True)
class ClockRecord:
    """The anchor of a run's time stamps: from a sample on they follow the wall clock as it is set then.

    Attributes:
        index: the first sample with such a stamp; t_ns: its stamp.
        offset_ns: wall clock minus monotonic clock. Stamps of one offset differ by what the monotonic clock
            says.
    """

    rig: str
    t_ns: int
    index: int
    offset_ns: int


@dataclass(frozen=True, slots=True)
class LearntRecord:
    """A rig knows more than before."""

    rig: str
    t_ns: int
    learnt: Learnt


@dataclass(frozen=True, slots=True)
class ConditionsRecord:
    """The conditions of one window of a rig.

    Attributes:
        window_s: its length, s.
        parameters: names of the columns of the trail.
    """

    rig: str
    t_ns: int
    window_s: float
    parameters: tuple[str, ...]
    found: WindowConditions


@dataclass(frozen=True, slots=True)
class ForecastRecord:
    """A forecast of when a parameter first reaches a limit, as the agent made it.

    Attributes:
        t_ns: when it was made: the instant of the newest row that it rests on.
        level, limit: the parameter then, and the value to be reached, in its unit.
        status: as in `agent.prognosis.forecast`.
        p10_ns, p50_ns, p90_ns: quantiles of the passage; None where nothing can be said.
        chance: of the passage within horizon_s; None where nothing can be said.
        family: JSON, the laws and their weights.
        draws: JSON, draws of the passage that are equally probable, s after t_ns.
        cause: "due" or "alarm".
    """

    rig: str
    parameter: str
    t_ns: int
    level: float
    limit: float
    status: str
    p10_ns: int | None
    p50_ns: int | None
    p90_ns: int | None
    chance: float | None
    horizon_s: float
    family: str
    draws: str
    cause: str


@dataclass(frozen=True, slots=True)
class TrendRecord:
    """How a parameter moves, as the agent saw it.

    Attributes:
        t_ns: of the newest row that it rests on.
        value, sd: the parameter then, on its line, in its unit; the newest row where there is no line.
        slope_per_day, slope_sd: of the line through the whole span; None where there are too few rows.
        trend: whether it changes by more than rows without any change would.
    """

    rig: str
    parameter: str
    t_ns: int
    value: float
    sd: float
    slope_per_day: float | None
    slope_sd: float | None
    trend: bool


@dataclass(frozen=True, slots=True)
class ForecastScore:
    """What became of a stored forecast.

    Attributes:
        number: its row; made_ns and parameter say again which it is.
        t_ns: when it was scored.
        crossed_ns: when the limit was reached; None where it was not.
        crps: continuous ranked probability score, s; None where the forecast had no draws.
        held: whether the passage came between P10 and P90; None where it had none.
    """

    rig: str
    parameter: str
    number: int
    made_ns: int
    t_ns: int
    crossed_ns: int | None
    crps: float | None
    held: bool | None


Record = (
    EstimateBatch | AlarmTransition | Health | HealthEvent | EventRecord | LearntRecord | Verdict
    | ClockRecord | ForecastRecord | ForecastScore | TrendRecord | CovariateMean | ConditionsRecord
)  # fmt: skip
