"""Cost of the streaming bank: ns a sample in large batches, µs a hop live. Run as python -m
tests.bench.bench_bank."""

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from agent.numerics.model.sensors import Nuisance
from agent.numerics.window.filtering.hops import HopPlan
from agent.numerics.window.filtering.noise import NoiseModel
from agent.numerics.window.stream import Stream
from tests.unit.numerics.window.bank_rigs import BankRig, bank_rig

HOP, SAMPLES, ROUNDS = 50, 400_000, 5
CONSTANTS = (
    Nuisance("y1", "gain", "output", 0), Nuisance("y2", "gain", "output", 1),
    Nuisance("f", "gain", "input", 0),
    Nuisance("b1", "bias", "output", 0), Nuisance("b2", "bias", "output", 1),
    Nuisance("b3", "bias", "input", 0),
    Nuisance("g", "gain", "input", 0),
)  # fmt: skip


def rig_with(constants: int) -> BankRig:
    """Two masses at 1 kHz, four parameters; without constants there is no input that is always 1."""
    rig = bank_rig(period=1e-3, constants=CONSTANTS[:constants])
    if constants:
        return rig
    m = rig.model
    return replace(rig, model=replace(m, B=m.B[:, :1], D=m.D[:, :1], dB=m.dB[:, :, :1], dD=m.dD[:, :, :1]))


def fastest(run: Callable[[], object]) -> float:
    """Processor time of the fastest of some rounds, s."""
    best = np.inf
    for _ in range(ROUNDS):
        start = time.process_time()
        run()
        best = min(best, time.process_time() - start)
    return float(best)


def main() -> None:
    """Print the table."""
    rng = np.random.default_rng(0)
    for constants in (0, 3, 7):
        rig = rig_with(constants)
        y, u = 1e-3 * rng.standard_normal((SAMPLES, 2)), rng.standard_normal((SAMPLES, rig.model.m))
        costs = [cost(rig, y, u, window) for window in (250, 1000, 4000, 16000, 60000)]
        print(
            f"{constants} constants: {' '.join(f'{c:.0f}' for c in costs)} ns a sample, windows 0.25 to 60 s"
        )


def cost(rig: BankRig, y: np.ndarray, u: np.ndarray, window: int) -> float:
    """ns a sample of rows and scans for one window length, the making of operators left out."""
    noise = NoiseModel(np.full(2, 1e-5), np.full(2, 0.3))
    streams = [
        Stream(rig.model, rig.push, noise, HopPlan(window, HOP), (), rig.interest) for _ in range(ROUNDS)
    ]

    v = np.hstack([y, u])

    def run() -> None:
        stream = streams.pop()
        stream.append(0, v)
        while stream.next() is not None:
            pass

    return fastest(run) / SAMPLES * 1e9


if __name__ == "__main__":
    main()
