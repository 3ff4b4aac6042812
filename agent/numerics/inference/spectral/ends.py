"""What unknown forces do at a window's ends: columns whose prior variance is that of the forces.

A slow force differs from its periodic likeness by the response to a^k, of variance 2 v²; the mean of any
force moves a free mass's momentum, of variance Σ (w E_j)² v² |P(1)|².
"""

import numpy as np

from agent.numerics.inference.spectral.response import Response
from agent.numerics.inference.spectral.sources import Source
from agent.types import FloatArray

LEAST_VARIANCE = 1e-300  # fixed by double precision


class Ends:
    """Prior precisions of the columns at `Layout.ends`: free masses', then those of slow forces."""

    def __init__(self, response: Response, sources: tuple[Source, ...]) -> None:
        self.slow = np.array([a for a, source in enumerate(sources) if source.is_slow_force], dtype=np.int64)
        at_rest = np.ones(1, dtype=complex)
        # (a, f) variance of a free mass's column by intensity²
        forces = response.H.shape[2]
        power = np.array([
            source.spectrum(at_rest)[0] * np.eye(forces)[source.number]
            if source.kind == "force"
            else np.zeros(forces)
            for source in sources
        ]).reshape(len(sources), forces)  # fmt: skip
        self.gain = response.drift_variance(power)

    def precision(self, intensity: FloatArray) -> FloatArray:
        """Return prior precisions (..., f + slow) at intensities (..., a)."""
        squared = intensity**2
        variance = np.concatenate([squared @ self.gain, 2 * squared[..., self.slow]], axis=-1)
        return np.asarray(1.0 / np.maximum(variance, LEAST_VARIANCE))
