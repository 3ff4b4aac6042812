"""Do springs that harden or soften explain a window, and better than parameters that change in it?

With constants N(m, P) a window's log evidence is −½ (power left + log det of the columns' precision +
log det P): P is opened for one spring after the other, and for all. Against it stand one jump of the
parameters, or a line that they run on, of each of them or of all.
"""

from dataclasses import replace

import numpy as np

from agent.numerics.inference import tuning
from agent.numerics.inference.linearise import Linearised, Lineariser
from agent.numerics.inference.noise.restricted_likelihood import Ridge
from agent.numerics.inference.posterior import Knowledge
from agent.numerics.inference.spectral.algebra import inverse, log_determinant, shown
from agent.types import FloatArray, IntArray


def hardening(lineariser: Lineariser, at: Linearised, known: Knowledge, temper: float) -> float:
    """Log evidence of a window that springs harden otherwise than is known, all else as it is known.

    temper: by how much less the window says than its linearisation has it.
    """
    straight = lineariser.spread(known.constants)
    every = lineariser.rig.of_kind("cubic")
    found = -np.inf
    for which in (*every[:, None], every):
        bent = lineariser.spread(known.constants, which)
        other = opened(lineariser, at, known, which)
        gain = (at.left - other.left) / temper + at.log_precision - other.log_precision
        found = max(found, 0.5 * float(gain + log_determinant(straight) - log_determinant(bent)))
    return found


def opened(lineariser: Lineariser, at: Linearised, known: Knowledge, which: IntArray) -> Linearised:
    """Return the same window where springs, by their constants, may harden."""
    xi = at.regression.layout.xi
    R, b = at.ridge.R.copy(), at.ridge.b.copy()
    R[xi, xi] = inverse(lineariser.spread(known.constants, which))
    b[xi] = R[xi, xi] @ (lineariser.expected(known.constants) - known.eta)
    return replace(at, ridge=Ridge(R, b))


def changing(at: Linearised, temper: float, *, jumps: bool = True) -> float:
    """Log evidence of a window that its parameters run on, or jump once; 0 without columns of jumps."""
    layout, (V, fit) = at.regression.layout, at.fitted
    if not layout.cuts:
        return 0.0
    q = layout.q
    columns = slice(layout.base, layout.base + layout.cuts * q)
    cross = at.G[: layout.base, columns]
    left = at.G[columns, columns] - cross.T @ V @ cross
    J, g = shown(
        0.5 * (left + left.T) / temper,
        (at.G[columns, -1] - cross.T @ fit) / temper,
        np.diag(at.G)[columns] / temper,
    )
    # a line is equal jumps at all cuts
    line = np.tile(np.eye(q), layout.cuts).T / layout.cuts
    found = _evidence(line.T @ J @ line, line.T @ g)
    if not jumps:
        return found
    each = [slice(i * q, (i + 1) * q) for i in range(layout.cuts)]
    return max(found, *(_evidence(J[cut, cut], g[cut]) - float(np.log(layout.cuts)) for cut in each))


def _evidence(S: FloatArray, g: FloatArray) -> float:
    """Log Bayes factor for changes of any one of some parameters, or of all of them.

    S (k, k), g (k,): information and score of these.
    """
    variance = tuning.LINE_SD**2
    own = variance * np.maximum(np.diag(S), 0.0)  # what is below 0 is rounding
    one = variance * g**2 / (1 + own) - np.log1p(own)
    asked = g @ np.linalg.solve(S + np.eye(len(g)) / variance, g)
    every = asked - log_determinant(np.eye(len(g)) + variance * S)
    return 0.5 * max(float(every), float(one.max()))
