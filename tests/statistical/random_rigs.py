"""Random rigs that are no chains, their forces, and ways in which a configuration of them is nearly right.

One to four masses in a random tree, further springs across it and to the ground, dampers beside most of the
springs; displacements, accelerometers or velocities, sometimes one fewer than masses; a force of one of five
kinds on the last mass. A rig is drawn anew until the noise of its sensors lets a window know every parameter
(`bounds`).
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.signal import chirp

from agent.types import FloatArray
from sim_bus.rig.plant import GROUND, Graph, Link, equations
from tests.statistical.chains import Chain
from tests.statistical.nearly_right import (
    SCALE,
    Case,
    Change,
    Found,
    Play,
    coloured,
    digits,
    drift,
    gains,
    held,
    masses,
    pushed,
    read_noise,
    said,
)
from tests.statistical.right_models import free_responses

SETTLE = 2
PERIODS = (8.0, 16.0)
"""Periods of the slowest mode that a window holds."""
WINDOW_S = (0.3, 10.0)
RATE_HZ = (50.0, 10_000.0)
SAMPLES_A_PERIOD = (20.0, 50.0)
"""Of the fastest mode."""
MOST_SAMPLES = 3000
MODES_HZ = (0.5, 500.0)
DAMPING = (0.005, 0.2)
KNOWN, KNOWN_WHOLE = 0.015, 0.12
"""Relative sd by which one window must know every parameter: by its sensors' noise alone, and with masses,
gains and the delay within their data sheets."""
LIMIT = 5.0
"""Least alarm limits in those sds, shares of nominal (else 15 %): a third of a limit has to be resolved."""
SHEETS = {"mass": 0.02, "gain": 0.01, "delay": 0.25}
NOISE_SHARE = (1e-4, 1e-2)
"""Sensor noise as a share of each output's rms."""
HUM_HZ = 50.0
STANDARD_GRAVITY = 9.80665
SIZES = (0.2, 0.4, 0.3, 0.1)
"""Shares of rigs with one mass and more."""
STEP = 1e-5
"""Relative step of central differences."""


@dataclass(frozen=True)
class Network(Chain):
    """A rig whose springs and dampers stand between any two places.

    Attributes:
        spring_ends, damper_ends: places of each.
        kind: how the measured force runs;  limit: of every parameter's change, a share.
    """

    spring_ends: tuple[tuple[str, str], ...] = ()
    damper_ends: tuple[tuple[str, str], ...] = ()
    kind: str = "noise"
    limit: float = 0.15

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(link.name for link in (*self.graph.springs, *self.graph.dampers))

    @property
    def graph(self) -> Graph:
        nodes = tuple(f"m{i + 1}" for i in range(len(self.masses)))
        springs = tuple(Link(f"k{i + 1}", ends) for i, ends in enumerate(self.spring_ends))
        dampers = tuple(Link(f"B{i + 1}", ends) for i, ends in enumerate(self.damper_ends))
        return Graph(nodes, springs, dampers)

    def force(self, rng: np.random.Generator, samples: int) -> FloatArray:
        u = FORCES[self.kind](self, rng, samples)
        return np.asarray(self.force_n * u / u.std())


def poles(rig: Chain) -> tuple[FloatArray, FloatArray]:
    """Frequencies in Hz and dampings of the modes, slowest first; overdamped ones have damping 1."""
    values = dict(zip(rig.names, rig.theta.tolist(), strict=True))
    F = equations(rig.graph, values | {f"m{i + 1}": m for i, m in enumerate(rig.masses)}).F
    lam = np.linalg.eigvals(F)
    lam = lam[lam.imag >= 0]
    size = np.abs(lam)
    order = np.argsort(size)
    return size[order] / (2 * np.pi), (-lam.real / size)[order]


# ------------------------------------------------------------------ forces
def _filtered(rig: Chain, rng: np.random.Generator, samples: int) -> FloatArray:
    return Chain.force(rig, rng, samples)


