"""What the simulator needs of a rig's configuration: model, channels, sources. Other keys are the agent's."""

import tomllib
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, ValidationError, model_validator

from sim_bus.errors import SimUsageError
from sim_bus.rig.covariates.channel import CovariateChannel
from sim_bus.rig.domains.built import Built
from sim_bus.rig.domains.system import KINDS, DomainSystem, DomainTable
from sim_bus.rig.linear import Linear, LinearSystem, with_numbers
from sim_bus.rig.plant import GROUND, Graph, Hold, Link, PlantError
from sim_bus.rig.units import si_factor
from sim_bus.tables import Part
from sim_bus.tuning import SLOW_HZ

Quantity = Literal[
    "force", "displacement", "velocity", "acceleration", "input", "output",
    "voltage", "current", "torque", "speed", "angle", "power", "temperature", "flow", "pressure", "level",
]  # fmt: skip
_PLAYED = (
    "the simulator plays what stands there: give the value that the machine is to have, or let "
    "`deltak identify CONFIG RECORDING --write` find it from a recording"
)
System = Graph | LinearSystem | DomainSystem
"""What moves: places where it is pushed, states, parameters."""
ModelType = TypeVar("ModelType", bound=BaseModel)


class Named(Part):
    """A mass: name and value, kg."""

    name: str
    value: float = Field(ge=0, allow_inf_nan=False)


class Element(Part):
    """A spring, damper or dry friction between two nodes."""

    name: str
    between: tuple[str, str]
    nominal: float = Field(allow_inf_nan=False)


class Channel(Part):
    """One signal: what is sensed where, and how a reading is written in the channel's unit."""

    name: str
    quantity: Quantity
    at: str = ""
    unit: str
    scale: float = 1.0
    offset: float = 0.0
    noise_sd: float | None = None
    delay_s: float = Field(default=0.0, ge=0)
    drives: bool | None = None

    @property
    def is_input(self) -> bool:
        """Whether it drives the rig; in a template its place says so."""
        return self.quantity in ("force", "input") if self.drives is None else self.drives

    @property
    def si_factor(self) -> float:
        """SI value of one of the channel's units."""
        return si_factor(self.quantity, self.unit)

    @model_validator(mode="after")
    def _scale_is_usable(self) -> Self:
        if self.scale == 0.0:
            raise ValueError("scale 0 cannot be undone; the simulator cannot tell what the device would send")
        return self


class Mechanics(Part):
    """Masses, springs, dampers and dry friction."""

    kind: Literal["mass-spring-damper"] = "mass-spring-damper"
    mass: tuple[Named, ...] = ()
    spring: tuple[Element, ...] = ()
    damper: tuple[Element, ...] = ()
    friction: tuple[Element, ...] = ()

    @model_validator(mode="after")
    def _can_be_played(self) -> Self:
        if not self.mass:
            raise ValueError("there is no mass; nothing could move")
        if self.friction:
            raise ValueError("dry friction cannot be simulated; leave friction empty")
        known = {GROUND, *(mass.name for mass in self.mass)}
        lost = [
            f"{e.name}: {end}" for e in (*self.spring, *self.damper) for end in e.between if end not in known
        ]
        if lost:
            raise ValueError(
                f"no mass is called so: {', '.join(lost)}; masses are {', '.join(sorted(known))}"
            )
        return self

    @property
    def graph(self) -> Graph:
        """The graph for the plant."""
        return Graph(
            nodes=tuple(mass.name for mass in self.mass),
            springs=tuple(Link(e.name, e.between) for e in self.spring),
            dampers=tuple(Link(e.name, e.between) for e in self.damper),
            massless=frozenset(mass.name for mass in self.mass if mass.value == 0.0),
        )

    @property
    def nominal(self) -> dict[str, float]:
        """Every constant by name."""
        return {mass.name: mass.value for mass in self.mass} | {
            e.name: e.nominal for e in (*self.spring, *self.damper)
        }


class Rig(Part):
    """The [rig] table."""

    name: str
    sample_rate_hz: float = Field(gt=0, allow_inf_nan=False)


class Estimator(Part):
    """Of [estimator]: what the input does between samples."""

    hold: Hold = "first"


