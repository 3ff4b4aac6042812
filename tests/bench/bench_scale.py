"""What the estimator costs as models, rigs and windows grow, and its memory over long streams.

python -m tests.bench.bench_scale (part of make bench). Samples per second of one core, running steadily: the
first fifth of each stream, in which the noise is learnt and the first fits are made, does not count.
"""

import os

# small products are ten times slower on two threads; must stand before numpy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import copy
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from agent.blocks.estimation import Estimation
from agent.config import RigConfig, load
from agent.runtime.assembly.methods import make_estimation
from agent.types import Samples
from sim_bus.rig.plant import Graph, Link, equations, propagate, step

FloatArray = NDArray[np.float64]
PERIOD, NOISE = 1e-3, 5e-6
BLOCK = 20_000
STATES = (2, 4, 8, 16)
RIGS = (1, 8, 64)
SETTLED = 3
"""Blocks after which a rig moves its reference no more."""
WINDOWS = ((0.25,), (0.25, 0.5, 1.0, 2.0, 4.0))


@dataclass(frozen=True, slots=True)
class Stream:
    """A chain's readings, played round and round: force (N, 1) on its last mass, displacements (N, p)."""

    u: FloatArray
    y: FloatArray


def text(masses: int, estimated: tuple[str, ...], windows: tuple[float, ...]) -> str:
    """A chain of equal masses fixed at one end, every displacement measured."""

    def links(letter: str, nominal: float) -> str:
        ends = ["ground", *(f"m{i + 1}" for i in range(masses))]
        rows = (
            f'{{ name = "{letter}{i + 1}", between = ["{ends[i]}", "{ends[i + 1]}"], nominal = {nominal} }}'
            for i in range(masses)
        )
        return ", ".join(rows)

    channels = "".join(
        f'[[channel]]\nname = "x{i + 1}"\nquantity = "displacement"\nat = "m{i + 1}"\n'
        f'unit = "m"\nnoise_sd = {NOISE}\n'
        for i in range(masses)
    )
    masses_text = ", ".join(f'{{ name = "m{i + 1}", value = 3.0 }}' for i in range(masses))
    return (
        '[rig]\nname = "chain"\nsample_rate_hz = 1000.0\nclock = "counter"\n'
        '[model]\nkind = "mass-spring-damper"\n'
        f"mass = [{masses_text}]\nspring = [{links('k', 300.0)}]\ndamper = [{links('B', 5.0)}]\n"
        f'[[channel]]\nname = "force"\nquantity = "force"\nat = "m{masses}"\nunit = "N"\n{channels}'
        f"[estimator]\nwindow_s = {list(windows)}\nhop_s = 0.05\nestimate = {list(estimated)}\n"
        f'[store]\npath = "chain.db"\n'
    ).replace("'", '"')


@cache
def config(masses: int, estimated: tuple[str, ...], windows: tuple[float, ...]) -> RigConfig:
    with TemporaryDirectory() as folder:
        file = Path(folder) / "chain.toml"
        file.write_text(text(masses, estimated, windows), encoding="utf-8")
        return load(file)


@cache
def stream(masses: int, samples: int = 10 * BLOCK) -> Stream:
    names = tuple(f"m{i + 1}" for i in range(masses))
    ends = ("ground", *names)
    pairs = [(ends[i], ends[i + 1]) for i in range(masses)]
    springs = tuple(Link(f"k{i + 1}", pair) for i, pair in enumerate(pairs))
    dampers = tuple(Link(f"B{i + 1}", pair) for i, pair in enumerate(pairs))
    values = (
        dict.fromkeys(names, 3.0)
        | {link.name: 300.0 for link in springs}
        | {link.name: 5.0 for link in dampers}
    )
    motion = equations(Graph(names, springs, dampers), values)
    rng = np.random.default_rng(masses)
    u = 5.0 * rng.standard_normal((samples + 1, 1))
    forces = np.hstack([np.zeros((samples + 1, masses - 1)), u])
    states = propagate(step(motion, PERIOD), np.zeros(2 * masses), forces)
    y = states[:-1, :masses]
    return Stream(u[:-1], y + NOISE * rng.standard_normal(y.shape))


