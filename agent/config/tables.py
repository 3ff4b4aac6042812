"""The tables of a configuration file as frozen models; attribute names are the file's keys.

These check each value by itself. What must hold between values stands in the `rules_*` modules.
"""

import hashlib
import json
import math
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

from pydantic import Field, PrivateAttr, Strict, ValidationInfo, field_validator

from agent.config.covariates.tables import BaselineTable, Covariate
from agent.config.domains.kinds import DomainModel
from agent.config.domains.plant import Domain
from agent.config.linear import ENTRY, LinearModel, LinearParameter
from agent.config.north.tables import North
from agent.config.process.settings import Agent
from agent.config.reading.fields import (
    Asked,
    Duration,
    FilePath,
    Hours,
    Intensities,
    Name,
    Names,
    NotNegative,
    Number,
    Positive,
    Row,
    Skew,
    Table,
    Text,
    Texts,
    Window,
)
from agent.config.reading.secrets import Secret
from agent.config.reading.units import Quantity, base_length, conversion, element_units
from agent.types import AlarmKind

GROUND = "ground"
Setting = TypeVar("Setting", str, Path)
Priority = Literal["low", "medium", "high", "critical"]
PRIORITIES: tuple[Priority, ...] = ("low", "medium", "high", "critical")
Nodes = Annotated[tuple[Name, Name], Strict(False)]


class Rig(Table):
    """What is watched, how fast it is sampled, and what orders its samples."""

    name: Name = Field(description='a name such as "press-7"')
    site: Text | None = None
    labels: dict[str, str] = Field(default_factory=dict)
    sample_rate_hz: Positive = Field(description="samples per second, such as 1000.0")
    clock: Literal["counter", "device", "uniform", "arrival"] = "counter"


class Mass(Table):
    """A node; value in kg, 0 for a node without mass."""

    name: Name
    value: NotNegative = Field(description="a mass is in kg; 0 makes a massless node, which needs a damper")
    sd_percent: NotNegative = Field(
        default=2.0, description="how well the mass is known, per cent; 0 for exactly"
    )


class Element(Table):
    """A spring, a damper or a dry friction between two nodes, with its healthy value."""

    name: Name
    between: Nodes = Field(description='two nodes, such as ["ground", "m1"]')
    nominal: NotNegative = math.nan

    @property
    def is_known(self) -> bool:
        """Whether its nominal is stated; `deltak identify` finds one that is not."""
        return not math.isnan(self.nominal)


class MechanicsModel(Table):
    """A graph of masses, springs, dampers and dry friction."""

    kind: Literal["mass-spring-damper"] = "mass-spring-damper"
    mass: tuple[Mass, ...] = ()
    spring: tuple[Element, ...] = ()
    damper: tuple[Element, ...] = ()
    friction: tuple[Element, ...] = ()


Model = MechanicsModel | LinearModel | DomainModel


class Channel(Table):
    """An input or output of the model: SI value = ((field * scale) + offset) * si_factor."""

    name: Name
    quantity: Quantity = Field(description="force, displacement, velocity or acceleration")
    at: Name = Field(default="", description='the mass it acts on or is measured at, such as "m1"')
    unit: Text = Field(description='the unit after scale and offset, such as "N", "mm" or "counts"')
    scale: Number = 1.0
    offset: Number = 0.0
    noise_sd: Positive | None = Field(default=None, description="leave it out where the noise is not known")
    noise_sd_spread: Positive = Field(
        default=0.3, description="how far noise_sd may be off, as a share of it"
    )
    gain_sd_percent: NotNegative = Field(
        default=1.0, description="how far the gain may be off, per cent; 0: exact"
    )
    bias: bool = False
    gain: bool = False
    delay_s: NotNegative = 0.0
    delay_sd_s: NotNegative | None = Field(
        default=None, description="how far delay_s may be off; 0 for exactly"
    )
    _drives: bool | None = PrivateAttr(default=None)

    @property
    def is_input(self) -> bool:
        """Whether it drives the model rather than being measured."""
        return self.quantity in ("force", "input") if self._drives is None else self._drives

    def placed(self, *, at: str, drives: bool) -> "Channel":
        """Return it at a place of a template, which says whether its quantity drives there or is read."""
        copy = self.model_copy(update={"at": at})
        copy._drives = drives  # noqa: SLF001 - its own class
        return copy

    @property
    def si_factor(self) -> float:
        """What turns the unit into SI; 1.0 for text that is no known unit."""
        return conversion(self.quantity, self.unit)[0]

    @property
    def si_unit(self) -> str:
        """The unit that the model sees; the text itself where it is no known unit."""
        return conversion(self.quantity, self.unit)[1]


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


