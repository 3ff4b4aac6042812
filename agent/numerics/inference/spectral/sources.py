"""Sources of noise: unknown forces, fresh and slow, and coloured sensor noise, each of unknown intensity.

    S(z) = diag(σ_c² s_c(z)) + Σ_a v_a² |P_a(z)|² d_a d_a*,     |P|² = (1 − a²) / |1 − a/z|²   (a = 0: white)

d_a is the response H_j to a force on mass j, or the unit vector of sensor c (Gauss-Markov noise of the sensor
itself).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from agent.numerics.inference.spectral.response import Response
from agent.numerics.inference.tuning import FORCE_CORNER_OF_SLOWEST, FORCE_CORNERS, SENSOR_CORNERS
from agent.numerics.model.uncertain import Rig, sampled
from agent.types import ComplexArray, FloatArray


@dataclass(frozen=True, slots=True)
class Source:
    """One source of noise.

    Attributes:
        kind: a force, or a sensor's own.
        number: which unknown force, or which output.
        pole: a of the first-order Gauss-Markov process; 0 for white noise.
    """

    kind: Literal["force", "sensor"]
    number: int
    pole: float

    @property
    def is_slow_force(self) -> bool:
        """Whether it is a force that lasts beyond the window's ends."""
        return self.kind == "force" and self.pole > 0

    @property
    def origin(self) -> tuple[str, int]:
        """The force or sensor, whatever the colour."""
        return self.kind, self.number

    @property
    def is_colour(self) -> bool:
        """Whether it is a sensor's noise that remembers itself."""
        return self.kind == "sensor" and self.pole > 0


def spectra(sources: tuple[Source, ...], z: ComplexArray) -> FloatArray:
    """Return |P(z)|² (a, cells), each of mean 1 over all frequencies."""
    a = np.array([source.pole for source in sources])[:, None]
    return np.asarray((1 - a * a) / np.abs(1 - a / z) ** 2)


def sources_of(rig: Rig, window: int, outputs: int) -> tuple[Source, ...]:
    """Return the sources a window can tell apart: each force white and slow, each sensor in three colours."""
    if rig.white:
        return ()
    corners = force_corner_hz(rig, window) * np.array(FORCE_CORNERS)
    lasting_poles = np.exp(-2 * np.pi * np.minimum(corners * rig.period_s, 0.25))
    forces = range(len(rig.pushed))
    white = [Source("force", j, 0.0) for j in forces]
    lasting = [Source("force", j, float(pole)) for pole in lasting_poles for j in forces if rig.slow_forces]
    poles = np.exp(-2 * np.pi * np.array(SENSOR_CORNERS))
    coloured = [Source("sensor", c, float(pole)) for pole in poles for c in range(outputs)]
    return (*white, *lasting, *coloured)


def force_corner_hz(rig: Rig, window: int) -> float:
    """Return the corner of slow forces, Hz: half the slowest mode's frequency, or what a window can show."""
    at = sampled(rig, rig.nominal, np.zeros(rig.masses))
    speed = np.abs(np.log(np.linalg.eigvals(at.A).astype(complex))) / (2 * np.pi * rig.period_s)
    moving = speed[speed > 1e-6 / rig.period_s / window]
    slowest = float(moving.min()) if len(moving) else 0.0
    return max(FORCE_CORNER_OF_SLOWEST * slowest, 0.5 / (window * rig.period_s))


def directions(response: Response, sources: tuple[Source, ...], output_gain: FloatArray) -> ComplexArray:
    """Return d (cells, p, a): how the outputs respond to each source; output_gain (p,)."""
    cells, p = len(response.z), len(output_gain)
    out = np.zeros((cells, p, len(sources)), dtype=complex)
    for a, source in enumerate(sources):
        if source.kind == "force":
            out[:, :, a] = response.H[:, :, source.number] * output_gain
        else:
            out[:, source.number, a] = 1.0
    return out


def end_effects(response: Response, sources: list[Source], output_gain: FloatArray) -> ComplexArray:
    """Return τ (kept, p, a): what a^k shows, by which lasting noise differs from its periodic likeness.

    output_gain (p,): a force is seen through it, a sensor's own noise is not.
    """
    z, W = response.z[: response.bins.kept], response.bins.window
    poles = np.array([source.pole for source in sources])
    decay = (1 - poles**W) / (1 - poles / z[:, None]) / np.sqrt(W)
    push = np.zeros((response.H.shape[2], len(sources)))
    own = np.zeros((len(output_gain), len(sources)))
    for a, source in enumerate(sources):
        (push if source.kind == "force" else own)[source.number, a] = 1.0
    return np.asarray(response.pushed(push, decay) * output_gain[:, None] + own * decay[:, None])
