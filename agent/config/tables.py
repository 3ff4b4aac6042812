"""The tables of a configuration file as frozen models; attribute names are the file's keys.

These check each value by itself. What must hold between values stands in the `rules_*` modules.
"""

import hashlib
import json
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from agent.config.model.parameters import Parameter, parameters_of
from agent.config.model.tables import Channel, Model
from agent.config.reading.fields import (
    Asked,
    Duration,
    Intensities,
    Name,
    Names,
    NotNegative,
    Positive,
    Row,
    Skew,
    Table,
    Text,
    Window,
)
from agent.config.sections.covariates import BaselineTable, Covariate
from agent.config.sections.north import North
from agent.config.sections.process import Agent
from agent.config.sections.results import Forecast, Metrics, Notify, Store


class Rig(Table):
    """What is watched, how fast it is sampled, and what orders its samples."""

    name: Name = Field(description='a name such as "press-7"')
    site: Text | None = None
    labels: dict[str, str] = Field(default_factory=dict)
    sample_rate_hz: Positive = Field(description="samples per second, such as 1000.0")
    clock: Literal["counter", "device", "uniform", "arrival"] = "counter"


class Observer(Table):
    """How the observer's gain is found."""

    gain: Literal["auto", "poles", "kalman"] = "auto"
    poles: Row = ()
    process_sd: Intensities | None = None


class Stop(Table):
    """When descents of the paper's method end: the step or the cost falls so far, or after so many steps."""

    step: NotNegative = 1e-12
    cost: NotNegative = 0.0
    iterations: int = Field(default=20_000, ge=1, le=1_000_000)


class Estimator(Table):
    """How parameters are estimated; `estimate` is empty until the defaults are filled in."""

    method: Literal["window-ml", "seed"] = "window-ml"
    window_s: Window = 0.25
    hop_s: Positive = 0.05
    hold: Literal["first", "zero", "cubic", "quintic"] = "first"
    estimate: Names = ()
    observer: Observer = Observer()
    resolve: Positive = 0.33
    passes: int = Field(default=10, ge=1, le=1000)
    stop: Stop = Stop()
    rank: int | None = Field(
        default=None, ge=1, description="directions that are solved before descent; 1 is printed"
    )
    drift_s: Positive | None = None

    @property
    def windows_s(self) -> tuple[float, ...]:
        """The lengths asked for, shortest first; empty for "auto"."""
        if self.window_s == "auto":
            return ()
        return tuple(sorted(self.window_s)) if isinstance(self.window_s, tuple) else (self.window_s,)


class Alarm(Table):
    """A limit on one parameter; deadband and on_delay_s are None where only the alarm can know them.

    A limit on the change raises alarms of kind level. within raises one of kind forecast where a forecast has
    the limit reached sooner, rate_per_day one of kind rate where the drift is faster; kind leaves of these
    only one.

    The deadband of a limit_percent is 0.1 of the limit that the reference gives; the on-delay of several
    windows is the window in use.
    """

    parameter: Asked
    kind: Literal["level", "forecast", "rate"] = "level"
    limit: Positive | None = None
    limit_percent: Positive | None = None
    side: Literal["both", "low", "high"] = "both"
    confidence: float = Field(default=0.95, ge=0.5, lt=1)
    deadband: NotNegative | None = None
    on_delay_s: NotNegative | None = None
    off_delay_s: NotNegative = 0.0
    priority: Literal["low", "medium", "high", "critical"] = "medium"
    blind_s: Positive | None = Field(
        default=None, description="how long without a valid estimate raises an alarm"
    )
    at_rest: Literal["hold", "suppress"] = "hold"
    re_alarm_s: Positive | None = Field(
        default=None, description="how long after its acknowledgement it asks again"
    )
    advice: Text | None = Field(default=None, description="what to do about it, in words")
    within: Duration | None = None
    rate_per_day: Positive | None = Field(default=None, description="the parameter's unit a day, such as 0.5")

    @property
    def has_limit(self) -> bool:
        """Whether it limits the change of the parameter."""
        return self.limit is not None or self.limit_percent is not None

    @property
    def kinds(self) -> tuple[str, ...]:
        """The kinds of alarms that it raises."""
        asked = {
            "level": self.has_limit,
            "forecast": self.within is not None,
            "rate": self.rate_per_day is not None,
        }
        only = self.kind if "kind" in self.model_fields_set else None
        return tuple(kind for kind, wanted in asked.items() if wanted and only in {None, kind})


