"""The paper's estimated matrix beside ours, and what of it one pass of the printed method can give."""

from typing import Any

import numpy as np

from agent.evaluation.paper import cases
from agent.numerics.model.statespace import discretise
from agent.numerics.paper.seed_window import SeedFit
from agent.types import FloatArray


def matrices(change: FloatArray, fit: SeedFit, recentred: FloatArray) -> dict[str, Any]:
    """Return ΔA of case 1: exact, as published, of one pass, and of re-centred passes with imposed structure.

    Args:
        change: (4,) the actual one.
        fit: the passes; the first of them is the method as printed.
        recentred: (4,) the change that they end at.
    """
    nominal = _transition(np.zeros(4))
    of = {
        "exact": _transition(change) - nominal,
        "published": cases.MATRIX,
        "as_printed": fit.descents[0].M,
        "recentred": _transition(recentred) - nominal,
    }
    return {name: matrix.tolist() for name, matrix in of.items()}


def in_range(matrix: FloatArray) -> dict[str, float]:
    """Say how a matrix lies to the range of K_e, in which every one-pass ΔA is, its regressand being K_e ε.

    outside: share of its norm beyond the range. lower_rows: its last two rows over its first two.
    """
    gain = cases.GAIN
    rest = matrix - gain @ np.linalg.lstsq(gain, matrix, rcond=None)[0]
    return {
        "outside": float(np.linalg.norm(rest) / np.linalg.norm(matrix)),
        "lower_rows": float(np.linalg.norm(matrix[2:]) / np.linalg.norm(matrix[:2])),
    }


def least_lower_rows() -> float:
    """Return the least that the last two rows of a matrix in the range of K_e can be, of its first two."""
    return float(np.linalg.svd(cases.GAIN[2:] @ np.linalg.inv(cases.GAIN[:2]), compute_uv=False)[-1])


def observer_poles() -> list[float]:
    """Return where the printed K_e puts the observer's poles, 1/s, by the first-order model: z = 1 + s T."""
    model = discretise(cases.rig().continuous(cases.NOMINAL), cases.PERIOD_S, "euler").model
    z = np.linalg.eigvals(model.A - cases.GAIN @ model.C)
    return sorted(((z.real - 1.0) / cases.PERIOD_S).tolist())


def _transition(change: FloatArray) -> FloatArray:
    return discretise(cases.rig().continuous(cases.NOMINAL + change), cases.PERIOD_S, "euler").model.A
