"""Drivers by name, from the entry points of what is installed."""

from functools import cache
from importlib.metadata import EntryPoint, entry_points

from agent.errors import ConfigError
from drivers.port import Driver

GROUP = "deltak.drivers"
_REPLAYED = ("recording", "can-log")
"""These read what `deltak replay` is given; no source is of such a kind."""


def driver_entries() -> dict[str, EntryPoint]:
    """Return the drivers that are installed, by name; nothing is imported yet."""
    return dict(_installed())


@cache
def _installed() -> dict[str, EntryPoint]:
    """Look through all that is installed, which takes ten milliseconds."""
    return {entry.name: entry for entry in sorted(entry_points(group=GROUP))}


def driver_class(name: str) -> type[Driver]:
    """Return the named driver; ConfigError (path "driver") names those known, or what its import lacks."""
    entries = driver_entries()
    if name not in entries:  # it may have been installed since
        _installed.cache_clear()
        entries = driver_entries()
    if name not in entries:
        there = ", ".join(entry for entry in entries if entry not in _REPLAYED) or "none"
        raise ConfigError.at("driver", f'no driver is called "{name}"', f"drivers are {there}")
    try:
        loaded: object = entries[name].load()
    except (ImportError, AttributeError) as error:
        raise ConfigError.at(
            "driver", f'"{name}" cannot be loaded: {error}', "install what it needs"
        ) from error
    if not (isinstance(loaded, type) and issubclass(loaded, Driver)):
        raise ConfigError.at(
            "driver", f'"{name}" is no driver', f"{entries[name].value} is not a drivers.port.Driver"
        )
    return loaded
