"""Recordings of rigs whose configuration is nearly right, and what the product says of them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from scipy.signal import lfilter

from agent.records import HealthEvent, Record
from agent.runtime.replay import SOURCE, make_pipeline
from agent.types import AlarmTransition, EstimateBatch, FloatArray, Status, Verdict
from drivers.port import SampleBlock
from tests.statistical.chains import DRIVEN, FELT, ONE, SHAKEN, SLOW, SMALL, THREE, TWO, Chain

SETTLE_WINDOWS = 2
SLACK_SD = 3.0
"""Standard deviations of a count by which a share may lie below its bound."""
BLOCK = 5000
Change = Callable[["Play", np.random.Generator], None]


@dataclass
class Play:
    """One recording while it is made.

    Attributes:
        chain: the rig as it is configured; truth: its parameters (q,).
        masses: the true ones; hold: how the force truly runs between samples.
        force: (N,) true force on the last mass;  others: (N, masses) forces that nobody measures.
        read: (N,) the force as it is measured;  after: what becomes of the readings (N, p), in turn.
        noise: (N, p);  fine: samples of the true force between two readings.
    """

    chain: Chain
    force: FloatArray
    others: FloatArray
    read: FloatArray
    noise: FloatArray
    masses: list[float]
    hold: str = "first"
    after: list[Callable[[FloatArray], FloatArray]] = field(default_factory=list)
    fine: FloatArray | None = None

    @classmethod
    def of(cls, chain: Chain, rng: np.random.Generator, samples: int) -> "Play":
        force = chain.force(rng, samples)
        noise = np.array(chain.noise) * rng.standard_normal((samples, len(chain.sensors)))
        return cls(
            chain, force, np.zeros((samples, len(chain.masses))), force.copy(), noise, list(chain.masses)
        )

    def readings(self) -> FloatArray:
        """(N, 1 + p) as channels give them."""
        count = len(self.chain.masses)
        if self.fine is None:
            forces = self.others.copy()
            forces[:, -1] += self.force
            y = self.chain.motion(forces, self.masses, self.hold)  # type: ignore[arg-type]
        else:
            every = len(self.fine) // len(self.force)
            forces = np.zeros((len(self.fine), count))
            forces[:, -1] = self.fine
            rate_hz = every * self.chain.rate_hz
            y = self.chain.motion(forces, self.masses, self.hold, rate_hz=rate_hz)[::every]  # type: ignore[arg-type]
        for change in self.after:
            y = change(y)
        return np.column_stack([self.read, y + self.noise])


def masses(*factors: float) -> Change:
    def change(play: Play, _: np.random.Generator) -> None:
        play.masses = [m * f for m, f in zip(play.masses, factors, strict=True)]

    return change


def gains(*factors: float) -> Change:
    return lambda play, _: play.after.append(lambda y: y * np.array(factors))


def drift(channel: int, share: float) -> Change:
    """A gain that grows by a share over the whole recording."""

    def spoil(y: FloatArray) -> FloatArray:
        out = y.copy()
        out[:, channel] *= 1 + share * np.arange(len(y)) / len(y)
        return out

    return lambda play, _: play.after.append(spoil)


def read_noise(share: float) -> Change:
    """White noise of the measured force, a share of its rms."""

    def change(play: Play, rng: np.random.Generator) -> None:
        play.read = play.read + share * play.force.std() * rng.standard_normal(len(play.read))

    return change


def pushed(sd: float, pole: float, mass: int = 0) -> Change:
    """A Gauss-Markov force that nobody measures."""

    def change(play: Play, rng: np.random.Generator) -> None:
        white = rng.standard_normal(len(play.force))
        play.others[:, mass] += sd * lfilter([np.sqrt(1 - pole**2)], [1, -pole], white)

    return change


def read_late(*lags: float) -> Change:
    """Outputs that are read so many samples late, each by its own: one converter after the other."""

    def spoil(y: FloatArray) -> FloatArray:
        k = np.arange(len(y))
        return np.column_stack([np.interp(k - lag, k, own) for lag, own in zip(lags, y.T, strict=True)])

    return lambda play, _: play.after.append(spoil)


def held(play: Play, _: np.random.Generator) -> None:
    play.hold = "zero"


def held_late(share: float) -> Change:
    """A force that is held and acts a share of a sample late (in quarters), after the outputs are read."""

    def change(play: Play, _: np.random.Generator) -> None:
        every = 4
        late = round(share * every)
        stepping = np.repeat(play.force, every)
        play.hold, play.fine = (
            "zero",
            np.concatenate([np.repeat(stepping[:1], late), stepping])[: len(stepping)],
        )

    return change


def crooked(play: Play, rng: np.random.Generator) -> None:
    """A force that is not straight between its readings: four instants of it a sample."""
    chain = play.chain
    every, n = 4, len(play.force)
    pole = np.exp(-2 * np.pi * 60.0 / (every * chain.rate_hz))
    white = rng.standard_normal(every * n + 4000)
    fine = lfilter([1 - pole], [1, -pole], lfilter([1 - pole], [1, -pole], white))[4000:]
    play.fine = fine / fine.std() * 3 * chain.force_n
    play.force = play.fine[::every]
    play.read = play.force.copy()


def hum(sd: float, hz: float = 50.0) -> Change:
    def spoil(y: FloatArray, rate: float) -> FloatArray:
        return np.asarray(y + sd * np.sqrt(2) * np.sin(2 * np.pi * hz / rate * np.arange(len(y)))[:, None])

    return lambda play, _: play.after.append(partial(spoil, rate=play.chain.rate_hz))


def coloured(pole: float) -> Change:
    def change(play: Play, rng: np.random.Generator) -> None:
        white = rng.standard_normal(play.noise.shape)
        sd = np.array(play.chain.noise)
        play.noise = sd * lfilter([np.sqrt(1 - pole**2)], [1, -pole], white, axis=0)

    return change


def digits(count: int, unit: float = 1.0) -> Change:
    """Readings as a table of so many significant digits gives them, in multiples of a unit."""

    def spoil(y: FloatArray) -> FloatArray:
        size = unit * 10.0 ** (np.floor(np.log10(np.maximum(np.abs(y / unit), 1e-300))) - count + 1)
        return np.asarray(np.round(y / size) * size)

    def change(play: Play, _: np.random.Generator) -> None:
        noise = play.noise
        play.after.append(lambda y: spoil(y + noise) - noise)

    return change


@dataclass(frozen=True)
class Case:
    """A rig, what is wrong with it, what the configuration says, and which verdicts are right.

    Attributes:
        right: any of these may be believed; nothing else by more than 0.5.
        said: what is right has to be said (by several hypotheses together, where the data cannot tell).
    """

    chain: Chain = TWO
    changes: tuple[Change, ...] = ()
    config: dict[str, object] = field(default_factory=dict)
    right: frozenset[str] = frozenset()
    said: bool = False


def stated(factor: float, chain: Chain = TWO) -> dict[str, object]:
    return {"noise": tuple(factor * s for s in chain.noise)}


SCALE = frozenset({"all masses", "all outputs", "force", "all inputs"})
"""What has the same effect: masses, springs and dampers are known only as far as forces and gains are."""
LATE = frozenset({"delay"})
ZERO: dict[str, object] = {"hold": "zero"}
IN_TURN: dict[str, object] = {"lag_sd_s": 2.5e-4}
POLES = '[estimator.observer]\ngain = "poles"\npoles = [-45.0, -40.0, -35.0, -30.0]'
KALMAN = '[estimator.observer]\ngain = "kalman"\nprocess_sd = [0.5, 0.5]'
CASES: dict[str, Case] = {
    "right": Case(),
    "right, one mass": Case(ONE),
    "right, three masses": Case(THREE),
    "noise x 0.92": Case(config=stated(0.92)),
    "noise x 0.83": Case(config=stated(0.83)),
    "noise x 0.5": Case(config=stated(0.5)),
    "noise x 2, one mass": Case(ONE, config=stated(2.0, ONE)),
    "noise not stated, three masses": Case(THREE, config={"noise": (None,) * 3}),
    "m1 +5 %": Case(changes=(masses(1.05, 1.0),), right=frozenset({"m1"}), said=True),
    "m1 +3 %": Case(changes=(masses(1.03, 1.0),), right=frozenset({"m1"})),
    "m2 -20 %": Case(changes=(masses(1.0, 0.8),), right=frozenset({"m2"}), said=True),
    "both masses +10 %": Case(changes=(masses(1.1, 1.1),), right=SCALE, said=True),
    "one mass +8 %": Case(ONE, (masses(1.08),), right=frozenset({"m1", "x1", "force"}), said=True),
    "middle mass +8 %": Case(THREE, (masses(1.0, 1.08, 1.0),), right=frozenset({"m2"}), said=True),
    "y1 drifts 5 %": Case(changes=(drift(0, 0.05),), right=frozenset({"x1", "x1 drifts"})),
    "x2 reads 5 % more, three masses": Case(THREE, (gains(1, 1.05, 1),), right=frozenset({"x2"}), said=True),
    "both outputs -10 %": Case(changes=(gains(0.9, 0.9),), right=SCALE, said=True),
    "force read with 0.2 %": Case(changes=(read_noise(0.002),)),
    "force read with 0.5 %, three masses": Case(THREE, (read_noise(0.005),)),
    "AR(0.99) 0.05 N": Case(changes=(pushed(0.05, 0.99),)),
    "AR(0.99) 0.01 N": Case(changes=(pushed(0.01, 0.99),)),
    "AR(0.98) 0.02 N, one mass": Case(ONE, (pushed(0.02, 0.98),)),
    "force not straight": Case(changes=(crooked,), right=frozenset({"delay"})),
    "held, hold first": Case(changes=(held,), right=frozenset({"delay"}), said=True),
    "held, hold first, one mass": Case(ONE, (held,), right=frozenset({"delay"})),
    "held, hold first, 200 Hz": Case(SLOW, (held,), right=frozenset({"delay"}), said=True),
    "held, hold first, accelerometers": Case(FELT, (held,), right=frozenset({"delay"}), said=True),
    "held, hold first, light parts": Case(SMALL, (held,), right=frozenset({"delay"}), said=True),
    "AR sensors and held, accelerometers": Case(FELT, (coloured(0.95), held), right=frozenset({"delay"})),
    "hold zero": Case(changes=(held,), config=ZERO),
    "hold zero, accelerometers": Case(FELT, (held,), ZERO),
    "late, hold zero": Case(changes=(held_late(0.5),), config=ZERO, right=LATE, said=True),
    "late, hold zero, one mass": Case(ONE, (held_late(0.5),), ZERO, LATE, said=True),
    "late, hold zero, 200 Hz": Case(SLOW, (held_late(0.5),), ZERO, LATE, said=True),
    "late, hold zero, accelerometers": Case(FELT, (held_late(0.5),), ZERO, LATE, said=True),
    "a sample late, hold zero, driving-point accelerometer": Case(
        DRIVEN, (held_late(1.0),), ZERO, LATE, said=True
    ),
    "late and m1 +3 %, hold zero, 200 Hz": Case(
        SLOW, (held_late(0.5), masses(1.03, 1.0)), ZERO, LATE | {"m1"}, said=True
    ),
    "late and m1 +3 %, hold zero, accelerometers": Case(
        FELT, (held_late(0.5), masses(1.03, 1.0)), ZERO, LATE | {"m1"}, said=True
    ),
    "late and AR sensors, hold zero": Case(
        changes=(held_late(0.5), coloured(0.95)), config=ZERO, right=LATE
    ),
    "not held, hold zero": Case(config=ZERO, right=LATE, said=True),
    "not held, hold zero, 200 Hz": Case(SLOW, config=ZERO, right=LATE, said=True),
    "not held, hold zero, accelerometers": Case(FELT, config=ZERO, right=LATE, said=True),
    "x2 a tenth of a sample late": Case(
        changes=(read_late(0.0, 0.1),), config=IN_TURN, right=frozenset({"x2 late"})
    ),
    "a1 half a sample late, accelerometers": Case(
        FELT, (read_late(0.5, 0.0),), IN_TURN, frozenset({"a1 late"})
    ),
    "a2 a quarter of a sample late, accelerometers": Case(
        FELT, (read_late(0.0, 0.25),), IN_TURN, frozenset({"a2 late"}), said=True
    ),
    "read one after the other, accelerometers": Case(
        FELT, (read_late(0.25, 0.5),), IN_TURN, frozenset({"a1 late", "a2 late", "delay"})
    ),
    "x2 half a sample late, three masses": Case(
        THREE, (read_late(0.0, 0.5, 0.0),), {"lag_sd_s": 5e-4}, frozenset({"x2 late"}), said=True
    ),
    "x1 half a sample late and m2 +5 %": Case(
        changes=(read_late(0.5, 0.0), masses(1.0, 1.05)), config=IN_TURN,
        right=frozenset({"x1 late", "m2"}),
    ),
    "right, outputs that may be late": Case(config=IN_TURN),
    "gain drifts, one mass": Case(
        SHAKEN, (drift(0, 0.05),), right=frozenset({"m1", "a1", "a1 drifts", "force", "force drifts"})
    ),
    "hum": Case(changes=(hum(1.4e-4),)),
    "hum, three masses": Case(THREE, (hum(4e-5),)),
    "driving-point accelerometer": Case(DRIVEN, (read_noise(0.002),)),
    "AR(0.95) sensors": Case(changes=(coloured(0.95),)),
    "three digits": Case(changes=(digits(3),)),
    "three digits, AR(0.95) sensors": Case(changes=(coloured(0.95), digits(3))),
    "gain by poles": Case(config={"observer": POLES}),
    "gain by kalman": Case(config={"observer": KALMAN}),
    "mass 3 % and hum": Case(changes=(masses(1.03, 1.0), hum(1.4e-4)), right=frozenset({"m1"})),
    "drift under an unknown force": Case(
        changes=(drift(0, 0.05), pushed(0.02, 0.99)), right=frozenset({"x1", "x1 drifts"})
    ),
    "noise x 0.83 and m2 +5 %": Case(
        changes=(masses(1.0, 1.05),), config=stated(0.83), right=frozenset({"m2"}), said=True
    ),
    "AR sensors and held": Case(changes=(coloured(0.95), held), right=frozenset({"delay"})),
    "force noise and x2 +4 %": Case(changes=(read_noise(0.002), gains(1.0, 1.04)), right=frozenset({"x2"})),
    "hum and 0.02 N, three masses": Case(THREE, (hum(4e-5), pushed(0.02, 0.99, 1))),
    "middle mass +8 % and noise x 0.6": Case(
        THREE, (masses(1.0, 1.08, 1.0),), stated(0.6, THREE), frozenset({"m2"}), said=True
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Found:
    """What the product said of recordings.

    Attributes:
        valid, held: (windows, q) of disjoint windows, from the first: valid; and the interval holds the
            truth.
        rows: share of all rows that are valid;  understood: or unexcited, where forces hide a parameter.
        alarms: parameters alarmed.
        beliefs: largest probability of each hypothesis, and the last of each.
    """

    valid: FloatArray
    held: FloatArray
    rows: float
    understood: float
    alarms: tuple[str, ...]
    largest: dict[str, float]
    last: dict[str, float]

    @property
    def cover(self) -> float:
        """Share of valid intervals that hold; NaN where there is none."""
        return float(self.held.sum() / self.valid.sum()) if self.valid.any() else float("nan")

    @property
    def each(self) -> FloatArray:
        """(q,) the same of each parameter."""
        valid = self.valid.sum(axis=0)
        return np.where(valid > 0, self.held.sum(axis=0) / np.maximum(valid, 1), np.nan)

    @property
    def worst(self) -> float:
        """The same of the worst parameter."""
        return float(np.min(self.each, where=~np.isnan(self.each), initial=1.0))

    def wrong(self, right: frozenset[str]) -> dict[str, float]:
        """Hypotheses believed by more than 0.5 that are not right."""
        return {name: p for name, p in self.largest.items() if p > 0.5 and name not in right}

    def __str__(self) -> str:
        per = ", ".join("-" if np.isnan(share) else f"{100 * share:.0f}" for share in self.each)
        top = ", ".join(f"{n} {p:.2f}" for n, p in sorted(self.largest.items(), key=lambda a: -a[1])[:3])
        alarms = ", ".join(self.alarms) or "none"
        return (
            f"rows valid {100 * self.rows:.1f} % (understood {100 * self.understood:.1f} %), "
            f"{self.valid.sum():.0f} intervals hold {100 * self.cover:.1f} % (each {per}), "
            f"alarms {alarms}, believed at most {top}"
        )


def together(found: Sequence[Found]) -> Found:
    """Recordings of one case as one."""
    largest: dict[str, float] = {}
    last: dict[str, float] = {}
    for one in found:
        for name, p in one.largest.items():
            largest[name] = max(p, largest.get(name, 0.0))
        for name, p in one.last.items():
            last[name] = last.get(name, 0.0) + p / len(found)
    return Found(
        np.vstack([f.valid for f in found]), np.vstack([f.held for f in found]),
        float(np.mean([f.rows for f in found])), float(np.mean([f.understood for f in found])),
        tuple(a for f in found for a in f.alarms), largest, last,
    )  # fmt: skip


def play(name: str, seed: int, windows: int) -> Found:
    """Make one recording of a case and give it to the product, from its configuration to its alarms."""
    return played(CASES[name], np.random.default_rng([seed, *name.encode()]), windows)


def played(case: Case, rng: np.random.Generator, windows: int) -> Found:
    first = SETTLE_WINDOWS * case.chain.window
    made = Play.of(case.chain, rng, first + windows * case.chain.window + 1)
    for change in case.changes:
        change(made, rng)
    return said(case, made.readings()[first:-1])


def said(case: Case, readings: FloatArray) -> Found:
    """What the product says of readings (N, 1 + p)."""
    return found(records(case, readings), case.chain, case.chain.theta)


def records(case: Case, readings: FloatArray) -> list[Record]:
    scale = case.config.get("scale", 1.0)
    assert isinstance(scale, float)
    readings = np.hstack([readings[:, :1], readings[:, 1:] / scale])  # as they come
    pipeline = make_pipeline(case.chain.configuration(**case.config))
    t_ns = np.round(np.arange(len(readings)) * 1e9 / case.chain.rate_hz).astype(np.int64)
    out: list[Record] = []
    for a in range(0, len(readings), BLOCK):
        block = SampleBlock(readings[a : a + BLOCK], 0, None, t_ns[a : a + BLOCK])
        out += pipeline.step(SOURCE, block, None, None)
    return out + pipeline.finish()


def found(given: Sequence[Record], chain: Chain, truth: FloatArray) -> Found:
    failures = [r.message for r in given if isinstance(r, HealthEvent) and r.cause == "failure"]
    assert not failures, failures
    batches = [r for r in given if isinstance(r, EstimateBatch)]
    index, status, lower, upper = (
        np.concatenate([getattr(b, part) for b in batches]) for part in ("index", "status", "lower", "upper")
    )
    whole = index >= chain.window - 1
    apart = whole & ((index + 1) % chain.window == 0)
    valid = status == Status.VALID
    held = valid & (lower <= truth) & (truth <= upper)
    largest: dict[str, float] = {}
    last: dict[str, float] = {}
    for r in given:
        if isinstance(r, Verdict):
            largest[r.hypothesis] = max(r.probability, largest.get(r.hypothesis, 0.0))
            last[r.hypothesis] = r.probability
    alarms = tuple(r.parameter for r in given if isinstance(r, AlarmTransition) and r.to_state == "UNACK")
    understood = np.isin(status, (Status.VALID, Status.UNEXCITED))
    return Found(
        valid[apart].astype(float), held[apart].astype(float), float(valid[whole].mean()),
        float(understood[whole].mean()), alarms, largest, last,
    )  # fmt: skip


def least(share: float, count: float) -> float:
    """The share that `count` intervals may show when `share` of all hold; neighbours share noise and
    constants."""
    return share - SLACK_SD * float((share * (1 - share) / max(count, 1.0)) ** 0.5)


def hold(name: str, case: Case, found: Found, sure: float, *, unsure: bool = False) -> None:
    """Assert what must be so; sure: share of the recordings in which what is right has to be said.

    unsure: parameters may be without a valid row, where what is understood of them says so.
    """
    total, each_one = found.valid.sum(), found.valid.sum(axis=0)
    assert unsure or each_one.all(), f"{name}: no row of a parameter is valid"
    assert found.understood >= 0.97, f"{name}: {100 * found.understood:.1f} % of rows"
    assert not found.cover < least(0.93, total), f"{name}: {100 * found.cover:.1f} % hold"
    assert found.worst >= least(0.90, each_one[each_one > 0].min(initial=np.inf)), f"{name}: {found.worst}"
    assert not set(found.alarms) - case.right, f"{name}: alarms {found.alarms}"
    assert not found.wrong(case.right), f"{name}: {found.wrong(case.right)}"
    if case.said:
        assert sum(found.last.get(which, 0.0) for which in case.right) >= sure