class Source(BaseModel):
    """One [[source]]; the driver's own keys are in `keys`."""

    model_config = ConfigDict(extra="allow", frozen=True)

    name: str = ""
    driver: str
    map: dict[str, str] = {}
    counter: str | None = None
    stale_s: float = 2.0
    record: bool = False
    skew_s: float | str = "auto"
    own_clock: bool = False
    rate_hz: float | None = Field(default=None, gt=0, allow_inf_nan=False)

    @property
    def keys(self) -> dict[str, Any]:
        """The driver's own keys."""
        return dict(self.model_extra or {})


_MECHANICAL, _LINEAR, _DOMAIN = "mass-spring-damper", "linear", "template"


def _kind(raw: object) -> str:
    """Return which kind of model a table, or one that was read, is."""
    kind = raw.get("kind") if isinstance(raw, dict) else getattr(raw, "kind", None)
    if isinstance(kind, str) and kind in KINDS:
        return _DOMAIN
    return _LINEAR if kind == _LINEAR else _MECHANICAL


class RigFile(Part):
    """A configuration as far as the simulator reads it."""

    rig: Rig
    model: Annotated[
        Annotated[Mechanics, Tag(_MECHANICAL)]
        | Annotated[Linear, Tag(_LINEAR)]
        | Annotated[DomainTable, Tag(_DOMAIN)],
        Discriminator(_kind),
    ]
    channel: tuple[Channel, ...] = Field(min_length=1)
    covariate: tuple[CovariateChannel, ...] = ()
    source: tuple[Source, ...] = Field(min_length=1)
    estimator: Estimator = Estimator()
    folder: Path = Path()

    @property
    def system(self) -> System:
        """What moves."""
        if isinstance(self.model, Mechanics):
            return self.model.graph
        ordered = sorted(self.channel, key=lambda channel: not channel.is_input)
        count = sum(channel.is_input for channel in ordered)
        names = tuple(channel.name for channel in ordered)
        if isinstance(self.model, Linear):
            return LinearSystem(names[:count], names[count:], self.model)
        places = tuple((c.quantity, c.at) for c in ordered)
        return DomainSystem(names[:count], names[count:], self.model, places)

    @property
    def nominal(self) -> dict[str, float]:
        """Every parameter by name."""
        system = self.system
        return system.nominal if isinstance(system, LinearSystem | DomainSystem) else self._mechanics.nominal

    @property
    def hold(self) -> Hold:
        """What inputs do between samples; a model in discrete time has it in it."""
        return (
            "zero"
            if isinstance(self.model, Linear) and self.model.time == "discrete"
            else self.estimator.hold
        )

    @property
    def _mechanics(self) -> Mechanics:
        if not isinstance(self.model, Mechanics):
            raise TypeError("not a rig of masses, springs and dampers")
        return self.model

    def place(self, channel: Channel) -> str:
        """Return where a channel acts or reads: a node, or of a linear rig the channel itself."""
        return channel.at if isinstance(self.model, Mechanics) else channel.name

    @model_validator(mode="before")
    @classmethod
    def _channels_are_placed(cls, raw: Any) -> Any:
        """Put the channels of a template at their places, which say whether they drive."""
        if not isinstance(raw, dict) or _kind(raw.get("model")) != _DOMAIN:
            return raw
        table = DomainTable(**raw["model"])
        built = table.built(table.nominal)
        return {**raw, "channel": [_placed(channel, built) for channel in raw.get("channel", ())]}

    @model_validator(mode="after")
    def _names_fit(self) -> Self:
        channels = {channel.name for channel in self.channel} | {one.name for one in self.covariate}
        lost = self._misplaced()
        lost += [
            f'source "{s.name or s.driver}": no channel is called "{name}"'
            for s in self.source
            for name in s.map
            if name not in channels
        ]
        if lost:
            raise ValueError("; ".join(lost))
        return self

    def _misplaced(self) -> list[str]:
        """Return in words which channels are nowhere, and which matrices do not fit the channels."""
        system = self.system
        if isinstance(system, DomainSystem):
            return []  # placed already
        if isinstance(system, LinearSystem):
            wrong = [c.name for c in self.channel if c.quantity not in ("input", "output")]
            try:
                system.matrices(system.nominal)
            except PlantError as error:
                return [f"model: {error}"]
            return [f'{name}: channels of a linear model have quantity "input" or "output"' for name in wrong]
        return [f'{c.name}: no mass is called "{c.at}"' for c in self.channel if c.at not in system.nodes]

    def has_signals(self, number: int) -> bool:
        """Tell whether a source carries any of the model's channels, not covariates alone."""
        beside = {covariate.name for covariate in self.covariate}
        return not beside or not beside.issuperset(self.source[number].map)

    @property
    def signal_sources(self) -> tuple[str, ...]:
        """The sources that carry any of the model's channels."""
        return tuple(name for number, name in enumerate(self.source_names) if self.has_signals(number))

    def rate_hz(self, number: int) -> float:
        """Return how many samples a second a source's device takes, by its own clock."""
        own = self.rig.sample_rate_hz
        return self.source[number].rate_hz or (own if self.has_signals(number) else min(SLOW_HZ, own))

    @property
    def slow_or_fast(self) -> tuple[str, ...]:
        """The sources of signals whose devices sample at another rate than the rig's."""
        rates = {name: self.rate_hz(self.source_names.index(name)) for name in self.signal_sources}
        return tuple(name for name, rate in rates.items() if rate != self.rig.sample_rate_hz)

    @property
    def drivers(self) -> dict[str, str]:
        """The sources' drivers, by the sources' names."""
        return {name: source.driver for name, source in zip(self.source_names, self.source, strict=True)}

    @property
    def source_names(self) -> tuple[str, ...]:
        """Names of sources; an unnamed one is called after its driver, a second of a kind gets a number."""
        taken = {source.name for source in self.source if source.name}
        names: list[str] = []
        for source in self.source:
            names.append(source.name or _free_name(source.driver, taken))
            taken.add(names[-1])
        return tuple(names)


