"""Is there dry friction that the model has no term for? The score test of one more column a damper.

The column is the response to a force of 1 N against the sign of the speed across a damper, from the window's
own trajectory. Its likelihood ratio is weighed against what a column costs (Schwarz, Ann. Stat. 6 (1978)
461).
"""

from dataclasses import dataclass

import numpy as np

from agent.numerics.inference import tuning
from agent.numerics.inference.spectral.bins import unitary
from agent.numerics.inference.spectral.response import Response
from agent.numerics.inference.tuning import UNSEEN
from agent.numerics.model.uncertain import Rubbing
from agent.types import ComplexArray, FloatArray


@dataclass(frozen=True, slots=True)
class Friction:
    """What one more column would say.

    Attributes:
        evidence: log Bayes factor for dry friction across a damper;  size: how much, N.
        shift: (q,) by how much its column moves the parameters, in units of their deviations.
    """

    evidence: float
    size: float
    shift: FloatArray


def columns(
    response: Response, states: ComplexArray, rubbings: tuple[Rubbing, ...], output_gain: FloatArray
) -> ComplexArray:
    """Return the responses (kept, p, r) to forces of 1 against speeds across dampers; states (kept, n)."""
    kept, window = response.bins.kept, response.bins.window
    across = np.array([rubbing.speed for rubbing in rubbings])
    push = np.array([rubbing.push for rubbing in rubbings])
    speed = np.fft.irfft(states @ across.T, window, axis=0) * np.sqrt(window)
    sign = np.where(np.abs(speed) > tuning.CREEP * np.abs(speed).max(axis=0), np.sign(speed), 0.0)
    return np.asarray(response.pushed(-push.T, unitary(sign)[:kept]) * output_gain[:, None])


def frictions(
    own: FloatArray, cross: FloatArray, V: FloatArray, fit: FloatArray, psi: slice, dof: float, misfit: float
) -> list[Friction]:
    """Weigh columns, one of them at a time, beside a regression's base.

    own: (r,) their power;  cross: (base + 1, r) their products with the base, and with the residual;  V, fit:
    (base, base) and (base,) covariance and estimate of the base without them.
    """
    along = V @ cross[:-1]
    left = own - (cross[:-1] * along).sum(axis=0)
    score = cross[-1] - fit @ cross[:-1]
    nothing = Friction(-np.inf, 0.0, np.zeros(psi.stop - psi.start))
    return [
        # the columns of the model may say all that one does
        _friction(score[i], left[i], -along[psi, i], dof, misfit) if left[i] > UNSEEN * own[i] else nothing
        for i in range(len(own))
    ]


def _friction(score: float, left: float, shift: FloatArray, dof: float, misfit: float) -> Friction:
    size = score / left
    evidence = 0.5 * score * size / misfit - 0.5 * np.log(dof)
    # friction that drives is none
    return Friction(float(evidence if size > 0 else -np.inf), float(size), np.asarray(shift * size))
