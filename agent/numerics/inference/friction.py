"""Is there dry friction that the model has no term for? The score test of one more column a damper.

The column is the response to a force of 1 N against the sign of the speed across a damper, from the window's
own trajectory. Its likelihood ratio is weighed against what a column costs (Schwarz, Ann. Stat. 6 (1978)
461).
"""

from dataclasses import dataclass

import numpy as np

from agent.numerics.inference import tuning
from agent.numerics.inference.spectral.algebra import inverse
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


def column(
    response: Response, states: ComplexArray, rubbing: Rubbing, output_gain: FloatArray
) -> ComplexArray:
    """Return the response (kept, p) to a force of 1 against the speed across a damper; states (kept, n)."""
    kept, window = response.bins.kept, response.bins.window
    speed = np.fft.irfft(states @ rubbing.speed, window) * np.sqrt(window)
    sign = np.where(np.abs(speed) > tuning.CREEP * np.abs(speed).max(), np.sign(speed), 0.0)
    signal = unitary(sign)[:kept]
    pushes = [-w * response.pushed(int(j), signal) for j, w in enumerate(rubbing.push) if w]
    return np.asarray(np.sum(pushes, axis=0) * output_gain)


def frictions(
    gram: FloatArray, R: FloatArray, b: FloatArray, psi: slice, dof: float, misfit: float
) -> list[Friction]:
    """Weigh columns, one of them at a time, that stand in a Gram after the base, residual last.

    R, b: the base's prior.
    """
    nb = len(R)
    more = slice(nb, -1)
    own = gram.diagonal()[more]
    along = inverse(gram[:nb, :nb] + R) @ gram[:nb, more]
    left = own - (gram[:nb, more] * along).sum(axis=0)
    score = gram[more, -1] - (gram[:nb, -1] + b) @ along
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
