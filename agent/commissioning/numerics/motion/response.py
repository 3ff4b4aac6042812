"""A start where motions are missing: the graph's frequency response fitted to the recordings'.

Stretches give the response of each output to each input, H = S_yu S_uu⁻¹, and what of the output no input
explains (Bendat & Piersol, Random Data, 4th ed. 2010, chapter 7). The graph's is, w_e an element's ends,

    H(θ) = C (iω)^r G⁻¹ B,   G = Σ θ_e (iω)^j w_e w_eᵀ,   dH/dθ_e = -C (iω)^r G⁻¹ w_e (iω)^j w_eᵀ G⁻¹ B

j = 0, 1, 2 of springs, dampers, masses. Unknown are logarithms, and errors are those of log H, which have few
false minima: Levenberg's and Marquardt's steps from guesses all over the band in which the machine moves.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.commissioning import tuning
from agent.commissioning.numerics.motion.modulation import Modulation, held
from agent.numerics.model.mechanics import GROUND, Element, MassSpringDamper
from agent.types import BoolArray, FloatArray

ComplexArray = NDArray[np.complex128]
KINDS = {"displacement": 0, "velocity": 1, "acceleration": 2}


@dataclass(frozen=True)
class Responses:
    """Measured responses H (F, p, m) at omega (F,), and weights (F, p, m): 0 of what says nothing."""

    omega: FloatArray
    H: ComplexArray
    weight: FloatArray


def measured(
    pieces: Sequence[tuple[FloatArray, FloatArray]], period_s: float, sigma: FloatArray, *, straight: bool
) -> Responses:
    """Return the responses of outputs y (N, p) to inputs u (N, m); sigma (p,): sensor sds.

    Raises ValueError where no piece is long enough.
    """
    length = max(len(y) for y, _ in pieces) // tuning.PARTS
    if length < tuning.SHORTEST_STRETCH:
        raise ValueError("no piece is long enough")
    modulation = Modulation(length, period_s, tuning.SMOOTH)
    p = len(sigma)
    found = np.array([
        modulation.transforms(np.hstack([y[a : a + length], u[a : a + length]]))[0]
        for y, u in pieces
        for a in range(0, len(y) - length + 1, length // 2)
    ])  # fmt: skip
    y = found[..., :p]
    u = found[..., p:] * held(modulation.omega, period_s, straight=straight)[:, None]
    S_uu = np.einsum("sfi,sfj->fij", u, u.conj())
    size = np.trace(S_uu, axis1=1, axis2=2).real[:, None, None]
    inverse = np.linalg.inv(S_uu + 1e-9 * (size + 1e-12 * size.max()) * np.eye(u.shape[2]))
    H: ComplexArray = np.einsum("sfp,sfi,fim->fpm", y, u.conj(), inverse)
    left = np.sum(np.abs(y - np.einsum("fpm,sfm->sfp", H, u)) ** 2, axis=0) / max(len(found) - u.shape[2], 1)
    white = sigma**2 * length * period_s**2 * 0.27
    error = np.sqrt(
        np.maximum(_smoothed(left), white)[:, :, None] * np.abs(np.einsum("fii->fi", inverse))[:, None]
    )
    relative = error / np.maximum(np.abs(H), 1e-300)
    weight = np.where(_certain(H, error, relative), 1.0 / np.hypot(relative, tuning.ROUGH), 0.0)
    weight[:2] = 0.0
    return _thinned(Responses(modulation.omega, H, weight))


def _certain(H: ComplexArray, error: FloatArray, relative: FloatArray) -> BoolArray:
    """Return which responses (F, p, m) say something, alone and among their neighbours.

    Of bins that are all noise 2 % pass the first test by chance, and are orders of magnitude off.
    """
    around = [
        _smoothed(power.reshape(len(power), -1)).reshape(power.shape) for power in (np.abs(H) ** 2, error**2)
    ]
    return np.asarray((relative < tuning.CERTAIN) & (around[1] < tuning.CERTAIN**2 * around[0]))


def _smoothed(power: FloatArray) -> FloatArray:
    """Return powers (F, p) averaged over neighbours: few stretches make each a rough one."""
    kernel = np.ones(9) / 9
    return np.array([np.convolve(np.pad(row, 4, mode="edge"), kernel, "valid") for row in power.T]).T


def _thinned(at: Responses) -> Responses:
    kept = np.flatnonzero(at.weight.any(axis=(1, 2)))
    kept = kept[:: -(-len(kept) // tuning.MOST_BINS)] if len(kept) else kept
    return Responses(at.omega[kept], at.H[kept], at.weight[kept])


class Graph:
    """The frequency response of a graph and its derivatives, of many parameter sets at once."""

    def __init__(self, model: MassSpringDamper, omega: FloatArray) -> None:
        s = model.structure
        self.nodes = [mass.name for mass in s.masses]
        self.names = list(model.parameters)
        self.iw = 1j * omega
        N = len(self.nodes)
        self.fixed = np.zeros((len(omega), N, N), dtype=complex)
        self.ways, self.order = np.zeros((len(self.names), N)), np.zeros(len(self.names), dtype=np.int64)
        masses = [(m.name, m.value, np.eye(N)[i]) for i, m in enumerate(s.masses)]
        terms = (
            [(e.name, e.nominal, self._way(e)) for e in s.springs],
            [(e.name, e.nominal, self._way(e)) for e in s.dampers],
            masses,
        )
        for order, elements in enumerate(terms):
            for name, value, way in elements:
                self._put(name, value, way, order)
        self.C = np.array([np.eye(N)[self.nodes.index(o.at)] for o in model.outputs])
        self.rises = self.iw[:, None] ** np.array([KINDS[o.quantity] for o in model.outputs])
        self.B = np.array([np.eye(N)[self.nodes.index(at)] for at in model.forces]).T

    def _put(self, name: str, value: float, way: FloatArray, order: int) -> None:
        if name in self.names:
            self.ways[self.names.index(name)], self.order[self.names.index(name)] = way, order
        else:
            self.fixed += value * (self.iw**order)[:, None, None] * np.outer(way, way)

    def _way(self, element: Element) -> FloatArray:
        way = np.zeros(len(self.nodes))
        for node, sign in zip(element.between, (1.0, -1.0), strict=True):
            if node != GROUND:
                way[self.nodes.index(node)] += sign
        return way

    def at(self, theta: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Return H (S, F, p, m) and dH (S, F, q, p, m) at theta (S, q)."""
        turn = self.iw[:, None] ** self.order
        G = self.fixed + np.einsum("sq,fq,qi,qj->sfij", theta, turn, self.ways, self.ways, optimize=True)
        X = np.linalg.inv(G)
        out = self.rises[None, :, :, None] * (self.C @ X)
        H = out @ self.B
        left, right = out @ self.ways.T, self.ways @ (X @ self.B)
        dH = -turn[None, :, :, None, None] * np.einsum("sfpq,sfqm->sfqpm", left, right)
        return H, dH


