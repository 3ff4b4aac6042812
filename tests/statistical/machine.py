"""The rig of the statistical tests, its configuration, and its motion as the simulator's own equations give
it."""

import copy
import os
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar

import numpy as np
import pytest

from agent.config import RigConfig, load
from agent.types import FloatArray
from sim_bus.rig.plant import Graph, Link, Step, equations, propagate, step

PERIOD = 1e-3
SECOND = 1000
NAMES = ("k1", "k2", "B1", "B2")
NOMINAL = np.array([25.0, 100.0, 5.0, 5.0])
MASSES = {"m1": 5.0, "m2": 3.0}
GRAPH = Graph(
    ("m1", "m2"),
    (Link("k1", ("ground", "m1")), Link("k2", ("m1", "m2"))),
    (Link("B1", ("ground", "m1")), Link("B2", ("m1", "m2"))),
)
TEXT = """
[rig]
name = "rig"
sample_rate_hz = 1000.0
clock = "counter"
[model]
kind = "mass-spring-damper"
mass = [{{ name = "m1", value = 5.0 }}, {{ name = "m2", value = 3.0 }}]
spring = [
    {{ name = "k1", between = ["ground", "m1"], nominal = 25.0 }},
    {{ name = "k2", between = ["m1", "m2"], nominal = 100.0 }},
]
damper = [
    {{ name = "B1", between = ["ground", "m1"], nominal = 5.0 }},
    {{ name = "B2", between = ["m1", "m2"], nominal = 5.0 }},
]
[[channel]]
name = "force"
quantity = "force"
at = "m2"
unit = "N"
[[channel]]
name = "x1"
quantity = "displacement"
at = "m1"
unit = "m"
{noise}
[[channel]]
name = "x2"
quantity = "displacement"
at = "m2"
unit = "m"
{noise}
[estimator]
window_s = {window_s}
hop_s = 0.05
{alarms}
[store]
path = "rig.db"
every_s = 0
"""
ALARM = """
[[alarm]]
parameter = "{name}"
{limit}
on_delay_s = 0.5
off_delay_s = 0.2
"""
Item = TypeVar("Item")
Found = TypeVar("Found")


@cache
def configuration(
    noise_sd: float | None, window_s: float = 1.0, limits: tuple[float, ...] = (),
    masses: tuple[float, float] = (5.0, 3.0),
) -> RigConfig:  # fmt: skip
    """The rig with sensors of a noise (None: to be learnt), limits in each parameter's unit or 10 % of
    nominal.

    masses: what the configuration says of them, right or wrong.
    """
    texts = [f"limit = {limit}" for limit in limits] or ["limit_percent = 10.0"] * len(NAMES)
    alarms = "".join(ALARM.format(name=name, limit=text) for name, text in zip(NAMES, texts, strict=True))
    noise = "" if noise_sd is None else f"noise_sd = {noise_sd!r}"
    with TemporaryDirectory() as folder:
        file = Path(folder) / "rig.toml"
        text = TEXT.format(noise=noise, window_s=window_s, alarms=alarms)
        text = text.replace("value = 5.0", f"value = {masses[0]}").replace(
            "value = 3.0", f"value = {masses[1]}"
        )
        file.write_text(text, encoding="utf-8")
        return load(file)


@cache
def _step(values: tuple[float, ...]) -> Step:
    return step(equations(GRAPH, MASSES | dict(zip(NAMES, values, strict=True))), PERIOD)


@dataclass(slots=True)
class Machine:
    """The rig in motion.

    Attributes:
        theta: (4,) springs and dampers that govern it now.
        state: (4,) displacements and velocities at the newest sample.
    """

    theta: FloatArray
    state: FloatArray

    @classmethod
    def at_rest(cls, theta: FloatArray = NOMINAL) -> "Machine":
        return cls(np.array(theta), np.zeros(4))

    def play(self, forces: FloatArray) -> FloatArray:
        """Return the states (N, 4) at the first N of N + 1 instants of forces on both masses (N + 1, 2)."""
        states = propagate(_step(tuple(self.theta.tolist())), self.state, forces)
        self.state = states[-1].copy()
        return states[:-1]

    def rates(self, states: FloatArray, forces: FloatArray) -> FloatArray:
        """Return the accelerations (N, 2) of both masses at states (N, 4) under forces (N, 2)."""
        motion = equations(GRAPH, MASSES | dict(zip(NAMES, self.theta.tolist(), strict=True)))
        return (states @ motion.F.T + forces @ motion.G.T)[:, 2:]


def on_second(force: FloatArray) -> FloatArray:
    """Return forces (N, 2) on both masses from the one (N,) on the second."""
    return np.column_stack([np.zeros_like(force), force])


Fresh = TypeVar("Fresh")
_made: dict[object, object] = {}


def fresh(key: object, make: Callable[[], Fresh]) -> Fresh:
    """Return an unused copy of what `make` gives: checking a configuration costs more than a short run."""
    if key not in _made:
        _made[key] = make()
    return copy.deepcopy(_made[key])  # type: ignore[return-value]


def each(work: Callable[[Item], Found], items: Iterable[Item], processes: int = 2) -> list[Found]:
    """Return work(item) for every item, on two processes; the order is that of the items.

    Within one of several processes that share a test run there is no processor left for more.
    """
    things = list(items)
    if "PYTEST_XDIST_WORKER" in os.environ:
        return list(map(work, things))
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        return list(pool.map(work, things, chunksize=max(1, len(things) // (4 * processes))))


def say(request: pytest.FixtureRequest, text: str) -> None:
    """Print a measured figure on the terminal, whatever is captured."""
    plugins = request.config.pluginmanager
    with plugins.get_plugin("capturemanager").global_and_fixture_disabled():
        plugins.get_plugin("terminalreporter").write_line(f"\nmeasured: {text}")
