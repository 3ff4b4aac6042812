"""What unknown forces and coloured noise do at a window's ends: columns whose prior variance is theirs.

A slow force, or a sensor's noise that remembers itself, differs from its periodic likeness by the response to
a^k, of variance 2 v²; the mean of any force moves a free mass's momentum, of variance Σ (w E_j)² v² |P(1)|².
"""

import numpy as np

from agent.numerics.inference.spectral.response import Response
from agent.numerics.inference.spectral.sources import Source
from agent.types import FloatArray

LEAST_VARIANCE = 1e-300  # fixed by double precision


class Ends:
    """Prior precisions of the columns at `Layout.ends`: free masses', then those of lasting sources."""

    def __init__(self, response: Response, sources: tuple[Source, ...], lasting: tuple[int, ...]) -> None:
        self.lasting = np.array(lasting, dtype=np.int64)
        power = np.zeros((len(sources), response.H.shape[2]))
        for a, source in enumerate(sources):
            if source.kind == "force":
                power[a, source.number] = (1 + source.pole) / (1 - source.pole)  # |P(1)|²
        # (a, f) variance of a free mass's column by intensity²
        self.gain = response.drift_variance(power)

    def precision(self, intensity: FloatArray) -> FloatArray:
        """Return prior precisions (..., f + lasting) at intensities (..., a)."""
        squared = intensity**2
        variance = np.concatenate([squared @ self.gain, 2 * squared[..., self.lasting]], axis=-1)
        return np.asarray(1.0 / np.maximum(variance, LEAST_VARIANCE))
