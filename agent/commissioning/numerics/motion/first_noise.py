"""The noise of a rig before its windows are joined: looked for in a short window, settled in a whole one.

Of the first window all sources of noise are sought on all of their grids, from three joint fits. That grows
with its samples and says little more of a source in 10,000 than in 1,000: where windows are long, the first
look is at the part of one that moves most. A whole window then goes on from there, within reach of what is
known of sources; of parameters and constants a part says too little, and they begin at nominal again.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from agent.commissioning.tuning import BRIEF, BRIEF_SHARE, FROM, SEARCHED, TAUGHT
from agent.numerics.inference.learner import Learner
from agent.numerics.inference.posterior import Knowledge
from agent.numerics.inference.spectral.columns import Window
from agent.types import FloatArray

Progress = Callable[[str], None]


def first_noise(
    learner: Learner, windows: Sequence[Window], sigma: FloatArray, spread: FloatArray, progress: Progress
) -> Knowledge:
    """Return what windows of one length teach of noise, begun at nominal; sigma, spread (p,) of sensors."""
    chosen = _spread_out(windows)
    known = learner.prior(sigma, spread)
    length = max(BRIEF, int(BRIEF_SHARE * learner.window))
    if length < learner.window and len(windows) >= FROM:
        progress("looking for noise where it moves most")
        short = Learner(learner.rig, length, learner.p, np.exp(learner.log_floor), learner.wire)
        _, seen = short.learn(_liveliest(chosen, length), short.prior(sigma, spread), believe=True)
        known = _lengthened(seen, known)
        chosen = chosen[len(chosen) // 2 :][:1] if seen.noise.is_started else chosen
    for number, window in enumerate(chosen):
        progress(f"learning the noise: window {number + 1} of {len(chosen)}")
        _, known = learner.learn(window, known, believe=True)
    return known


def _spread_out(windows: Sequence[Window]) -> list[Window]:
    chosen = np.unique(np.linspace(0, len(windows) - 1, min(TAUGHT, len(windows))).round().astype(int))
    return [windows[i] for i in chosen.tolist()]


def _liveliest(windows: Sequence[Window], length: int) -> Window:
    """Return the part of windows without lost readings, of so many samples, whose outputs move most."""
    size = np.maximum(np.max([window.y.var(axis=0) for window in windows], axis=0), 1e-300)
    parts = [
        replace(window, y=window.y[here], u=window.u[here], slope=window.slope[here])
        for window in windows
        for here in (slice(a, a + length) for a in range(0, window.length - length + 1, length))
    ]
    return max(parts, key=lambda part: float(np.sum(part.y.var(axis=0) / size)))


def _lengthened(seen: Knowledge, prior: Knowledge) -> Knowledge:
    """Return what a short window taught for windows of the prior's length, whose bins have levels anew."""
    if not seen.noise.is_started:
        return prior
    of_bins = prior.noise
    noise = replace(seen.noise, power=of_bins.power, dof=of_bins.dof, places=of_bins.places, windows=SEARCHED)
    return replace(prior, noise=noise)