def fitted(model: MassSpringDamper, seen: Responses) -> list[FloatArray]:
    """Return the parameters (q,) of the lowest minima, the lowest first."""
    graph = Graph(model, seen.omega)
    phi = _guesses(model, graph, seen)
    seen, middle = _connected(graph, seen, phi), phi.mean(axis=0)
    cost, J, r = _errors(graph, seen, phi, middle)
    damping = np.full(len(phi), 1e-2)
    for turn in range(tuning.ROUNDS_OF_A_START):
        if turn == tuning.FIRST_ROUNDS:
            best = np.argsort(cost)[: tuning.FOLLOWED]
            phi, cost, J, r, damping = phi[best], cost[best], J[best], r[best], damping[best]
        A, g = np.einsum("sqn,skn->sqk", J, J), np.einsum("sqn,sn->sq", J, r)
        diagonal = np.einsum("sqq->sq", A)
        A = A + (damping[:, None] * diagonal + 1e-9 * diagonal.max(axis=1, keepdims=True))[
            ..., None
        ] * np.eye(A.shape[1])
        tried = phi - np.clip(np.linalg.solve(A, g[..., None])[..., 0], -1.0, 1.0)
        there = _errors(graph, seen, tried, middle)
        better = there[0] < cost
        phi = np.where(better[:, None], tried, phi)
        cost = np.where(better, there[0], cost)
        J = np.where(better[:, None, None], there[1], J)
        r = np.where(better[:, None], there[2], r)
        damping = np.clip(np.where(better, damping / 4, damping * 6), 1e-9, 1e6)
    return _apart(phi[np.argsort(cost)], graph.order != 1)


