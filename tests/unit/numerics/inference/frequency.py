"""The agent's window at chosen hyperparameters."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from agent.numerics.inference.learner import Learner
from agent.numerics.inference.linearise import Linearised
from agent.numerics.inference.posterior import Knowledge
from agent.numerics.inference.spectral.columns import Window, window_of
from tests.unit.numerics.inference.chain import ChainRig, DenseNoise

FloatArray = NDArray[np.float64]
W = 120
NO_CUTS = np.zeros(0, dtype=np.int64)


def learner_of(rig: ChainRig, window: int = W) -> Learner:
    return Learner(rig.rig, window, len(rig.seen), np.zeros(len(rig.seen)))


def knowledge(learner: Learner, noise: DenseNoise) -> Knowledge:
    """What is known when the noise is known: every bin kept, levels 1, intensities on nodes of their own."""
    known = learner.prior(noise.sigma, np.full(len(noise.sigma), 0.3))
    intensity = np.full(len(learner.sources), 1e-60)
    for a, source in enumerate(learner.sources):
        if source.kind == "force" and source.pole == 0:
            intensity[a] = max(noise.white[source.number], 1e-60)
        for kind, entries in (("force", noise.slow), ("sensor", noise.coloured)):
            for number, pole, sd in entries:
                if source.kind == kind and source.number == number and abs(source.pole - pole) < 1e-9:
                    intensity[a] = sd
    nodes = np.tile(1e-70 * 2.0 ** np.arange(4), (len(intensity), 1))
    held = replace(known.noise, intensity=intensity, nodes=nodes, log_weight=np.zeros_like(nodes), windows=1)
    return replace(known, noise=held, kept=learner.window // 2 + 1)


def linearised(
    learner: Learner, known: Knowledge, window: Window, cuts: NDArray[np.int64] = NO_CUTS
) -> Linearised:
    return learner.lineariser.point(window, known, known.theta, cuts)


def record(
    rig: ChainRig, rng: np.random.Generator, noise: DenseNoise, samples: int = W, force: float = 20.0,
    off: float = 1.03,
) -> tuple[Window, FloatArray, FloatArray]:  # fmt: skip
    """A window of a rig off by a factor, and its readings and forces."""
    u = force * rng.standard_normal((samples + 1, 1))
    x0 = 0.01 * rng.standard_normal(2 * rig.count)
    slope = np.diff(u, axis=0)
    y = rig.readings(off * rig.theta, np.zeros(rig.count + len(rig.seen) + 2), x0, u[1:], slope).real
    y = y + noise.sigma * rng.standard_normal(y.shape)
    return window_of(y, u[1:], u[0]), y, u[1:]


def in_time(columns: NDArray[np.complex128], window: int) -> FloatArray:
    """Columns (kept, p, c) on all bins as samples (Wp, c)."""
    return np.asarray(np.fft.irfft(columns, window, axis=0) * np.sqrt(window)).reshape(-1, columns.shape[-1])


def start_of(rig: ChainRig, at: Linearised, window: Window) -> FloatArray:
    """The initial state (n,) of the trajectory about which a window was linearised, read off its residual."""
    eta, n = np.zeros(len(rig.constants)), 2 * rig.count
    mean = window.y.reshape(-1) - in_time(at.regression.X[..., -1:], window.length)[:, 0]
    forced = rig.readings(at.theta, eta, np.zeros(n), window.u, window.slope).real.reshape(-1)
    free = [
        rig.readings(at.theta, eta, e, 0 * window.u, 0 * window.slope).real.reshape(-1) for e in np.eye(n)
    ]
    return np.asarray(np.linalg.lstsq(np.column_stack(free), mean - forced, rcond=None)[0])
