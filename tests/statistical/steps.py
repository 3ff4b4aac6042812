"""Parameters that step, flicker or stay: what the product raises, when, and says of broken windows."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.records import Record
from agent.types import AlarmTransition, EstimateBatch, FloatArray, IntArray, Reason, Status
from sim_bus.rig.plant import GROUND
from tests.statistical.chains import TWO, Chain
from tests.statistical.nearly_right import Case, Play, records
from tests.statistical.random_rigs import Network

ON_DELAY_S, LIMIT_SHARE = 0.5, 0.6
BEFORE, AFTER, SETTLE = 5, 4, 2
"""Windows before and after a step, and before the recording."""
WITHIN = 1.6
"""Windows beyond the on-delay within which a step is alarmed."""


@dataclass(frozen=True)
class Step:
    """Changes of parameters as shares (q,) of themselves, and the alarm limit in per cent of nominal."""

    shares: tuple[float, ...]

    @property
    def limit_percent(self) -> float:
        """Limit at a share of the smallest change."""
        return 100 * LIMIT_SHARE * min(abs(s) for s in self.shares if s)


STEPS = {
    "k1 -5 %": Step((-0.05, 0, 0, 0)),
    "k2 +15 %": Step((0, 0.15, 0, 0)),
    "k1 -50 %": Step((-0.5, 0, 0, 0)),
    "k1 -15 %, k2 -15 %": Step((-0.15, -0.15, 0, 0)),
    "k1 -15 %, k2 +15 %": Step((-0.15, 0.15, 0, 0)),
    "B1 +50 %": Step((0, 0, 0.5, 0)),
    "B2 +15 %": Step((0, 0, 0, 0.15)),
    "k2 +50 %, B2 -50 %": Step((0, 0.5, 0, -0.5)),
}


LIGHT = Network(
    (4.0, 3.0, 2.5), (3.0e4, 2.5e4, 2.0e4, 1.5e4, 9.0e3), (6.8, 5.7, 4.5, 3.4, 2.0), 2000.0,
    (("displacement", 0), ("velocity", 1), ("acceleration", 2)), (7.9e-7, 6.4e-5, 9e-3),
    window_s=1.06, force_n=1.0, force_hz=35.0,
    spring_ends=((GROUND, "m1"), (GROUND, "m2"), ("m1", "m3"), ("m2", "m3"), ("m1", "m2")),
    damper_ends=((GROUND, "m1"), (GROUND, "m2"), ("m1", "m3"), ("m2", "m3"), ("m1", "m2")),
)  # fmt: skip
"""Lightly damped, with sensors so good that no parameters nearly fit a window that holds a change."""
GIVES_WAY, LASTS = -0.3, 1.5
"""Share of itself that a spring loses, and windows in which it does."""
PIECES = 200
"""Steps a window in which it is played."""


@dataclass(frozen=True)
class Raised:
    """What came of a step: delay of each alarm that had to be, s (NaN: none), and what else was alarmed."""

    delays: tuple[float, ...]
    wrong: tuple[str, ...]


def step(name: str, seed: int, chain: Chain = TWO) -> Raised:
    """Play one step of a chain; it falls anywhere in a window."""
    change = STEPS[name]
    rng = np.random.default_rng([seed, *name.encode()])
    W = chain.window
    at = BEFORE * W + int(rng.integers(W))
    after = chain.theta * (1 + np.array(change.shares))
    v = readings(chain, rng, at + AFTER * W, [(0, chain.theta), (at + SETTLE * W, after)])
    found = records(Case(chain, config={"limit_percent": change.limit_percent}), v)
    alarms = raised(found, chain)
    wanted = [n for n, s in zip(chain.names, change.shares, strict=True) if s]
    delays = tuple(
        next(((t - at) / chain.rate_hz for n, t in alarms if n == w and t >= at), np.nan) for w in wanted
    )
    wrong = tuple(n for n, t in alarms if n not in wanted or t < at)
    return Raised(delays, wrong)


def gives_way(seed: int, chain: Chain = LIGHT) -> Raised:
    """Play a spring that softens within some windows and then stays; masses as their data sheets say."""
    rng = np.random.default_rng([seed, 97])
    W = chain.window
    at, lasts = 12 * W + int(rng.integers(W)), int(LASTS * W)
    thetas = [(0, chain.theta)]
    for k in range(int(LASTS * PIECES)):
        softer = chain.theta.copy()
        softer[2] *= 1 + GIVES_WAY * (k + 1) / (LASTS * PIECES)
        thetas.append((SETTLE * W + at + k * W // PIECES, softer))
    masses = chain.masses * np.exp(0.02 * rng.standard_normal(len(chain.masses)))
    v = readings(chain, rng, at + lasts + 8 * W, thetas, masses.tolist())
    alarms = raised(records(Case(chain), v), chain)
    delay = next(((t - at) / chain.rate_hz for n, t in alarms if n == "k3"), np.nan)
    return Raised((delay,), tuple(n for n, t in alarms if n != "k3" or t < at))


def latest(chain: Chain = TWO) -> float:
    """Seconds after which a step has to be alarmed."""
    return ON_DELAY_S + WITHIN * chain.window_s


def readings(
    chain: Chain,
    rng: np.random.Generator,
    samples: int,
    thetas: Sequence[tuple[int, FloatArray]],
    masses: Sequence[float] = (),
) -> FloatArray:
    """Readings (samples, 1 + p) of a chain whose parameters change at samples counted from the settling's
    first; masses: the true ones, where they are not as configured."""
    play = Play.of(chain, rng, samples + SETTLE * chain.window + 1)
    forces = np.zeros((len(play.force), len(chain.masses)))
    forces[:, -1] = play.force
    y = chain.motion(forces, masses, thetas=thetas) + play.noise
    return np.column_stack([play.force, y])[SETTLE * chain.window : -1]


def raised(found: Sequence[Record], chain: Chain) -> list[tuple[str, int]]:
    """(parameter, sample) of every activation."""
    return [
        (r.parameter, round(r.t_ns * 1e-9 * chain.rate_hz))
        for r in found
        if isinstance(r, AlarmTransition) and r.to_state == "UNACK"
    ]


@dataclass(frozen=True)
class Rows:
    """All rows of a run: sample (N,), whether each parameter is valid (N, q), and `changing` (N,)."""

    index: IntArray
    valid: NDArray[np.bool_]
    changing: NDArray[np.bool_]


def rows(found: Sequence[Record]) -> Rows:
    """Join the rows of a run."""
    batches = [r for r in found if isinstance(r, EstimateBatch)]
    parts = ("index", "status", "reason")
    index, status, reason = (np.concatenate([getattr(b, part) for b in batches]) for part in parts)
    changing = (status == Status.INVALID) & (reason == Reason.CHANGING)
    return Rows(index, status == Status.VALID, changing.any(axis=1))


def healthy(seed: int, windows: int, chain: Chain = TWO) -> tuple[int, int]:
    """Hops of a healthy run, and how many of them were called changing."""
    v = readings(chain, np.random.default_rng([seed, 99]), windows * chain.window, [(0, chain.theta)])
    found = rows(records(Case(chain), v))
    return len(found.index), int(found.changing.sum())


def flicker(
    seed: int, share: float = -0.2, on_s: float = 0.3, every_s: float = 2.0, chain: Chain = TWO
) -> float:
    """Share of the rows whose windows hold some of a fault that comes and goes, and that are neither invalid
    nor alarmed."""
    W, rate = chain.window, chain.rate_hz
    samples = 20 * W
    weak = chain.theta.copy()
    weak[0] *= 1 + share
    starts = np.arange(6 * W, samples - W, round(every_s * rate))
    thetas = [(0, chain.theta)]
    for start in starts:
        thetas += [
            (int(start) + SETTLE * W, weak),
            (int(start) + SETTLE * W + round(on_s * rate), chain.theta),
        ]
    v = readings(chain, np.random.default_rng([seed, 98]), samples, thetas)
    given = records(Case(chain, config={"limit_percent": 10.0}), v)
    found = rows(given)
    alarmed = [t for n, t in raised(given, chain) if n == "k1"]
    # whole faults inside: those that only just begin cannot be seen
    holds = np.array(
        [np.any((starts > i - 0.8 * W) & (starts + on_s * rate < i - 0.1 * W)) for i in found.index]
    )
    known = ~found.valid[:, 0] | np.array([any(t <= i for t in alarmed) for i in found.index])
    return float((holds & ~known).sum() / max(holds.sum(), 1))
