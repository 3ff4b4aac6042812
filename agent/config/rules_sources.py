"""What must hold in [[source]]: drivers, their keys, names, who delivers which channel; and in [[notify]]."""

from collections.abc import Collection, Iterator, Mapping
from typing import Any, Final

from pydantic import BaseModel, ValidationError

from agent.config.draft import Draft
from agent.config.plugins import driver_class
from agent.config.reading.fields import shown
from agent.config.reading.messages import faults_of, join, listing
from agent.config.reading.parse import Entry, Faults, read_list, readable, unique
from agent.config.reading.secrets import is_vague
from agent.config.sections.results import Notify
from agent.config.tables import Source
from agent.errors import ConfigError, Fault

COMMON: Final = tuple(key for key in Source.model_fields if key not in {"settings", "covariates"})

_NEEDED: Final = {"command": ("command",), "webhook": ("url",), "smtp": ("host", "sender", "recipients"),
           "apprise": ("url",)}  # fmt: skip
"""Keys that a kind cannot do without."""
_OWN: Final = {
    "command": ("command",),
    "webhook": ("url", "token"),
    "apprise": ("url",),
    "smtp": ("host", "port", "tls", "sender", "recipients", "user", "password"),
}
"""Keys that not every kind has."""


def read_sources(raw: object, faults: Faults) -> list[Entry[Source]]:
    """Read the sources: the keys that all share, then the rest by the model that the driver names."""
    rows = raw if isinstance(raw, list) else []
    shared = [{k: v for k, v in row.items() if k in COMMON} if isinstance(row, dict) else row for row in rows]
    entries = read_list(Source, shared if isinstance(raw, list) else raw, "source", faults)
    return [_with_settings(entry, row, faults) for entry, row in zip(entries, rows, strict=True)]


def _with_settings(entry: Entry[Source], row: object, faults: Faults) -> Entry[Source]:
    path, source = entry
    if not readable(source.driver) or not isinstance(row, dict):
        return entry
    own = {key: value for key, value in row.items() if key not in COMMON}
    return Entry(path, source.model_copy(update={"settings": _settings(path, source.driver, own, faults)}))


def _settings(path: str, driver: str, own: Mapping[str, Any], faults: Faults) -> BaseModel | None:
    try:
        model = driver_class(driver).settings_model
    except ConfigError as error:
        for fault in error.faults:
            faults.add(f"{path}.driver", fault.message, fault.advice)
        return None
    try:
        return model.model_validate(own)
    except ValidationError as error:
        faults.found += [_keyed(fault, path, model) for fault in faults_of(error, path, own, _keys(model))]
        return None


def _keyed(fault: Fault, path: str, model: type[BaseModel]) -> Fault:
    """Return a fault of a whole source as one of the key with which its words begin."""
    key = fault.message.split(" ", 1)[0].rstrip(":")
    if fault.path != path or key not in model.model_fields:
        return fault
    return Fault(join(path, key), fault.message.removeprefix(f"{key}: "), fault.advice)


def _keys(model: type[BaseModel]) -> list[str]:
    """Return every key that a driver's model knows at any depth, then those of every source."""
    schema = model.model_json_schema()
    tables = [schema, *schema.get("$defs", {}).values()]
    return list(
        dict.fromkeys([key for table in tables for key in table.get("properties", ())] + list(COMMON))
    )


def check_sources(draft: Draft) -> None:
    """Note the faults of sources and give those without a name the driver's."""
    draft.sources = list(_named(draft.sources, draft.faults))
    owner: dict[str, str] = {}
    for path, source in draft.sources:
        for name in source.map or {}:
            _check_mapped(join(f"{path}.map", name), name, owner, draft)
    if not draft.sources or not readable(*(source.map for _, source in draft.sources)):
        return
    channels = [(path, channel.name) for path, channel in draft.channels]
    for path, name in [*channels, *((path, one.name) for path, one in draft.covariates)]:
        if readable(name) and name not in owner:
            draft.faults.add(
                path, f"no source maps {shown(name)}", f'add {name} = "..." to the map of a source'
            )


def _check_mapped(path: str, channel: str, owner: dict[str, str], draft: Draft) -> None:
    names = [*draft.channel_names, *draft.covariate_names]
    if channel in owner:
        draft.faults.add(
            path, f"{shown(channel)} is mapped by {owner[channel]} already", "map each channel once"
        )
    elif channel in names:
        owner[channel] = path.rpartition(".map")[0]
    elif len(names) == len(draft.channels) + len(draft.covariates):
        draft.faults.add(path, f"no channel is called {shown(channel)}", f"channels are {listing(names)}")


def divided(source: Source, covariates: Collection[str]) -> Source:
    """Return a source with its map divided into the model's channels and covariates."""
    beside = {name: text for name, text in source.map.items() if name in covariates}
    own = {name: text for name, text in source.map.items() if name not in covariates}
    return source.model_copy(update={"map": own, "covariates": beside}) if beside else source


def _named(sources: list[Entry[Source]], faults: Faults) -> Iterator[Entry[Source]]:
    taken: dict[str, str] = {}
    for path, source in sources:
        if source.name and source.name in taken:
            faults.add(
                f"{path}.name",
                f"{shown(source.name)} is the name of {taken[source.name]}",
                "names must differ",
            )
        name = source.name or _free_name(source.driver, [s.name for _, s in sources] + list(taken))
        taken[name] = path
        yield Entry(path, source.model_copy(update={"name": name}))


def _free_name(driver: str | None, taken: list[str]) -> str:
    stem = driver or "source"
    number = 1
    while (name := stem if number == 1 else f"{stem}-{number}") in taken:
        number += 1
    return name


def check_notify(draft: Draft) -> None:
    """Note the faults of targets."""
    unique(draft.notify, draft.faults)
    for path, target in draft.notify:
        if readable(target.name, target.kind):
            draft.faults.found += _target_faults(path, target)


def _target_faults(path: str, target: Notify) -> Iterator[Fault]:
    for key in _NEEDED[target.kind]:
        if key not in target.model_fields_set:
            yield Fault(join(path, key), "is missing", f'kind = "{target.kind}" needs it')
    yield from _strange_keys(path, target)
    yield from _vague_secrets(path, target)
    url = target.url
    is_address = not isinstance(url, str) or url.startswith(("http://", "https://"))
    if target.kind == "webhook" and not is_address:
        yield Fault(join(path, "url"), "is no address of this kind", 'write "https://..."')


def _strange_keys(path: str, target: Notify) -> Iterator[Fault]:
    """Keys that belong to targets of another kind."""
    others = {key: kind for kind, keys in _OWN.items() for key in keys if key not in _OWN[target.kind]}
    for key in sorted(target.model_fields_set & others.keys()):
        yield Fault(join(path, key), f'belongs to kind = "{others[key]}"', "leave it out, or change the kind")


def _vague_secrets(path: str, target: Notify) -> Iterator[Fault]:
    """Secrets that name no place, or two."""
    secrets = {key: getattr(target, key) for key in ("url", "token", "password")}
    for key, secret in secrets.items():
        if is_vague(secret):
            yield Fault(join(path, key), "must name one place", '{ file = "..." } or { env = "..." }')
