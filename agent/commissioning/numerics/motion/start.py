"""A start from nothing: the weak form solved by least squares, then by refined instruments.

Bins are weighed by what the sensors' noise leaves of them, N = G Σ Gᴴ + unknown forces, G the dynamic
stiffness at the estimate before. Noise in the columns biases least squares; what it adds to the normal
equations is known and taken out. Where forces are measured, the columns of the motion that they cause, G⁻¹ F,
are instruments: they know nothing of the noise, whatever it is (Young & Jakeman's refined instrumental
variables, Int. J. Control 29 (1979) 1, bin by bin).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from agent.commissioning.numerics.motion.weak_form import (
    Equations,
    Sensing,
    Spectra,
    spectra,
    usable_nodes,
)
from agent.commissioning.tuning import RESTS, SCALES, SHORTEST_STRETCH, STILL_VARIANCE, WEAK_ROUNDS
from agent.numerics.model.mechanics import GROUND, MassSpringDamper
from agent.types import FloatArray

ComplexArray = NDArray[np.complex128]


def hidden(model: MassSpringDamper) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the parameters that no equation with measured motion only holds, and the unmeasured nodes."""
    sensing = Sensing.of(model)
    usable = usable_nodes(model, sensing)
    s = model.structure
    nodes = [mass.name for mass in s.masses]
    held = {name for name, use in zip(nodes, usable.tolist(), strict=True) if use}
    for element in (*s.springs, *s.dampers, *s.frictions):
        if held & set(element.between):
            held.add(element.name)
    return tuple(name for name in model.parameters if name not in held), sensing.unseen


def start(
    model: MassSpringDamper, pieces: Sequence[tuple[FloatArray, FloatArray]], period_s: float,
    sigma: FloatArray,
    *, straight: bool, standing: bool,
) -> FloatArray:  # fmt: skip
    """Return parameters (q,) of records (y (N, p), u (N, m), friction signs last); sigma (p,): sensor sds.

    Raises ValueError where no piece is long enough.
    """
    sensing = Sensing.of(model)
    equations = Equations(model, usable_nodes(model, sensing), standing and sensing.highest == 0)
    at = _joined(model, sensing, pieces, period_s, straight=straight)
    noise = sigma[sensing.sensor] ** 2
    return _Solver(equations, sensing, at, noise).solve()


def _joined(
    model: MassSpringDamper, sensing: Sensing, pieces: Sequence[tuple[FloatArray, FloatArray]],
    period_s: float,
    *, straight: bool,
) -> Spectra:  # fmt: skip
    # a motion that dies away is seen by short stretches near its beginning
    scales = SCALES[1:2] if model.forces else SCALES
    parts = [
        spectra(model, sensing, y[here], u[here], period_s, straight=straight)
        for y, u in pieces
        for here in _stretches(len(y), scales)
    ]
    if not parts:
        raise ValueError("no piece is long enough")
    return Spectra.joined(parts)


