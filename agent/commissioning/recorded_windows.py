"""What the motion of a recording leaves open: changes of several parameters together that its windows cannot tell."""

from dataclasses import dataclass

import numpy as np

from agent.blocks.rig_model import RigModel
from agent.commissioning.prediction import Excitation, noise_to_expect, recorded_excitation, sampled, windows
from agent.commissioning.readings import Recorded
from agent.config import RigConfig
from agent.errors import Fault
from agent.numerics.fitting.information import window_information
from agent.numerics.model.holds import straight
from agent.numerics.model.identifiability import readable_blends
from agent.numerics.model.statespace import Model, discretise
from agent.runtime.assembly.model_check import blend_in_words, blend_named, further_outputs
from agent.types import FloatArray

WEAKEST = 1.0
"""Standard deviation of a change, in sizes of the parameters, beyond which a window does not tell it."""
NOISE_OF_MORE = 1e-3
"""Noise of an output that is not there yet, as a share of what it would read."""


@dataclass(frozen=True)
class _Look:
    """A recording's motion, the length of the windows that see it, and the size (q,) of each parameter."""

    config: RigConfig
    excitation: Excitation
    length: int
    size: FloatArray

    def weak(self, model: Model, sigma: FloatArray) -> FloatArray:
        """Return the changes (k, q) that windows know no better than the parameters' own size."""
        period_s, hold = 1.0 / self.config.rig.sample_rate_hz, straight(self.config.estimator.hold)
        discrete = discretise(model.continuous(model.nominal), period_s, hold)
        each = []
        for start in self.excitation.starts(self.length):
            x0, u = self.excitation.state(start, self.length), self.excitation.u[start : start + self.length]
            each.append(window_information(discrete, x0, u, sigma))
        mean = np.mean(each, axis=0)
        values, vectors = np.linalg.eigh(mean * np.outer(self.size, self.size))
        lengths = np.sqrt(np.maximum(np.diag(mean), 1e-300))
        return readable_blends(vectors[:, values < WEAKEST**-2].T * self.size, self.size, lengths)

    def leaves_less(self, model: Model, sigma: FloatArray, open_before: int) -> bool:
        """Whether one more output, read to a thousandth of the largest that is read, leaves less open."""
        noise = NOISE_OF_MORE * max(float(self.excitation.rms.max(initial=0.0)), float(sigma.min()))
        return len(self.weak(model, np.append(sigma, noise))) < open_before


def left_open(config: RigConfig, rig: RigModel, resolution: FloatArray, recorded: Recorded | None) -> list[Fault]:
    """Say each change that the longest window of a recording cannot tell, and which output would help."""
    if recorded is None or not rig.parameters:
        return []
    excitation = recorded_excitation(sampled(config, rig), recorded)
    sigma, _ = noise_to_expect(config, resolution, excitation, recorded)
    look = _Look(config, excitation, max(windows(config)), _sizes(rig))
    if not len(excitation.starts(look.length)):
        return []
    weak = look.weak(rig.model, sigma)
    more = [name for name, model in further_outputs(rig) if len(weak) and look.leaves_less(model, sigma, len(weak))]
    advice = f"measure {more[0]} as well" if more else "give another excitation, a longer window, or fewer parameters"
    span = f"over {look.length / config.rig.sample_rate_hz:g} s of {recorded.name}"
    return [Fault("estimator.estimate", f"{span} {_words(rig, blend)}", advice) for blend in weak]


def _sizes(rig: RigModel) -> FloatArray:
    size = np.where(rig.model.nominal != 0, np.abs(rig.model.nominal), np.maximum(rig.limits, 0.0))
    return np.asarray(np.where(size > 0, size, 1.0))


def _words(rig: RigModel, blend: FloatArray) -> str:
    apart = " apart" if np.count_nonzero(blend) > 1 else ""
    return f"{blend_named(rig, blend)} cannot be told{apart}: {blend_in_words(rig, blend)} drowns in the noise"