def _multisine(rig: Chain, rng: np.random.Generator, samples: int) -> FloatArray:
    """Tones from half the slowest mode to the bandwidth, four windows a period."""
    long = 4 * rig.window
    f = np.arange(1, long // 2) * rig.rate_hz / long
    tones = f[(f > 0.5 * poles(rig)[0][0]) & (f < rig.force_hz)]
    tones = tones[np.sort(rng.permutation(len(tones))[: max(30, len(tones) // 3)])]
    t = np.arange(samples) / rig.rate_hz
    u = np.zeros(samples)
    for hz, phase in zip(tones, rng.uniform(0, 2 * np.pi, len(tones)), strict=True):
        u += np.cos(2 * np.pi * hz * t + phase)
    return u


def _chirp(rig: Chain, rng: np.random.Generator, samples: int) -> FloatArray:
    """A sweep a window, from half the slowest mode to the bandwidth and back."""
    t = np.arange(rig.window) / rig.rate_hz
    up = chirp(t, 0.5 * poles(rig)[0][0], t[-1], rig.force_hz, phi=float(rng.uniform(0, 360)))
    both = np.concatenate([up, up[::-1]])
    return np.tile(both, samples // len(both) + 1)[:samples]


def _steps(rig: Chain, rng: np.random.Generator, samples: int) -> FloatArray:
    """Levels that last two to five periods of the fastest mode."""
    period = rig.rate_hz / poles(rig)[0][-1]
    lasts = np.maximum(2, rng.uniform(1, 8, samples) * period).astype(int)
    count = int(np.searchsorted(np.cumsum(lasts), samples)) + 1
    return np.repeat(rng.standard_normal(count), lasts[:count])[:samples]


def _blows(rig: Chain, rng: np.random.Generator, samples: int) -> FloatArray:
    """Four or more blows a window, half sines of half a period of the fastest mode."""
    width = max(4, round(0.5 * rig.rate_hz / poles(rig)[0][-1]))
    u = np.zeros(samples + rig.window)
    shape = np.sin(np.pi * np.arange(width + 1) / width)
    for start in range(0, samples, rig.window // 4):
        at = start + int(rng.integers(rig.window // 4))
        u[at : at + width + 1] += rng.uniform(0.5, 1.5) * shape[: len(u) - at]
    return u[:samples]


FORCES: dict[str, Callable[[Chain, np.random.Generator, int], FloatArray]] = {
    "noise": _filtered, "multisine": _multisine, "chirp": _chirp, "steps": _steps, "blows": _blows,
}  # fmt: skip


# ------------------------------------------------------------------ rigs
def rig(seed: int, driven: bool = False) -> Network:
    """The rig of a seed; driven: with an accelerometer where the force acts."""
    rng = np.random.default_rng([seed, 71])
    count, kind = int(rng.choice(4, p=SIZES)) + 1, str(rng.choice(list(FORCES)))
    while True:
        found = _drawn(rng, count, kind, driven)
        if found is not None:
            return found


def _drawn(rng: np.random.Generator, count: int, kind: str, driven: bool) -> Network | None:
    """A rig, or None where the draw is none: its modes, dampings or sensors do not do."""
    spring_ends = _springs(rng, count)
    damped = [ends for i, ends in enumerate(spring_ends) if i < count or rng.random() < 0.6]
    mass, shape = rng.uniform(1, 3, count), rng.uniform(0.5, 2.0, len(spring_ends))
    damping = rng.uniform(0.5, 2.0, len(damped))
    unit = Network(
        tuple(mass.tolist()), tuple(shape.tolist()), tuple((1e-3 * damping).tolist()), 1.0, (), (),
        spring_ends=spring_ends, damper_ends=tuple(damped),
    )  # fmt: skip
    hz, ratio = poles(unit)
    fast = 10 ** rng.uniform(*np.log10(MODES_HZ))
    speed = fast / hz[-1]
    middle = float(np.exp(rng.uniform(*np.log(DAMPING))))
    damping *= 1e-3 * middle / float(np.exp(np.log(ratio).mean())) * speed
    weight = 10 ** rng.uniform(-1.5, 1.5)
    slow = fast * hz[0] / hz[-1]
    rate = _round(fast * rng.uniform(*SAMPLES_A_PERIOD))
    window_s = rng.uniform(*PERIODS) / slow
    window_s = max(window_s, WINDOW_S[0])
    samples = 20 * round(window_s * rate / 20)
    rate_ok = RATE_HZ[0] <= rate <= RATE_HZ[1] and 200 <= samples <= MOST_SAMPLES
    if not rate_ok or slow < MODES_HZ[0] or window_s > WINDOW_S[1]:
        return None
    made = replace(
        unit, masses=tuple((weight * mass).tolist()), springs=tuple((weight * speed**2 * shape).tolist()),
        dampers=tuple((weight * damping).tolist()), rate_hz=rate, window_s=samples / rate,
        sensors=_sensors(rng, count, driven), force_n=float(10 ** rng.uniform(-1, 2)),
        force_hz=float(fast * rng.uniform(0.7, 1.5)), kind=kind,
    )  # fmt: skip
    dampings = poles(made)[1]
    return _seen(made, rng) if 0.8 * DAMPING[0] <= dampings.min() and dampings.max() < 0.25 else None


def _springs(rng: np.random.Generator, count: int) -> tuple[tuple[str, str], ...]:
    """A random tree from the ground, and up to two springs more between places that have none yet."""
    names = [GROUND, *(f"m{i + 1}" for i in rng.permutation(count))]
    tree = [(names[int(rng.integers(i))], names[i]) for i in range(1, count + 1)]
    apart = [
        (a, b)
        for i, a in enumerate(names)
        for b in names[i + 1 :]
        if (a, b) not in tree and (b, a) not in tree
    ]
    more = int(rng.integers(0, 3))
    return (*tree, *(apart[i] for i in rng.permutation(len(apart))[:more]))


def _sensors(rng: np.random.Generator, count: int, driven: bool) -> tuple[tuple[str, int], ...]:
    places = list(range(count))
    if count > 1 and rng.random() < 0.25 and not driven:
        places.remove(int(rng.integers(count)))
    felt = float(rng.choice([0.0, 0.3, 0.6]))
    kinds = ["acceleration" if rng.random() < felt else "displacement" for _ in places]
    if rng.random() < 0.15:
        kinds[0] = "velocity"
    if driven:
        kinds[-1] = "acceleration"
    return tuple((kind, place) for kind, place in zip(kinds, places, strict=True))


def _seen(made: Network, rng: np.random.Generator) -> Network | None:
    """The rig with sensors good enough that a window knows every parameter, None where no usual one is."""
    forces = np.zeros(((SETTLE + 4) * made.window, len(made.masses)))
    forces[:, -1] = made.force(rng, len(forces))
    rms = made.motion(forces)[SETTLE * made.window :].std(axis=0)
    share = np.exp(rng.uniform(*np.log(NOISE_SHARE)))
    if not rms.all():  # nothing passes the force on through the ground
        return None
    own, whole = bounds(made, forces, rms)
    share = min(share, KNOWN / own)
    if not share > NOISE_SHARE[0] or not whole < KNOWN_WHOLE:
        return None
    limit = max(made.limit, _round(LIMIT * float(np.hypot(share * own, whole))))
    return replace(made, noise=tuple(float(f"{s:.3g}") for s in share * rms), limit=limit)


def bounds(made: Chain, forces: FloatArray, sigma: FloatArray) -> tuple[float, float]:
    """Largest relative sds of a parameter after the window at `SETTLE`: by noise sigma (p,) alone, and by
    constants within their data sheets alone, its estimate as good as that noise allows.

    Central differences of the simulated motion, the initial state unknown (Cramer-Rao).
    """
    part = slice(SETTLE * made.window, (SETTLE + 1) * made.window)
    thetas = [made.theta * (1 + sign * STEP * e) for e in np.eye(len(made.theta)) for sign in (1, -1)]
    moved = [made.motion(forces, thetas=[(0, theta)])[part] for theta in thetas]
    weights = [
        (np.array(made.masses) * (1 + sign * STEP * e)).tolist()
        for e in np.eye(len(made.masses))
        for sign in (1, -1)
    ]
    moved += [made.motion(forces, masses=weight)[part] for weight in weights]
    columns = [(a - b) / (2 * STEP) for a, b in zip(moved[::2], moved[1::2], strict=True)]
    y = made.motion(forces)
    columns += [y[part] * e for e in np.eye(y.shape[1])]
    columns += [y[part], (y[1:] - y[:-1])[part]]
    sheets = [SHEETS["mass"]] * len(made.masses) + [SHEETS["gain"]] * (y.shape[1] + 1) + [SHEETS["delay"]]
    X = (np.stack(columns, axis=2) / sigma[:, None]).reshape(-1, len(columns))
    Q = np.linalg.qr((free_responses(made) / sigma[:, None]).reshape(-1, 2 * len(made.masses)))[0]
    for _ in range(2):
        X = X - Q @ (Q.T @ X)
    q = len(made.theta)
    V = np.linalg.pinv(X[:, :q].T @ X[:, :q])
    moves = V @ X[:, :q].T @ X[:, q:] * np.array(sheets)
    variance = np.where(np.diag(V) > 0, np.diag(V), np.inf)  # without digits: nothing tells it
    return float(np.sqrt(variance).max()), float(np.sqrt((moves**2).sum(axis=1)).max())


def _round(value: float) -> float:
    """Two digits of a number."""
    return float(f"{value:.2g}")


# ------------------------------------------------------------------ imperfections
@dataclass(frozen=True)
class Fault:
    """One way in which a configuration is nearly right.

    Attributes:
        kind: what it is called.
        changes, config, right: as in `Case`.
    """

    kind: str
    changes: tuple[Change, ...] = ()
    config: dict[str, object] = field(default_factory=dict)
    right: frozenset[str] = frozenset()


def _stated(rig: Network, rng: np.random.Generator) -> Fault:
    factor = float(rng.choice([0.92, 0.83, 0.5, 2.0]))
    return Fault("noise stated", config={"noise": tuple(factor * s for s in rig.noise)})


def _not_stated(rig: Network, _: np.random.Generator) -> Fault:
    return Fault("noise not stated", config={"noise": (None,) * len(rig.noise)})


def _one_mass(rig: Network, rng: np.random.Generator) -> Fault:
    """One mass is off; of one mass alone the scale is."""
    which, size = int(rng.integers(len(rig.masses))), rng.uniform(0.03, 0.2) * rng.choice([-1, 1])
    factors = [1.0] * len(rig.masses)
    factors[which] += size
    alone = frozenset({"force", *rig.outputs}) if len(factors) == 1 else frozenset()
    return Fault("one mass", (masses(*factors),), right=alone | {f"m{which + 1}"})


def _all_masses(rig: Network, rng: np.random.Generator) -> Fault:
    factor = 1 + rng.uniform(0.03, 0.2) * rng.choice([-1, 1])
    alone = frozenset({"m1", *rig.outputs}) if len(rig.masses) == 1 else frozenset()
    only = frozenset(rig.outputs) if len(rig.outputs) == 1 else frozenset()
    return Fault("all masses", (masses(*[factor] * len(rig.masses)),), right=SCALE | alone | only)


def _drift(rig: Network, rng: np.random.Generator) -> Fault:
    which = int(rng.integers(len(rig.sensors)))
    name = rig.outputs[which]
    right = {name, f"{name} drifts"}
    if len(rig.sensors) == 1:
        right |= SCALE | {f"{scale} drifts" for scale in SCALE} | {"m1"}
    return Fault("gain drifts", (drift(which, 0.05),), right=frozenset(right))


def _outputs(rig: Network, _: np.random.Generator) -> Fault:
    alone = frozenset({"m1"}) if len(rig.masses) == 1 else frozenset()
    only = frozenset(rig.outputs) if len(rig.outputs) == 1 else frozenset()
    return Fault("all outputs", (gains(*[0.9] * len(rig.sensors)),), right=SCALE | alone | only)


def _one_output(rig: Network, rng: np.random.Generator) -> Fault:
    which, size = int(rng.integers(len(rig.sensors))), rng.uniform(0.03, 0.05)
    factors = [1.0] * len(rig.sensors)
    factors[which] += size
    alone = SCALE | {"m1"} if len(rig.sensors) == 1 else frozenset()
    return Fault("one output", (gains(*factors),), right=alone | {rig.outputs[which]})


def _read_noise(_: Network, rng: np.random.Generator) -> Fault:
    return Fault("force noise", (read_noise(float(rng.uniform(0.002, 0.005))),))


def _pushed(rig: Network, rng: np.random.Generator) -> Fault:
    share, mass = float(rng.uniform(0.005, 0.025)), int(rng.integers(len(rig.masses)))
    return Fault("unknown force", (pushed(share * rig.force_n, 0.99, mass),))


def _hum(rig: Network, rng: np.random.Generator) -> Fault:
    """As much in each output as one to three times its noise."""
    sd = float(rng.uniform(1, 3)) * np.array(rig.noise)
    hz = HUM_HZ

    def spoil(play: Play, _: np.random.Generator) -> None:
        t = np.arange(len(play.force)) / rig.rate_hz
        play.noise = play.noise + sd * np.sqrt(2) * np.sin(2 * np.pi * hz * t)[:, None]

    return Fault("hum", (spoil,))


def _held(_: Network, __: np.random.Generator) -> Fault:
    return Fault("held", (held,), right=frozenset({"delay"}))


def _digits(_: Network, __: np.random.Generator) -> Fault:
    return Fault("three digits", (digits(3),))


def _digits_of_g(_: Network, __: np.random.Generator) -> Fault:
    """Such a table, whose scale makes SI of it: there it has steps of no decimal number."""
    return Fault("three digits of g", (digits(3, STANDARD_GRAVITY),), {"scale": STANDARD_GRAVITY})


def _coloured(_: Network, __: np.random.Generator) -> Fault:
    return Fault("AR sensors", (coloured(0.95),))


def _gain(rig: Network, rng: np.random.Generator) -> Fault:
    n, fast = 2 * len(rig.masses), 2 * np.pi * poles(rig)[0][-1]
    where = ", ".join(f"{-fast * (2 + 0.2 * i):.5g}" for i in range(n))
    sds = ", ".join(["0.5"] * len(rig.masses))
    text = {
        "gain by poles": f'[estimator.observer]\ngain = "poles"\npoles = [{where}]',
        "gain by kalman": f'[estimator.observer]\ngain = "kalman"\nprocess_sd = [{sds}]',
    }
    return Fault("gain", config={"observer": text[str(rng.choice(list(text)))]})


def _sheets(rig: Network, rng: np.random.Generator) -> Fault:
    """Every mass and gain is off, as far as its data sheet says."""
    mass = np.exp(SHEETS["mass"] * rng.standard_normal(len(rig.masses)))
    force, *outputs = np.exp(SHEETS["gain"] * rng.standard_normal(1 + len(rig.sensors)))

    def scaled(play: Play, _: np.random.Generator) -> None:
        play.read = force * play.read

    return Fault("data sheets", (masses(*mass), gains(*outputs), scaled))


FAULTS: dict[str, Callable[[Network, np.random.Generator], Fault]] = {
    "noise stated": _stated, "noise not stated": _not_stated, "one mass": _one_mass,
    "all masses": _all_masses, "gain drifts": _drift, "all outputs": _outputs, "one output": _one_output,
    "force noise": _read_noise, "unknown force": _pushed, "hum": _hum, "held": _held,
    "three digits": _digits, "AR sensors": _coloured, "gain": _gain,
}  # fmt: skip
DRIVEN = frozenset({"driving-point force noise"})
SCALED: dict[str, Callable[[Network, np.random.Generator], Fault]] = {"three digits of g": _digits_of_g}
DRAWN: dict[str, Callable[[Network, np.random.Generator], Fault]] = {"data sheets": _sheets}
"""What is right of nineteen rigs in twenty, by the meaning of a data sheet: counted over rigs."""
PAIRS = (
    ("one mass", "hum"), ("gain drifts", "unknown force"), ("noise stated", "one mass"),
    ("AR sensors", "one output"), ("force noise", "one output"), ("hum", "unknown force"),
    ("one mass", "unknown force"), ("three digits", "noise stated"), ("force noise", "one mass"),
    ("hum", "all outputs"), ("AR sensors", "one mass"), ("unknown force", "three digits"),
    ("force noise", "hum"), ("gain drifts", "one mass"), ("gain drifts", "all masses"),
)  # fmt: skip

APART = ({"noise stated", "noise not stated"}, {"one mass", "all masses"})
"""Kinds of which one undoes the other."""


def drawn(seed: int) -> tuple[str, ...]:
    """None to three kinds that go together, drawn at random."""
    rng = np.random.default_rng(seed)
    while True:
        count = int(rng.choice(4, p=[0.1, 0.3, 0.5, 0.1]))
        kinds = tuple(rng.choice(sorted(FAULTS), count, replace=False).tolist())
        if not any(apart <= set(kinds) for apart in APART):
            return kinds


def case(seed: int, kinds: tuple[str, ...]) -> Case:
    """The rig of a seed with imperfections of kinds."""
    driven = bool(DRIVEN.intersection(kinds))
    for own in _seeds(seed):
        made = rig(own, driven)
        if _is_seen(made) and ("hum" not in kinds or made.rate_hz > 2.5 * HUM_HZ):
            break
    rng = np.random.default_rng([seed, 72])
    known = FAULTS | SCALED | DRAWN
    faults = [known["force noise" if kind in DRIVEN else kind](made, rng) for kind in kinds]
    config: dict[str, object] = {"limit_percent": 100 * made.limit}
    config |= {key: value for fault in faults for key, value in fault.config.items()}
    right = frozenset().union(*(fault.right for fault in faults))
    return Case(made, tuple(change for fault in faults for change in fault.changes), config, right)


def _is_seen(made: Network) -> bool:
    """Whether every mass is measured, or held to one that is, not only to the ground: others are refused."""
    seen = {f"m{number + 1}" for _, number in made.sensors}
    ends = [set(pair) for pair in (*made.spring_ends, *made.damper_ends) if "ground" not in pair]
    for _ in made.masses:
        seen |= {name for pair in ends if pair & seen for name in pair}
    return len(seen) == len(made.masses)


def _seeds(seed: int) -> Iterator[int]:
    while True:
        yield seed
        seed += 100_000


def play(seed: int, kinds: tuple[str, ...], recording: int, windows: int) -> Found:
    """What the product says of one recording of the rig of a seed."""
    one = case(seed, kinds)
    rng = np.random.default_rng([seed, recording, 73])
    first = SETTLE * one.chain.window
    made = Play.of(one.chain, rng, first + windows * one.chain.window + 1)
    for change in one.changes:
        change(made, rng)
    return said(one, made.readings()[first:-1])
