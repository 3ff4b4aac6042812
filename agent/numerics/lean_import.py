"""scipy without what it takes along and does not use: numpy's compiler of Fortran and its tools for tests.

scipy's layer for other array libraries copies every name of numpy, and by that imports all of its lazy
submodules, a twentieth of what a small agent keeps in memory. While scipy is imported, their names stand for
nothing. Nor are the documents of its functions written anew, to say which other libraries they take arrays
of: that is a fifth of the import.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

_UNUSED = ("f2py", "testing", "ctypeslib", "polynomial", "char", "rec", "strings", "core", "matlib")


def _import_scipy() -> None:
    aside = [name for name in _UNUSED if name not in vars(np)]
    for name in aside:
        setattr(np, name, None)
    try:
        from scipy._lib import _array_api

        whole = getattr(_array_api, "xp_capabilities", None)
        if whole is not None:
            _array_api.xp_capabilities = _undocumented  # type: ignore[assignment]  # takes less, returns less
        import scipy.linalg
        import scipy.special  # noqa: F401 - to have both imported now

        if whole is not None:
            _array_api.xp_capabilities = whole
    finally:
        for name in aside:
            if getattr(np, name) is None:  # else somebody imported it meanwhile
                delattr(np, name)


def _undocumented(*_: Any, **__: Any) -> Callable[[Any], Any]:
    """Return what leaves a function as it is."""
    return lambda function: function


_import_scipy()
