"""Random linear systems with a configuration and a recording of each, integrated by neither agent nor
simulator.

2-8 states, 1-3 inputs and outputs, in continuous or discrete time, every motion decaying or one that does
not.
"""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, expm

from agent.config import RigConfig, load

FloatArray = NDArray[np.float64]
Entry = tuple[str, int, int]
RATE_HZ = 100.0
MATRICES = "ABCD"
EXACT = "gain_sd_percent = 0.0\ndelay_sd_s = 0.0\n"


@dataclass(frozen=True)
class System:
    """x' = A x + B u, y = C x + D u, or the next state in the place of x'."""

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    discrete: bool

    def entry(self, entry: Entry) -> float:
        """Return one number of a matrix."""
        return float(getattr(self, entry[0])[entry[1:]])

    def moved(self, entries: list[Entry], values: FloatArray) -> "System":
        """Return the system with other numbers in its matrices."""
        new = {name: getattr(self, name).copy() for name in MATRICES}
        for (name, i, j), value in zip(entries, values.tolist(), strict=True):
            new[name][i, j] = value
        return replace(self, **new)

    def motion(self, u: FloatArray, x0: FloatArray) -> FloatArray:
        """Return y (N, p): inputs u (N + 1, m) are straight between samples of a continuous-time system."""
        A, B0, B1 = self._step()
        x, y = x0, np.empty((len(u) - 1, len(self.C)))
        for k in range(len(y)):
            y[k] = self.C @ x + self.D @ u[k]
            x = A @ x + B0 @ u[k] + B1 @ u[k + 1]
        return y

    def states(self, u: FloatArray, x0: FloatArray) -> FloatArray:
        """Return the states (N, n) at the samples."""
        n = len(self.A)
        return replace(self, C=np.eye(n), D=np.zeros((n, self.B.shape[1]))).motion(u, x0)

    @property
    def radius(self) -> float:
        """The largest pole in discrete time."""
        return float(np.abs(np.linalg.eigvals(self._step()[0])).max())

    def _step(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        if self.discrete:
            return self.A, self.B, np.zeros_like(self.B)
        n, m = self.B.shape
        big = np.zeros((n + 2 * m, n + 2 * m))
        big[:n, : n + m] = np.hstack([self.A, self.B]) / RATE_HZ
        big[n : n + m, n + m :] = np.eye(m)
        grown = expm(big)[:n]
        return grown[:, :n], grown[:, n : n + m] - grown[:, n + m :], grown[:, n + m :]


def random_system(rng: np.random.Generator) -> System:
    """Return a system whose motions last a few samples to some seconds; of a third one does not decay."""
    n, m, p = int(rng.integers(2, 9)), int(rng.integers(1, 4)), int(rng.integers(1, 4))
    blocks = []
    left = n
    if rng.random() < 1 / 3:
        blocks.append(np.zeros((1, 1)))
        left -= 1
    while left:
        speed = float(np.exp(rng.uniform(np.log(3.0), np.log(25.0))))
        if left >= 2 and rng.random() < 0.6:
            decay = speed * rng.uniform(0.1, 0.6)
            blocks.append(np.array([[-decay, speed], [-speed, -decay]]))
        else:
            blocks.append(np.array([[-speed]]))
        left -= len(blocks[-1])
    turn = np.linalg.qr(rng.standard_normal((n, n)))[0] * rng.uniform(0.7, 1.4, n)
    A = np.linalg.solve(turn, block_diag(*blocks) @ turn)
    B, C, D = rng.standard_normal((n, m)), rng.standard_normal((p, n)), rng.standard_normal((p, m))
    discrete = bool(rng.random() < 0.5)
    return System(expm(A / RATE_HZ) if discrete else A, B / (10 if discrete else 1), C, D, discrete)


def every_entry(system: System) -> list[Entry]:
    """Return all entries of all matrices."""
    return [(name, i, j) for name in MATRICES for i, j in np.ndindex(getattr(system, name).shape)]


def sensitivities(
    system: System, entries: list[Entry], u: FloatArray, x0: FloatArray, sigma: FloatArray | float = 1.0
) -> FloatArray:
    """Return d y / sigma by each entry (N p, q), by central differences, the initial state projected out."""
    columns = []
    for entry in entries:
        value = system.entry(entry)
        step = 1e-5 * max(abs(value), 0.1 * float(np.abs(getattr(system, entry[0])).max()))
        apart = [system.moved([entry], np.array([value + sign * step])).motion(u, x0) for sign in (1, -1)]
        columns.append(((apart[0] - apart[1]) / sigma).ravel() / (2 * step))
    free = [(system.motion(0 * u, e) / sigma).ravel() for e in np.eye(len(x0))]
    basis = np.linalg.svd(np.column_stack(free), full_matrices=False)[0]
    psi = np.column_stack(columns)
    for _ in range(2):
        psi = psi - basis @ (basis.T @ psi)
    return psi


def rank(psi: FloatArray) -> int:
    """Return how many parameters sensitivities tell apart."""
    lengths = np.linalg.norm(psi, axis=0)
    values = np.linalg.svd(psi / np.where(lengths > 0, lengths, 1.0), compute_uv=False)
    return int(np.sum(values > 1e-6 * values[0]))


def told(rng: np.random.Generator, system: System, psi: FloatArray, most: int) -> list[int]:
    """Return numbers of some entries that a record tells apart well, drawn one after another."""
    chosen: list[int] = []
    unit = psi / np.linalg.norm(psi, axis=0)
    for i in rng.permutation(psi.shape[1]).tolist():
        values = np.linalg.svd(unit[:, [*chosen, i]], compute_uv=False)
        if values[-1] > 0.05 * values[0] and len(chosen) < most:
            chosen.append(i)
    return sorted(chosen)


def configuration(
    system: System, entries: list[Entry], sigma: FloatArray, window_s: float, observer: str = ""
) -> RigConfig:
    """Return the configuration of a system whose entries are uncertain; sigma (p,) is its sensors' noise."""
    time = f'time = "discrete"\nrate_hz = {RATE_HZ}\n' if system.discrete else ""
    matrices = "".join(f"{name} = {json.dumps(getattr(system, name).tolist())}\n" for name in MATRICES)
    names = json.dumps([f"{name}[{i},{j}]" for name, i, j in entries])
    text = (
        f'[rig]\nname = "random"\nsample_rate_hz = {RATE_HZ}\nclock = "uniform"\n[model]\nkind = "linear"\n'
    )
    text += f"{time}{matrices}uncertain = {names}\n"
    for i in range(system.B.shape[1]):
        text += f'[[channel]]\nname = "u{i}"\nquantity = "input"\nunit = "1"\n{EXACT}'
    for i, noise in enumerate(sigma.tolist()):
        text += f'[[channel]]\nname = "y{i}"\nquantity = "output"\nunit = "1"\nnoise_sd = {noise!r}\n'
        text += "gain_sd_percent = 0.0\n"
    text += f"[estimator]\nwindow_s = {window_s}\nhop_s = {window_s}\n{observer}"
    with TemporaryDirectory() as folder:
        file = Path(folder) / "rig.toml"
        file.write_text(text, encoding="utf-8")
        return load(file)
