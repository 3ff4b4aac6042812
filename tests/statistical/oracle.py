"""What nobody can know better: the Cramér-Rao sd of each parameter in each window where the noise's spectrum is given.

Dense generalised least squares in the time domain, from the simulator's own motion; it shares no code with the
agent. With readings y = Γ e₀ + Ψ δ + Ξ η + n, n ~ N(0, S), S as it truly is, e₀ and δ flat, the sds are those of
δ with the constants η

    exact     known
    sheet     N(0, data sheet) anew in each window
    carried   N(0, data sheet) before the first window, and what all windows up to this one say of them

The little that an unknown force's own spectrum tells of the rig is not counted: its motion is not known.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import cholesky, solve_triangular, toeplitz

from agent.types import FloatArray
from sim_bus.rig.plant import equations, step
from tests.statistical.chains import Chain
from tests.statistical.nearly_right import CASES, SETTLE_WINDOWS, Play

MASS_SHEET, GAIN_SHEET, DELAY_SHEET = 0.02, 0.01, 0.25
"""Data sheets where a configuration says none: of logarithms, and samples."""
RESOLVE, LIMIT = 0.33, 0.15
"""A row is valid up to this share of the alarm limit, which is that share of the parameter."""
STEP = 1e-4


@dataclass(frozen=True)
class Spectrum:
    """The noise of a case as it truly is.

    Attributes:
        pole: a of all sensors' Gauss-Markov noise; 0: white.
        forces: (mass, sd, pole) of unknown Gauss-Markov forces.
        digits: significant digits of the readings; 0: all.
    """

    pole: float = 0.0
    forces: tuple[tuple[int, float, float], ...] = ()
    digits: int = 0


SPECTRA: dict[str, Spectrum] = {
    "right": Spectrum(),
    "AR(0.99) 0.05 N": Spectrum(forces=((0, 0.05, 0.99),)),
    "AR(0.99) 0.01 N": Spectrum(forces=((0, 0.01, 0.99),)),
    "drift under an unknown force": Spectrum(forces=((0, 0.02, 0.99),)),
    "AR(0.95) sensors": Spectrum(0.95),
    "AR sensors and held": Spectrum(0.95),
    "late and AR sensors, hold zero": Spectrum(0.95),
    "AR sensors and held, accelerometers": Spectrum(0.95),
    "three digits": Spectrum(digits=3),
    "three digits, AR(0.95) sensors": Spectrum(0.95, digits=3),
}
"""Of the cases that the table of docs/statistics.md compares."""


@dataclass(frozen=True)
class Bound:
    """Relative Cramér-Rao sds (windows, q) of disjoint windows."""

    exact: FloatArray
    sheet: FloatArray
    carried: FloatArray
    names: tuple[str, ...] = field(default=())

    @staticmethod
    def known(sd: FloatArray) -> float:
        """The share of estimates sharp enough for a valid row."""
        return float((sd <= RESOLVE * LIMIT).mean())


def bound(name: str, seed: int, windows: int) -> Bound:
    """Return the bound of the recording that `nearly_right.play` makes of the same name, seed and windows."""
    case, spectrum = CASES[name], SPECTRA[name]
    chain, W = case.chain, case.chain.window
    rng = np.random.default_rng([seed, *name.encode()])
    first = SETTLE_WINDOWS * W
    made = Play.of(chain, rng, first + windows * W + 1)
    for change in case.changes:
        change(made, rng)
    columns, gains, truth = _columns(made)
    free = _free(chain, made)
    noise = _Noise(spectrum, chain, made, W)
    return Bound(*_sds(columns, gains, truth, free, noise, range(first, first + windows * W, W)), chain.names)


def _motion(made: Play, theta: FloatArray, masses: list[float], others: bool = True) -> FloatArray:
    """(N, p) motion of the true rig, or of one whose parameters and masses are others."""
    chain = made.chain
    every = 1 if made.fine is None else len(made.fine) // len(made.force)
    known = made.force if made.fine is None else made.fine
    forces = np.repeat(made.others, every, axis=0) * others
    forces[:, -1] += known
    y = chain.motion(forces, masses, made.hold, [(0, theta)], every * chain.rate_hz)  # type: ignore[arg-type]
    return y[::every]


def _columns(made: Play) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Ψ and Ξ (N, p, q + c), the constants' data sheets (c,), and the readings without noise (N, p).

    From rest at the recording's start: from a window's start they differ by a free response only.
    """
    chain = made.chain
    theta, masses = chain.theta, list(made.masses)
    columns = []
    for i in range(len(theta)):
        up, down = theta.copy(), theta.copy()
        up[i] *= 1 + STEP
        down[i] *= 1 - STEP
        columns.append((_motion(made, up, masses) - _motion(made, down, masses)) / (2 * STEP))
    for i in range(len(masses)):
        up, down = ([m * (1 + s * (j == i)) for j, m in enumerate(masses)] for s in (STEP, -STEP))
        columns.append((_motion(made, theta, up) - _motion(made, theta, down)) / (2 * STEP))
    y, known = _motion(made, theta, masses), _motion(made, theta, masses, others=False)
    columns += [y * (np.arange(y.shape[1]) == c) for c in range(y.shape[1])]
    columns += [known, -np.gradient(known, axis=0)]
    sheets = [MASS_SHEET] * len(masses) + [GAIN_SHEET] * (y.shape[1] + 1) + [DELAY_SHEET]
    for change in made.after:
        y = change(y)
    return np.stack(columns, axis=2), np.array(sheets), y


