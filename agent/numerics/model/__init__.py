"""Rigs as state-space models with exact derivatives, seen through sensors, and the observers of such models."""

import numpy as np


def _import_scipy() -> None:
    """Import scipy's linear algebra, but not numpy's Fortran compiler, which it takes along with every name of numpy.

    Nobody here calls that; it costs every start 30 ms and 4 MB.
    """
    if "f2py" in vars(np):
        return
    np.f2py = None  # type: ignore[attr-defined]
    try:
        import scipy.linalg  # noqa: F401
    finally:
        del np.f2py  # type: ignore[attr-defined]


_import_scipy()