class Source(Table):
    """A bus or recording that samples come from; settings is an instance of the driver's own model.

    map has the model's channels; covariates those that are beside the model, which the file has in the same
    map.
    """

    driver: Name = Field(description='a driver such as "can"')
    name: Name = ""
    map: dict[str, Text] = Field(description='{ channel = "field of the bus" }')
    counter: Text | None = None
    stale_s: Positive = 2.0
    record: bool = False
    skew_s: Skew = "auto"
    own_clock: bool = False
    rate_hz: Positive | None = Field(
        default=None, description="samples a second of this device, such as 200.0"
    )
    settings: Any = None
    covariates: dict[str, Text] = Field(default_factory=dict)

    @property
    def fields(self) -> tuple[str, ...]:
        """The fields that it is asked for: of the model's channels, then of covariates."""
        return (*self.map.values(), *self.covariates.values())

    def connection(self, folder: Path) -> str:
        """Return a text that sources share when they may share one connection: driver, keys, folder of paths.

        Covariates alone share none with signals, which would wait for them.
        """
        keys = self.settings.model_dump(mode="json")
        beside = [] if self.map else ["covariates"]
        return json.dumps([self.driver, keys, str(folder), *beside], sort_keys=True)


class Columns(Table):
    """The names that recordings give to channels (and `t`), and what separates columns; None is sniffed."""

    names: dict[str, str] = Field(default_factory=dict)
    delimiter: str | None = None


class RigConfig(Table):
    """One checked configuration file.

    channel has the model's channels, covariate those of role "covariate"; source the sources that carry any
    of the model's, covariate_source those that carry nothing but covariates.
    """

    rig: Rig
    model: Model
    channel: tuple[Channel, ...]
    estimator: Estimator
    alarm: tuple[Alarm, ...] = ()
    source: tuple[Source, ...] = ()
    covariate: tuple[Covariate, ...] = ()
    covariate_source: tuple[Source, ...] = ()
    baseline: BaselineTable = BaselineTable()
    store: Store
    columns: Columns = Columns()
    forecast: Forecast = Forecast()
    metrics: Metrics = Metrics()
    notify: tuple[Notify, ...] = ()
    north: tuple[North, ...] = ()
    agent: Agent = Agent()
    file: Path
    sha256: str

    @property
    def folder(self) -> Path:
        """Where relative paths of the file start."""
        return self.file.parent

    @property
    def limits(self) -> tuple[Alarm, ...]:
        """The alarms that limit the change of a parameter, in the file's order."""
        return tuple(alarm for alarm in self.alarm if "level" in alarm.kinds)

    @property
    def inputs(self) -> tuple[Channel, ...]:
        """The channels that drive the model, in the file's order."""
        return tuple(channel for channel in self.channel if channel.is_input)

    @property
    def outputs(self) -> tuple[Channel, ...]:
        """The channels that are measured, in the file's order."""
        return tuple(channel for channel in self.channel if not channel.is_input)

    @property
    def parameters(self) -> dict[str, Parameter]:
        """All that could be estimated, by name, in the file's order; `estimator.estimate` says what is."""
        return parameters_of(self.model, self.channel)


def learnt_key(config: RigConfig) -> str:
    """Return the SHA-256, in hexadecimal, of the model, channels, rate, window, hop, hold and estimate.

    An edit of alarms, store or sources leaves it as it is, so does a default that is written out; a key that
    a later version brings changes it only where it is used.
    """
    estimator = config.estimator
    parts = [
        config.rig.sample_rate_hz,
        config.model.model_dump(mode="json", exclude_defaults=True),
        [channel.model_dump(mode="json", exclude_defaults=True) for channel in config.channel],
        [estimator.windows_s or "auto", estimator.hop_s, estimator.hold, estimator.estimate],
    ]
    text = json.dumps(parts, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode("utf-8")).hexdigest()