def _stretches(samples: int, scales: Sequence[int]) -> Iterator[slice]:
    """Yield stretches, half overlapping, of so many samples divided by each scale; none that is too short."""
    lengths = [samples // scale for scale in scales]
    for length in (length for length in lengths if length >= SHORTEST_STRETCH):
        for first in range(0, samples - length + 1, max(1, length // 2)):
            yield slice(first, first + length)


def rests(pieces: Sequence[tuple[FloatArray, FloatArray]], sigma: FloatArray) -> bool:
    """Whether no output (p,) moves beyond the noise of its sensor."""
    y = np.concatenate([piece - piece.mean(axis=0) for piece, _ in pieces])
    return bool(np.all(y.var(axis=0) <= STILL_VARIANCE * sigma**2 + 1e-300))


def still(
    model: MassSpringDamper, pieces: Sequence[tuple[FloatArray, FloatArray]], sigma: FloatArray
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the elements that nothing stretches, and nodes that do not move beyond their sensors' noise."""
    sensing = Sensing.of(model)
    s = model.structure
    names = [mass.name for mass in s.masses]
    sensor = {names[i]: r for i, r in zip(sensing.node.tolist(), sensing.sensor.tolist(), strict=True)}
    y = np.concatenate([piece - piece.mean(axis=0) for piece, _ in pieces])

    def quiet_between(ends: Sequence[str]) -> bool:
        if any(end not in sensor for end in ends if end != GROUND):
            return False
        places = [sensor[end] for end in ends if end != GROUND]
        alike = len({model.outputs[place].quantity for place in places}) == 1
        motion = y[:, places] @ np.array([1.0, -1.0][: len(places)]) if alike else y[:, places[0]]
        return bool(motion.var() <= STILL_VARIANCE * np.sum(sigma[places] ** 2) + 1e-300)

    elements = [e for e in (*s.springs, *s.dampers, *s.frictions) if e.name in model.parameters]
    quiet = tuple(e.name for e in elements if quiet_between(e.between))
    return quiet, tuple(name for name in names if quiet_between([name]))


@dataclass
class _Solver:
    """The weak form of all stretches: equations, sensors, transforms `at`, variances (v,) of sensor noise."""

    equations: Equations
    sensing: Sensing
    at: Spectra
    noise: FloatArray

    def solve(self) -> FloatArray:
        """Return the parameters (q,)."""
        P, b = self.equations.regression(self.at)
        q = len(self.equations.model.parameters)
        N = self._first_weight()
        theta = self._solved(P, P, b, N, compensated=False)
        for turn in range(WEAK_ROUNDS):
            N = self._weight(theta[:q], P, b, theta)
            instruments = turn > 2 and bool(self.equations.model.forces)
            Z = self._instruments(theta[:q], P) if instruments else P
            found = self._solved(Z, P, b, N, compensated=not instruments)
            rests = np.all(np.abs(found - theta)[:q] <= RESTS * np.abs(found)[:q])
            theta = found
            if rests and turn > 4:
                break
        return np.asarray(theta[:q])

    def _scattered(self) -> FloatArray:
        """(b, v) variance that sensor noise gives the transforms of the measured nodes' displacements."""
        r = self.sensing.highest
        lowest = float(np.min(self.at.omega[self.at.omega > 0]))
        w = np.maximum(self.at.omega, lowest)[:, None]
        return np.asarray(self.noise * self.at.energy[:, None] * w ** (2.0 * (r - self.sensing.order)))

    def _first_weight(self) -> ComplexArray:
        """N (b, n, n) before anything is known: of masses and equal stiffness at the motion's frequency."""
        power = np.abs(self.at.motion[0]) ** 2
        rows = self.equations.usable
        w = self.at.omega
        middle = np.sum(power * w[:, None] ** 2) / np.sum(power)
        masses = np.array([m.value or 1.0 for m in self.equations.model.structure.masses])
        N = np.zeros((len(w), rows.sum(), rows.sum()), dtype=complex)
        each = (masses[rows] ** 2) * (w[:, None] ** 4 + middle**2) * w[:, None] ** (2 * self.sensing.highest)
        every = np.arange(int(rows.sum()))
        N[:, every, every] = np.maximum(each, 1e-12 * each.max()) * self.at.energy[:, None]
        return N

    def _gain(self, theta: FloatArray) -> ComplexArray:
        """(b, n, v) dynamic stiffness between usable equations and measured nodes."""
        G = self.equations.stiffness(theta, self.at.omega)
        return G[:, self.equations.usable][:, :, self.sensing.node]

    def _weight(self, theta: FloatArray, P: ComplexArray, b: ComplexArray, whole: FloatArray) -> ComplexArray:
        G = self._gain(theta)
        noise = self._scattered()
        N: ComplexArray = np.einsum("bnv,bv,bmv->bnm", G, noise, G.conj()).astype(np.complex128)
        every = np.arange(N.shape[1])
        left = np.abs(b - P @ whole) ** 2
        force = np.maximum(np.median(left - N[:, every, every].real, axis=0), 0.0)
        floor = 1e-10 * (np.mean(np.abs(self.at.force) ** 2) + np.mean(np.abs(b) ** 2))
        N[:, every, every] += force + floor + 1e-300
        return N

    def _instruments(self, theta: FloatArray, P: ComplexArray) -> ComplexArray:
        """Return the columns of the motion that the measured forces cause at theta (q,)."""
        G = self.equations.stiffness(theta, self.at.omega)
        s, model = self.at, self.equations.model
        force = s.force.copy()
        for i, friction in enumerate(model.at(theta).frictions):
            nodes = [m.name for m in model.structure.masses]
            for node, sign in zip(friction.between, (1.0, -1.0), strict=True):
                if node in nodes:
                    force[:, nodes.index(node)] -= sign * friction.nominal * s.slip[:, i]
        # at rest a free rig has no stiffness
        scale = np.abs(G).max(axis=(1, 2), keepdims=True)
        G = G + (1e-9 * scale + 1e-12 * scale.max()) * np.eye(G.shape[1])
        x = np.linalg.solve(G, force[..., None])[..., 0]
        iw = 1j * s.omega[:, None]
        Z, _ = self.equations.regression(replace(s, motion=np.array([x, iw * x, iw**2 * x])))
        return Z

    def _solved(
        self, Z: ComplexArray, P: ComplexArray, b: ComplexArray, N: ComplexArray, *, compensated: bool
    ) -> FloatArray:
        """Return the unknowns from Re Zᴴ N⁻¹ (P θ - b) = 0, noise in the columns' products taken out."""
        W: ComplexArray = np.asarray(np.linalg.inv(N), dtype=np.complex128)
        A = np.einsum("bnc,bnm,bmd->cd", Z.conj(), W, P, optimize=True).real
        g = np.einsum("bnc,bnm,bm->c", Z.conj(), W, b, optimize=True).real
        if compensated:
            dA, dg = self._added(W)
            A, g = A - dA, g - dg
        size = np.sqrt(np.maximum(np.abs(np.diag(A)), 1e-300))
        return np.asarray(np.linalg.lstsq(A / np.outer(size, size), g / size, rcond=1e-12)[0] / size)

    def _added(self, W: ComplexArray) -> tuple[FloatArray, FloatArray]:
        """Return what the sensors' noise adds to Pᴴ W P and Pᴴ W b."""
        s = self.at
        noise = self._scattered()
        dA, dg = np.zeros((self.equations.columns,) * 2), np.zeros(self.equations.columns)
        iw = 1j * s.omega
        for v, node in enumerate(self.sensing.node):
            x = np.zeros((len(s.omega), s.force.shape[1]), dtype=complex)
            x[:, node] = np.sqrt(noise[:, v])
            motion = np.array([x, iw[:, None] * x, iw[:, None] ** 2 * x])
            alone = replace(
                s,
                motion=motion,
                force=np.zeros_like(s.force),
                slip=np.zeros_like(s.slip),
                standing=0 * s.standing,
            )
            P, b = self.equations.regression(alone)
            dA += np.einsum("bnc,bnm,bmd->cd", P.conj(), W, P, optimize=True).real
            dg += np.einsum("bnc,bnm,bm->c", P.conj(), W, b, optimize=True).real
        return dA, dg
