"""Which key of which [[source]] a driver cannot work with, found by asking it for less."""

from collections.abc import Sequence
from pathlib import Path

from agent.config.plugins import driver_class
from agent.config.tables import RigConfig, Source
from agent.errors import ConfigError, Fault
from drivers.port import DriverConfigError, SourceRequest


def source_error(configs: Sequence[RigConfig], error: DriverConfigError) -> ConfigError:
    """Return a driver's error with the key paths of all faulty sources, led by the file where several are."""
    led = [(f"{config.file}: " if len(configs) > 1 else "", config) for config in configs]
    faults = [
        Fault(lead + fault.path, fault.message, fault.advice) for lead, c in led for fault in source_faults(c)
    ]
    return ConfigError(faults or [_fault("source", str(error))])


def source_faults(config: RigConfig) -> list[Fault]:
    """Return what the drivers of a rig's sources say against their keys."""
    sources = (*config.source, *config.covariate_source)
    return [
        fault for number, source in enumerate(sources) for fault in _Asked(config, number, source).faults()
    ]


def _fault(path: str, words: str) -> Fault:
    message, _, advice = words.partition("; ")
    return Fault(path, message, advice or "mend it and start again")


class _Asked:
    """One source, whose driver is made again and again for some of its fields."""

    def __init__(self, config: RigConfig, number: int, source: Source) -> None:
        self._config = config
        self._source = source
        self._path = f"source[{number}]"

    def faults(self) -> list[Fault]:
        fields = self._source.fields
        whole = self._says(fields, self._source.counter)
        if whole is None:
            return []
        faults = self._of_map()
        if not faults and self._says(fields, None) is None:
            faults = [_fault(f"{self._path}.counter", whole)]
        return faults or [self._of_settings(whole)]

    def _of_settings(self, words: str) -> Fault:
        path = self._keyed(words)
        if path is None:
            return _fault(self._path, words)
        return _fault(path, words.removeprefix(f"{path.rpartition('.')[2]}: "))

    def _of_map(self) -> list[Fault]:
        """Return the faults of the fields that cannot be read by themselves."""
        alone = {channel: self._says((field,), None) for channel, field in self._places()}
        words = [said for said in alone.values() if said is not None]
        of_all = len(words) == len(alone) > 1 and len(set(words)) == 1
        if of_all or any(self._keyed(said) for said in words):
            return []
        return [
            _fault(f"{self._path}.map.{channel}", said) for channel, said in alone.items() if said is not None
        ]

    def _places(self) -> list[tuple[str, str]]:
        return [*self._source.map.items(), *self._source.covariates.items()]

    def _says(self, fields: tuple[str, ...], counter: str | None) -> str | None:
        """Return what the driver says against being made for these; None where it can be."""
        source = self._source
        request = SourceRequest(source.name, source.settings, fields, counter, self._config.folder)
        try:
            driver_class(source.driver)(request).resolution()
        except DriverConfigError as error:
            return str(error)
        return None

    def _keyed(self, words: str) -> str | None:
        """Return the path of the driver's own key that words begin with, or whose file they name."""
        settings = self._source.settings
        for key in type(settings).model_fields:
            value = getattr(settings, key)
            names_file = isinstance(value, Path) and words.startswith(f"{self._config.folder / value}:")
            if names_file or words.startswith(f"{key}:"):
                return f"{self._path}.{key}"
        return None
