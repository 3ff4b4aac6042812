"""Plants of other libraries as configuration text: state spaces of scipy.signal and python-control."""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from agent.errors import UsageError

MATRICES = ("A", "B", "C", "D")


def linear_table(system: Any, *, uncertain: Sequence[str]) -> str:
    """Return [model] and the [[channel]] tables of a plant as TOML, units left for the user to fill in.

    Args:
        system: what has A, B, C, D and `dt`, or `to_ss()` as transfer functions have; names are taken from
            `state_labels`, `input_labels`, `output_labels` where there are any.
        uncertain: entries such as "A[0,1]", or whole matrices, that are to be estimated.

    Raises UsageError for what is no state space: an improper transfer function, no sampling time of a
    discrete one.
    """
    system = _state_space(system)
    matrices = {name: np.atleast_2d(np.asarray(getattr(system, name), dtype=float)) for name in MATRICES}
    lines = ["[model]", 'kind = "linear"', *_time(system)]
    lines += [f"{name} = {json.dumps(matrix.tolist())}" for name, matrix in matrices.items()]
    names = [f"{{ name = {json.dumps(name)} }}" for name in _labels(system, "state", len(matrices["A"]))]
    lines += [f"state = [{', '.join(names)}]"]
    lines += [f"uncertain = {json.dumps(list(uncertain))}"]
    for quantity, count in (("input", matrices["B"].shape[1]), ("output", len(matrices["C"]))):
        for name in _labels(system, quantity, count):
            lines += [
                "",
                "[[channel]]",
                f"name = {json.dumps(name)}",
                f'quantity = "{quantity}"',
                'unit = "1"',
            ]
    return "\n".join([*lines, ""])


def _state_space(system: Any) -> Any:
    """Return what has matrices; a transfer function is put into its controllable form."""
    if not hasattr(system, "A") and hasattr(system, "to_ss"):
        try:
            system = system.to_ss()
        except ValueError as error:
            what = "is improper: its numerator is of a higher degree than its denominator, so y would need u'"
            raise UsageError.at("system", what, "add the pole that the real plant has") from error
    if not all(hasattr(system, name) for name in MATRICES):
        what = f"{type(system).__name__} has no matrices A, B, C, D"
        raise UsageError.at("system", what, "give a StateSpace of scipy.signal or python-control")
    if hasattr(system, "E") and not np.allclose(np.asarray(system.E), np.eye(len(system.A))):
        what = "is a descriptor system, E x' = A x + B u: a singular E is an improper plant"
        raise UsageError.at(
            "system", what, "solve for x' where E has an inverse; else add what it leaves out"
        )
    return system


def _time(system: Any) -> list[str]:
    dt = getattr(system, "dt", None)
    if dt is None or (dt == 0 and dt is not False):
        return []
    if isinstance(dt, bool):
        what = "is in discrete time, with no sampling time"
        raise UsageError.at("system.dt", what, "give dt in seconds")
    return ['time = "discrete"', f"rate_hz = {1.0 / float(dt)!r}"]


def _labels(system: Any, what: str, count: int) -> list[str]:
    """Return the names that the plant has, made names of a configuration, or "u1", "y1", "x1" ..."""
    given = list(getattr(system, f"{what}_labels", None) or [])
    letter = {"state": "x", "input": "u", "output": "y"}[what]
    names = [_name(str(text)) for text in given]
    return names if len(names) == count and all(names) else [f"{letter}{i + 1}" for i in range(count)]


def _name(text: str) -> str:
    kept = "".join(c if c.isascii() and (c.isalnum() or c in "_.-") else "_" for c in text)
    return kept[:64] if kept[:1].isalpha() else ""
