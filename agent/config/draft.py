"""What was read of a file, before it is known to be right."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from agent.config.domains.plant import Domain, Plant
from agent.config.model.linear import LinearModel
from agent.config.model.parameters import Parameter, parameters_of
from agent.config.model.tables import Channel, MechanicsModel, Model
from agent.config.reading.parse import Entry, Faults, readable
from agent.config.sections.covariates import BaselineTable, Covariate
from agent.config.sections.north import North
from agent.config.sections.process import Agent
from agent.config.sections.results import Forecast, Metrics, Notify, Store
from agent.config.tables import Alarm, Columns, Estimator, Rig, Source


@dataclass
class Draft:
    """The tables of one file with their key paths, and the faults found in it.

    Values that could not be read are None; rules pass over them, because they have been complained of
    already. rig and model are None where the file has none. identified: nominals are yet to be found, none
    need be stated. attached: the SHA-256 of files that stand beside it and hold a part of it.
    """

    folder: Path
    identified: bool = False
    faults: Faults = field(default_factory=Faults)
    rig: Rig | None = None
    model: Model | None = None
    channels: list[Entry[Channel]] = field(default_factory=list)
    covariates: list[Entry[Covariate]] = field(default_factory=list)
    estimator: Estimator = field(default_factory=Estimator)
    alarms: list[Entry[Alarm]] = field(default_factory=list)
    sources: list[Entry[Source]] = field(default_factory=list)
    store: Store = field(default_factory=Store)
    columns: Columns = field(default_factory=Columns)
    forecast: Forecast = field(default_factory=Forecast)
    baseline: BaselineTable = field(default_factory=BaselineTable)
    attached: list[str] = field(default_factory=list)
    metrics: Metrics = field(default_factory=Metrics)
    notify: list[Entry[Notify]] = field(default_factory=list)
    north: list[Entry[North]] = field(default_factory=list)
    agent: Agent = field(default_factory=Agent)

    @property
    def rate_hz(self) -> float | None:
        """The sample rate, where it could be read."""
        return self.rig.sample_rate_hz if self.rig else None

    @property
    def channel_names(self) -> list[str]:
        """The names of the channels that have one."""
        return [entry.table.name for entry in self.channels if readable(entry.table.name)]

    @property
    def covariate_names(self) -> list[str]:
        """The names of the covariates that have one."""
        return [entry.table.name for entry in self.covariates if readable(entry.table.name)]

    @property
    def inputs(self) -> list[Entry[Channel]]:
        """The channels that drive the model."""
        return [entry for entry in self.channels if entry.table.is_input]

    @property
    def outputs(self) -> list[Entry[Channel]]:
        """The channels that are measured (those of unreadable quantity left out)."""
        return [
            entry for entry in self.channels if readable(entry.table.quantity) and not entry.table.is_input
        ]

    @property
    def parameters(self) -> dict[str, Parameter]:
        """Everything that could be estimated, by name."""
        if self.model is None or (isinstance(self.model, Domain) and self.plant is None):
            return {}
        channels = [table for _, table in self.channels if readable(table.name, table.quantity, table.unit)]
        found = parameters_of(self.model, tuple(channels))
        return {name: parameter for name, parameter in found.items() if readable(name)}

    @property
    def defaults(self) -> tuple[str, ...]:
        """The parameters estimated by default: all but masses, and what keeps energy as they do."""
        kinds = ("spring", "damper", "linear", "element")
        return tuple(name for name, parameter in self.parameters.items() if parameter.kind in kinds)

    @property
    def estimated(self) -> tuple[str, ...]:
        """The names of what is estimated, whether they exist or not."""
        return self.estimator.estimate or self.defaults

    @property
    def plant(self) -> Plant | None:
        """The equations of a template, where it could be read and nothing is wrong with it."""
        if not isinstance(self.model, Domain) or any(
            fault.path.startswith("model") for fault in self.faults.found
        ):
            return None
        return self.model.plant(frozenset(entry.table.quantity for entry in self.channels))

    @property
    def is_discrete(self) -> bool:
        """Whether the model is given in discrete time, which has in it how inputs run between samples."""
        return isinstance(self.model, LinearModel) and self.model.time == "discrete"

    @property
    def hold(self) -> Literal["first", "zero", "cubic", "quintic"]:
        """How inputs run between samples: as configured, or from sample to sample of a discrete model."""
        return "zero" if self.is_discrete else self.estimator.hold

    @property
    def states(self) -> int | None:
        """How many states the model has, where that can be told."""
        count = 0
        if isinstance(self.model, LinearModel):
            count = len(self.model.A or ())
        elif self.plant is not None:
            count = len(self.plant.states)
        elif isinstance(self.model, MechanicsModel) and readable(*(mass.value for mass in self.model.mass)):
            count = sum(2 if mass.value > 0 else 1 for mass in self.model.mass)
        return count or None
