"""Whether a window of a rig that has changed is clean of what the rig was before, or straddles the change.

Two stories of one window are held against each other by their sums of squares: one theta from its first sample on, or
the theta of the past up to a split and another one behind it, the state carried through, since masses do not jump.
Both have as many free figures. A window counts as clean when no split tells it better.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from agent.numerics.fitting.guarded import GREATEST
from agent.numerics.model.observer import Gain
from agent.numerics.model.sensitivity import sensitivity_filter
from agent.numerics.model.statespace import Discrete, StateSpace
from agent.numerics.window.cells import cell_operators, propagate, run_cells

FloatArray = NDArray[np.float64]
SPLITS = (0.25, 0.5, 0.75)
STEPS = 3
CELLS = 40
"""Cells that a window is cut into, on whose borders it may be split."""


@dataclass(frozen=True, slots=True)
class Window:
    """A window to be told.

    Attributes:
        sample: theta (q,) -> the sampled model there.
        gain: of the observer.
        v: (W, p+m) outputs and inputs.
        scale: (q,) sizes of the parameters.
        lower: (q,) their bounds from below.
        cell: samples computed at once; splits fall between cells.
    """

    sample: Callable[[FloatArray], Discrete]
    gain: Gain
    v: FloatArray
    scale: FloatArray
    lower: FloatArray
    cell: int = 1


def is_clean(window: Window, past: FloatArray, theta: FloatArray) -> bool:
    """Return whether one theta, near `theta` (q,), tells a window better than a change from `past` (q,) inside it."""
    cell = max(1, len(window.v) // CELLS)
    window = replace(window, v=window.v[len(window.v) % cell :], cell=cell)
    squares, theta = _best(window, 0, past, theta, None)
    places = [round(share * len(window.v) / cell) * cell for share in SPLITS]
    return all(_best(window, place, past, theta, squares)[0] > squares for place in places)


def _best(
    window: Window, place: int, past: FloatArray, theta: FloatArray, enough: float | None
) -> tuple[float, FloatArray]:
    """Return the least sum of squares with `past` before a split, and the theta behind it; stop when under `enough`."""
    x0, least = np.zeros(window.sample(past).model.n), np.inf
    before = _without_parameters(window.sample(past).model) if place else None
    for _ in range(STEPS):
        e, columns = _linear(window, before, place, window.sample(theta).model, x0)
        norms = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        if not (np.all(norms < GREATEST) and np.all(np.abs(e) < GREATEST)):
            break  # the step before led out of the numbers
        found = np.linalg.lstsq(columns / norms, e, rcond=1e-10)[0] / norms
        left = e - columns @ found
        least = min(least, float(left @ left))
        step = np.clip(found[len(x0) :], -0.5 * window.scale, 0.5 * window.scale)
        if (enough is not None and least <= enough) or bool(np.all(np.abs(step) < 1e-3 * window.scale)):
            break
        theta, x0 = np.maximum(theta + step, window.lower), x0 + found[: len(x0)]
    return least, theta


def _linear(
    window: Window, before: StateSpace | None, place: int, after: StateSpace, x0: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return innovations (W p,) from x0 (n,) and what they owe to x0 and to the theta behind the split (W p, n+q)."""
    innovations, leverage, carried = [], [], np.eye(len(x0))
    if before is not None:
        out, Gamma, x0, carried = _run(before, window.gain, window.v[:place], x0, window.cell)
        innovations.append(out[:, 0])
        leverage.append(np.hstack([Gamma, np.zeros((len(Gamma), after.q))]))
    out, Gamma, _, _ = _run(after, window.gain, window.v[place:], x0, window.cell)
    innovations.append(out[:, 0])
    leverage.append(np.hstack([Gamma @ carried, out[:, 1:]]))
    return np.concatenate(innovations), np.vstack(leverage)


def _run(
    model: StateSpace, gain: Gain, v: FloatArray, x0: FloatArray, cell: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Run the filters over v from x0, sensitivities from zero.

    Returns [e psi] (N p, 1+q), Gamma (N p, n), the observer's state behind and how it depends on x0 (n, n).
    """
    system = sensitivity_filter(model, gain.L, gain.whitening)
    operator = cell_operators(system, [cell])[cell]
    inputs = v.reshape(len(v) // cell, -1)
    start = np.concatenate([x0, np.zeros(len(system.F) - len(x0))])
    states, end = propagate(start, operator.state_from_state, inputs @ operator.state_from_inputs)
    Phi, carried, Gamma = operator.state_from_state[: model.n, : model.n], np.eye(model.n), []
    for _ in range(len(inputs)):
        Gamma.append(operator.G[:, : model.n] @ carried)
        carried = Phi @ carried
    out = run_cells(operator, inputs, states).reshape(-1, 1 + model.q)
    return out, np.vstack(Gamma), end[: model.n], carried


def _without_parameters(model: StateSpace) -> StateSpace:
    return replace(model, dA=model.dA[:0], dB=model.dB[:0], dC=model.dC[:0], dD=model.dD[:0])