def _apart(phi: FloatArray, telling: BoolArray) -> list[FloatArray]:
    """Return parameters of rows (S, q) of logarithms that differ in what is telling (q,), the first few."""
    kept: list[FloatArray] = []
    for row in phi:
        if len(kept) < tuning.MOST_MINIMA and all(
            np.abs(row - other)[telling].max(initial=0.0) > tuning.ALIKE for other in kept
        ):
            kept.append(row)
    return [np.exp(row) for row in kept]


def _connected(graph: Graph, seen: Responses, phi: FloatArray) -> Responses:
    """Return the responses without those of outputs that a force does not reach."""
    H = np.abs(graph.at(np.exp(phi[:1]))[0][0])
    reached = np.any(H.max(axis=(0, 2), keepdims=True) * 1e-12 < H, axis=0)
    return Responses(seen.omega, seen.H, seen.weight * reached)


def _errors(
    graph: Graph, seen: Responses, phi: FloatArray, middle: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return costs (S,), derivatives (S, q, n) and errors (S, n).

    Errors are those of log H, and of phi (S, q) about the middle (q,).
    """
    theta = np.exp(phi)
    H, dH = graph.at(theta)
    used = seen.weight > 0
    w = seen.weight[used]
    e = w * np.log(H[:, used] / seen.H[used])
    D = w * (theta[:, None, :, None, None] * dH).swapaxes(1, 2)[:, :, used] / H[:, None, used]
    r = np.concatenate([e.real, e.imag, (phi - middle) / tuning.VAGUE_LOG], axis=1)
    known = np.broadcast_to(np.eye(phi.shape[1]) / tuning.VAGUE_LOG, (len(phi), *2 * phi.shape[1:]))
    return np.sum(r**2, axis=1), np.concatenate([D.real, D.imag, known], axis=2), r


def _guesses(model: MassSpringDamper, graph: Graph, seen: Responses) -> FloatArray:
    """Return logarithms (S, q): springs that move the lighter of their ends at a frequency of the band."""
    rng = np.random.default_rng(tuning.SEED)
    speed = np.abs(seen.H / graph.rises[:, :, None] * graph.iw[:, None, None]) ** 2
    share = np.cumsum(np.sum(speed / np.maximum(speed.sum(axis=0), 1e-300), axis=(1, 2)))
    low, high = (float(seen.omega[np.searchsorted(share, part * share[-1])]) for part in (0.05, 0.95))
    w = np.exp(rng.uniform(np.log(0.7 * low), np.log(1.5 * high), (tuning.STARTS, len(graph.names))))
    mass = np.array([m.value for m in model.structure.masses])
    typical = float(np.median(mass[mass > 0])) if (mass > 0).any() else 1.0
    lightest = np.array([min((m for m in mass[way != 0] if m > 0), default=typical) for way in graph.ways])
    size = np.array([lightest * w**2, 2 * tuning.DAMPING * lightest * w, np.broadcast_to(typical, w.shape)])
    rows = np.take_along_axis(size, np.broadcast_to(graph.order, (1, *w.shape)), axis=0)
    return np.asarray(np.log(rows[0]))
