"""Configuration: TOML files to checked, frozen models.

`load` reads one file, `load_many` those of one agent; both raise ConfigError with every fault at once.

    toml_file -> parse (tables.py, fields.py, units.py) -> rules_* (what must hold between values) ->
    RigConfig
"""

from agent.config.load import load, load_many, parse
from agent.config.model.linear import LinearModel, LinearParameter
from agent.config.model.parameters import Parameter
from agent.config.model.tables import Channel, Element, Mass, MechanicsModel, Model
from agent.config.plugins import driver_class, driver_entries
from agent.config.reading.toml_file import files_of
from agent.config.sections.results import Forecast, Metrics, Store
from agent.config.tables import Alarm, Estimator, Observer, Rig, RigConfig, Source, learnt_key

__all__ = [
    "Alarm",
    "Channel",
    "Element",
    "Estimator",
    "Forecast",
    "LinearModel",
    "LinearParameter",
    "Mass",
    "MechanicsModel",
    "Metrics",
    "Model",
    "Observer",
    "Parameter",
    "Rig",
    "RigConfig",
    "Source",
    "Store",
    "driver_class",
    "driver_entries",
    "files_of",
    "learnt_key",
    "load",
    "load_many",
    "parse",
]