class Keep(Table):
    """For how long rows are kept, seconds; infinite for "forever"."""

    full: Duration = 7 * 86400.0
    minute: Duration = 90 * 86400.0
    hour: Duration = float("inf")


class Recordings(Table):
    """Limits of each source's raw recordings (`record = true`): megabytes and age, the oldest go first."""

    max_mb: Positive = 1024.0
    keep: Duration = float("inf")


class Events(Table):
    """The raw samples that are kept around alarms; the oldest records go first.

    per_hour bounds what a restless alarm writes; max_count = 0 keeps none.
    """

    before_s: NotNegative = 10.0
    after_s: NotNegative = 10.0
    max_count: int = Field(default=100, ge=0, le=10_000)
    max_mb: Positive = 100.0
    keep: Duration = float("inf")
    per_hour: int = Field(default=12, ge=1, le=3600)


class Store(Table):
    """Where and how densely results are kept; path is absolute, by default <rig>.db beside the file."""

    path: FilePath = Path()
    every_s: NotNegative = 1.0
    commit_s: Annotated[float, Field(ge=0.02, le=60.0, description="seconds from 0.02 to 60")] = 1.0
    keep: Keep = Keep()
    max_mb: Positive = 1024.0
    recordings: Recordings = Recordings()
    events: Events = Events()


class Columns(Table):
    """The names that recordings give to channels (and `t`), and what separates columns; None is sniffed."""

    names: dict[str, str] = Field(default_factory=dict)
    delimiter: str | None = None


class Forecast(Table):
    """When forecasts are made and how far ahead; like names histories of like machines, or a learnt prior.

    every: from one forecast of a parameter to the next; infinite makes them at alarms only. horizon: what the
    chance is of; None for as long again as the history is.
    """

    every: Duration = 3600.0
    horizon: Duration | None = None
    like: Annotated[tuple[FilePath, ...], Strict(False)] = ()

    def beside(self, folder: Path) -> "Forecast":
        """Return the same with paths that start at a folder."""
        return self.model_copy(update={"like": tuple(folder / path for path in self.like)})


class Metrics(Table):
    """Where the agent's figures can be read, in Prometheus text form; they are those of the whole agent."""

    unprotected: bool = False
    listen: Text | None = None
    textfile: FilePath | None = None

    @field_validator("listen")
    @classmethod
    def _check_listen(cls, listen: str, info: ValidationInfo) -> str:
        host, _, port = listen.rpartition(":")
        if not host or not port.isdigit() or not 0 <= int(port) <= 65535:
            raise ValueError(f'must be "ADDRESS:PORT" such as "127.0.0.1:9464", not "{listen}"')
        is_local = host in {"localhost", "[::1]"} or host.startswith("127.")
        if not is_local and not info.data.get("unprotected"):
            raise ValueError(
                f'"{listen}" is open to other machines, without a password; '
                "say unprotected = true, or use 127.0.0.1"
            )
        return _with_library(listen)

    @field_validator("textfile")
    @classmethod
    def _check_textfile(cls, file: Path) -> Path:
        if file.suffix != ".prom":
            raise ValueError(f'must end in .prom, which is what node_exporter reads, not "{file}"')
        return _with_library(file)


def _with_library(value: Setting) -> Setting:
    if find_spec("prometheus_client") is None:
        raise ValueError("needs prometheus_client, which is not installed; pip install 'deltak[metrics]'")
    return value


