"""What a rig knew before the samples of an event record, so its verdicts can be recomputed digit for digit.

The state is a pickle of the pipeline and of the rounds in which its samples were computed. It is read by
names: of classes and functions of the packages that only compute, of numpy's arrays and of a few of Python's
own; all else is refused, so that a file from elsewhere runs nothing.
"""

import io
import logging
import pickle
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np

from agent.recording.event_files import Labels, Taken
from agent.recording.tuning import STATE_BYTES

_PACKAGES: Final = (
    "agent.numerics.", "agent.blocks.", "agent.config.", "agent.types", "agent.alarms.",
    "agent.runtime.pipeline",
    "agent.runtime.ledger", "agent.runtime.assembly.", "agent.recording.event_files", "drivers.",
)  # fmt: skip
_OTHERS: Final = frozenset({
    ("collections", "Counter"), ("collections", "deque"), ("collections", "OrderedDict"),
    ("functools", "partial"), ("collections", "defaultdict"), ("builtins", "set"), ("builtins", "frozenset"),
    ("builtins", "complex"), ("builtins", "slice"), ("builtins", "range"), ("builtins", "bytearray"),
    ("builtins", "list"), ("builtins", "dict"), ("numpy", "dtype"), ("numpy", "ndarray"),
    ("numpy._core.multiarray", "_reconstruct"), ("numpy._core.multiarray", "scalar"),
    ("numpy._core.numeric", "_frombuffer"), ("pathlib", "PosixPath"), ("pathlib", "Path"),
    ("pathlib._local", "PosixPath"), ("numpy.random._pickle", "__generator_ctor"),
    ("numpy.random._pickle", "__bit_generator_ctor"), ("numpy.random._pcg64", "PCG64"),
})  # fmt: skip

log = logging.getLogger(__name__)


class State(NamedTuple):
    """A pipeline before a round: its content, the first block after it, and how far the rig had come."""

    content: bytes
    serial: int
    moment: int


class StateError(Exception):
    """What a record says of the state cannot be read by this program."""


class Rounds(NamedTuple):
    """A pipeline and what it was given since: blocks by round, their time stamps, each source's modulus."""

    pipeline: Any
    items: Sequence[Taken]
    labels: Sequence[Labels]
    moduli: Mapping[str, int | None]


def frozen(pipeline: object) -> bytes | None:
    """Return a pipeline's state; None where it cannot be kept."""
    try:
        content = pickle.dumps(pipeline, 5)
    except (pickle.PicklingError, TypeError, AttributeError, RecursionError) as error:
        log.warning("alarms of this run cannot be computed again later: %s", error)
        return None
    return content if len(content) <= STATE_BYTES else None


def state_bytes(state: State, given: Rounds, span: tuple[int, int]) -> bytes:
    """Return what a record holds beside the samples of a span; these are left out of the pipeline's input."""
    bare = [_bare(item, span) for item in given.items if item.serial >= state.serial]
    stamps = [label for label in given.labels if len(label.number) and label.number[-1] >= state.moment]
    return pickle.dumps((state.content, bare, stamps, dict(given.moduli)), 5)


def _bare(item: Taken, span: tuple[int, int]) -> Taken:
    own = item.kept & (item.number >= span[0]) & (item.number <= span[1])
    values = np.where(own[:, None], 0.0, item.block.values)
    return item._replace(block=replace(item.block, values=values))


def thawed(content: bytes) -> Rounds:
    """Return what a record's state holds. Raises StateError for another program's, and for what is none."""
    try:
        pipeline, items, labels, moduli = _Reader(io.BytesIO(content)).load()
        return Rounds(_Reader(io.BytesIO(pipeline)).load(), items, labels, moduli)
    except Exception as error:  # a pickle of another version fails in any way that its classes may fail
        raise StateError(f"{type(error).__name__}: {error}") from error


class _Reader(pickle.Unpickler):
    """An unpickler that knows the names of what only computes."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) == ("builtins", "getattr"):
            return _method
        if (module, name) in _OTHERS:
            return super().find_class(module, name)
        if not f"{module}.".startswith(_PACKAGES) and not module.startswith(_PACKAGES):
            raise pickle.UnpicklingError(f"{module}.{name} is no part of a state")
        found = super().find_class(module, name)
        if not _is_own(found):
            raise pickle.UnpicklingError(f"{module}.{name} is no part of a state")
        return found


def _is_own(found: Any) -> bool:
    """Tell whether something is defined in the packages that only compute, and not just imported there."""
    home = str(getattr(found, "__module__", ""))
    is_defined = isinstance(found, type) or hasattr(found, "__code__")
    return is_defined and home in sys.modules and home.startswith(_PACKAGES)


def _method(owner: Any, name: str) -> Callable[..., Any]:
    """Return a method of an object of ours; what Python itself would give for any name of any object."""
    found = getattr(owner, name)
    if name.startswith("__") or not _is_own(type(owner)) or isinstance(owner, partial):
        raise pickle.UnpicklingError(f"{name} is no part of a state")
    return found  # type: ignore[no-any-return]
