"""Do springs that harden or soften explain a window, and better than parameters that change in it?

A window's log evidence is compared with that of the same columns once more, free by themselves: a cube's, for
one spring after the other and for all; against it one jump of the parameters, or a line that they run on, of
each of them or of all.
"""

from dataclasses import replace

import numpy as np

from agent.numerics.inference import tuning
from agent.numerics.inference.linearise import Linearised, Lineariser
from agent.numerics.inference.noise.restricted_likelihood import Ridge
from agent.numerics.inference.posterior import Knowledge
from agent.numerics.inference.spectral.algebra import inverse, log_determinant
from agent.types import FloatArray, IntArray


def hardening(at: Linearised, cubes: IntArray, temper: float) -> float:
    """Log evidence of a window that springs harden otherwise than is known, all else as it is known.

    cubes: springs, by their constants.  temper: by how much less the window says than its linearisation has
    it.
    """
    return _evidence(*_beside(at, at.regression.layout.xi.start + cubes, temper), tuning.OFF_CUBIC**2)


def opened(lineariser: Lineariser, at: Linearised, known: Knowledge, which: IntArray) -> Linearised:
    """Return the same window where springs, by their constants, may harden."""
    xi = at.regression.layout.xi
    R, b = at.ridge.R.copy(), at.ridge.b.copy()
    R[xi, xi] = inverse(lineariser.spread(known.constants, which))
    b[xi] = R[xi, xi] @ (lineariser.expected(known.constants) - known.eta)
    return replace(at, ridge=Ridge(R, b))


def changing(at: Linearised, temper: float, *, jumps: bool = True) -> float:
    """Log evidence of a window that its parameters run on, or jump once; 0 without columns of jumps."""
    layout = at.regression.layout
    if not layout.cuts:
        return 0.0
    q = layout.q
    variance = tuning.LINE_SD**2
    J, g = _beside(at, np.arange(layout.base, layout.base + layout.cuts * q), temper)
    # a line is equal jumps at all cuts
    line = np.tile(np.eye(q), layout.cuts).T / layout.cuts
    found = _evidence(line.T @ J @ line, line.T @ g, variance)
    if not jumps:
        return found
    price = float(np.log(layout.cuts))
    each = [slice(i * q, (i + 1) * q) for i in range(layout.cuts)]
    return max(found, *(_evidence(J[cut, cut], g[cut], variance) - price for cut in each))


def _beside(at: Linearised, columns: IntArray, temper: float) -> tuple[FloatArray, FloatArray]:
    """Information (k, k) and score (k,) of columns beside the base, which takes what it can of them."""
    base, (V, fit) = at.regression.layout.base, at.fitted
    cross = at.G[:base, columns]
    J = at.G[np.ix_(columns, columns)] - cross.T @ V @ cross
    return J / temper, (at.G[columns, -1] - cross.T @ fit) / temper


def _evidence(S: FloatArray, g: FloatArray, variance: float) -> float:
    """Log Bayes factor for any one of some columns that has a coefficient of a variance, or all of them.

    S (k, k), g (k,): information and score of these.
    """
    own = variance * np.diag(S)
    one = variance * g**2 / (1 + own) - np.log1p(own)
    asked = g @ np.linalg.solve(S + np.eye(len(g)) / variance, g)
    every = asked - log_determinant(np.eye(len(g)) + variance * S)
    return 0.5 * max(float(every), float(one.max()))
