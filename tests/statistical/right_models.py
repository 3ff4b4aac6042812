"""Random rigs whose configuration is right: errors and intervals against the bound of the noise simulated."""

from dataclasses import dataclass, replace

import numpy as np

from agent.types import EstimateBatch, FloatArray, Status
from sim_bus.rig.plant import equations, step
from tests.statistical.chains import Chain
from tests.statistical.nearly_right import Case, Play, records

WINDOWS, SETTLE = 20, 2
RATES_HZ = (50.0, 200.0, 1000.0, 5000.0, 20_000.0)
EXACT: dict[str, object] = {"sd_percent": 0.0, "gain_sd_percent": 0.0, "delay_sd_s": 0.0}
NOISE_SHARE = 3e-3
"""Sensor noise as a share of each output's rms."""
SAMPLES_A_PERIOD, PERIODS, MOST_SAMPLES = 40, 4, 4000
KINDS = ("displacement", "velocity", "acceleration")


def rig(seed: int) -> Chain:
    """A chain of 1 to 6 masses, its fastest mode at a fortieth of the sampling rate, four slow periods a
    window."""
    rng = np.random.default_rng([seed, 61])
    count, rate = 1 + seed % 6, RATES_HZ[seed % len(RATES_HZ)]
    masses, shape = rng.uniform(1, 3, count), rng.uniform(0.7, 1.4, count)
    E = np.eye(count) - np.eye(count, k=-1)
    lam = np.sort(np.sqrt(np.linalg.eigvals(np.diag(1 / masses) @ E.T @ np.diag(shape) @ E).real))
    scale = (2 * np.pi * rate / SAMPLES_A_PERIOD / lam[-1]) ** 2
    springs = scale * shape
    slow, fast = np.sqrt(scale) * lam[0], np.sqrt(scale) * lam[-1]
    dampers = rng.uniform(0.05, 0.15, count) * springs / fast * 2
    samples = min(MOST_SAMPLES, round(PERIODS * 2 * np.pi / slow * rate))
    sensors = tuple((str(rng.choice(KINDS)) if i else "displacement", i) for i in range(count))
    window_s = 20 * max(4, round(samples / 20)) / rate
    return Chain(
        tuple(masses.tolist()), tuple(springs.tolist()), tuple(dampers.tolist()), rate, sensors,
        (1.0,) * count,
        window_s, force_n=10.0, force_hz=fast / (2 * np.pi),
    )  # fmt: skip


@dataclass(frozen=True)
class Errors:
    """Disjoint windows of one rig, (WINDOWS, q) each: error, stated sd in units of the bound; valid, held."""

    error: FloatArray
    sd: FloatArray
    valid: FloatArray
    held: FloatArray


def errors(seed: int) -> Errors:
    """Play one random rig and compare every disjoint window with its bound."""
    chain = rig(seed)
    return compared(chain, chain, np.random.default_rng([seed, 62]), WINDOWS)


def compared(chain: Chain, said: Chain, rng: np.random.Generator, windows: int) -> Errors:
    """Compare the disjoint windows of a chain with their bound; said: as it is configured."""
    play = Play.of(chain, rng, (windows + SETTLE) * chain.window + 1)
    forces = np.zeros((len(play.force), len(chain.masses)))
    forces[:, -1] = play.force
    y = chain.motion(forces)
    sigma = NOISE_SHARE * y.std(axis=0)
    said = replace(said, noise=tuple(sigma.tolist()))
    v = np.column_stack([play.force, y + sigma * rng.standard_normal(y.shape)])[SETTLE * chain.window : -1]
    given = records(Case(said, config=EXACT | {"limit_percent": 1e4}), v)
    batches = [r for r in given if isinstance(r, EstimateBatch)]
    parts = ("index", "value", "sd_repeat", "lower", "upper", "status")
    index, value, sd, lower, upper, status = (
        np.concatenate([getattr(b, part) for b in batches]) for part in parts
    )
    ends = np.searchsorted(index, (np.arange(windows) + 1) * chain.window - 1)
    bound = bounds(chain, forces, sigma)
    held = (lower[ends] <= chain.theta) & (chain.theta <= upper[ends])
    valid = status[ends] == Status.VALID
    return Errors((value[ends] - chain.theta) / bound, sd[ends] / bound, valid, held & valid)


def bounds(chain: Chain, forces: FloatArray, sigma: FloatArray) -> FloatArray:
    """(windows, q) Cramer-Rao bounds with unknown initial state, by central differences of the simulated
    motion."""
    columns = []
    for i, size in enumerate(chain.theta):
        change = np.zeros(len(chain.theta))
        change[i] = 1e-5 * size
        apart = [chain.motion(forces, thetas=[(0, chain.theta + sign * change)]) for sign in (1, -1)]
        columns.append((apart[0] - apart[1]) / 2e-5)
    psi = np.stack(columns, axis=2) / sigma[:, None]
    free = free_responses(chain) / sigma[:, None]
    Q = np.linalg.qr(free.reshape(-1, free.shape[2]))[0]
    out = []
    for w in range(SETTLE, len(forces) // chain.window):
        X = psi[w * chain.window : (w + 1) * chain.window].reshape(-1, psi.shape[2])
        for _ in range(2):
            X = X - Q @ (Q.T @ X)
        out.append(np.sqrt(np.diag(np.linalg.inv(X.T @ X))) * chain.theta)
    return np.array(out)


def free_responses(chain: Chain) -> FloatArray:
    """(W, p, n) free responses."""
    values = dict(zip(chain.names, chain.theta.tolist(), strict=True))
    motion = equations(chain.graph, values | {f"m{i + 1}": m for i, m in enumerate(chain.masses)})
    A = step(motion, 1 / chain.rate_hz).A
    C = np.array([motion.output(quantity, f"m{mass + 1}")[0] for quantity, mass in chain.sensors])
    power, out = np.eye(len(A)), []
    for _ in range(chain.window):
        out.append(C @ power)
        power = A @ power
    return np.array(out)
