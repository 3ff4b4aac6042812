"""Dataclasses that are defined while the command line is imported behave as all others do."""

import pickle
from dataclasses import FrozenInstanceError, dataclass, field, replace
from typing import Any

import pytest

from agent.cli.terminal.start import fast_import

with fast_import():

    @dataclass(frozen=True, slots=True)
    class Quick:
        number: int
        text: str = "a"
        unseen: list[int] = field(default_factory=list, repr=False, compare=False)

    @dataclass(frozen=True, order=True)
    class One:
        number: int

    @dataclass
    class Open:
        inner: Any = None

    @dataclass(frozen=True)
    class Nothing:
        pass


def test_dataclass_defined_while_importing_shows_and_compares_its_fields() -> None:
    assert repr(Quick(3, unseen=[1])) == "Quick(number=3, text='a')"
    assert Quick(3, unseen=[1]) == Quick(3)
    assert Quick(3) != Quick(3, "b")
    others: list[object] = [3, Quick(3), One(4)]
    assert One(3) not in others
    assert One(1) < One(2) <= One(2)
    assert Nothing() == Nothing()
    assert hash(Quick(3, unseen=[1])) == hash((3, "a"))
    assert len({One(3), One(3), One(4)}) == 2
    assert hash(Nothing()) == hash(())


def test_dataclass_defined_while_importing_is_frozen_copied_and_pickled() -> None:
    with pytest.raises(FrozenInstanceError, match="cannot assign to field 'number'"):
        Quick(3).number = 4  # type: ignore[misc]
    with pytest.raises(FrozenInstanceError, match="cannot delete field 'number'"):
        del One(3).number
    assert replace(Quick(3), text="b") == Quick(3, "b")
    assert pickle.loads(pickle.dumps(Quick(3))) == Quick(3)


def test_dataclass_defined_while_importing_that_holds_itself_is_shown() -> None:
    ring = Open()
    ring.inner = ring
    assert repr(ring) == "Open(inner=...)"
    with pytest.raises(TypeError, match="unhashable"):
        hash(ring)


def test_dataclasses_are_made_as_ever_after_the_imports() -> None:
    import dataclasses

    before = dict(vars(dataclasses))
    with pytest.raises(KeyError), fast_import():
        raise KeyError
    assert vars(dataclasses) == before
