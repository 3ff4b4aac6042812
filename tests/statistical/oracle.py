"""What nobody can know better: each parameter's Cramér-Rao sd in each window, given the noise's spectrum.

Dense generalised least squares in the time domain, of the simulator's own motion; no code is shared with the
agent. With readings y = Γ e₀ + Ψ δ + Ξ η + n, n ~ N(0, S) as it truly is, e₀ and δ flat, the sds are those of
δ with the constants η

    exact     known
    sheet     N(0, data sheet) anew in each window
    carried   N(0, data sheet) before the first window, and what all windows up to this one say of them

The little that an unknown force's own spectrum tells of the rig is not counted: its motion is not known.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular, toeplitz

from agent.types import FloatArray
from sim_bus.rig.plant import equations, step
from tests.statistical.nearly_right import CASES, SETTLE_WINDOWS, Play

MASS_SHEET, GAIN_SHEET, DELAY_SHEET = 0.02, 0.01, 0.25
"""Data sheets where a configuration says none: of logarithms, and samples."""
ENOUGH = 0.33 * 0.15
"""Relative sd up to which a row is valid: `resolve` times the alarm limit of 15 %."""
CHANGE = 1e-4


@dataclass(frozen=True)
class Spectrum:
    """The noise of a case as it truly is.

    Attributes:
        pole: a of all sensors' Gauss-Markov noise; 0: white.
        forces: (mass, sd, pole) of unknown Gauss-Markov forces.
        digits: significant digits of the readings, their rounding taken for white noise; 0: all.
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
"""Cases of `nearly_right` in which forces or colours may hide a parameter."""


@dataclass(frozen=True)
class Bound:
    """Relative Cramér-Rao sds (windows, q) of disjoint windows, constants known as the module's text says."""

    exact: FloatArray
    sheet: FloatArray
    carried: FloatArray


def known(sd: FloatArray) -> float:
    """The share of estimates that are sharp enough for a valid row."""
    return float((sd <= ENOUGH).mean())


def bound(name: str, seed: int, windows: int) -> Bound:
    """The bound of the recording that `nearly_right.play` makes of the same name, seed and windows."""
    made = recording(name, seed, windows)
    return bound_of(made, SPECTRA[name], windows)


def recording(name: str, seed: int, windows: int) -> Play:
    case = CASES[name]
    rng = np.random.default_rng([seed, *name.encode()])
    made = Play.of(case.chain, rng, (SETTLE_WINDOWS + windows) * case.chain.window + 1)
    for change in case.changes:
        change(made, rng)
    return made


def bound_of(made: Play, spectrum: Spectrum, windows: int) -> Bound:
    W, q, masses = made.chain.window, len(made.chain.theta), len(made.masses)
    sheets = np.array([MASS_SHEET] * masses + [GAIN_SHEET] * (len(made.chain.sensors) + 1) + [DELAY_SHEET])
    columns, free, noise = derivatives(made), free_responses(made), Noise(spectrum, made)
    y = motion(made)
    for change in made.after:
        y = change(y)
    exact, sheet, carried = [], [], []
    told = np.diag(sheets**-2.0)
    for start in range(SETTLE_WINDOWS * W, (SETTLE_WINDOWS + windows) * W, W):
        here = slice(start, start + W)
        X = np.concatenate([free, columns[here]], axis=2).reshape(-1, free.shape[2] + columns.shape[2])
        w = solve_triangular(noise.factor(y[here]), X, lower=True)
        Q, _ = np.linalg.qr(w[:, : free.shape[2]])
        left = w[:, free.shape[2] :] - Q @ (Q.T @ w[:, free.shape[2] :])
        G = left.T @ left
        V = np.linalg.inv(G[:q, :q])
        Z = V @ G[:q, q:]
        S = G[q:, q:] - G[q:, :q] @ Z
        told = told + S
        exact.append(np.sqrt(np.diag(V)))
        for found, precision in ((sheet, np.diag(sheets**-2.0) + S), (carried, told)):
            found.append(np.sqrt(np.diag(V + Z @ np.linalg.inv(precision) @ Z.T)))
    return Bound(np.array(exact), np.array(sheet), np.array(carried))


