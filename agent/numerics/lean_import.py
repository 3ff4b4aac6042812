"""scipy without what it takes along and does not use: numpy's compiler of Fortran and its tools for tests.

scipy's layer for other array libraries copies every name of numpy, and by that imports all of its lazy
submodules, a twentieth of what a small agent keeps in memory. While scipy is imported, their names stand for
nothing. Nor are the documents of its functions taken apart and written anew, to say which other libraries
they take arrays of, and that they take stacks of matrices: that is a third of the import.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

_UNUSED = ("f2py", "testing", "ctypeslib", "polynomial", "char", "ma", "rec", "strings", "core", "matlib")


def _import_scipy() -> None:
    aside = [name for name in _UNUSED if name not in vars(np)]
    for name in aside:
        setattr(np, name, None)
    try:
        from scipy._lib import _array_api, _util

        writing = ((_array_api, "xp_capabilities", _undocumented), (_util, "FunctionDoc", _Unchanged))
        whole = [(m, name, getattr(m, name)) for m, name, _ in writing if hasattr(m, name)]
        for module, name, less in writing:
            setattr(module, name, less)
        import scipy.linalg
        import scipy.special  # noqa: F401 - to have both imported now

        for module, name, before in whole:
            setattr(module, name, before)
    finally:
        for name in aside:
            if getattr(np, name) is None:  # else somebody imported it meanwhile
                delattr(np, name)


def _undocumented(*_: Any, **__: Any) -> Callable[[Any], Any]:
    """Return what leaves a function as it is."""
    return lambda function: function


class _Unchanged:
    """Document of a function as it stands, whatever is put into its sections."""

    def __init__(self, function: Any) -> None:
        self._text = function.__doc__ or ""

    def __getitem__(self, _section: str) -> list[Any]:
        return []

    def __str__(self) -> str:
        return f"\n{self._text}"  # scipy takes the first line, a signature, off


_import_scipy()
