"""The noise of a rig before its windows are joined: looked for in a short window, settled in a whole one.

Of the first window all sources of noise are sought on all of their grids, from three joint fits. That grows
with its samples and says little more of a source in 10,000 than in 1,000: where windows are long, the first
look is at the beginning of one. A whole window then goes on from there, within reach of what is known.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from agent.numerics.inference.learner import Learner
from agent.numerics.inference.posterior import Knowledge
from agent.numerics.inference.spectral.columns import Window
from agent.types import FloatArray

TAUGHT = 3
"""Windows from which the noise is learnt: a window costs a hundred times more to learn from than to read."""
BRIEF, BRIEF_SHARE = 512, 0.1
"""Samples at least, and share of a window (a period of the slowest mode), of the first look."""
SOUGHT = 3
"""Windows behind a noise whose sources are not sought on all of their grids any more."""
Progress = Callable[[str], None]


def first_noise(
    learner: Learner, windows: Sequence[Window], sigma: FloatArray, spread: FloatArray, progress: Progress
) -> Knowledge:
    """Return what windows of one length teach of noise, begun at nominal; sigma, spread (p,) of sensors."""
    chosen = _spread_out(windows)
    known = learner.prior(sigma, spread)
    length = max(BRIEF, int(BRIEF_SHARE * learner.window))
    if length < learner.window:
        progress("looking for noise at the beginning")
        short = Learner(learner.rig, length, learner.p, np.exp(learner.log_floor))
        _, seen = short.learn(_beginning(chosen[0], length), short.prior(sigma, spread), believe=True)
        known = _lengthened(seen, known)
        chosen = chosen[len(chosen) // 2 :][:1] if seen.noise.is_started else chosen
    for number, window in enumerate(chosen):
        progress(f"learning the noise: window {number + 1} of {len(chosen)}")
        _, known = learner.learn(window, known, believe=True)
    return known


def _spread_out(windows: Sequence[Window]) -> list[Window]:
    chosen = np.unique(np.linspace(0, len(windows) - 1, min(TAUGHT, len(windows))).round().astype(int))
    return [windows[i] for i in chosen.tolist()]


def _beginning(window: Window, length: int) -> Window:
    """Return the first samples of a window without lost readings."""
    return replace(window, y=window.y[:length], u=window.u[:length], slope=window.slope[:length])


def _lengthened(seen: Knowledge, prior: Knowledge) -> Knowledge:
    """Return what a short window taught for windows of the prior's length, whose bins have levels anew."""
    if not seen.noise.is_started:
        return prior
    noise = replace(seen.noise, power=prior.noise.power, dof=prior.noise.dof, windows=SOUGHT)
    return replace(seen, noise=noise, kept=0, kept_for=None)