def _placed(channel: Mapping[str, Any], built: Built) -> dict[str, Any]:
    place = built.place(str(channel.get("quantity")), str(channel.get("at", "")))
    if place is None:
        raise ValueError(f"channel {channel.get('name')}: there is no such place; deltak check lists them")
    return {**channel, "at": place[1], "drives": place in built.drives}


def _free_name(stem: str, taken: set[str]) -> str:
    number = 1
    while (name := stem if number == 1 else f"{stem}-{number}") in taken:
        number += 1
    return name


def read_toml(path: Path) -> dict[str, Any]:
    """Return a TOML file's content; SimUsageError says what is wrong with it."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SimUsageError(f"{path}: {error.strerror or error}; name a configuration file") from error
    except UnicodeDecodeError as error:
        raise SimUsageError(f"{path}: is no text in UTF-8 (byte {error.start})") from error
    except tomllib.TOMLDecodeError as error:
        raise SimUsageError(f"{path}: {error}") from error


def checked(model: type[ModelType], content: Any, where: str) -> ModelType:
    """Return content as a model; SimUsageError lists every fault with its key path after `where`."""
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise SimUsageError(
            [_line(where, fault["loc"], _words(fault, model)) for fault in error.errors()]
        ) from error


def _words(fault: Mapping[str, Any], model: type[BaseModel]) -> str:
    if fault["type"] != "extra_forbidden":
        return str(fault["msg"])
    known = list(model.model_fields) if len(fault["loc"]) == 1 else []
    close = get_close_matches(str(fault["loc"][-1]), known, 1)
    return f'there is no such key; did you mean "{close[0]}"?' if close else "there is no such key"


def _line(where: str, location: tuple[int | str, ...], message: str) -> str:
    path = ""
    if message == "Field required":
        message = "is missing" + (f"; {_PLAYED}" if location[-1] == "nominal" else "")
    for part in (part for part in location if part not in (_MECHANICAL, _LINEAR)):
        path += f"[{part}]" if isinstance(part, int) else f".{part}" if path else part
    return ": ".join(text for text in (where, path, message.removeprefix("Value error, ")) if text)


def covariates_apart(content: dict[str, Any]) -> dict[str, Any]:
    """Return a configuration whose channels beside the model are tables of their own."""
    rows = content.get("channel", ())
    beside = [row for row in rows if isinstance(row, dict) and row.get("role") == "covariate"]
    return content | {"channel": [row for row in rows if row not in beside], "covariate": beside}


def read_rig(path: Path) -> RigFile:
    """Read a configuration file."""
    content = read_toml(path)
    if not content.get("source"):
        raise SimUsageError(f"source: {path} has no [[source]]; add one for each device that is to be played")
    folder = path.resolve().parent
    content = covariates_apart(content)
    return checked(RigFile, with_numbers(content, folder) | {"folder": folder}, str(path))
