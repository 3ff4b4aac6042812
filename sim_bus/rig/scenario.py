"""Scenarios: what a simulated rig does. TOML files; some come with the package and are found by name."""

import os
import re
from collections.abc import Callable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import Field, model_validator

from sim_bus.errors import SimUsageError
from sim_bus.rig.covariates.course import Covariate
from sim_bus.rig.excitation import Force
from sim_bus.rig.fault_names import SENSORS
from sim_bus.rig.rigfile import Channel, Mechanics, Quantity, RigFile, checked, read_toml
from sim_bus.rig.schedule import Change, Draw
from sim_bus.rig.sensors import Oscillator, Sensor
from sim_bus.rig.wear import Wear
from sim_bus.tables import Table
from sim_bus.tuning import NAMED

SEED_VARIABLE = "DELTAK_SEED"
_NUMBER = r"[0-9]+(?:\.[0-9]+)?"
_FAULT = re.compile(
    rf"(?P<name>[a-z][a-z0-9.-]*)(:(?P<target>[A-Za-z0-9_.-]+))?@(?P<at>{_NUMBER})s?(\+(?P<long>{_NUMBER})s?)?"
)


class Initial(Table):
    """[initial]: the state at sample 0: `all` for every displacement (m) and velocity (m/s), or by mass.

    `state` names states, those of a linear rig as well.
    """

    all: float = 0.0
    displacement: dict[str, float] = Field(default_factory=dict)
    velocity: dict[str, float] = Field(default_factory=dict)
    state: dict[str, float] = Field(default_factory=dict)


class FaultAt(Table):
    """One [[fault]]: `name` as in `--fault NAME@T`, `at_s`, and for how long where it lasts; which one."""

    name: str
    at_s: float = Field(ge=0)
    for_s: float = Field(default=0.0, ge=0)
    source: str | None = None
    channel: str | None = None

    @property
    def sensor(self) -> str | None:
        """Which fault of a sensor it is; None where it is one of a line or a device."""
        kind, _, name = self.name.partition(".")
        return name if kind == "sensor" else None


_BROKEN: Mapping[str, dict[str, Any]] = {
    "stuck": {"stuck": True},
    "dead": {"gain": -1.0},
    "reversed": {"gain": -2.0},
    "scaled": {"gain": 999.0},
    "gain": {"gain": -0.2},
    "offset": {"bias": 0.5, "measure": "peak"},
    "drift": {"drift_per_s": 0.5, "measure": "peak"},
    "saturated": {"rail": 0.5, "measure": "peak"},
    "flicker": {"stuck": True, "flicker": 1e-5, "measure": "peak"},
    "spikes": {"spike": 2.0, "spikes_hz": 10.0, "measure": "peak"},
}
"""What the faults of sensors are, as [[sensor]] says it."""