class Notify(Table):
    """One target. What a kind needs beside name and kind: command; url; host, sender and recipients."""

    name: Name = Field(description='a name such as "shift"')
    kind: Literal["command", "webhook", "smtp", "apprise"]
    priority: Priority = "low"
    kinds: Annotated[tuple[AlarmKind, ...], Strict(False), Field(min_length=1)] | None = None
    quiet: Hours | None = None
    timeout_s: Positive = 30.0
    attempts: int = Field(default=400, ge=1, le=100_000)
    command: Texts | None = Field(
        default=None, description='a list such as ["/usr/local/bin/page", "--shift"]'
    )
    url: Text | Secret | None = None
    token: Secret | None = None
    host: Text | None = None
    port: int | None = Field(default=None, ge=1, le=65535)
    tls: Literal["starttls", "tls", "none"] = "starttls"
    sender: Text | None = None
    recipients: Texts | None = None
    user: Text | None = None
    password: Secret | None = None


class Parameter(NamedTuple):
    """Something that can be estimated."""

    name: str
    kind: Literal["mass", "spring", "damper", "friction", "linear", "element", "storage", "bias", "gain"]
    nominal: float
    unit: str


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
    def with_alarms(self) -> tuple[str, ...]:
        """The parameters that any alarm is of, in the file's order."""
        return tuple(dict.fromkeys(alarm.parameter for alarm in self.alarm))

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


def parameters_of(model: Model, channels: tuple[Channel, ...]) -> dict[str, Parameter]:
    """Return everything that a model and its channels offer for estimation, by name."""
    if isinstance(model, Domain):
        found = [Parameter(p.name, p.kind, p.nominal, p.unit) for p in model.parts]
    else:
        found = _linear(model, channels) if isinstance(model, LinearModel) else _mechanical(model, channels)
    for channel in channels:
        found.append(Parameter(f"{channel.name}.bias", "bias", 0.0, channel.si_unit))
        found.append(Parameter(f"{channel.name}.gain", "gain", 1.0, "1"))
    return {parameter.name: parameter for parameter in found}


def _linear(model: LinearModel, channels: tuple[Channel, ...]) -> list[Parameter]:
    return [
        Parameter(p.name, "linear", p.nominal, p.unit or _unit(p, model, channels)) for p in model.parameters
    ]


def _unit(parameter: LinearParameter, model: LinearModel, channels: tuple[Channel, ...]) -> str:
    """Return the unit of an uncertain entry from those of its row and column; "" where these have none."""
    entry = ENTRY.fullmatch(parameter.name)
    if entry is None:
        return ""
    states = [state.unit for state in model.state or ()]
    inputs = [channel.unit for channel in channels if channel.is_input]
    outputs = [channel.unit for channel in channels if not channel.is_input]
    rows, columns = {
        "A": (states, states),
        "B": (states, inputs),
        "C": (outputs, states),
        "D": (outputs, inputs),
    }[entry["matrix"]]
    row, column = int(entry["row"]), int(entry["column"])
    units = rows[row : row + 1] + columns[column : column + 1]
    if len(units) < 2 or not all(units):
        return ""
    by_time = " s" if entry["matrix"] in "AB" and model.time == "continuous" else ""
    return _quotient(units[0], units[1], by_time)


def _quotient(unit: str, by: str, by_time: str) -> str:
    """Return unit/(by s), or unit/by without a time."""
    if unit == by:
        return f"1/{by_time.strip()}" if by_time else "1"
    joined = any(mark in unit for mark in " /")
    top = f"({unit})" if joined else unit
    return f"{top}/({by}{by_time})" if by_time or any(mark in by for mark in " /") else f"{top}/{by}"


def _mechanical(model: MechanicsModel, channels: tuple[Channel, ...]) -> list[Parameter]:
    units = _units(channels)
    found = [Parameter(m.name, "mass", m.value, units["mass"]) for m in model.mass]
    found += [Parameter(e.name, "spring", e.nominal, units["spring"]) for e in model.spring]
    found += [Parameter(e.name, "damper", e.nominal, units["damper"]) for e in model.damper]
    return found + [Parameter(e.name, "friction", e.nominal, units["friction"]) for e in model.friction]


def _units(channels: tuple[Channel, ...]) -> dict[str, str]:
    first = {channel.quantity: channel.si_unit for channel in reversed(channels)}
    length = base_length(first.get("displacement"), first.get("velocity"), first.get("acceleration"))
    return element_units(first.get("force", "N"), length)


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
