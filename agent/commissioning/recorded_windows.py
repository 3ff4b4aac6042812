"""What windows of a recording leave open, and what the paper's conditions and re-centring come to there."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from agent.blocks.rig_model import RigModel, rig_model
from agent.commissioning.numerics.information import bound_sd, window_information
from agent.commissioning.prediction import (
    Excitation,
    assumed_excitation,
    expected_noise,
    recorded_excitation,
    sampled,
    windows,
)
from agent.commissioning.readings import Recorded
from agent.commissioning.tuning import NOISE_OF_MORE, SEEN_WINDOWS, SHARE_OF_MORE, WEAKEST
from agent.config import RigConfig
from agent.errors import Fault
from agent.numerics.model.holds import straight
from agent.numerics.model.identifiability import readable_blends
from agent.numerics.model.sensors import with_constant
from agent.numerics.model.statespace import Discrete, Model, discretise, simulate
from agent.numerics.paper.recentring import recentring
from agent.numerics.paper.seed import (
    existence,
    general_solution,
    observe,
    output_batch,
    special_case_defect,
    state_batch,
)
from agent.runtime.assembly.model_check import blend_in_words, blend_named, further_outputs
from agent.types import FloatArray


@dataclass(frozen=True)
class _Look:
    """A recording's motion, the length of the windows that see it, and the size (q,) of each parameter."""

    config: RigConfig
    excitation: Excitation
    length: int
    size: FloatArray

    def weak(self, model: Model, sigma: FloatArray) -> FloatArray:
        """Return the changes (k, q) that windows know no better than the parameters' own size."""
        period_s = 1.0 / self.config.rig.sample_rate_hz
        hold = straight(self.config.estimator.hold)
        discrete = discretise(model.continuous(model.nominal), period_s, hold)
        each = []
        starts = self.excitation.starts(self.length)
        for start in starts[:: -(-len(starts) // SEEN_WINDOWS)]:
            x0 = self.excitation.state(start, self.length)
            u = self.excitation.u[start : start + self.length]
            each.append(window_information(discrete, x0, u, sigma))
        mean = np.mean(each, axis=0)
        values, vectors = np.linalg.eigh(mean * np.outer(self.size, self.size))
        lengths = np.sqrt(np.maximum(np.diag(mean), 1e-300))
        return readable_blends(vectors[:, values < WEAKEST**-2].T * self.size, self.size, lengths)

    def leaves_less(self, model: Model, sigma: FloatArray, open_before: int) -> bool:
        """Whether one more output, read to a thousandth of the largest that is read, leaves less open."""
        noise = NOISE_OF_MORE * max(float(self.excitation.rms.max(initial=0.0)), float(sigma.min()))
        return len(self.weak(model, np.append(sigma, noise))) < open_before


def left_open(
    config: RigConfig, rig: RigModel, resolution: FloatArray, recorded: Recorded | None
) -> list[Fault]:
    """Say each change that the longest window which a recording has cannot tell, and what would help."""
    if recorded is None or not rig.parameters:
        return []
    excitation = recorded_excitation(sampled(config, rig), recorded)
    sigma, _ = expected_noise(config, resolution, excitation, recorded)
    there = [length for length in windows(config) if len(excitation.starts(length))]
    if not there:
        return []
    look = _Look(config, excitation, max(there), _sizes(rig))
    weak = look.weak(rig.model, sigma)
    more = [
        name
        for name, model in further_outputs(rig)
        if len(weak) and look.leaves_less(model, sigma, len(weak))
    ]
    advice = (
        f"measure {more[0]} as well"
        if more
        else "give another excitation, a longer window, or fewer parameters"
    )
    span = f"over {look.length / config.rig.sample_rate_hz:g} s of {recorded.name}"
    return [Fault("estimator.estimate", f"{span} {_words(rig, blend)}", advice) for blend in weak]


def helping(
    config: RigConfig, recorded: Recorded, window: int, count: int, sigma: FloatArray
) -> list[tuple[str, FloatArray]]:
    """Return displacements that are not measured, each with the sds (q,) of so many windows with it.

    Its sensor is taken to read a hundredth of the motion there; sigma (p,) of those there are.
    """
    rig = rig_model(config)
    first, end = max(recorded.pieces, key=lambda piece: piece[1] - piece[0])
    end = min(end, first + window)
    found = []
    for place, model in further_outputs(rig):
        discrete = discretise(
            model.continuous(model.nominal), 1.0 / config.rig.sample_rate_hz, straight(config.estimator.hold)
        )
        u = with_constant(recorded.u[first:end], discrete.model.m)
        x0 = recorded.first_state(sampled(config, rig), first, end)
        moved = simulate(discrete, x0 - discrete.B1 @ u[0], u)[1][:, -1]
        noise = np.append(sigma, max(SHARE_OF_MORE * float(moved.std()), 1e-300))
        found.append((place, bound_sd(window_information(discrete, x0, u, noise)) / np.sqrt(count)))
    return found


def _sizes(rig: RigModel) -> FloatArray:
    size = np.where(rig.model.nominal != 0, np.abs(rig.model.nominal), np.maximum(rig.limits, 0.0))
    return np.asarray(np.where(size > 0, size, 1.0))


def _words(rig: RigModel, blend: FloatArray) -> str:
    apart = " apart" if np.count_nonzero(blend) > 1 else ""
    return (
        f"{blend_named(rig, blend)} cannot be told{apart}: {blend_in_words(rig, blend)} drowns in the noise"
    )


def paper_conditions(
    config: RigConfig, discrete: Discrete, gain: FloatArray, recorded: Recorded | None
) -> dict[str, Any] | None:
    """Evaluate (11), (12) and the special case (14), (15) over the recording's last window; None without one.

    The observer of `gain` (n, p) runs on the nominal model, as the paper's does.
    """
    first, end = (
        max(recorded.pieces, key=lambda piece: piece[1] - piece[0]) if recorded is not None else (0, 0)
    )
    there = [length for length in windows(config) if length <= end - first]
    if recorded is None or not there:
        return None
    length = max(there)
    y = recorded.y[first:end]
    u = with_constant(recorded.u[first:end], discrete.model.m)
    x0 = recorded.first_state(discrete, first, first + length) - discrete.B1 @ u[0]
    x = observe(discrete.model, gain, y, u, x0)[-length - 1 :]
    states = state_batch(discrete.model, x, u[-length:])
    outputs = output_batch(discrete.model, x[:-1], y[-length:], u[-length:])
    solution = general_solution(states)
    one = [special_case_defect(solution.base, state) for state in x[: -1 : max(1, length // 50)]]
    return {
        "window_s": length / config.rig.sample_rate_hz,
        "condition_11": {
            "defect_states": existence(states).defect,
            "defect_outputs": existence(outputs).defect,
        },
        "condition_12": {"rank": existence(states).rank, "rank_joined": existence(states).rank_joined},
        "condition_15": {
            "z_zero": solution.rank == discrete.model.n,
            "defect_of_one_sample": float(np.median(one)),
        },
    }


def recentring_ratio(
    config: RigConfig, rig: RigModel, discrete: Discrete, gain: FloatArray, recorded: Recorded | None
) -> dict[str, Any] | None:
    """Say whether re-centred passes reach parameters that are the nominal ones; None with another method."""
    if config.estimator.method != "seed":
        return None
    length = max(windows(config))
    if recorded is not None and recorded.pieces:
        first, end = max(recorded.pieces, key=lambda piece: piece[1] - piece[0])
        u = with_constant(recorded.u[first:end], discrete.model.m)
    else:
        u = assumed_excitation(config, discrete, rig, length).u
    u = u[-min(len(u), 4 * length) :]
    found = recentring(discrete.model, gain, _sizes(rig), u, np.zeros(discrete.model.n), min(length, len(u)))
    return {"ratio": found.ratio, "independent": found.independent, "converges": found.converges}


def recentring_faults(found: Mapping[str, Any] | None) -> list[Fault]:
    """Warn where passes do not reach the right parameters."""
    if found is None or found["converges"]:
        return []
    what = (
        "re-centred passes do not reach the right parameters: "
        f"a step is {found['ratio']:.4g} of the one before"
    )
    advice = 'take faster poles, measure more states, or method = "window-ml"; rows will say diverged'
    return [Fault("estimator.method", what, advice)]
