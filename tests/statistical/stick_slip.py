"""A mass on a spring with dry friction, solved from event to event, and what the agent says of it.

Between two events (the mass stops, breaks loose) the equations are linear with a force on a straight line, so
each piece is exact; the instant of an event is found by bisection.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.linalg import expm

from agent.blocks.friction import dry_friction
from agent.config import load
from agent.runtime.assembly.methods import make_estimation
from agent.types import FloatArray, Samples, Status

MASS, SPRING, DAMPER = 5.0, 200.0, 10.0
PERIOD = 1e-3
WINDOW = 2000
TEXT = """
[rig]
name = "slider"
sample_rate_hz = 1000.0
clock = "counter"
[model]
kind = "mass-spring-damper"
mass = [{{ name = "m", value = 5.0 }}]
spring = [{{ name = "k", between = ["ground", "m"], nominal = 200.0 }}]
damper = [{{ name = "c", between = ["ground", "m"], nominal = 10.0 }}]
friction = [{{ name = "Fc", between = ["ground", "m"], nominal = {nominal} }}]
[[channel]]
name = "f"
quantity = "force"
at = "m"
unit = "N"
[[channel]]
name = "x"
quantity = "displacement"
at = "m"
unit = "m"
noise_sd = {noise}
[estimator]
window_s = 2.0
estimate = ["k", "c", "Fc"]
[[alarm]]
parameter = "k"
limit_percent = 10.0
[[alarm]]
parameter = "c"
limit_percent = 30.0
"""


def _generator(way: int, friction: float) -> FloatArray:
    """Of (v, x, F, F', 1) while it slides that way."""
    A = np.zeros((5, 5))
    A[0] = [-DAMPER / MASS, -SPRING / MASS, 1.0 / MASS, 0.0, -way * friction / MASS]
    A[1, 0] = A[2, 3] = 1.0
    return A


def slide(force: FloatArray, friction: float) -> tuple[FloatArray, FloatArray]:
    """Return displacement and velocity (N,) at the samples of a force (N,), from rest."""
    generators = {way: _generator(way, friction) for way in (-1, 1)}
    whole = {way: np.asarray(expm(A * PERIOD)) for way, A in generators.items()}
    x, v = np.zeros(len(force)), np.zeros(len(force))
    z, way = np.zeros(5), 0
    for k in range(len(force) - 1):
        z[2:] = force[k], (force[k + 1] - force[k]) / PERIOD, 1.0
        left = PERIOD
        while left > 1e-15:
            if not way:
                left, way = _held(z, left, friction)
                continue
            z_end = (whole[way] if left == PERIOD else expm(generators[way] * left)) @ z
            if z_end[0] * way >= 0.0:
                z, left = z_end, 0.0
                continue
            stop = _stop(generators[way], z, way, left)
            z = expm(generators[way] * stop) @ z
            z[0], left = 0.0, left - stop
            push = z[2] - SPRING * z[1]
            way = 0 if abs(push) <= friction else int(np.sign(push))
        x[k + 1], v[k + 1] = z[1], z[0]
    return x, v


def _held(z: FloatArray, left: float, friction: float) -> tuple[float, int]:
    """Pass the time that a mass sticks; return what is left and which way it breaks loose (0: not yet)."""
    push = z[2] - SPRING * z[1]
    end = push + z[3] * left
    if abs(push) > friction:
        return left, int(np.sign(push))
    if abs(end) <= friction:
        z[2] += z[3] * left
        return 0.0, 0
    after = (np.sign(end) * friction - push) / z[3]
    z[2] += z[3] * after
    return left - after, int(np.sign(end))


def _stop(A: FloatArray, z: FloatArray, way: int, left: float) -> float:
    """Return when a velocity comes to zero, as the first instant of the other sign."""
    low, high = 0.0, left
    for _ in range(45):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if (expm(A * middle) @ z)[0] * way >= 0.0 else (low, middle)
    return high


@dataclass(frozen=True, slots=True)
class Case:
    """Friction, N: true and of the configuration; noise of the displacement, m; strength of the force."""

    friction: float
    nominal: float
    noise: float = 1e-6
    strength: float = 1.0
    windows: int = 7


def run(case: Case, seed: int) -> tuple[FloatArray, FloatArray, float]:
    """(windows, 3) which of k, c, Fc are valid, and errors over half widths (1 is the edge), the share that
    sticks.

    The first window is left out.
    """
    rng = np.random.default_rng([seed, 3])
    samples = (case.windows + 1) * WINDOW
    t, phase = np.arange(samples) * PERIOD, rng.uniform(0.0, 2.0 * np.pi, 2)
    slow, fast = 60.0 * np.sin(1.4 * np.pi * t + phase[0]), 40.0 * np.sin(3.8 * np.pi * t + phase[1])
    force = case.strength * (slow + fast + rng.normal(0.0, 5.0, samples))
    x, v = slide(force, case.friction)
    y = x + case.noise * rng.standard_normal(samples)
    with TemporaryDirectory() as folder:
        file = Path(folder) / "slider.toml"
        file.write_text(TEXT.format(nominal=case.nominal, noise=case.noise), encoding="utf-8")
        config = load(file)
    estimation, friction = make_estimation(config, np.zeros(1)), dry_friction(config, np.zeros(1))
    batches = []
    for index in np.split(np.arange(samples, dtype=np.int64), range(WINDOW, samples, WINDOW)):
        taken = Samples(index, index * 1_000_000, force[index, None], y[index, None], 0)
        batches.append(estimation.step(replace(taken, u=friction.step(taken))).batch)
    rows, value, upper, status = (
        np.concatenate([getattr(batch, part) for batch in batches if batch is not None])
        for part in ("index", "value", "upper", "status")
    )
    ends = np.searchsorted(rows, np.arange(2, case.windows + 2) * WINDOW - 1)
    truth = np.array([SPRING, DAMPER, case.friction])
    wrong = np.abs(value[ends] - truth) / (upper[ends] - value[ends])
    return status[ends] == Status.VALID, wrong, float(np.mean(v == 0.0))
