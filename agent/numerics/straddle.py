"""Whether the parameters changed inside a window: a score test that sees what the residual's size does not.

A step that moves the residual variance by a few per cent, far below its gate, can bend an estimate by many of its sd.
The test asks for it directly: psi restarted at a split with nothing behind it is what a change of theta there would
add to the window; where adding that explains significantly more, the window is of two machines (Chow, Econometrica
1960, with the state carried through the split, since masses do not jump).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from agent.numerics.cells import CellOperator, cell_operators, propagate, run_cells
from agent.numerics.observer import Gain
from agent.numerics.sensitivity import sensitivity_filter
from agent.numerics.statespace import StateSpace

FloatArray = NDArray[np.float64]
PIECES = 32
"""A window is cut into about so many cells, and may be split between any two of them."""
SPLITS = (0.25, 0.5, 0.75)
CHANCE = 1e-4
"""How often a window without a change is taken for one with it, for each split."""


@dataclass(frozen=True, slots=True)
class Split:
    """What a change of theta at one place of a window explains.

    Attributes:
        chi2: what it takes off the residual sum of squares, in units of the residual variance that is left.
        change: (q,) by how much theta would have changed.
    """

    chi2: float
    change: FloatArray


def straddles(found: list[Split], widening: FloatArray, matters: FloatArray) -> bool:
    """Return whether some split shows a change beyond chance that is large enough to matter.

    Args:
        found: the splits of a window.
        widening: (q,) honest sd over the white one.
        matters: (q,) changes smaller than these are of no concern.
    """
    bar = float(chdtri(len(matters), CHANCE) * np.max(widening) ** 2)
    return any(split.chi2 > bar and bool(np.any(np.abs(split.change) > matters)) for split in found)


def splits(model: StateSpace, gain: Gain, v: FloatArray) -> list[Split]:
    """Test a window v (W, p+m) for a change at each of SPLITS, about the model at the window's own estimate."""
    length = max(1, len(v) // PIECES)
    operator = cell_operators(sensitivity_filter(model, gain.L, gain.whitening), [length])[length]
    inputs = v[len(v) % length :].reshape(-1, length * v.shape[1])
    forced = inputs @ operator.state_from_inputs
    explained, start = _initial(operator, inputs, forced)
    states, _ = propagate(start, operator.state_from_state, forced)
    out = _run(operator, inputs, states)
    basis = np.linalg.qr(_scaled(np.hstack([explained, out[:, 1:]])))[0]
    left = out[:, 0] - basis @ (basis.T @ out[:, 0])
    places = dict.fromkeys(round(share * len(inputs)) for share in SPLITS)
    return [_split(operator, inputs, forced, states, (place, basis, left)) for place in places if place]


def _initial(operator: CellOperator, inputs: FloatArray, forced: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return Gamma over the window (W p, n) and the filter's state (nz,) with the initial state that fits best."""
    states, _ = propagate(np.zeros(len(forced[0])), operator.state_from_state, forced)
    e = _run(operator, inputs, states)[:, 0]
    carried, pieces = np.eye(operator.n), []
    for _ in range(len(inputs)):
        pieces.append(operator.G[:, : operator.n] @ carried)
        carried = operator.Pi[: operator.n, : operator.n] @ carried
    Gamma = np.vstack(pieces)
    norms = np.maximum(np.linalg.norm(Gamma, axis=0), 1e-300)
    start = np.zeros(len(forced[0]))
    start[: operator.n] = np.linalg.lstsq(Gamma / norms, e, rcond=1e-12)[0] / norms
    return Gamma, start


def _run(operator: CellOperator, inputs: FloatArray, states: FloatArray) -> FloatArray:
    return run_cells(operator, inputs, states).reshape(-1, 1 + operator.q)


def _scaled(columns: FloatArray) -> FloatArray:
    return np.asarray(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300))


def _split(
    operator: CellOperator, inputs: FloatArray, forced: FloatArray, states: FloatArray,
    rest: tuple[int, FloatArray, FloatArray],
) -> Split:  # fmt: skip
    place, basis, left = rest
    start = states[place].copy()
    start[operator.n :] = 0.0
    tail, _ = propagate(start, operator.state_from_state, forced[place:])
    after = np.zeros((len(left), operator.q))
    after[place * operator.length * operator.p :] = _run(operator, inputs[place:], tail)[:, 1:]
    after -= basis @ (basis.T @ after)
    norms = np.maximum(np.linalg.norm(after, axis=0), 1e-300)
    change = np.linalg.lstsq(after / norms, left, rcond=1e-6)[0] / norms
    remaining = left - after @ change
    dof = max(len(left) - basis.shape[1] - operator.q, 1)
    squares = float(remaining @ remaining)
    return Split((float(left @ left) - squares) / max(squares / dof, 1e-300), change)
