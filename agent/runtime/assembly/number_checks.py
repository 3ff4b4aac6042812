"""Whether a rig can be computed: its model is a number, an observer exists, its windows fit into memory."""

from collections.abc import Callable, Iterator
from typing import TypeVar

import numpy as np

from agent.blocks.rig_model import RigModel, observer_gain, windows_s
from agent.config import RigConfig
from agent.config.rules_estimator import most_samples
from agent.config.tuning import MOST_GB
from agent.errors import Fault
from agent.numerics.model.holds import straight
from agent.numerics.model.statespace import StateSpace, discretise

T = TypeVar("T")
FAILED = (ArithmeticError, ValueError, MemoryError)
"""What arithmetic and linear algebra raise where numbers end; numpy's LinAlgError is a ValueError."""


def attempted(work: Callable[[], T], what: str, path: str, failed: list[Fault]) -> T | None:
    """Return what some work gives; None and a fault in `failed` where its numbers end."""
    try:
        with np.errstate(all="ignore"):  # what is no number shows in the results
            return work()
    except FAILED as error:
        failed.append(
            Fault(path, f"{what} cannot be computed: {error}", "look at units and sizes of the values")
        )
        return None


def number_faults(config: RigConfig, rig: RigModel) -> list[Fault]:
    """Return what keeps a rig from being computed with at all."""
    faults: list[Fault] = []
    model = attempted(lambda: rig.model.continuous(rig.model.nominal), "the nominal model", "model", faults)
    if model is None or not _finite(model):
        return faults or [
            Fault("model", "its matrices leave the numbers", "look at units and sizes of the values")
        ]
    return [*faults, *_window_faults(config, rig)]


def observer_faults(config: RigConfig, rig: RigModel) -> list[Fault]:
    """Return why no observer can be had of a rig whose states its channels show."""
    faults: list[Fault] = []
    attempted(lambda: _start(config, rig), "an observer", "estimator.observer", faults)
    return faults


def _start(config: RigConfig, rig: RigModel) -> None:
    model = rig.model.continuous(rig.model.nominal)
    sampled = discretise(model, 1.0 / config.rig.sample_rate_hz, straight(config.estimator.hold))
    if not _finite(sampled.model):
        raise ValueError(f"sampled at {config.rig.sample_rate_hz:g} Hz the model leaves the numbers")
    observer_gain(config, rig, sampled, np.zeros(len(config.outputs)))


def _finite(model: StateSpace) -> bool:
    matrices = (model.A, model.B, model.C, model.D, model.dA, model.dB, model.dC, model.dD)
    return all(bool(np.all(np.isfinite(matrix))) for matrix in matrices)


def _window_faults(config: RigConfig, rig: RigModel) -> Iterator[Fault]:
    longest = max(windows_s(config)) * config.rig.sample_rate_hz
    most = most_samples(len(config.outputs), len(rig.parameters) + len(rig.model.state_names))
    if longest > most:
        what = (
            f'"auto" comes to {longest:.3g} samples, '
            f"which take about {longest / most * MOST_GB:.2g} GB of memory"
        )
        yield Fault("estimator.window_s", what, "give the length in seconds")
