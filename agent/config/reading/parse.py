"""Raw tables of a file to models, collecting every fault instead of stopping at the first."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Generic, NamedTuple, Protocol, TypeVar, cast, get_args, get_origin

from pydantic import ConfigDict, TypeAdapter, ValidationError

from agent.config.reading.fields import Table, shown
from agent.config.reading.messages import faults_of, join, unknown_key
from agent.errors import Fault

T = TypeVar("T", bound=Table)


@dataclass
class Faults:
    """The faults found so far, in the order of the file's tables."""

    found: list[Fault] = field(default_factory=list)

    def add(self, path: str, message: str, advice: str = "") -> None:
        """Note one fault."""
        self.found.append(Fault(path, message, advice))


class Entry(NamedTuple, Generic[T]):
    """One table of a list with the key path that it has in the file."""

    path: str
    table: T


class Titled(Protocol):
    """A table that has a name."""

    @property
    def name(self) -> str:
        """Its name."""


def unique(
    entries: Iterable[tuple[str, Titled]], faults: Faults, others: Iterable[tuple[str, Titled]] = ()
) -> None:
    """Note each name that an earlier table, or one of the others, has already."""
    owner = {table.name: path for path, table in others if readable(table.name)}
    for path, table in entries:
        if table.name in owner:
            faults.add(
                f"{path}.name", f"{shown(table.name)} is the name of {owner[table.name]}", "names must differ"
            )
        elif readable(table.name):
            owner[table.name] = path


def readable(*values: object) -> bool:
    """Return whether all these values of read tables could be read."""
    return all(value is not None for value in values)


def read_table(table: type[T], raw: object, path: str, faults: Faults) -> T:
    """Read one table; note its faults.

    A value that could not be read is None in what is returned, whatever its annotation says, so that the
    rules between values can test the rest; such a table never leaves this package.
    """
    if not isinstance(raw, dict):
        faults.add(path, f"must be a table, not {shown(raw)}")
        needed = {key for key, about in table.model_fields.items() if about.is_required()}
        return _salvage(table, {}, needed)  # the rest as if the table were empty, so that rules can test it
    fields = table.model_fields
    faults.found += [unknown_key(path, key, list(fields)) for key in raw if key not in fields]
    known = {key: _nested(table, key, raw[key], join(path, key), faults) for key in fields if key in raw}
    try:
        return table.model_validate(known)
    except ValidationError as error:
        faults.found += [_advised(fault, table, path) for fault in faults_of(error, path, known)]
        return _salvage(table, known, {str(detail["loc"][0]) for detail in error.errors(include_url=False)})


def read_list(table: type[T], raw: object, path: str, faults: Faults) -> list[Entry[T]]:
    """Read a list of tables; what is no table is noted and left out."""
    if not isinstance(raw, list):
        faults.add(
            path, f"must be a list of tables, not {shown(raw)}", f"write [[{path}]] or {path} = [{{ ... }}]"
        )
        return []
    return [
        Entry(join(path, i), read_table(table, item, join(path, i), faults)) for i, item in enumerate(raw)
    ]


def _nested(table: type[Table], key: str, value: object, path: str, faults: Faults) -> object:
    """Read tables inside a table first, so that their faults are found one by one."""
    kind = table.model_fields[key].annotation
    if isinstance(kind, type) and issubclass(kind, Table):
        return read_table(kind, value, path, faults)
    inner: Any = get_args(kind)[0] if get_origin(kind) is tuple else None
    if isinstance(inner, type) and issubclass(inner, Table):
        return tuple(entry.table for entry in read_list(inner, value, path, faults))
    return value


def _advised(fault: Fault, table: type[Table], path: str) -> Fault:
    """Add a field's description where the fault itself has no advice."""
    key = fault.path.removeprefix(f"{path}.")
    description = table.model_fields[key].description if key in table.model_fields else None
    return Fault(fault.path, fault.message, fault.advice or description or "")


def _salvage(table: type[T], known: Mapping[str, object], bad: set[str]) -> T:
    values: dict[str, Any] = dict.fromkeys(bad & set(table.model_fields))
    for key, value in known.items():
        if key not in bad:
            values[key] = _converted(table, key, value)
    return cast("T", table.model_construct(**values))


def _converted(table: type[Table], key: str, value: object) -> object:
    """Return a good value as its field holds it (a list as a tuple, a duration in seconds)."""
    about = table.model_fields[key]
    if isinstance(about.annotation, type) and issubclass(about.annotation, Table):
        return value
    config = ConfigDict(strict=True, allow_inf_nan=False)
    adapter = TypeAdapter(cast("type[object]", Annotated[about.annotation, about]), config=config)
    return adapter.validate_python(value)
