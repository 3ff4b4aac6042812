"""How the observer is set over the life of an estimator: before the first fit, and about a fitted model."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from agent.numerics.model.observer import Gain, Noise, matched_gain, plain_gain, poles_gain, start_gain
from agent.numerics.model.riccati import spectral_radius
from agent.numerics.model.statespace import Discrete
from agent.numerics.paper.tuning import STRICTLY_STABLE
from agent.types import FloatArray


class Gains(Protocol):
    """A rule for the observer's gain."""

    @property
    def disturbance(self) -> FloatArray | None:
        """(n, d) directions of unknown forces to search for; None where the rule does not ask for them."""
        ...

    def start(self, discrete: Discrete, noise: Noise) -> Gain:
        """Return a gain that finds its way from a wrong model."""
        ...

    def settled(self, discrete: Discrete, noise: Noise) -> Gain:
        """Return the gain about a fitted model."""
        ...


@dataclass(frozen=True, slots=True)
class AutomaticGains:
    """A Kalman start; then the matched gain where forces disturb the rig, none at all where nothing does.

    With sensor noise alone any correction loses information; but a model that is not strictly stable needs
    one.
    """

    disturbance: FloatArray
    window: int

    def start(self, discrete: Discrete, noise: Noise) -> Gain:
        """Return a gain that forgets within a window."""
        return plain_gain(start_gain(discrete, self.disturbance, noise.sigma, self.window), noise.sigma)

    def settled(self, discrete: Discrete, noise: Noise) -> Gain:
        """Return the efficient gain for the disturbances found."""
        if noise.forced:
            return matched_gain(discrete, self.disturbance, noise)
        if spectral_radius(discrete.model.A) < STRICTLY_STABLE:
            return plain_gain(np.zeros((discrete.model.n, discrete.model.p)), noise.sigma)
        return self.start(discrete, noise)


@dataclass(frozen=True, slots=True)
class PlacedGains:
    """Observer poles as configured, 1/s, before and after.

    outputs: numbers of the outputs that the observer corrects itself by; None for all of them.
    """

    poles: Sequence[complex]
    outputs: tuple[int, ...] | None = None
    disturbance: None = None

    def start(self, discrete: Discrete, noise: Noise) -> Gain:
        """Return the gain that places the poles."""
        model = discrete.model
        rows = list(range(model.p)) if self.outputs is None else list(self.outputs)
        gain = np.zeros((model.n, model.p))
        gain[:, rows] = poles_gain(replace(model, C=model.C[rows]), self.poles, discrete.period_s)
        return plain_gain(gain, noise.sigma)

    def settled(self, discrete: Discrete, noise: Noise) -> Gain:
        """Return the same."""
        return self.start(discrete, noise)


@dataclass(frozen=True, slots=True)
class KalmanGains:
    """A Kalman gain for unknown forces of the configured intensities, N."""

    directions: FloatArray
    process: FloatArray
    disturbance: None = None

    def start(self, discrete: Discrete, noise: Noise) -> Gain:
        """Return the matched gain."""
        return matched_gain(discrete, self.directions, Noise(noise.sigma, self.process))

    def settled(self, discrete: Discrete, noise: Noise) -> Gain:
        """Return the same."""
        return self.start(discrete, noise)


@dataclass(frozen=True, slots=True)
class QuietGains:
    """No unknown force at all: a correction that finds its way at first, then none where the model allows it.

    What such an observer leaves in its residual is whatever the model cannot do over the whole window (dry
    friction where it is not in the model), in place of a force that explains it away sample by sample.
    """

    directions: FloatArray
    window: int
    disturbance: None = None

    def start(self, discrete: Discrete, noise: Noise) -> Gain:
        """Return a gain that forgets within a window."""
        return AutomaticGains(self.directions, self.window).start(discrete, noise)

    def settled(self, discrete: Discrete, noise: Noise) -> Gain:
        """Return no gain, or for a model that is not strictly stable one that forgets within a window."""
        unforced = Noise(noise.sigma, np.zeros(0))
        return AutomaticGains(self.directions, self.window).settled(discrete, unforced)
