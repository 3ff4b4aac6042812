"""Methods of dataclasses as closures over the names of fields.

The standard library of Python 3.11 writes the text of each method and compiles it, up to six times a class:
a seventh of the time until a command begins. What the methods do is the same; other versions are left alone.
"""

import dataclasses
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from operator import attrgetter
from reprlib import recursive_repr
from typing import Any

Fields = Sequence[dataclasses.Field[Any]]


@contextmanager
def fast_methods() -> Iterator[None]:
    """Make the dataclasses that are defined inside so."""
    ours: dict[str, Callable[..., Any]] = {}
    if sys.version_info[:2] == (3, 11):
        ours = {"_repr_fn": _repr, "_hash_fn": _hash, "_cmp_fn": _equal, "_frozen_get_del_attr": _frozen}
    before = {name: getattr(dataclasses, name) for name in ours}
    try:
        vars(dataclasses).update(ours)
        yield
    finally:
        vars(dataclasses).update(before)


def _cells(names: Sequence[str]) -> Callable[[Any], tuple[Any, ...]]:
    """Return what takes the values of fields out of an instance."""
    if len(names) > 1:
        return attrgetter(*names)
    return lambda instance: tuple(getattr(instance, name) for name in names)


def _repr(fields: Fields, _: object) -> Callable[[Any], str]:
    names = [field.name for field in fields]

    @recursive_repr()
    def show(self: Any) -> str:
        cells = ", ".join([f"{name}={getattr(self, name)!r}" for name in names])
        return f"{self.__class__.__qualname__}({cells})"

    return show


def _hash(fields: Fields, _: object) -> Callable[[Any], int]:
    cells = _cells([field.name for field in fields])

    def digest(self: Any) -> int:
        return hash(cells(self))

    return digest


def _equal(name: str, op: str, own: str, other: str, **scope: object) -> Callable[[Any, Any], Any]:
    if op != "==":
        return _COMPARE(name, op, own, other, **scope)
    cells = _cells([cell.removeprefix("self.") for cell in own.strip("()").split(",") if cell])

    def equal(self: Any, other: Any) -> Any:
        return cells(self) == cells(other) if other.__class__ is self.__class__ else NotImplemented

    return equal


def _frozen(cls: type[Any], fields: Fields, _: object) -> tuple[Callable[..., None], Callable[..., None]]:
    names = {field.name for field in fields}

    def assign(self: Any, name: str, value: object) -> None:
        if type(self) is cls or name in names:
            raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")
        super(cls, self).__setattr__(name, value)

    def delete(self: Any, name: str) -> None:
        if type(self) is cls or name in names:
            raise dataclasses.FrozenInstanceError(f"cannot delete field {name!r}")
        super(cls, self).__delattr__(name)

    # by which they are put into the class
    assign.__name__ = "__setattr__"
    delete.__name__ = "__delattr__"
    return assign, delete


_COMPARE: Callable[..., Callable[[Any, Any], Any]] = vars(dataclasses).get("_cmp_fn", _equal)