def _free(chain: Chain, made: Play) -> FloatArray:
    """Γ (W, p, n): the response to each initial state."""
    motion, one = _steps(chain, made)
    seen = np.array([motion.output(quantity, f"m{mass + 1}")[0] for quantity, mass in chain.sensors])
    state, out = np.eye(len(one.A)), []
    for _ in range(chain.window):
        out.append(seen @ state)
        state = one.A @ state
    return np.array(out)


def _steps(chain: Chain, made: Play):  # type: ignore[no-untyped-def] # noqa: ANN202
    values = dict(zip(chain.names, chain.theta.tolist(), strict=True))
    motion = equations(chain.graph, values | {f"m{i + 1}": m for i, m in enumerate(made.masses)})
    return motion, step(motion, 1.0 / chain.rate_hz, made.hold)  # type: ignore[arg-type]


class _Noise:
    """The covariance of a window's noise, readings by time and then by output, and its Cholesky factor."""

    def __init__(self, spectrum: Spectrum, chain: Chain, made: Play, samples: int) -> None:
        self.spectrum, p = spectrum, len(chain.sensors)
        sd = np.array(chain.noise)
        self.S = np.kron(_markov(spectrum.pole, samples), np.diag(sd**2))
        motion, one = _steps(chain, made)
        outputs = [motion.output(quantity, f"m{mass + 1}") for quantity, mass in chain.sensors]
        for mass, force_sd, pole in spectrum.forces:
            pushed = np.zeros((samples, p, samples))
            for s in range(1):
                state = np.zeros(len(one.A))
                impulse = np.zeros((samples, p))
                for k in range(samples):
                    impulse[k] = [h @ state + j[mass] * (k == 0) for h, j in outputs]
                    state = one.A @ state + one.B0[:, mass] * (k == 0)
                    # a straight line begins a sample before the reading where it ends
                    state = state + (one.A @ one.B1[:, mass] * (k == 0))
            late = impulse.copy()
            late[0] += [h @ one.B1[:, mass] for h, _ in outputs]
            for s in range(samples):
                pushed[s:, :, s] = late[: samples - s]
            G = pushed.reshape(samples * p, samples)
            self.S = self.S + force_sd**2 * G @ _markov(pole, samples) @ G.T
        self._factor = cholesky(self.S, lower=True)

    def factor(self, y: FloatArray) -> FloatArray:
        """L of L Lᵀ = S in a window of readings y (W, p), with what rounding them adds."""
        if not self.spectrum.digits:
            return self._factor
        size = 10.0 ** (np.floor(np.log10(np.maximum(np.abs(y), 1e-300))) - self.spectrum.digits + 1)
        return np.asarray(cholesky(self.S + np.diag(size.reshape(-1) ** 2 / 12), lower=True))


def _markov(pole: float, samples: int) -> FloatArray:
    return np.asarray(toeplitz(float(pole) ** np.arange(samples)) if pole else np.eye(samples))


def _sds(
    columns: FloatArray, sheets: FloatArray, y: FloatArray, free: FloatArray, noise: _Noise, starts: range
) -> Iterator[FloatArray]:
    """Relative sds (windows, q) with constants exact, at data sheet, and carried."""
    W, p, n = free.shape
    q = columns.shape[2] - len(sheets)
    exact, sheet, carried = [], [], []
    told = np.zeros((len(sheets), len(sheets)))
    prior = np.diag(sheets**-2.0)
    for start in starts:
        X = np.concatenate([free, columns[start : start + W]], axis=2).reshape(W * p, -1)
        X = X / np.linalg.norm(X, axis=0) * (size := np.linalg.norm(X, axis=0)) if False else X
        w = solve_triangular(noise.factor(y[start : start + W]), X, lower=True)
        Q, _ = np.linalg.qr(w[:, :n])
        rest = w[:, n:] - Q @ (Q.T @ w[:, n:])
        G = rest.T @ rest
        V = np.linalg.inv(G[:q, :q])
        Z = V @ G[:q, q:]
        told = told + G[q:, q:] - G[q:, :q] @ Z
        exact.append(np.sqrt(np.diag(V)))
        both = G + np.diag(np.concatenate([np.zeros(q), sheets**-2.0]))
        sheet.append(np.sqrt(np.diag(np.linalg.inv(both))[:q]))
        carried.append(np.sqrt(np.diag(V + Z @ np.linalg.inv(prior + told) @ Z.T)))
    return iter((np.array(exact), np.array(sheet), np.array(carried)))