class Scenario(Table):
    """What is played.

    `duration_s` 0 is without end. `start`: the clock starts when every source has met a reader, or when the
    devices are ready. `noise` is the sensors' standard deviation by quantity in SI units. [draw] replaces
    [[change]]. `rig` is the configuration with which `deltak score` plays it (a path beside the file) and
    [expect] what is then to be found.
    """

    title: str = ""
    seed: int = Field(default=0, ge=0)
    duration_s: float = Field(default=0.0, ge=0, allow_inf_nan=False)
    start: Literal["reader", "ready"] = "reader"
    initial: Initial = Initial()
    force: tuple[Force, ...] = ()
    noise: dict[Quantity, float] = Field(default_factory=dict)
    sensor: tuple[Sensor, ...] = ()
    change: tuple[Change, ...] = ()
    wear: tuple[Wear, ...] = ()
    covariate: tuple[Covariate, ...] = ()
    draw: Draw | None = None
    device: tuple[Oscillator, ...] = ()
    fault: tuple[FaultAt, ...] = ()
    rig: str | None = None
    expect: dict[str, Any] = Field(default_factory=dict)
    folder: Path = Path()

    @model_validator(mode="after")
    def _one_schedule(self) -> Self:
        if self.draw is not None and self.change:
            raise ValueError("change and draw exclude each other: a schedule is either written or drawn")
        return self

    @property
    def changes(self) -> tuple[Change, ...]:
        """The schedule, drawn where it is to be drawn."""
        return self.change if self.draw is None else tuple(self.draw.changes(self.seed))

    def forces_on(self, rig: RigFile) -> list[tuple[Force, str]]:
        """Return every force with the node on which it acts."""
        sensed = list(dict.fromkeys(rig.place(channel) for channel in rig.channel if channel.is_input))
        return [(force, node) for force in self.force for node in ([force.at] if force.at else sensed)]

    def sensors_on(self, channels: Sequence[Channel]) -> list[Sensor]:
        """Return what sensors get wrong, also by faults: of the channel named, or the last output."""
        last = next((c.name for c in reversed(channels) if not c.is_input), "")
        struck = [fault for fault in self.fault if fault.sensor in _BROKEN]
        return [*self.sensor, *(_broken(fault, fault.channel or last) for fault in struck)]

    def with_faults(self, texts: Sequence[str], duration_s: float | None = None) -> Self:
        """Return the scenario with more faults, each as NAME[:TARGET]@SECONDS[+HOW_LONG], within its time."""
        more = [_fault_of(text) for text in texts]
        end_s = self.duration_s if duration_s is None else duration_s
        late = [fault for fault in more if end_s and fault.at_s >= end_s]
        if late:
            over = f"s all is over, after {end_s:g} s; let it come earlier or play longer"
            raise SimUsageError(f"--fault: {fault.name}: at {fault.at_s:g} {over}" for fault in late)
        return self.model_copy(update={"fault": (*self.fault, *more)})

    def fits(self, rig: RigFile) -> None:
        """Raise SimUsageError unless every name in the scenario is one of the rig's."""
        nodes, constants = set(rig.system.nodes), set(rig.nominal)
        channels = {channel.name for channel in rig.channel}
        wrong = [f"force.at: {n}" for _, n in self.forces_on(rig) if n not in nodes]
        wrong += [
            f"initial: {n}" for n in (*self.initial.displacement, *self.initial.velocity) if n not in nodes
        ]
        wrong += [f"initial.state: {n}" for n in self.initial.state if n not in rig.system.state_names]
        wrong += [
            f"sensor.channel: {s.channel}" for s in self.sensors_on(rig.channel) if s.channel not in channels
        ]
        wrong += [
            f"device.source: {d.source}" for d in self.device if d.source not in {None, *rig.source_names}
        ]
        wrong += [f"wear: {n}" for wear in self.wear for n in wear.names if n not in constants]
        wrong += [f"change: {n}" for change in self.changes for n in change.names if n not in constants]
        known = (
            f"parameters are {', '.join(_first(sorted(constants)))}; "
            f"channels are {', '.join(sorted(channels))}"
        )
        lines = [f"{text}: the configuration has no such thing; {known}" for text in wrong]
        lines += self._unread(rig) + self._impossible(rig)
        if lines:
            raise SimUsageError(f"scenario: {line}" for line in lines)

    def _unread(self, rig: RigFile) -> list[str]:
        """Return in words which covariates the configuration has no channel for."""
        read = [covariate.name for covariate in rig.covariate]
        asked = [("covariate", one.channel) for one in self.covariate]
        asked += [("wear", wear.channel) for wear in self.wear if wear.channel is not None]
        known = f"its covariates are {', '.join(read)}" if read else "it has none"
        words = 'the configuration has no channel of role "covariate" of this name'
        return [f"{table}.channel: {name}: {words}; {known}" for table, name in asked if name not in read]

    def _impossible(self, rig: RigFile) -> list[str]:
        """Return in words which masses are to become what no mass can be."""
        if not isinstance(rig.model, Mechanics):
            return []
        massless = rig.system.massless
        masses = {mass.name for mass in rig.model.mass}
        goes = [(name, value) for c in self.changes for name, value in c.targets(rig.nominal).items()]
        lines = [f"change: {name}: a massless node stays massless" for name, _ in goes if name in massless]
        lighter = [(name, value) for name, value in goes if name in masses - massless and value <= 0.0]
        return lines + [f"change: {name}: {value:g} kg: a mass stays above 0" for name, value in lighter]


def built_in_names() -> tuple[str, ...]:
    """Names of the scenarios that come with the package."""
    folder = resources.files("sim_bus") / "scenarios"
    return tuple(
        sorted(item.name.removesuffix(".toml") for item in folder.iterdir() if item.name.endswith(".toml"))
    )


def scenario_path(name_or_file: str, known: Callable[[], Sequence[str]] = built_in_names) -> Path:
    """Return the file of a scenario by its built-in name or its path.

    Raises SimUsageError when there is none, naming those that `known` tells of.
    """
    if name_or_file in built_in_names():
        return Path(str(resources.files("sim_bus") / "scenarios" / f"{name_or_file}.toml"))
    if not Path(name_or_file).is_file():
        names = ", ".join(known())
        raise SimUsageError(f'scenario: "{name_or_file}" is neither a file nor one of {names}')
    return Path(name_or_file)


def load_scenario(
    name_or_file: str,
    environment: Mapping[str, str] = os.environ,
    known: Callable[[], Sequence[str]] = built_in_names,
) -> Scenario:
    """Return a scenario by its built-in name or from a file; the seed in the environment precedes its own."""
    path = scenario_path(name_or_file, known)
    content = read_toml(path) | {"folder": path.resolve().parent}
    return checked(Scenario, content | _seed_of(environment), str(path))


def _first(names: list[str]) -> list[str]:
    return names if len(names) <= NAMED else [*names[:NAMED], "..."]


def _broken(fault: FaultAt, channel: str) -> Sensor:
    until = fault.at_s + (fault.for_s or SENSORS[fault.sensor or ""].lasts_s)
    return Sensor(channel=channel, from_s=fault.at_s, until_s=until, **_BROKEN[fault.sensor or ""])


def _fault_of(text: str) -> FaultAt:
    match = _FAULT.fullmatch(text)
    if match is None:
        raise SimUsageError(
            f'--fault: "{text}" is not of the form NAME[:TARGET]@SECONDS[+HOW_LONG]; e.g. serial.garbage@10s'
        )
    target = {"channel" if match["name"].startswith("sensor.") else "source": match["target"]}
    return FaultAt(name=match["name"], at_s=float(match["at"]), for_s=float(match["long"] or 0.0), **target)


def _seed_of(environment: Mapping[str, str]) -> dict[str, int]:
    text = environment.get(SEED_VARIABLE, "")
    if not text:
        return {}
    if not text.isdecimal():
        raise SimUsageError(f'{SEED_VARIABLE}: "{text}" is no whole number; use digits only')
    return {"seed": int(text)}
