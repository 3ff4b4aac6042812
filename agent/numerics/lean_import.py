"""scipy without what it takes along and does not use: numpy's compiler of Fortran and its tools for tests.

scipy's layer for other array libraries copies every name of numpy, and by that imports all of its lazy
submodules, a twentieth of what a small agent keeps in memory. While scipy is imported, their names stand for
nothing.
"""

import numpy as np

_UNUSED = ("f2py", "testing", "ctypeslib")


def _import_scipy() -> None:
    aside = [name for name in _UNUSED if name not in vars(np)]
    for name in aside:
        setattr(np, name, None)
    try:
        import scipy.linalg  # noqa: F401 - to have it imported now
    finally:
        for name in aside:
            if getattr(np, name) is None:  # else somebody imported it meanwhile
                delattr(np, name)


_import_scipy()