def everything(masses: int) -> tuple[str, ...]:
    return tuple(f"{letter}{i + 1}" for letter in "kB" for i in range(masses))


def few(masses: int) -> tuple[str, ...]:
    return everything(masses) if masses == 1 else ("k1", "k2", "B1", "B2")


def fresh(masses: int, estimated: tuple[str, ...], windows: tuple[float, ...] = (0.25,)) -> Estimation:
    return make_estimation(config(masses, estimated, windows), np.zeros(masses))


def feed(block: Estimation, played: Stream, number: int) -> None:
    """Give an estimator its block `number`, from a record that is played forth without end."""
    where = np.arange(number * BLOCK, (number + 1) * BLOCK, dtype=np.int64)
    rows = slice(number * BLOCK % len(played.u), number * BLOCK % len(played.u) + BLOCK)
    block.step(Samples(where, where * 1_000_000, played.u[rows], played.y[rows], 0))


def rate(blocks: list[Estimation], played: Stream, rounds: int = 10, begun: int = 0) -> float:
    """Return samples a second of one core, of all the estimators together, each given a block in turn.

    begun: blocks that they were given before.
    """
    settling = rounds // 5
    for number in range(rounds):
        if number == settling:
            start = time.process_time()
        for block in blocks:
            feed(block, played, begun + number)
    return len(blocks) * BLOCK * (rounds - settling) / (time.process_time() - start)


def by_states() -> list[tuple[int, int, float]]:
    """(states, parameters, rate): four parameters, and every spring and damper of the chain."""
    chains = [(n, chosen) for n in STATES for chosen in dict.fromkeys([few(n // 2), everything(n // 2)])]
    return [(n, len(chosen), rate([fresh(n // 2, chosen)], stream(n // 2))) for n, chosen in chains]


def by_rigs() -> list[tuple[int, float]]:
    """(rigs, rate): rigs of one model, each at an operating point of its own."""
    first, played = fresh(2, everything(2)), stream(2)
    for number in range(SETTLED):
        feed(first, played, number)
    found = []
    for count in RIGS:
        own = [copy.deepcopy(first) for _ in range(count)]
        found.append((count, rate(own, played, begun=SETTLED)))
    return found


def by_windows() -> list[tuple[tuple[float, ...], float]]:
    return [(windows, rate([fresh(2, everything(2), windows)], stream(2), 20)) for windows in WINDOWS]


def resident_mb() -> float:
    """Resident memory of this process now, MB."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def growth_mb(samples: int) -> tuple[float, float]:
    """Return resident memory, MB, after a tenth of a stream and by how much it has grown at its end."""
    block, played = fresh(2, everything(2)), stream(2)
    blocks = samples // BLOCK
    for number in range(blocks):
        if number == blocks // 10:
            early = resident_mb()
        feed(block, played, number)
    return early, resident_mb() - early


def table() -> list[str]:
    lines = ["", "| states | parameters | samples/s of one core |", "|---|---|---|"]
    lines += [f"| {n} | {q} | {found / 1e6:.2f} M |" for n, q, found in by_states()]
    lines += ["", "| rigs of one model | samples/s of one core |", "|---|---|"]
    lines += [f"| {count} | {found / 1e6:.2f} M |" for count, found in by_rigs()]
    lines += ["", "| windows, s | samples/s of one core |", "|---|---|"]
    lines += [f"| {', '.join(map(str, windows))} | {found / 1e6:.2f} M |" for windows, found in by_windows()]
    return lines


def main() -> None:
    """Print the tables."""
    print("\n".join(table()))


if __name__ == "__main__":
    main()
