"""Chains of masses from the ground: their configuration, and their motion as the simulator's own equations
give it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.signal import lfilter

from agent.config import RigConfig, load
from agent.types import FloatArray
from sim_bus.rig.plant import Graph, Hold, Link, equations, propagate, step

UNITS = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s^2"}


@dataclass(frozen=True)
class Chain:
    """Masses in a row, a spring and a damper before each of them, a measured force on the last.

    Attributes:
        masses, springs, dampers: kg, N/m, N s/m, from the ground on.
        rate_hz: samples a second;  window_s: of the estimator.
        sensors: (quantity, number of the mass) of each output.
        noise: sensor sd of each output, SI.
        force_n: rms of the measured force;  force_hz: its bandwidth.
    """

    masses: tuple[float, ...]
    springs: tuple[float, ...]
    dampers: tuple[float, ...]
    rate_hz: float
    sensors: tuple[tuple[str, int], ...]
    noise: tuple[float, ...]
    window_s: float = 1.0
    force_n: float = 2.0
    force_hz: float = 5.0

    @property
    def theta(self) -> FloatArray:
        """(q,) springs, then dampers."""
        return np.array([*self.springs, *self.dampers])

    @property
    def names(self) -> tuple[str, ...]:
        """k1.., B1.. in the order of `theta`."""
        count = range(1, len(self.masses) + 1)
        return (*(f"k{i}" for i in count), *(f"B{i}" for i in count))

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the output channels."""
        return tuple(f"{quantity[0].replace('d', 'x')}{mass + 1}" for quantity, mass in self.sensors)

    @property
    def window(self) -> int:
        """Samples of a window."""
        return round(self.window_s * self.rate_hz)

    @property
    def graph(self) -> Graph:
        """The chain as the simulator takes it."""
        nodes = ["ground", *(f"m{i + 1}" for i in range(len(self.masses)))]
        ends = list(pairwise(nodes))
        springs = tuple(Link(f"k{i + 1}", pair) for i, pair in enumerate(ends))
        dampers = tuple(Link(f"B{i + 1}", pair) for i, pair in enumerate(ends))
        return Graph(tuple(nodes[1:]), springs, dampers)

    def force(self, rng: np.random.Generator, samples: int) -> FloatArray:
        """The measured force (samples,): noise through two equal low-pass filters."""
        pole = np.exp(-2 * np.pi * self.force_hz / self.rate_hz)
        u = lfilter([1 - pole], [1, -pole], rng.standard_normal(samples + 2000))
        u = lfilter([1 - pole], [1, -pole], u)[2000:]
        return np.asarray(self.force_n * u / u.std())

    def motion(
        self, forces: FloatArray, masses: Sequence[float] = (), hold: Hold = "first",
        thetas: Sequence[tuple[int, FloatArray]] = (), rate_hz: float = 0.0,
        loads: Sequence[tuple[int, Sequence[float]]] = (),
    ) -> FloatArray:  # fmt: skip
        """Readings (N, p) without noise under forces (N, masses), of a rig at rest at first.

        masses: the true ones; thetas: (sample, parameters) from which each set holds; loads: the same of
        masses; rate_hz: of the forces.
        """
        sets = dict(thetas) or {0: self.theta}
        heavy = {0: list(masses) or list(self.masses)} | {at: list(load) for at, load in loads}
        graph, state, out = self.graph, np.zeros(2 * len(self.masses)), []
        starts = sorted({*sets, *heavy})
        for start, stop in zip(starts, [*starts[1:], len(forces) - 1], strict=True):
            theta, true = (known[max(at for at in known if at <= start)] for known in (sets, heavy))
            values = dict(zip(self.names, theta.tolist(), strict=True)) | {
                f"m{i + 1}": m for i, m in enumerate(true)
            }
            motion = equations(graph, values)
            states = propagate(
                step(motion, 1.0 / (rate_hz or self.rate_hz), hold), state, forces[start : stop + 1]
            )
            last = stop == len(forces) - 1
            rows = [motion.output(quantity, f"m{mass + 1}") for quantity, mass in self.sensors]
            seen = np.column_stack([states @ h + forces[start : stop + 1] @ j for h, j in rows])
            out.append(seen if last else seen[:-1])
            state = states[-1]
        return np.vstack(out)

    def configuration(self, **said: object) -> RigConfig:
        """The rig as it is configured: `noise` (per output, None: not stated), `masses`, `hold`,
        `limit_percent`, `observer` (a table's text), `sd_percent`, `gain_sd_percent`, `delay_sd_s`,
        `lag_sd_s`, the same of outputs, and `scale` of outputs."""
        return _loaded(self, tuple(sorted(said.items())))


@cache
def _loaded(chain: Chain, said: tuple[tuple[str, object], ...]) -> RigConfig:
    with TemporaryDirectory() as folder:
        file = Path(folder) / "rig.toml"
        file.write_text(_text(chain, dict(said)), encoding="utf-8")
        return load(file)