def derivatives(made: Play) -> FloatArray:
    """Ψ, Ξ (N, p, q + c): by the logarithms of parameters, masses, gains of outputs and force; by the delay.

    From rest at the recording's start: from a window's start on they differ by a free response only.
    """
    sizes = np.concatenate([made.chain.theta, made.masses])
    columns = []
    for i in range(len(sizes)):
        moved = CHANGE * sizes * (np.arange(len(sizes)) == i)
        columns.append((motion(made, moved) - motion(made, -moved)) / (2 * CHANGE))
    y = motion(made)
    columns += [y * (np.arange(y.shape[1]) == output) for output in range(y.shape[1])]
    driven = motion(made, unknown=False)
    return np.stack([*columns, driven, -np.gradient(driven, axis=0)], axis=2)


def motion(made: Play, moved: FloatArray | float = 0.0, unknown: bool = True) -> FloatArray:
    """(N, p) motion of the true rig, its parameters and masses moved."""
    chain, q = made.chain, len(made.chain.theta)
    every = 1 if made.fine is None else len(made.fine) // len(made.force)
    values = np.concatenate([chain.theta, made.masses]) + moved
    forces = np.repeat(made.others, every, axis=0) * unknown
    forces[:, -1] += made.force if made.fine is None else made.fine
    rate_hz = every * chain.rate_hz
    return chain.motion(forces, values[q:].tolist(), made.hold, [(0, values[:q])], rate_hz)[::every]  # type: ignore[arg-type]


def _impulses(made: Play) -> tuple[FloatArray, FloatArray]:
    """The response (W, p, n) to each initial state, and (W, p, masses) to 1 N in the first sample."""
    chain = made.chain
    values = dict(zip(chain.names, chain.theta.tolist(), strict=True))
    rig = equations(chain.graph, values | {f"m{i + 1}": m for i, m in enumerate(made.masses)})
    one = step(rig, 1.0 / chain.rate_hz, made.hold)  # type: ignore[arg-type]
    seen, direct = (
        np.array(part)
        for part in zip(*(rig.output(kind, f"m{mass + 1}") for kind, mass in chain.sensors), strict=True)
    )
    free, pushed = np.eye(len(one.A)), one.B1
    out = [(seen @ free, seen @ pushed + direct)]
    pushed = one.A @ pushed + one.B0
    for _ in range(1, chain.window):
        free = one.A @ free
        out.append((seen @ free, seen @ pushed))
        pushed = one.A @ pushed
    return np.array([f for f, _ in out]), np.array([p for _, p in out])


def free_responses(made: Play) -> FloatArray:
    """Γ (W, p, n), columns scaled."""
    free = _impulses(made)[0]
    return np.asarray(free / np.sqrt((free**2).sum(axis=(0, 1))))


class Noise:
    """The covariance (Wp, Wp) of a window's noise, readings in order of time, then of outputs.

    What an unknown force did before the window is in its initial state.
    """

    def __init__(self, spectrum: Spectrum, made: Play) -> None:
        W, p = made.chain.window, len(made.chain.sensors)
        self._digits = spectrum.digits
        self.S = np.kron(_markov(spectrum.pole, W), np.diag(np.array(made.chain.noise) ** 2))
        impulses = _impulses(made)[1]
        for mass, sd, pole in spectrum.forces:
            pushed = np.zeros((W, p, W))
            for sample in range(W):
                pushed[sample:, :, sample] = impulses[: W - sample, :, mass]
            G = pushed.reshape(W * p, W)
            self.S = self.S + sd**2 * G @ _markov(pole, W) @ G.T
        self._factor = cholesky(self.S, lower=True)

    def factor(self, y: FloatArray) -> FloatArray:
        """L of L Lᵀ = S in a window of readings y (W, p), with what rounding them adds."""
        if not self._digits:
            return np.asarray(self._factor)
        size = 10.0 ** (np.floor(np.log10(np.maximum(np.abs(y), 1e-300))) - self._digits + 1)
        return np.asarray(cholesky(self.S + np.diag(size.reshape(-1) ** 2 / 12), lower=True))


def _markov(pole: float, samples: int) -> FloatArray:
    return np.asarray(toeplitz(pole ** np.arange(samples)) if pole else np.eye(samples))
