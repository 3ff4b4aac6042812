"""Truths drawn from the family of laws itself, stepped by Euler with sums of the tests' own."""

from dataclasses import dataclass

import numpy as np

from agent.prognosis.history import History

WEIGHTS = {
    "constant": 0.14, "rate law": 0.3, "ramp": 0.06, "run-in": 0.1, "onset": 0.14, "saturation": 0.1,
    "growth": 0.16,
}  # fmt: skip
BENT = {"rate law", "run-in", "onset"}
MEANS = 100
STEP = 1.0 / 400.0
LEVEL = 25.0


@dataclass(frozen=True)
class Law:
    """One part's law, in shares of its first level and spans of its history, which ends at t = 0.

    `bend` is ln(rate at the limit / rate at the start); after the newest row the rate at the limit differs by
    `later`.
    """

    rate: float
    limit: float
    scatter: float
    walk: float
    wander: float
    bend: float = 0.0
    later: float = 0.0
    ramp: float = 0.0
    onset: float = -1.0
    run_in: float = -1.0
    constant: float = np.inf
    growth: float = 0.0

    def of_time(self, t: float) -> float:
        """Rate at t over the rate at the start, as far as time alone decides."""
        power = min(self.growth * (t + 1.0), 30.0) - (t + 1.0) / self.constant
        return (t >= self.onset) * (1.0 + self.ramp * (t + 1.0)) * float(np.exp(power))

    def of_level(self, z: float, now: float | None = None) -> float:
        """Rate at a level over the rate at the start, as far as the level decides; now: the newest one, if
        gone by."""
        x, reach = np.log1p(max(z, -0.99)), np.log1p(self.limit)
        power = self.bend * x / reach
        if now is not None:
            x_now = np.log1p(now)
            power += self.later * (x - x_now) / (reach - x_now)
        return float(np.exp(np.clip(power, -30.0, 30.0)))


def of_the_family(rng: np.random.Generator) -> tuple[str, History, float, float]:
    """Return a law's name, its history, the limit, and what remains until it first reaches that; inf for
    never."""
    while True:
        name = str(rng.choice(list(WEIGHTS), p=list(WEIGHTS.values())))
        law, gone = drawn(rng, name)
        levels = lived(rng, law, gone)
        if levels is None or -levels[-1] < 3.0 * law.scatter:
            continue  # reached already, or nothing to see
        t = np.linspace(-1.0, 0.0, MEANS)
        level, rate = np.interp(t, np.linspace(-1.0, 0.0, len(levels[:-1])), levels[:-1]), levels[-1]
        value = level + law.scatter * rng.standard_normal(MEANS)
        history = History(100.0 * (t + 1.0), LEVEL * (1.0 + value), np.full(MEANS, LEVEL * law.scatter))
        return (
            name,
            history,
            LEVEL * (1.0 + law.limit),
            100.0 * onward(rng, law, float(level[-1]), float(rate)),
        )


def student(rng: np.random.Generator, loc: float, scale: float, dof: float = 8.0) -> float:
    return float(loc + scale * rng.standard_t(dof))


def instant(logit: float) -> float:
    return float(-1.0 / (1.0 + np.exp(logit)))


def drawn(rng: np.random.Generator, name: str) -> tuple[Law, float]:
    """Return a law and about how much of its level is gone by now."""
    limit = -float(np.exp(rng.uniform(np.log(0.08), np.log(0.5))))
    gone = float(rng.uniform(0.1, 0.9)) * -limit
    scatter = gone * float(np.exp(rng.uniform(np.log(0.005), np.log(0.1))))
    shapes: dict[str, float] = {}
    if name in BENT:
        shapes["bend"] = student(rng, 1.4, 1.0, 5.0)
    if name in BENT | {"growth"}:
        shapes["later"] = student(rng, 0.8, 1.4)
    if name == "ramp":
        shapes["ramp"] = float(np.exp(student(rng, 1.0, 1.2)))
    if name == "onset":
        shapes["onset"] = instant(student(rng, 0.0, 1.5))
    if name == "run-in":
        shapes["run_in"] = instant(student(rng, -1.0, 1.0))
    if name == "growth":
        shapes["growth"] = float(np.exp(student(rng, 0.7, 0.7)))
    if name == "saturation":
        shapes["constant"] = float(np.exp(student(rng, 0.0, 1.0)))
    law = Law(
        rate=1.0, limit=limit, scatter=scatter,
        walk=0.3 * scatter * np.sqrt(MEANS) * float(np.exp(student(rng, 0.0, 1.5))),
        wander=float(np.exp(student(rng, np.log(0.05), 0.9, 30.0))), **shapes,
    )  # fmt: skip
    way = STEP * sum(law.of_time(t) for t in np.arange(-1.0, 0.0, STEP))
    rate = -gone * float(np.exp(0.4 * rng.standard_normal())) / max(way, 0.05)
    return Law(**{**vars(law), "rate": rate}), gone


def lived(rng: np.random.Generator, law: Law, gone: float) -> np.ndarray | None:
    """Return levels up to now and, last, the rate by then; None where the limit was reached."""
    z, rate, levels = 0.0, law.rate, [0.0]
    for t in np.arange(-1.0, 0.0, STEP):
        z += (rate * law.of_time(t) * STEP + law.walk * np.sqrt(STEP) * rng.standard_normal()) * law.of_level(
            z
        )
        rate += (50.0 if t < law.run_in else law.wander) * gone * np.sqrt(STEP) * rng.standard_normal()
        levels.append(z)
        if z <= law.limit:
            return None
    return np.array([*levels, rate])


def onward(rng: np.random.Generator, law: Law, now: float, rate: float) -> float:
    z, t, far = now, 0.0, 25.0
    while t < far:
        dt = max(1e-3, 0.01 * t)
        at = law.of_level(z, now)
        z += (rate * law.of_time(t) * dt + law.walk * np.sqrt(dt) * rng.standard_normal()) * at
        rate *= float(np.exp(law.wander * np.sqrt(dt) * rng.standard_normal()))
        t += dt
        if z <= law.limit:
            return t
    return float(np.inf)


def cracking(rng: np.random.Generator) -> History:
    """A crack that grows by a power of its length, and faster than that near its end, to 50 mm."""
    speed, power = 2e-3 * float(np.exp(0.1 * rng.standard_normal())), 1.8 + 0.1 * rng.standard_normal()
    length, lengths = 9.0, [9.0]
    while length < 50.0:
        faster = 1.0 + (length / 46.0) ** 30
        length += speed * length**power * faster * float(np.exp(0.2 * rng.standard_normal()))
        lengths.append(length)
    t = np.arange(float(len(lengths)))
    return History(t, np.array(lengths) + 0.02 * rng.standard_normal(len(t)), np.zeros(len(t)))