def _text(chain: Chain, said: Mapping[str, object]) -> str:
    nodes = ["ground", *(f"m{i + 1}" for i in range(len(chain.masses)))]
    masses = said.get("masses", chain.masses)
    sheet = f", sd_percent = {said['sd_percent']}" if "sd_percent" in said else ""
    gain = f"gain_sd_percent = {said['gain_sd_percent']}\n" if "gain_sd_percent" in said else ""
    late = f"delay_sd_s = {said['delay_sd_s']}\n" if "delay_sd_s" in said else ""
    lines = ["[rig]", 'name = "chain"', f"sample_rate_hz = {chain.rate_hz}", 'clock = "counter"', "[model]"]
    lines += ['kind = "mass-spring-damper"', "mass = ["]
    lines += [f'{{ name = "{n}", value = {m!r}{sheet} }},' for n, m in zip(nodes[1:], masses, strict=True)]  # type: ignore[call-overload]
    graph, values = chain.graph, chain.theta.tolist()
    count = len(graph.springs)
    for kind, links, nominal in (
        ("spring", graph.springs, values[:count]), ("damper", graph.dampers, values[count:])
    ):  # fmt: skip
        lines += ["]", f"{kind} = ["]
        lines += [
            f'{{ name = "{link.name}", between = ["{link.ends[0]}", "{link.ends[1]}"], '
            f"nominal = {value!r} }},"
            for link, value in zip(links, nominal, strict=True)
        ]
    lines += ["]", "[[channel]]", 'name = "force"', 'quantity = "force"', f'at = "{nodes[-1]}"']
    lines += [f'unit = "N"\n{gain}{late}']
    stated = said.get("noise", chain.noise)
    gain += f"delay_sd_s = {said['lag_sd_s']}\n" if "lag_sd_s" in said else ""
    for (quantity, mass), name, noise in zip(chain.sensors, chain.outputs, stated, strict=True):  # type: ignore[call-overload]
        lines += ["[[channel]]", f'name = "{name}"', f'quantity = "{quantity}"', f'at = "m{mass + 1}"']
        lines += [f'unit = "{UNITS[quantity]}"\n{gain}' + ("" if noise is None else f"noise_sd = {noise!r}")]
        lines += [f"scale = {said.get('scale', 1.0)!r}"]
    lines += [
        "[estimator]",
        f"window_s = {chain.window_s}",
        f"hop_s = {said.get('hop_s', chain.window_s / 20)}",
    ]
    lines += [f'hold = "{said.get("hold", "first")}"']
    lines += [str(said.get("observer", ""))]
    for name in chain.names:
        lines += ["[[alarm]]", f'parameter = "{name}"', f"limit_percent = {said.get('limit_percent', 15.0)}"]
        lines += ["on_delay_s = 0.5", "off_delay_s = 0.2"]
    return "\n".join([*lines, "[store]", 'path = "rig.db"', "every_s = 0"])


ONE = Chain((2.0,), (200.0,), (4.0,), 500.0, (("displacement", 0),), (5e-5,))
TWO = Chain(
    (5.0, 3.0), (25.0, 100.0), (5.0, 5.0), 1000.0, (("displacement", 0), ("displacement", 1)), (7e-5, 7e-5)
)
THREE = Chain(
    (2.0, 1.5, 1.0), (300.0, 200.0, 250.0), (3.0, 2.0, 2.5), 500.0,
    (("displacement", 0), ("displacement", 1), ("displacement", 2)), (2e-5, 2e-5, 2e-5), force_hz=10.0,
)  # fmt: skip
DRIVEN = Chain(
    (5.0, 3.0), (25.0, 100.0), (5.0, 5.0), 1000.0, (("displacement", 0), ("acceleration", 1)), (7e-5, 5e-3)
)  # fmt: skip
"""An accelerometer where the force acts."""
SLOW = Chain(
    (8.0, 4.0), (600.0, 900.0), (12.0, 9.0), 200.0, (("velocity", 0), ("displacement", 1)), (1e-4, 2e-5),
    window_s=2.5, force_n=5.0, force_hz=6.0,
)  # fmt: skip
FELT = Chain(
    (2.0, 1.0), (800.0, 1500.0), (4.0, 5.0), 1000.0, (("acceleration", 0), ("acceleration", 1)),
    (5e-3, 5e-3), force_n=3.0, force_hz=15.0,
)  # fmt: skip
SMALL = Chain(
    (0.05, 0.08), (9000.0, 6000.0), (1.2, 0.9), 5000.0, (("displacement", 0), ("acceleration", 1)),
    (2e-7, 0.05), window_s=0.2, force_n=0.5, force_hz=100.0,
)  # fmt: skip
SHAKEN = Chain(
    (0.4,), (1600.0,), (1.5,), 2000.0, (("acceleration", 0),), (0.02,), window_s=0.5, force_n=1.0,
    force_hz=20.0,
)  # fmt: skip
"""Rigs of other rates and sensors: few samples a period, accelerometers only, light parts, one mass."""
